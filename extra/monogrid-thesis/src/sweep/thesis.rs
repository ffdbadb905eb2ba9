//! The thesis' own numbers (Hull 2017, chapter 6), to stand beside ours. `None`: beyond 10 GB.

use super::plan::{BUFFERS, Model, SIGNIFICANCES};

/// A model with one parameter, the thesis' ten values of it, and where the thesis shows its
/// results.
#[derive(Debug)]
pub struct Family {
    /// Name of the model.
    pub name: &'static str,
    /// Its name in names of files.
    pub file: &'static str,
    /// Symbol of the parameter, a length in metres.
    pub symbol: &'static str,
    /// Its values.
    pub values: [f64; 10],
    model: fn(f64) -> Model,
    /// Areas under the ROC curves: rows as the values, columns 8 to 128 mm.
    pub auc: [[f64; 5]; 10],
    /// Number of the table of these areas.
    pub table: &'static str,
    /// Number of the figure of the ROC curves.
    pub figure: &'static str,
}

/// Thrun's model with its buffer L.
pub const THRUN: Family = Family {
    name: "Thrun",
    file: "thrun",
    symbol: "L",
    values: BUFFERS,
    model: Model::Thrun,
    auc: AUC_THRUN,
    table: "6.8",
    figure: "6.13",
};

/// Andert's model with its significance k.
pub const ANDERT: Family = Family {
    name: "Andert",
    file: "andert",
    symbol: "k",
    values: SIGNIFICANCES,
    model: Model::Andert,
    auc: AUC_ANDERT,
    table: "6.9",
    figure: "6.14",
};

impl Family {
    /// The model with each value.
    pub fn models(&self) -> [Model; 10] {
        self.values.map(self.model)
    }
}

/// A row of Table 6.4, MB: memory in maximum-likelihood and full form, size of `.bt` and of `.ot`.
pub type MemoryRow = [Option<f64>; 4];

const X: MemoryRow = [None; 4];

const fn row(bt_ram: f64, ot_ram: f64, bt_file: f64, ot_file: f64) -> MemoryRow {
    [Some(bt_ram), Some(ot_ram), Some(bt_file), Some(ot_file)]
}

/// Table 6.4, office data set, Thrun, 8 to 128 mm.
pub const OFFICE_MEMORY_THRUN: [MemoryRow; 5] = [
    row(1500.0, 1700.0, 3.6, 50.9),
    row(555.8, 597.7, 0.734, 9.7),
    row(125.8, 133.5, 0.153, 1.9),
    row(41.7, 41.5, 0.032, 0.398),
    row(20.1, 24.6, 0.007, 0.084),
];
/// Table 6.4, office data set, Andert.
pub const OFFICE_MEMORY_ANDERT: [MemoryRow; 5] = [
    row(1100.0, 2300.0, 3.6, 153.1),
    row(531.8, 938.9, 0.725, 22.3),
    row(123.3, 181.1, 0.151, 3.9),
    row(40.2, 49.3, 0.032, 0.746),
    row(23.9, 25.4, 0.007, 0.149),
];
/// Table 6.4, machine data set, Thrun.
pub const MACHINE_MEMORY_THRUN: [MemoryRow; 5] = [
    X,
    X,
    row(4700.0, 6100.0, 30.0, 465.1),
    row(1000.0, 1000.0, 5.1, 61.7),
    row(674.1, 679.1, 0.985, 12.0),
];
/// Table 6.4, machine data set, Andert.
pub const MACHINE_MEMORY_ANDERT: [MemoryRow; 5] = [
    X,
    X,
    [Some(5700.0), None, Some(39.9), Some(1300.0)],
    row(836.2, 2400.0, 5.0, 194.3),
    row(674.3, 1100.0, 0.989, 27.0),
];

/// Table 6.6, seconds per 100 000 points, machine data set: ideal, Thrun, Andert.
pub const MACHINE_SECONDS: [[f64; 5]; 3] = [
    [4.23, 2.01, 1.35, 0.47, 0.15],
    [14.02, 5.76, 3.04, 2.00, 1.14],
    [25.28, 8.17, 7.26, 4.15, 1.68],
];
/// Table 6.7, seconds per 100 000 points, office data set: ideal, Thrun, Andert.
pub const OFFICE_SECONDS: [[f64; 5]; 3] = [
    [0.94, 0.40, 0.20, 0.11, 0.05],
    [4.72, 2.17, 1.31, 0.55, 0.29],
    [7.37, 3.03, 1.45, 0.74, 0.38],
];
/// Measurements of the data sets (Tables 6.3 and 6.5), in units of 100 000.
pub const MACHINE_100K_POINTS: f64 = 163.5;
/// See [`MACHINE_100K_POINTS`].
pub const OFFICE_100K_POINTS: f64 = 34.4;

/// Table 6.8, AUC of Thrun's model: rows as the values of L in the plan, columns 8 to 128 mm.
const AUC_THRUN: [[f64; 5]; 10] = [
    [0.63, 0.61, 0.66, 0.69, 0.60],
    [0.70, 0.67, 0.71, 0.74, 0.66],
    [0.77, 0.73, 0.77, 0.79, 0.74],
    [0.85, 0.75, 0.81, 0.82, 0.78],
    [0.90, 0.78, 0.83, 0.86, 0.79],
    [0.91, 0.77, 0.82, 0.87, 0.80],
    [0.90, 0.74, 0.80, 0.85, 0.79],
    [0.89, 0.66, 0.78, 0.83, 0.78],
    [0.88, 0.60, 0.73, 0.80, 0.78],
    [0.85, 0.56, 0.61, 0.72, 0.76],
];
/// Table 6.9, AUC of Andert's model: rows as the values of k in the plan.
const AUC_ANDERT: [[f64; 5]; 10] = [
    [0.62, 0.72, 0.78, 0.82, 0.77],
    [0.65, 0.74, 0.79, 0.84, 0.77],
    [0.69, 0.76, 0.80, 0.85, 0.79],
    [0.70, 0.76, 0.80, 0.85, 0.80],
    [0.71, 0.76, 0.81, 0.84, 0.80],
    [0.71, 0.77, 0.80, 0.83, 0.80],
    [0.72, 0.77, 0.80, 0.83, 0.79],
    [0.73, 0.76, 0.80, 0.82, 0.79],
    [0.73, 0.76, 0.80, 0.82, 0.79],
    [0.73, 0.76, 0.80, 0.81, 0.78],
];

/// Column of a resolution in the tables; `None` for other resolutions.
pub fn column(resolution: f64) -> Option<usize> {
    super::plan::RESOLUTIONS
        .iter()
        .position(|r| (r / resolution - 1.0).abs() < 1e-6)
}
