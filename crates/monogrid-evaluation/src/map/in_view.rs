//! Lookup of the cells in view.

use super::MapEvaluationError;
use crate::truth::{CellCounts, TruthGrid};
use monogrid_occupancy::Occupancy;

/// The cells in view, by keys of the truth; without a view all cells are.
#[derive(Debug)]
pub(crate) struct InView<'a> {
    grid: Option<&'a TruthGrid>,
    /// Cells of the truth along one edge of a cell of the view.
    factor: i32,
}

impl<'a> InView<'a> {
    pub fn new(grid: Option<&'a TruthGrid>, truth: f64) -> Result<Self, MapEvaluationError> {
        let view = grid.map_or(truth, TruthGrid::resolution);
        let factor = (view / truth).round();
        if factor < 1.0 || (view / truth - factor).abs() > 1e-6 * factor {
            return Err(MapEvaluationError::View { view, truth });
        }
        Ok(Self {
            grid,
            factor: factor as i32,
        })
    }

    pub fn contains(&self, key: [i32; 3]) -> bool {
        self.grid.is_none_or(|grid| {
            grid.state(key.map(|k| k.div_euclid(self.factor))) != Occupancy::Unknown
        })
    }

    /// States of the true cells in view; `None` without a view.
    pub fn counts(&self, truth: &TruthGrid) -> Option<CellCounts> {
        self.grid?;
        let mut counts = CellCounts::default();
        for cell in truth.cells() {
            let key = truth.global(cell);
            if self.contains(key) {
                counts.add(truth.state_at(cell));
            }
        }
        Some(counts)
    }
}
