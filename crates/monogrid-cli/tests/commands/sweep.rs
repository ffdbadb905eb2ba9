//! `sweep`, `sensor-model`, `slice`, and the evaluation of recordings.

use crate::common::{assert_fails, code, json, monogrid, small_sequence, stderr};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

fn text(path: &Path) -> &str {
    path.to_str().expect("paths of tests are UTF-8")
}

/// A run on the small sequence and the true map of its room, made once.
struct Room {
    recording: PathBuf,
    map: PathBuf,
    truth: PathBuf,
    align: String,
}

fn room() -> &'static Room {
    static ROOM: OnceLock<Room> = OnceLock::new();
    ROOM.get_or_init(|| {
        let source = small_sequence();
        let folder = std::env::temp_dir().join(format!("monogrid-sweep-{}", std::process::id()));
        let align = format!("gt:{}", text(&source.join("groundtruth.txt")));
        let (run, truth) = (folder.join("run"), folder.join("truth.ot"));
        let options = ["--seed-depth", "dataset", "--resolution", "0.128"];
        let mut args = vec!["run", text(source), "--out", text(&run), "--align", &align];
        args.extend(options);
        let output = monogrid(args);
        assert_eq!(code(&output), 0, "{}", stderr(&output));
        let options = ["--resolution", "0.064", "--out"];
        let mut args = vec!["truth", "living-room"];
        args.extend(options);
        args.push(text(&truth));
        let output = monogrid(args);
        assert_eq!(code(&output), 0, "{}", stderr(&output));
        // aligned by its keyframes, as the commands below do; the run aligns by all its frames
        let recording = run.join("recording.mgk");
        let map = folder.join("map.ot");
        let args = [
            "map",
            text(&recording),
            "--align",
            &align,
            "--out",
            text(&map),
        ];
        let output = monogrid(args);
        assert_eq!(code(&output), 0, "{}", stderr(&output));
        Room {
            recording,
            map,
            truth,
            align,
        }
    })
}

fn sweep(out: &Path, more: &[&str]) -> std::process::Output {
    let room = room();
    let mut args = vec![
        "thesis",
        "sweep",
        text(&room.recording),
        "--truth",
        text(&room.truth),
    ];
    args.extend(["--align", &room.align, "--out", text(out), "--json"]);
    args.extend(["--resolutions", "0.128,0.256"]);
    args.extend(more);
    monogrid(args)
}

#[test]
fn a_sweep_measures_every_map_once_and_goes_on_where_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("sweep");
    let first = json(&sweep(&out, &[]));
    assert_eq!(first["maps"], 2 * 23);
    assert_eq!(first["beyond_memory"], 0);
    let maps = std::fs::read_to_string(out.join("maps.csv")).unwrap();
    assert_eq!(maps.lines().count(), 1 + 2 * 23);
    let columns = maps.lines().next().unwrap().split(',').count();
    assert!(maps.lines().all(|line| line.split(',').count() == columns));

    // ours observes the room well; the unprocessed map knows no free space
    let auc = |model: &str| -> f64 {
        let line = maps
            .lines()
            .find(|l| l.starts_with(&format!("run,default,{model},")) && l.contains(",0.128,"));
        line.unwrap().split(',').nth(17).unwrap().parse().unwrap()
    };
    assert!(auc("automatic") > 0.8, "{maps}");
    assert!((auc("none") - 0.5).abs() < 1e-9);

    let page = std::fs::read_to_string(out.join("sweep.html")).unwrap();
    for figure in [
        "6.4", "6.8", "6.9", "6.11", "6.12", "6.13", "6.14", "6.15", "6.16", "6.17",
    ] {
        assert!(page.contains(figure), "figure or table {figure} is missing");
    }
    assert!(page.contains("data:image/png") && !page.contains("src=\"http"));

    // one record is lost: only that map is built again, with the same result
    let kept = out.join("run").join("ideal-0.128.json");
    let lost = out.join("run").join("thrun-0.5-0.128.json");
    let written = std::fs::metadata(&kept).unwrap().modified().unwrap();
    std::fs::remove_file(&lost).unwrap();
    sweep(&out, &["--threads", "1"]);
    assert_eq!(
        std::fs::metadata(&kept).unwrap().modified().unwrap(),
        written
    );
    let without_times = |text: &str| -> Vec<String> {
        let cells = |line: &str| -> Vec<String> {
            let cells = line.split(',').enumerate();
            cells
                .filter(|(i, _)| *i != 7)
                .map(|(_, c)| c.to_owned())
                .collect()
        };
        text.lines().map(|line| cells(line).join(",")).collect()
    };
    let again = std::fs::read_to_string(out.join("maps.csv")).unwrap();
    assert_eq!(without_times(&maps), without_times(&again));
}

