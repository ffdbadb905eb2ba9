//! Maps in `.bt`: an error, or a map within the budget that can be written and read again.
#![no_main]

use libfuzzer_sys::fuzz_target;
use monogrid_occupancy::{read_bt, write_bt};

const BUDGET: usize = 64 << 20;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(map) = read_bt(bytes, BUDGET) {
        assert!(map.bytes_in_memory() <= BUDGET);
        let mut written = Vec::new();
        if write_bt(&map, &mut written).is_ok() {
            let again = read_bt(&written[..], 2 * BUDGET).expect("what was written is readable");
            assert!(again == map);
        }
    }
});
