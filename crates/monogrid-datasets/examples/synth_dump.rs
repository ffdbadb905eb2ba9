//! Writes the demonstration sequence, or any built-in world, as a data set in TUM layout:
//! `cargo run --release -p monogrid-datasets --example synth_dump -- OUT [FRAMES] [WORLD]`.
#![allow(clippy::print_stderr, reason = "progress of an example")]

use monogrid_datasets::synth::{
    Carrier, SynthConfig, SynthSequence, WriteConfig, usual_frames, write_tum_layout,
};
use std::path::Path;
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let Some(folder) = arguments.first() else {
        return Err("usage: synth_dump OUT [FRAMES] [WORLD]".into());
    };
    let world = arguments.get(2).map_or("living-room", String::as_str);
    let whole = usual_frames(world);
    let frames = match arguments.get(1) {
        Some(text) => text.parse()?,
        None => whole,
    };
    // fewer frames show the beginning of the same motion
    let config = SynthConfig {
        frames: frames.max(whole),
        ..SynthConfig::demo()
    };
    let start = Instant::now();
    let sequence = SynthSequence::built_in(world, Carrier::Hand, config)?.shortened(frames);
    eprintln!(
        "{world}: {} triangles, {:?}, path {:.1} m, built in {:.1} s",
        sequence.world().bvh().triangles().len(),
        sequence.world().surface_shares(),
        sequence.path().length_m(30.0),
        start.elapsed().as_secs_f64()
    );
    let start = Instant::now();
    let write = WriteConfig {
        depth_every: 5,
        ..WriteConfig::default()
    };
    write_tum_layout(&sequence, Path::new(folder), &write, |done| {
        if done % 100 == 0 {
            let rate = done as f64 / start.elapsed().as_secs_f64();
            eprintln!("{done} frames, {rate:.1} per second");
        }
    })?;
    Ok(())
}
