//! `monogrid distances`: the distance to the nearest obstacle as an array.

use clap::Args;
use monogrid_app::args::{WriteArgs, positive};
use monogrid_app::mapfile;
use monogrid_app::output::{Inputs, OutputFile};
use monogrid_app::process::failure::{Classify, CommandResult, Failure};
use monogrid_occupancy::{
    DistanceConfig, DistanceField, Occupancy, OccupancyMap, UnknownCells, VoxelKey,
};
use std::path::PathBuf;

/// `monogrid distances`.
#[derive(Debug, Args)]
pub struct DistancesArgs {
    /// Map to read (.ot, .bt, .mgo, or the folder of a run)
    pub map: PathBuf,
    /// Array to write (.npy); where it lies in the map is written beside it (.yaml)
    pub output: PathBuf,
    /// Only the layer of cells at this height
    #[arg(long, value_name = "Z")]
    pub height: Option<f64>,
    /// Largest distance that is told apart, in the unit of the map; at most 181 cells
    #[arg(
        long, value_name = "D", value_parser = positive,
        default_value_t = DistanceConfig::default().max_distance
    )]
    pub max_distance: f64,
    /// Unknown cells are obstacles
    #[arg(long)]
    pub unknown_blocks: bool,
    #[command(flatten)]
    pub write: WriteArgs,
}

/// Numbers in an array at most.
const MAX_CELLS: usize = 200_000_000;

/// Computes and writes the array.
pub fn execute(args: &DistancesArgs) -> CommandResult {
    if args.output.extension().is_none_or(|e| e != "npy") {
        return Err(Failure::input(format!(
            "cannot write {}: expected a name that ends in .npy",
            args.output.display()
        )));
    }
    let inputs = Inputs::of("the map", &args.map);
    let file = OutputFile::new(&args.output, args.write.force, &inputs)?;
    let yaml = args.output.with_extension("yaml");
    let yaml = OutputFile::new(&yaml, args.write.force, &inputs)?;
    let (map, _) = mapfile::load(&args.map)?;
    let layers = Layers::new(&map, args)?;
    let config = DistanceConfig {
        max_distance: args.max_distance,
        unknown: match args.unknown_blocks {
            true => UnknownCells::Stop,
            false => UnknownCells::PassThrough,
        },
    };
    let field = DistanceField::new(&map, config, rayon::current_num_threads()).bad_input()?;
    file.write_with(|out| {
        out.write_all(&npy_header(&layers.shape()))?;
        for key in layers.keys() {
            let distance = match map.state_of(key) {
                Occupancy::Unknown => f32::NAN,
                _ => field.distance_of(key).unwrap_or(args.max_distance) as f32,
            };
            out.write_all(&distance.to_le_bytes())?;
        }
        Ok(())
    })?;
    yaml.write(layers.description(&map, args).as_bytes())?;
    let (shape, resolution) = (layers.shape(), map.resolution());
    let report = serde_json::json!({
        "shape": shape,
        "resolution": resolution,
        "origin": layers.first.center(resolution),
    });
    args.write.json.print(&report, || {
        println!("{}: {shape:?} cells of {resolution}", args.output.display());
    })
}

/// The cells of the array.
struct Layers {
    first: VoxelKey,
    last: VoxelKey,
    is_flat: bool,
}

impl Layers {
    fn new(map: &OccupancyMap, args: &DistancesArgs) -> Result<Self, Failure> {
        let bounds = map.key_bounds();
        let (mut first, mut last) = bounds
            .ok_or_else(|| Failure::input(format!("{} has no known cells", args.map.display())))?;
        if let Some(height) = args.height {
            let layer = map.key([0.0, 0.0, height]).map(|key| key.z);
            let layer = layer.filter(|z| (first.z..=last.z).contains(z));
            let edge = map.resolution();
            (first.z, last.z) = layer.map(|z| (z, z)).ok_or_else(|| {
                Failure::input(format!(
                    "--height {height} lies outside the map, which reaches from {} to {}",
                    f64::from(first.z) * edge,
                    f64::from(last.z + 1) * edge
                ))
            })?;
        }
        let this = Self {
            first,
            last,
            is_flat: args.height.is_some(),
        };
        let [x, y, z] = this.sides();
        let count = x.checked_mul(y).and_then(|count| count.checked_mul(z));
        if count.is_some_and(|count| count <= MAX_CELLS) {
            return Ok(this);
        }
        Err(Failure::input(format!(
            "the map is {x} x {y} x {z} cells, expected at most {MAX_CELLS}: take one layer \
             (--height) or a part (monogrid crop)"
        )))
    }

    /// Cells along x, y and z.
    fn sides(&self) -> [usize; 3] {
        let (first, last) = (self.first.to_array(), self.last.to_array());
        [0, 1, 2].map(|axis| (i64::from(last[axis]) - i64::from(first[axis]) + 1) as usize)
    }

    /// Lengths of the array's axes, z first; of a layer only y and x.
    fn shape(&self) -> Vec<usize> {
        let [x, y, z] = self.sides();
        match self.is_flat {
            true => vec![y, x],
            false => vec![z, y, x],
        }
    }

    /// x fastest, then y, then z.
    fn keys(&self) -> impl Iterator<Item = VoxelKey> {
        let (first, last) = (self.first, self.last);
        (first.z..=last.z).flat_map(move |z| {
            (first.y..=last.y)
                .flat_map(move |y| (first.x..=last.x).map(move |x| VoxelKey::new(x, y, z)))
        })
    }

    fn description(&self, map: &OccupancyMap, args: &DistancesArgs) -> String {
        let [x, y, z] = self.first.center(map.resolution());
        let name = args.output.file_name().unwrap_or_default();
        let or_unknown = match args.unknown_blocks {
            true => " or unknown one",
            false => "",
        };
        let axes = if self.is_flat { "y, x" } else { "z, y, x" };
        format!(
            "array: {}\nresolution: {}\norigin: [{x}, {y}, {z}]\nmax_distance: {}\n# distances \
             between centres of cells, to the nearest occupied one{or_unknown}, in the unit of the \
             map; max_distance stands\n# for all that is farther, NaN for unknown cells; axes are \
             {axes}; origin is the centre of the first cell\n",
            name.to_string_lossy(),
            map.resolution(),
            args.max_distance
        )
    }
}

/// The header of an array of little-endian 32-bit floats, version 1.0 of the format
/// (numpy.lib.format).
fn npy_header(shape: &[usize]) -> Vec<u8> {
    const MAGIC: &[u8] = b"\x93NUMPY\x01\x00";
    let sides: Vec<String> = shape.iter().map(usize::to_string).collect();
    let mut text = format!(
        "{{'descr': '<f4', 'fortran_order': False, 'shape': ({}), }}",
        sides.join(", ")
    );
    // the data begin at a multiple of 64 bytes, after a line break
    let length = (MAGIC.len() + 2 + text.len() + 1).next_multiple_of(64) - MAGIC.len() - 2;
    text += &" ".repeat(length - 1 - text.len());
    text.push('\n');
    [MAGIC, &(length as u16).to_le_bytes(), text.as_bytes()].concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_header_is_the_one_of_numpy() {
        let header = npy_header(&[16, 20, 40]);
        assert_eq!((header.len() % 64, header[header.len() - 1]), (0, b'\n'));
        let length = usize::from(u16::from_le_bytes([header[8], header[9]]));
        assert_eq!(length, header.len() - 10);
        let text = String::from_utf8_lossy(&header[10..]);
        assert!(
            text.starts_with("{'descr': '<f4', 'fortran_order': False, 'shape': (16, 20, 40), }")
        );
    }
}
