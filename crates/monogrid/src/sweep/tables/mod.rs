//! The tables of a sweep, with the thesis' own numbers beside ours.

mod all_maps;
mod resources;
mod scores;

pub use all_maps::all_maps_csv;
pub use resources::{data_sets, memory, speed};
pub use scores::{Score, best_of, over_parameter};

use super::plan::Model;
use std::fmt::Write;

/// A table with a title. Cells that start with `*` are the best of their column.
#[derive(Clone, Debug)]
pub struct Table {
    /// Name of its file.
    pub file: &'static str,
    /// Title.
    pub title: String,
    /// What the reader must know.
    pub note: String,
    /// Names of the columns.
    pub header: Vec<String>,
    /// Cells.
    pub rows: Vec<Vec<String>>,
}

impl Table {
    /// Comma-separated values.
    pub fn csv(&self) -> String {
        let mut text = String::new();
        for row in std::iter::once(&self.header).chain(&self.rows) {
            let cells: Vec<String> = row.iter().map(|cell| csv_cell(cell)).collect();
            let _ = writeln!(text, "{}", cells.join(","));
        }
        text
    }
}

fn csv_cell(cell: &str) -> String {
    let plain = cell.strip_prefix('*').unwrap_or(cell);
    if plain.contains([',', '"']) {
        format!("\"{}\"", plain.replace('"', "\"\""))
    } else {
        plain.to_owned()
    }
}

/// Millimetres, for headings.
pub fn mm(resolution: f64) -> String {
    format!("{} mm", crate::report::svg::number(resolution * 1e3))
}

fn headings(first: &str, rest: &[&str]) -> Vec<String> {
    std::iter::once(first)
        .chain(rest.iter().copied())
        .map(str::to_owned)
        .collect()
}

fn model_name(model: Model) -> String {
    match model {
        Model::None => "unprocessed".to_owned(),
        Model::Ideal => "ideal".to_owned(),
        Model::Thrun(l) => format!("Thrun, L = {l}"),
        Model::Andert(k) => format!("Andert, k = {k}"),
        Model::Automatic => "ours, automatic".to_owned(),
    }
}
