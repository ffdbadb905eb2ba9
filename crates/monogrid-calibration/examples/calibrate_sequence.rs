//! Calibrates from the images of a sequence and compares with its calibration:
//! `cargo run --release -p monogrid-calibration --example calibrate_sequence -- FOLDER [START
//! [COUNT]]`.
#![allow(clippy::print_stdout, reason = "an example")]

use monogrid_calibration::{
    CollectorConfig, EstimateConfig, Prior, TrackCollector, estimate_intrinsics,
};
use monogrid_datasets::{Dataset, DatasetError, SourceOptions, read_gray};
use std::path::Path;

fn main() -> Result<(), DatasetError> {
    let mut arguments = std::env::args().skip(1);
    let folder = arguments.next().unwrap_or_else(|| ".".to_owned());
    let mut number = |default: usize| {
        let given = arguments.next().and_then(|text| text.parse().ok());
        given.unwrap_or(default)
    };
    let (start, count) = (number(0), number(600));
    let dataset = Dataset::open(Path::new(&folder), SourceOptions::default())?;
    let mut collector = TrackCollector::new(CollectorConfig::default());
    let mut size = (0, 0);
    for frame in dataset.frames.iter().skip(start).take(count) {
        let image = read_gray(&frame.path)?;
        size = (image.width(), image.height());
        collector.add(&image);
    }
    let windows = collector.finish();
    let prior = Prior::ordinary(62.0, size);
    let config = EstimateConfig::default();
    for (i, window) in windows.iter().enumerate() {
        let one = estimate_intrinsics(std::slice::from_ref(window), size, &prior, &config);
        println!(
            "window {i}: {} views, {} tracks, f {:.1} +- {:.1} px, {:.4?}, rms {:.2} px, used {}",
            window.num_views,
            window.tracks.len(),
            one.intrinsics.focal,
            one.intrinsics.focal * one.sigma[0],
            one.intrinsics.radial,
            one.rms_px,
            one.num_windows
        );
    }
    let all = estimate_intrinsics(&windows, size, &prior, &config);
    println!("{all:.4?}\n95 % interval {:.1?}", all.focal_interval_px());
    if let Some(calibration) = dataset.calibration(Some(size))? {
        println!("calibration {:?}", calibration.camera);
    }
    Ok(())
}
