//! Plays images of one size there and back as a camera would: YUV4MPEG2 on standard output, each
//! frame at its own time.
//!
//!     cargo run -p monogrid-video --example player -- FOLDER 30 600 | monogrid run - --realtime
//!
//! FOLDER holds JPEG, PNG or PNM files, which are played in the order of their names; those that
//! repeat the one before are left out. Then frames per second, and seconds. All images are decoded
//! before the first is played, so that playing costs next to nothing.

use monogrid_datasets::read_gray;
use std::error::Error;
use std::io::Write;
use std::path::PathBuf;
use std::thread::sleep;
use std::time::{Duration, Instant};

/// Width, height and pixels.
type Picture = (usize, usize, Vec<u8>);

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args().skip(1);
    let mut next = |name: &str| args.next().ok_or(format!("{name} is missing"));
    let folder = next("FOLDER")?;
    let (rate, seconds): (u32, u32) = (next("RATE")?.parse()?, next("SECONDS")?.parse()?);
    if rate == 0 {
        return Err("RATE is 0, expected at least 1".into());
    }
    let images = decoded(&folder)?;
    let Some((width, height, _)) = images.first() else {
        return Err(format!("{folder} has no images").into());
    };
    let mut out = std::io::stdout().lock();
    writeln!(
        out,
        "YUV4MPEG2 W{width} H{height} F{rate}:1 Cmono XCOLORRANGE=FULL"
    )?;
    let begin = Instant::now();
    let both_ways = 2 * (images.len() - 1).max(1);
    for frame in 0..rate.saturating_mul(seconds) {
        let step = frame as usize % both_ways;
        let shown = images.get(step.min(both_ways - step)).or(images.first());
        let due = Duration::from_secs(1) * frame / rate;
        sleep(due.saturating_sub(begin.elapsed()));
        out.write_all(b"FRAME\n")?;
        out.write_all(shown.map_or(&[], |(_, _, pixels)| pixels))?;
    }
    Ok(())
}

/// The images of a folder.
fn decoded(folder: &str) -> Result<Vec<Picture>, Box<dyn Error>> {
    let entries = std::fs::read_dir(folder)?;
    let paths: Result<Vec<PathBuf>, _> = entries.map(|entry| entry.map(|e| e.path())).collect();
    let mut paths = paths?;
    paths.sort();
    let mut images: Vec<Picture> = Vec::with_capacity(paths.len());
    for path in paths {
        let image = read_gray(&path)?;
        let pixels = image.as_slice().iter().map(|v| *v as u8).collect();
        images.push((image.width(), image.height(), pixels));
    }
    images.dedup();
    let is_same = |pair: &[Picture]| (pair[0].0, pair[0].1) == (pair[1].0, pair[1].1);
    if !images.windows(2).all(is_same) {
        return Err(format!("the images of {folder} have several sizes").into());
    }
    Ok(images)
}
