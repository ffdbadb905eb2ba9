//! Facts about submaps.

use crate::commands::{bytes, print_json};
use crate::failure::{Classify, Failure};
use monogrid_datasets::{
    Scale, SubmapEntry, SubmapReader, SubmapTable, format_seconds, is_submap, is_submap_table,
    submap_table_in,
};
use serde::Serialize;
use std::path::Path;

/// All submaps of a run, or one file.
#[derive(Debug, Serialize)]
pub struct Submaps {
    format: &'static str,
    keyframes: usize,
    file_bytes: u64,
    submaps: Vec<Submap>,
}

/// What its directory and the table say of one; nothing else is read.
#[derive(Debug, Serialize)]
struct Submap {
    file: String,
    file_bytes: u64,
    keyframes: usize,
    blocks: usize,
    width: usize,
    height: usize,
    scale: &'static str,
    seconds: Option<[String; 2]>,
    bounds_min: Option<[f64; 3]>,
    bounds_max: Option<[f64; 3]>,
    /// Whether it has a pose in the map; `None` of a file alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    is_placed: Option<bool>,
    /// Keyframes that moved in it since it was closed.
    #[serde(skip_serializing_if = "Option::is_none")]
    moved: Option<usize>,
}

impl Submaps {
    /// What lies at a path; `None` where it is something else.
    pub fn at(path: &Path) -> Result<Option<Self>, Failure> {
        if is_submap(path) {
            let submap = Submap::read(path)?;
            return Ok(Some(Self::of("submap (.mgs)", vec![submap])));
        }
        let table = match path.is_dir() {
            true => submap_table_in(path),
            false => is_submap_table(path).then(|| path.to_owned()),
        };
        table.map(|table| Self::of_table(&table)).transpose()
    }

    fn of_table(file: &Path) -> Result<Self, Failure> {
        let folder = file.parent().unwrap_or(Path::new(""));
        let table = SubmapTable::read(file).bad_input()?;
        let submap = |entry: &SubmapEntry| {
            Ok(Submap {
                is_placed: Some(entry.world_from_submap.is_some()),
                moved: Some(entry.moved.len()),
                ..Submap::read(&folder.join(entry.file.file_name()))?
            })
        };
        let submaps = table.submaps.iter().map(submap).collect::<Result<_, _>>()?;
        Ok(Self::of("submaps of a run", submaps))
    }

    fn of(format: &'static str, submaps: Vec<Submap>) -> Self {
        Self {
            format,
            keyframes: submaps.iter().map(|submap| submap.keyframes).sum(),
            file_bytes: submaps.iter().map(|submap| submap.file_bytes).sum(),
            submaps,
        }
    }

    /// Says it.
    pub fn tell(&self, path: &Path, as_json: bool) -> Result<(), Failure> {
        if as_json {
            return print_json(self);
        }
        println!("{}: {}", path.display(), self.format);
        println!(
            "{} files, {} keyframes, {}",
            self.submaps.len(),
            self.keyframes,
            bytes(self.file_bytes)
        );
        self.submaps.iter().for_each(Submap::tell);
        Ok(())
    }
}

impl Submap {
    fn read(path: &Path) -> Result<Self, Failure> {
        let reader = SubmapReader::open(path).bad_input()?;
        let info = reader.info();
        Ok(Self {
            file: reader.id().file_name(),
            file_bytes: std::fs::metadata(path).map_or(0, |metadata| metadata.len()),
            keyframes: reader.num_keyframes(),
            blocks: reader.blocks().len(),
            width: info.camera.width,
            height: info.camera.height,
            scale: match info.scale {
                Scale::Arbitrary => "arbitrary",
                Scale::Metric => "metric",
            },
            seconds: info.times_ns.map(|times| times.map(format_seconds)),
            bounds_min: info.bounds.map(|[low, _]| low),
            bounds_max: info.bounds.map(|[_, high]| high),
            is_placed: None,
            moved: None,
        })
    }

    fn tell(&self) {
        let [first, last] = self.seconds.clone().unwrap_or_default();
        println!(
            "{}: {} keyframes of {}x{} pixels, {first} to {last} s, {}, scale {}",
            self.file,
            self.keyframes,
            self.width,
            self.height,
            bytes(self.file_bytes),
            self.scale
        );
        if let (Some(low), Some(high)) = (self.bounds_min, self.bounds_max) {
            let size: [f64; 3] = std::array::from_fn(|axis| high[axis] - low[axis]);
            println!(
                "    {:.3} x {:.3} x {:.3} in its frame{}",
                size[0],
                size[1],
                size[2],
                match self.is_placed {
                    Some(false) => "; it has no place in the map",
                    _ => "",
                }
            );
        }
    }
}
