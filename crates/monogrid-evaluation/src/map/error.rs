//! Why maps cannot be compared.

/// Why maps cannot be compared.
#[derive(Debug, thiserror::Error, Clone, PartialEq)]
#[non_exhaustive]
pub enum MapEvaluationError {
    /// Cells of different size.
    #[error(
        "the estimated map has cells of {estimate}, the true one of {truth}; make the truth at the \
         estimate's resolution"
    )]
    Resolution {
        /// Edge of a cell of the estimate.
        estimate: f64,
        /// Edge of a cell of the truth.
        truth: f64,
    },
    /// The view does not fit the truth.
    #[error("cells in view have an edge of {view}, expected a multiple of the truth's {truth}")]
    View {
        /// Edge of a cell of the view.
        view: f64,
        /// Edge of a cell of the truth.
        truth: f64,
    },
    /// The truth knows only free or only occupied cells.
    #[error("the true map has {free} free and {occupied} occupied cells, expected some of both")]
    OneClass {
        /// Free cells.
        free: u64,
        /// Occupied cells.
        occupied: u64,
    },
}
