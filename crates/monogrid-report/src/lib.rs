//! Pictures, plots and pages of maps and runs.
//!
//! [`picture`] draws keyframes, layers and cells as PNG, [`svg`] plots curves, [`Page`] puts them
//! on a page that needs no other file. [`explorer`] is the part of a page that is explored in three
//! dimensions, with the server that shows it while a run goes on. [`surface`] makes coloured meshes
//! of a map, and writes them.
#![deny(missing_docs)]

pub mod colours;
mod error;
pub mod explorer;
pub mod page;
pub mod picture;
pub mod surface;
pub mod svg;

pub use error::ReportError;
pub use page::Page;
