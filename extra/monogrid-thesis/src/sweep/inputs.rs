//! What a sweep reads, and the folder that it writes to.

use super::pictures::PictureOrders;
use monogrid_app::output::{Inputs, OutputFolder, changed_ns};
use monogrid_app::process::failure::Failure;
use monogrid_app::recorded::Recorded;
use monogrid_app::run::align::Align;
use monogrid_evaluation::TruthGrid;
use monogrid_geometry::Vec3;
use std::path::{Path, PathBuf};

/// A recording and its name in the output.
#[derive(Debug)]
pub struct Named {
    /// Name of its folder.
    pub name: String,
    /// Where it was read.
    pub path: PathBuf,
    /// What it holds.
    pub recorded: Recorded,
}

/// Reads all recordings and gives each a name of its own.
pub fn read_recordings(paths: &[PathBuf], align: &Align) -> Result<Vec<Named>, Failure> {
    let mut named: Vec<Named> = Vec::new();
    for path in paths {
        let stem = path.file_stem().map(|s| s.to_string_lossy().into_owned());
        let folder = std::path::absolute(path)
            .ok()
            .and_then(|p| Some(p.parent()?.file_name()?.to_string_lossy().into_owned()));
        // every run calls its recording the same
        let name = match (stem.as_deref(), folder) {
            (Some("recording") | None, Some(folder)) => folder,
            (stem, _) => stem.unwrap_or("recording").to_owned(),
        };
        if named.iter().any(|other| other.name == name) {
            let said = format!("two recordings are called {name}: give them different file names");
            return Err(Failure::input(said));
        }
        named.push(Named {
            recorded: Recorded::read(path, align)?,
            name,
            path: path.clone(),
        });
    }
    Ok(named)
}

/// The output folder, which may hold an earlier sweep.
pub fn open_folder(
    out: &Path,
    force: bool,
    inputs: &Inputs,
    recordings: &[Named],
) -> Result<OutputFolder, Failure> {
    let folder = OutputFolder::resume(out, force, inputs)?;
    let names: Vec<&str> = recordings.iter().map(|r| r.name.as_str()).collect();
    let names = serde_json::json!({ "recordings": names }).to_string();
    folder.write("sweep.json", names)?;
    Ok(folder)
}

/// The part of the world that pictures show: what is true to be free, or where the cameras were.
pub fn orders(
    recordings: &[Named],
    truth: Option<&TruthGrid>,
    resolutions: &[f64],
) -> PictureOrders {
    /// Around the cameras, where there is no truth.
    const AROUND: f64 = 3.0;
    // the thesis shows maps of 16 mm
    let distance = |r: &f64| (r.ln() - 0.016_f64.ln()).abs();
    let all = resolutions.iter().copied();
    let nearest = all.min_by(|a, b| distance(a).total_cmp(&distance(b)));
    let (low, high) = match truth {
        Some(truth) => {
            let first = truth.center(truth.first_key());
            let edges = truth.size().map(|n| n as f64 * truth.resolution());
            (first, std::array::from_fn(|a| first[a] + edges[a]))
        }
        None => {
            let views = recordings.iter().flat_map(|r| r.recorded.views());
            let centres: Vec<Vec3> = views.map(|v| v.world_from_camera.translation).collect();
            let along = |axis: usize| centres.iter().map(move |centre| centre[axis]);
            let low = |axis| {
                along(axis)
                    .map(|x| x - AROUND)
                    .fold(f64::INFINITY, f64::min)
            };
            let high = |axis| {
                along(axis)
                    .map(|x| x + AROUND)
                    .fold(f64::NEG_INFINITY, f64::max)
            };
            (std::array::from_fn(low), std::array::from_fn(high))
        }
    };
    PictureOrders::new(low, high, nearest.unwrap_or(0.016))
}

/// Name, length and time of change of a file.
pub fn file_stamp(path: &Path) -> Result<String, Failure> {
    let metadata = std::fs::metadata(path)
        .map_err(|error| Failure::input(format!("{} cannot be read: {error}", path.display())))?;
    let (length, changed) = (metadata.len(), changed_ns(&metadata));
    Ok(format!("{} {length} {changed}; ", path.display()))
}
