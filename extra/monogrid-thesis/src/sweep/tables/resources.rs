//! Data sets, memory and time.

use super::{Table, mm, model_name, or, words};
use crate::sweep::plan::{Entry, Model};
use crate::sweep::record::{Built, MapRecord};
use crate::sweep::result::RecordingResult;
use crate::sweep::thesis;
use monogrid_report::svg::number;

/// Tables 6.3 and 6.5: the data sets.
pub fn data_sets(results: &[RecordingResult]) -> Table {
    let row = |result: &RecordingResult| {
        let size = or("not known", result.environment, extent);
        let rate = result.rates.iter().map(|rate| rate.frames_per_second);
        let fastest = rate.reduce(f64::max);
        vec![
            format!("{} ({})", result.name, result.profile),
            size,
            format!("{:.0} s, {} frames", result.video_seconds, result.frames),
            result.keyframes.to_string(),
            format!("{:.2} million", result.points as f64 / 1e6),
            or("not measured", fastest, |rate| {
                format!("{rate:.1} per second")
            }),
        ]
    };
    let of_thesis = [
        "thesis: machine | 30 x 30 x 12 | 140 s at 50 Hz | 148 | 16.35 million | 10 per second",
        "thesis: office | 7 x 8 x 3.5 | 51 s at 30 Hz | 45 | 3.44 million | 14 per second",
    ];
    Table {
        file: "table-6.3-6.5-data-sets".to_owned(),
        title: "Data sets (Tables 6.3 and 6.5)".to_owned(),
        note: "Seconds from the first to the last keyframe. Rate: SLAM with the least demanding \
               mapping beside it."
            .to_owned(),
        header: words("data set | environment, m | video | keyframes | points | SLAM"),
        rows: results
            .iter()
            .map(row)
            .chain(of_thesis.map(words))
            .collect(),
    }
}

fn extent([x, y, z]: [f64; 3]) -> String {
    format!("{x:.1} x {y:.1} x {z:.1}")
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
    let row = |record: &MapRecord| {
        let Entry { model, resolution } = record.entry;
        let name = vec![model_name(model), mm(resolution)];
        let beyond = || vec!["x".to_owned(); 6];
        let ours = record.built().map_or_else(beyond, memory_cells);
        [name, ours, thesis_memory_cells(model, resolution)].concat()
    };
    Table {
        file: "table-6.4-memory".to_owned(),
        title: format!("Memory and files (Table 6.4): {}", result.name),
        note:
            "Megabytes, as likely / full: the map in maximum-likelihood form (every cell free or \
               occupied) and with probabilities; files .bt / .ot. x: beyond the memory limit. The \
               thesis measured the memory of its mapping process, which also holds waiting \
               keyframes; ours is the map alone."
                .to_owned(),
        header: words(
            "model | cells | RAM likely | RAM full | .bt | .ot | nodes | extent, m | \
             thesis office: RAM | files | thesis machine: RAM | files",
        ),
        rows: result.usual_records().map(row).collect(),
    }
}

fn memory_cells(built: &Built) -> Vec<String> {
    let file = |bytes: Option<u64>| or("-", bytes, |bytes| megabytes(bytes as usize));
    vec![
        megabytes(built.bytes_likelihood),
        megabytes(built.bytes),
        file(built.bt_bytes),
        file(built.ot_bytes),
        or("-", built.nodes, |n| n.to_string()),
        extent(built.extent),
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
    let cell = |value: Option<f64>| or("x", value, number);
    let cells = tables.iter().flat_map(|table| {
        let [bt_ram, ot_ram, bt_file, ot_file] = table[column].map(cell);
        [
            format!("{bt_ram} / {ot_ram}"),
            format!("{bt_file} / {ot_file}"),
        ]
    });
    cells.collect()
}

/// Tables 6.6 and 6.7: time, and the rate of SLAM beside it.
pub fn speed(result: &RecordingResult) -> Table {
    let total = |per_100k: Option<f64>, count: f64| {
        or("", per_100k, |s| format!("{s:.2} ({:.0})", s * count))
    };
    let row = |record: &MapRecord| {
        let Entry { model, resolution } = record.entry;
        let built = record.built();
        let per_100k = |built: &Built| built.seconds * 1e5 / built.points.max(1) as f64;
        let mut rates = result.rates.iter();
        let rate = rates.find(|rate| rate.entry == record.entry);
        let [office, machine] = thesis_seconds(model, resolution);
        vec![
            model_name(model),
            mm(resolution),
            or("x", built, |built| format!("{:.3}", per_100k(built))),
            or("x", built, |built| significant(built.seconds)),
            or("-", rate, |rate| format!("{:.1}", rate.frames_per_second)),
            total(office, thesis::OFFICE_100K_POINTS),
            total(machine, thesis::MACHINE_100K_POINTS),
        ]
    };
    Table {
        file: "table-6.6-6.7-speed".to_owned(),
        title: format!("Time (Tables 6.6 and 6.7): {}", result.name),
        note:
            "CPU seconds of one core per 100 000 points, and for the whole recording. The thesis \
            used a core of an i7-4700MQ; its seconds for the whole data set (in brackets) are its \
            rate times its points. SLAM: frames per second with this mapping running beside it."
                .to_owned(),
        header: words(
            "model | cells | s per 100k | s in all | SLAM | thesis office | thesis machine",
        ),
        rows: result.usual_records().map(row).collect(),
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
    let tables = [thesis::OFFICE_SECONDS, thesis::MACHINE_SECONDS];
    tables.map(|table| column.map(|c| table[row][c]))
}
