//! Recordings of robots: MCAP, SQLite and ROS 1, their images, calibrations and inertial readings.
#![no_main]

use libfuzzer_sys::fuzz_target;
use monogrid_bags::Bag;
use std::io::Write;

/// Messages that are decoded at most, of each topic.
const MAX_MESSAGES: usize = 50;

fuzz_target!(|bytes: &[u8]| {
    let mut file = tempfile::NamedTempFile::new_in("/dev/shm").expect("a file in memory");
    file.write_all(bytes).expect("room in memory");
    let Ok(bag) = Bag::open(file.path()) else {
        return;
    };
    for topic in bag.topics() {
        let _ = bag.camera_of(topic);
        for (_, image) in bag.images(topic).take(MAX_MESSAGES).flatten() {
            assert!(image.width() > 0 && image.height() > 0, "{}", topic.name);
        }
        let _ = bag.packets(topic).take(MAX_MESSAGES).count();
    }
});