#[test]
fn maps_beyond_the_memory_limit_are_marked() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("sweep");
    let report = json(&sweep(&out, &["--memory", "0.0001"]));
    assert!(report["beyond_memory"].as_u64().unwrap() > 0, "{report}");
    let page = std::fs::read_to_string(out.join("sweep.html")).unwrap();
    assert!(page.contains("<td class=\"n\">x</td>"));
}

#[test]
fn a_folder_that_holds_something_else_is_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("precious"), "x").unwrap();
    assert_fails(&sweep(folder.path(), &[]), 2, &["precious", "--force"]);
    assert!(folder.path().join("precious").is_file());
}

#[test]
fn a_recording_is_evaluated_as_its_map_and_tells_what_was_in_view() {
    let room = room();
    let truth = text(&room.truth);
    let base = ["evaluate", "map", "--json", "--align", &room.align];
    let direct = base.iter().copied().chain([text(&room.recording), truth]);
    let direct = json(&monogrid(direct));
    let recording = ["--recording", text(&room.recording)];
    let of_map = base
        .iter()
        .copied()
        .chain([text(&room.map), truth])
        .chain(recording);
    let of_map = json(&monogrid(of_map));
    assert_eq!(direct["policies"], of_map["policies"]);
    for class in ["free", "occupied"] {
        let all = of_map[format!("coverage_{class}")].as_f64().unwrap();
        let in_view = of_map[format!("coverage_{class}_in_view")]
            .as_f64()
            .unwrap();
        // few keyframes see a part of the room
        assert!(
            in_view > 1.5 * all && in_view <= 1.0,
            "{class}: {all} {in_view}"
        );
        assert_eq!(
            direct[format!("coverage_{class}_in_view")].as_f64(),
            Some(in_view)
        );
    }
    let output = monogrid(base.into_iter().chain([text(&room.map), truth]));
    assert_fails(&output, 2, &["--recording", "--move-map"]);
}

#[test]
fn a_finished_map_can_be_moved_before_it_is_compared() {
    let room = room();
    let folder = tempfile::tempdir().unwrap();
    let [identity, shifted] = [("identity", 0.0), ("shifted", 0.6)].map(|(name, x)| {
        let file = folder.path().join(name);
        std::fs::write(&file, format!("1 {x} {x} {x} 0 0 0 1\n")).unwrap();
        file
    });
    let auc = |more: &[&str]| {
        let args = [
            "evaluate",
            "map",
            "--json",
            text(&room.map),
            text(&room.truth),
        ];
        let report = json(&monogrid(args.iter().chain(more)));
        report["policies"]["observed"]["auc"].as_f64().unwrap()
    };
    let plain = auc(&[]);
    assert!((auc(&["--move-map", text(&identity)]) - plain).abs() < 1e-12);
    assert!(auc(&["--move-map", text(&shifted)]) < plain - 0.05);
}

#[test]
fn sensor_models_are_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let out = text(folder.path());
    let args = [
        "thesis",
        "sensor-model",
        "--plot",
        out,
        "--json",
        "--sensor-model",
        "andert-stereo",
    ];
    let report = json(&monogrid(args.into_iter().chain(["--range", "2,4"])));
    assert_eq!(report["figures"].as_array().unwrap().len(), 13);
    for file in [
        "figure-5.11-andert-stereo.svg",
        "chosen.csv",
        "sensor-models.html",
    ] {
        assert!(folder.path().join(file).is_file(), "{file}");
    }
    let bad = [
        "thesis",
        "sensor-model",
        "--plot",
        out,
        "--sensor-model",
        "andert",
        "--p-min",
        "0.7",
    ];
    assert_fails(&monogrid(bad), 2, &["p_min"]);
}

#[test]
fn slices_cover_the_height_of_a_map() {
    let room = room();
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("slices");
    let args = ["slice", text(&room.map), text(&out), "--json", "--leaves"];
    let report = json(&monogrid(args));
    let count = report["slices"].as_u64().unwrap() as usize;
    assert!(count > 5, "{report}");
    assert_eq!(
        std::fs::read_dir(&out).unwrap().count(),
        count + 1,
        "and the manifest"
    );
    let every_second = monogrid(args.into_iter().chain(["--step", "0.256"]));
    assert_eq!(json(&every_second)["slices"], count.div_ceil(2));
    let nothing = monogrid(args.into_iter().chain(["--min-height", "100"]));
    assert_fails(&nothing, 2, &["--min-height"]);
}
