//! Lookup of the cells in view.

use super::error::MapEvaluationError;
use crate::truth::{CellCounts, TruthGrid, whole_ratio};
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
        let factor = whole_ratio(view, truth).ok_or(MapEvaluationError::View { view, truth })?;
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
        let is_in_view = |cell: &_| self.contains(truth.global(*cell));
        for cell in truth.cells().filter(is_in_view) {
            counts.add(truth.state_at(cell));
        }
        Some(counts)
    }
}
