//! Data sets, memory and time.

use super::{Table, headings, mm, model_name};
use crate::sweep::plan::{Model, usual_models};
use crate::sweep::record::{Built, MapResult};
use crate::sweep::result::RecordingResult;
use crate::sweep::thesis;

/// Tables 6.3 and 6.5: the data sets.
pub fn data_sets(results: &[RecordingResult]) -> Table {
    let mut rows: Vec<Vec<String>> = results
        .iter()
        .map(|result| {
            let size = result.environment.map_or_else(
                || "not known".to_owned(),
                |[x, y, z]| format!("{x:.1} x {y:.1} x {z:.1}"),
            );
            let rate = result.rates.iter().map(|rate| rate.frames_per_second);
            let rate = rate.fold(f64::NAN, f64::max);
            vec![
                format!("{} ({})", result.name, result.profile),
                size,
                format!("{:.0} s, {} frames", result.video_seconds, result.frames),
                result.keyframes.to_string(),
                format!("{:.2} million", result.points as f64 / 1e6),
                if rate.is_nan() {
                    "not measured".to_owned()
                } else {
                    format!("{rate:.1} per second")
                },
            ]
        })
        .collect();
    let of_thesis = [
        [
            "thesis: machine",
            "30 x 30 x 12",
            "140 s at 50 Hz",
            "148",
            "16.35 million",
            "10 per second",
        ],
        [
            "thesis: office",
            "7 x 8 x 3.5",
            "51 s at 30 Hz",
            "45",
            "3.44 million",
            "14 per second",
        ],
    ];
    rows.extend(of_thesis.map(|row| row.map(str::to_owned).to_vec()));
    Table {
        file: "table-6.3-6.5-data-sets".to_owned(),
        title: "Data sets (Tables 6.3 and 6.5)".to_owned(),
        note: "Seconds from the first to the last keyframe. Rate: SLAM with the least demanding \
               mapping beside it."
            .to_owned(),
        header: headings(
            "data set",
            &["environment, m", "video", "keyframes", "points", "SLAM"],
        ),
        rows,
    }
}

fn megabytes(bytes: usize) -> String {
    significant(bytes as f64 / 1e6)
}

/// Three significant digits.
fn significant(value: f64) -> String {
    match value {
        v if v >= 100.0 => format!("{v:.0}"),
        v if v >= 10.0 => format!("{v:.1}"),
        v if v >= 1.0 => format!("{v:.2}"),
        v => format!("{v:.3}"),
    }
}

/// Table 6.4: memory and files.
pub fn memory(result: &RecordingResult) -> Table {
    let mut rows = Vec::new();
    for model in usual_models() {
        for &resolution in &result.resolutions {
            let Some(record) = result.record(model, resolution) else {
                continue;
            };
            let mut row = vec![model_name(model), mm(resolution)];
            match &record.result {
                MapResult::Built(built) => row.extend(memory_cells(built)),
                MapResult::BeyondMemory { .. } => row.extend(vec!["x".to_owned(); 6]),
            }
            row.extend(thesis_memory_cells(model, resolution));
            rows.push(row);
        }
    }
    Table {
        file: "table-6.4-memory".to_owned(),
        title: format!("Memory and files (Table 6.4): {}", result.name),
        note:
            "Megabytes, as likely / full: the map in maximum-likelihood form (every cell free or \
               occupied) and with probabilities; files .bt / .ot. x: beyond the memory limit. The \
               thesis measured the memory of its mapping process, which also holds waiting \
               keyframes; ours is the map alone."
                .to_owned(),
        header: headings(
            "model",
            &[
                "cells",
                "RAM likely",
                "RAM full",
                ".bt",
                ".ot",
                "nodes",
                "extent, m",
                "thesis office: RAM",
                "files",
                "thesis machine: RAM",
                "files",
            ],
        ),
        rows,
    }
}

