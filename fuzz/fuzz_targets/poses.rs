//! Trajectories and times: finite, or an error.
#![no_main]

use libfuzzer_sys::fuzz_target;
use monogrid_datasets::{parse_kitti, parse_seconds, parse_trajectory};
use std::path::Path;

fuzz_target!(|text: &str| {
    let _ = parse_seconds(text);
    let times: Vec<i64> = (0..100).collect();
    let read = [
        parse_trajectory(text, Path::new("fuzz")),
        parse_kitti(text, &times, Path::new("fuzz")),
    ];
    for poses in read.into_iter().flatten() {
        assert!(poses.iter().all(|p| p.world_from_camera.is_finite()));
    }
});
