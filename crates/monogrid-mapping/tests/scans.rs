//! What is mapped of the keyframes of a whole system, on a rendered room.
#![allow(clippy::unwrap_used, reason = "a test fails where it unwraps")]

use monogrid_image::Mask;
use monogrid_mapping::{MappingConfig, final_scans_of};
use monogrid_slam::{FrameInput, Slam, SlamConfig};
use monogrid_worlds::SynthSequence;
use std::fmt::Write;
use std::fs::File;
use std::sync::OnceLock;
use std::sync::atomic::AtomicUsize;

const FRAMES: usize = 70;

fn sequence() -> &'static SynthSequence {
    static SEQUENCE: OnceLock<SynthSequence> = OnceLock::new();
    SEQUENCE.get_or_init(|| SynthSequence::small_demo().unwrap().shortened(FRAMES))
}

/// The first seconds of the small demonstration, rendered once.
fn inputs() -> &'static [FrameInput] {
    static INPUTS: OnceLock<Vec<FrameInput>> = OnceLock::new();
    INPUTS.get_or_init(|| {
        let input = |index: usize| {
            let frame = sequence().frame(index).unwrap();
            FrameInput {
                index,
                timestamp_ns: frame.timestamp_ns,
                image: frame.image,
                depth: (index == 0)
                    .then(|| sequence().depth(0))
                    .flatten()
                    .map(Into::into),
            }
        };
        (0..FRAMES).map(input).collect()
    })
}

/// A run that has ended, with so much memory for keyframes, the rest in a file.
fn run(memory_mb: f64, file: File) -> Slam {
    let mut config = SlamConfig::default();
    config.memory.keyframes_mb = memory_mb;
    config.memory.prepared_mb = memory_mb;
    let camera = sequence().camera();
    let mask = Mask::filled(camera.width, camera.height, 255);
    let mut slam = Slam::new(config, camera.pinhole, mask, 3).unwrap();
    slam.spill_into(file);
    for input in inputs() {
        slam.process_frame(input.clone());
    }
    slam.finish();
    slam
}

#[test]
fn the_same_bits_for_any_number_of_threads_and_any_memory() {
    let on = |threads: usize, memory_mb: f64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        pool.build().unwrap().install(|| {
            let slam = run(memory_mb, tempfile::tempfile().unwrap());
            let (mut text, done) = (String::new(), AtomicUsize::new(0));
            for scan in final_scans_of(&slam, &MappingConfig::default(), threads, &done) {
                writeln!(text, "{} {:?}", scan.num_filled, &**scan.pixels()).unwrap();
            }
            assert_eq!(done.into_inner(), slam.num_keyframes());
            text
        })
    };
    let one = on(1, 1e6);
    assert!(one.len() > 10_000);
    assert!(one == on(2, 1e6), "two threads differ");
    assert!(one == on(5, 0.0), "five threads without memory differ");
}

#[test]
fn depth_that_cannot_be_read_back_is_an_error_of_what_was_made_without_it() {
    use std::io::{Seek as _, SeekFrom, Write as _};
    let mut file = tempfile::tempfile().unwrap();
    let slam = run(0.0, file.try_clone().unwrap());
    let scans = || final_scans_of(&slam, &MappingConfig::default(), 1, &AtomicUsize::new(0));
    let whole: usize = scans().iter().map(|scan| scan.num_pixels).sum();
    let count = slam.num_keyframes();
    assert!(
        whole > 0 && count > 1,
        "{whole} pixels of {count} keyframes"
    );
    slam.check_spilled().unwrap();
    let length = file.seek(SeekFrom::End(0)).unwrap();
    file.seek(SeekFrom::Start(0)).unwrap();
    file.write_all(&vec![0xa5; length as usize]).unwrap();
    let left: usize = scans().iter().map(|scan| scan.num_pixels).sum();
    assert!(left < whole, "{left} of {whole}");
    let said = slam.check_spilled().unwrap_err().to_string();
    assert!(said.contains("cannot be read back"), "{said}");
}
