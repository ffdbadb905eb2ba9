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
    pub file: String,
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

    /// A section of a Markdown page; the best of each column is bold.
    pub fn markdown(&self) -> String {
        let row = |cells: &[String]| {
            let cells = cells.iter().map(|cell| match cell.strip_prefix('*') {
                Some(best) => format!("**{best}**"),
                None => cell.replace('|', "\\|"),
            });
            format!("| {} |\n", cells.collect::<Vec<_>>().join(" | "))
        };
        let mut text = format!("### {}\n\n{}\n\n", self.title, self.note);
        text.push_str(&row(&self.header));
        text.push_str(&format!("{}|\n", "|---".repeat(self.header.len())));
        text.extend(self.rows.iter().map(|cells| row(cells)));
        text.push('\n');
        text
    }
}

fn csv_cell(cell: &str) -> String {
    let plain = cell.strip_prefix('*').unwrap_or(cell);
    match plain.contains([',', '"']) {
        true => format!("\"{}\"", plain.replace('"', "\"\"")),
        false => plain.to_owned(),
    }
}

/// Millimetres, for headings.
pub fn mm(resolution: f64) -> String {
    format!("{} mm", monogrid_report::svg::number(resolution * 1e3))
}

/// Cells of a row that has the same words in every sweep.
fn words(row: &str) -> Vec<String> {
    row.split(" | ").map(str::to_owned).collect()
}

/// A cell of what may be missing.
fn or<T>(missing: &str, value: Option<T>, text: impl FnOnce(T) -> String) -> String {
    value.map_or_else(|| missing.to_owned(), text)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_is_written_as_csv_and_as_markdown() {
        let table = Table {
            file: "t".into(),
            title: "Title".into(),
            note: "Note.".into(),
            header: words("a | b"),
            rows: vec![vec!["*1".into(), "x, \"y\" | z".into()]],
        };
        assert_eq!(table.csv(), "a,b\n1,\"x, \"\"y\"\" | z\"\n");
        assert_eq!(
            table.markdown(),
            "### Title\n\nNote.\n\n| a | b |\n|---|---|\n| **1** | x, \"y\" \\| z |\n\n"
        );
    }
}
