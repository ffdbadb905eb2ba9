//! `monogrid info`: facts about a map or submaps.

use crate::commands::bytes;
use clap::Args;
use monogrid_app::args::JsonArg;
use monogrid_app::mapfile;
use monogrid_app::output::map_at;
use monogrid_app::process::failure::{Classify, CommandResult, Failure};
use monogrid_datasets::{
    Scale, SubmapEntry, SubmapReader, SubmapTable, format_seconds, is_submap, is_submap_table,
    submap_table_in,
};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// `monogrid info`.
#[derive(Debug, Args)]
pub struct InfoArgs {
    /// Map (.ot, .bt, .mgo, or the folder of a run), a submap (.mgs), or submaps (submaps.json, or
    /// the folder of them)
    pub map: PathBuf,
    #[command(flatten)]
    pub json: JsonArg,
}

#[derive(Serialize)]
struct Info {
    format: &'static str,
    resolution: f64,
    leaves: usize,
    cells_occupied: u64,
    cells_free: u64,
    bounds_min: Option<[f64; 3]>,
    bounds_max: Option<[f64; 3]>,
    bytes_in_memory: usize,
    file_bytes: u64,
}

/// Prints facts about a map, a submap or all submaps of a run.
pub fn execute(args: &InfoArgs) -> CommandResult {
    if let Some(submaps) = Submaps::at(&args.map)? {
        return submaps.tell(&args.map, args.json);
    }
    let (map, format) = mapfile::load(&args.map)?;
    let counts = map.cell_counts();
    let bounds = map.bounds();
    let info = Info {
        format: format.description(),
        resolution: map.resolution(),
        leaves: map.leaf_count(),
        cells_occupied: counts.occupied,
        cells_free: counts.free,
        bounds_min: bounds.map(|b| b.0),
        bounds_max: bounds.map(|b| b.1),
        bytes_in_memory: map.bytes_in_memory(),
        file_bytes: std::fs::metadata(map_at(&args.map)).map_or(0, |m| m.len()),
    };
    args.json.print(&info, || {
        println!("{}: {}", args.map.display(), info.format);
        println!(
            "resolution  {} (maps hold no unit: lengths are metres only where the scale was known)",
            info.resolution
        );
        println!("leaves      {}", info.leaves);
        let (occupied, free) = (info.cells_occupied, info.cells_free);
        println!("cells       {occupied} occupied, {free} free");
        if let Some((low, high)) = bounds {
            let [x, y, z] = [0, 1, 2].map(|axis| high[axis] - low[axis]);
            println!("extent      {x:.3} x {y:.3} x {z:.3}");
            println!(
                "            from ({:.3}, {:.3}, {:.3}) to ({:.3}, {:.3}, {:.3})",
                low[0], low[1], low[2], high[0], high[1], high[2]
            );
        } else {
            println!("extent      the map is empty");
        }
        let [memory, file] = [info.bytes_in_memory as u64, info.file_bytes].map(bytes);
        println!("memory      {memory}, file {file}");
    })
}

/// All submaps of a run, or one file.
#[derive(Debug, Serialize)]
struct Submaps {
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
    fn at(path: &Path) -> Result<Option<Self>, Failure> {
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
            Ok::<_, Failure>(Submap {
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
    fn tell(&self, path: &Path, json: JsonArg) -> CommandResult {
        json.print(self, || {
            println!("{}: {}", path.display(), self.format);
            let (files, size) = (self.submaps.len(), bytes(self.file_bytes));
            println!("{files} files, {} keyframes, {size}", self.keyframes);
            self.submaps.iter().for_each(Submap::tell);
        })
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
        let size = bytes(self.file_bytes);
        println!(
            "{}: {} keyframes of {}x{} pixels, {first} to {last} s, {size}, scale {}",
            self.file, self.keyframes, self.width, self.height, self.scale
        );
        if let (Some(low), Some(high)) = (self.bounds_min, self.bounds_max) {
            let [x, y, z] = [0, 1, 2].map(|axis| high[axis] - low[axis]);
            let place = match self.is_placed {
                Some(false) => "; it has no place in the map",
                _ => "",
            };
            println!("    {x:.3} x {y:.3} x {z:.3} in its frame{place}");
        }
    }
}
