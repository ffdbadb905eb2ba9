//! Maps that others are compared with.

use crate::mapfile;
use crate::process::failure::{Classify, Failure};
use crate::recorded::Recorded;
use anyhow::Context as _;
use monogrid_evaluation::{TruthGrid, cells_in_view};
use std::path::Path;

/// Most cells of the box of a true map, two bits each.
const MAX_CELLS: u64 = 4_000_000_000;

/// Edge of the cells in which views are traced: finer ones cost time and change little.
const VIEW_CELL: f64 = 0.064;

/// Reads a true map.
pub fn load_truth(path: &Path) -> Result<TruthGrid, Failure> {
    let (map, _) = mapfile::load(path)?;
    let truth = TruthGrid::from_map(&map, MAX_CELLS).with_context(|| name_of(path));
    truth.bad_input()
}

/// As messages name it.
pub fn name_of(truth: &Path) -> String {
    format!("true map {}", truth.display())
}

/// The cells that some keyframe of a recording looks at.
pub fn in_view(truth: &TruthGrid, recorded: &Recorded, range: f64) -> Result<TruthGrid, Failure> {
    let factor = (VIEW_CELL / truth.resolution()).floor().max(1.0) as u32;
    let coarse = truth
        .coarsened(factor)
        .while_running("no view can be made")?;
    Ok(cells_in_view(&coarse, &recorded.views(), range))
}