fn memory_cells(built: &Built) -> Vec<String> {
    let file = |bytes: Option<u64>| {
        bytes.map_or_else(|| "-".to_owned(), |bytes| megabytes(bytes as usize))
    };
    let [x, y, z] = built.extent;
    vec![
        megabytes(built.bytes_likelihood),
        megabytes(built.bytes),
        file(built.bt_bytes),
        file(built.ot_bytes),
        built
            .nodes
            .map_or_else(|| "-".to_owned(), |n| n.to_string()),
        format!("{x:.1} x {y:.1} x {z:.1}"),
    ]
}

fn thesis_memory_cells(model: Model, resolution: f64) -> Vec<String> {
    let tables = match model {
        Model::Thrun(_) => [thesis::OFFICE_MEMORY_THRUN, thesis::MACHINE_MEMORY_THRUN],
        Model::Andert(_) => [thesis::OFFICE_MEMORY_ANDERT, thesis::MACHINE_MEMORY_ANDERT],
        _ => return vec![String::new(); 4],
    };
    let Some(column) = thesis::column(resolution) else {
        return vec![String::new(); 4];
    };
    let cell =
        |value: Option<f64>| value.map_or_else(|| "x".to_owned(), crate::report::svg::number);
    tables
        .iter()
        .flat_map(|table| {
            let [bt_ram, ot_ram, bt_file, ot_file] = table[column].map(cell);
            [
                format!("{bt_ram} / {ot_ram}"),
                format!("{bt_file} / {ot_file}"),
            ]
        })
        .collect()
}

/// Tables 6.6 and 6.7: time, and the rate of SLAM beside it.
pub fn speed(result: &RecordingResult) -> Table {
    let mut rows = Vec::new();
    for model in usual_models() {
        for &resolution in &result.resolutions {
            let Some(record) = result.record(model, resolution) else {
                continue;
            };
            let cells = match record.built() {
                Some(built) => [
                    format!("{:.3}", built.seconds * 1e5 / built.points.max(1) as f64),
                    significant(built.seconds),
                ],
                None => ["x".to_owned(), "x".to_owned()],
            };
            let rate = result
                .rates
                .iter()
                .find(|rate| rate.entry == record.entry)
                .map_or_else(
                    || "-".to_owned(),
                    |rate| format!("{:.1}", rate.frames_per_second),
                );
            let [office, machine] = thesis_seconds(model, resolution);
            let total = |per_100k: Option<f64>, count: f64| {
                per_100k.map_or_else(String::new, |s| format!("{s:.2} ({:.0})", s * count))
            };
            let mut row = vec![model_name(model), mm(resolution)];
            row.extend(cells);
            row.push(rate);
            row.push(total(office, thesis::OFFICE_100K_POINTS));
            row.push(total(machine, thesis::MACHINE_100K_POINTS));
            rows.push(row);
        }
    }
    Table {
        file: "table-6.6-6.7-speed".to_owned(),
        title: format!("Time (Tables 6.6 and 6.7): {}", result.name),
        note: "CPU seconds of one core per 100 000 points, and for the whole recording. The thesis \
               used a core of an i7-4700MQ; its seconds for the whole data set (in brackets) are its \
               rate times its points. SLAM: frames per second with this mapping running beside it."
            .to_owned(),
        header: headings(
            "model",
            &[
                "cells",
                "s per 100k",
                "s in all",
                "SLAM",
                "thesis office",
                "thesis machine",
            ],
        ),
        rows,
    }
}

/// Seconds per 100 000 points in the thesis: office and machine.
fn thesis_seconds(model: Model, resolution: f64) -> [Option<f64>; 2] {
    let row = match model {
        Model::Ideal => 0,
        Model::Thrun(_) => 1,
        Model::Andert(_) => 2,
        Model::None | Model::Automatic => return [None, None],
    };
    let column = thesis::column(resolution);
    [
        column.map(|c| thesis::OFFICE_SECONDS[row][c]),
        column.map(|c| thesis::MACHINE_SECONDS[row][c]),
    ]
}
