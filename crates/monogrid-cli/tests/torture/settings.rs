//! Settings and options at their ends: a sentence, or a run that ends.

use super::limits::{limited, run};
use super::seeds::Seeds;
use crate::Outcomes;

/// Runs the program; it must end within its limits, and say why where it refuses.
fn attempt(outcomes: &mut Outcomes, seeds: &Seeds, args: &[&str]) {
    let _ = std::fs::remove_dir_all(seeds.path("x"));
    let _ = std::fs::remove_file(seeds.path("x.ot"));
    let ended = run(limited("", args), seeds.root());
    let mut harms: Vec<String> = ended.harm().into_iter().collect();
    if ended.code != Some(0) && ended.said.trim().is_empty() {
        harms.push("nothing was said".to_owned());
    }
    outcomes.count(&format!("{args:?}"), &ended, &harms);
}

#[test]
#[ignore = "takes minutes; see scripts/torture.sh"]
fn cells_of_any_size() {
    let seeds = Seeds::new();
    let mut outcomes = Outcomes::default();
    let recording = seeds.path("run/recording.mgk").display().to_string();
    let scans = seeds.path("scans.scans").display().to_string();
    let mesh = seeds.path("mesh.obj").display().to_string();
    let truth = seeds.path("video/groundtruth.txt").display().to_string();
    let to = seeds.path("x.ot").display().to_string();
    for cells in [
        "1e-300", "1e-9", "1e-6", "1e-5", "1e-4", "1e-3", "2e-3", "5e-3", "1e3", "1e300",
    ] {
        for rule in ["fused", "rays"] {
            attempt(
                &mut outcomes,
                &seeds,
                &[
                    "map",
                    &recording,
                    "--resolution",
                    cells,
                    "--integration",
                    rule,
                    "--out",
                    &to,
                ],
            );
            attempt(
                &mut outcomes,
                &seeds,
                &[
                    "map",
                    &scans,
                    "--resolution",
                    cells,
                    "--integration",
                    rule,
                    "--out",
                    &to,
                ],
            );
        }
        attempt(
            &mut outcomes,
            &seeds,
            &[
                "truth",
                &mesh,
                "--trajectory",
                &truth,
                "--resolution",
                cells,
                "--out",
                &to,
            ],
        );
    }
    outcomes.conclude("cells of 1e-300 to 1e300");
}

#[test]
#[ignore = "takes minutes; see scripts/torture.sh"]
fn extreme_settings_of_maps() {
    let seeds = Seeds::new();
    let mut outcomes = Outcomes::default();
    let recording = seeds.path("run/recording.mgk").display().to_string();
    let to = seeds.path("x.ot").display().to_string();
    for option in [
        &["--buffer", "1e5"][..],
        &["--buffer", "1e5", "--max-range", "1e6"],
        &["--max-range", "1e300"],
        &["--max-range", "1e-300"],
        &["--significance", "1e300", "--sensor-model", "andert"],
        &["--set", "mapping.pose_sigma=1e6"],
        &["--set", "mapping.planes.max_count=1000"],
        &[
            "--set",
            "mapping.max_memory_gb=0.01",
            "--resolution",
            "0.01",
        ],
        &["--threads", "100000"],
        &["--threads", "64"],
    ] {
        attempt(
            &mut outcomes,
            &seeds,
            &[&["map", &recording, "--out", &to], option].concat(),
        );
    }
    outcomes.conclude("extreme settings of maps");
}

#[test]
#[ignore = "takes minutes; see scripts/torture.sh"]
fn extreme_settings_of_runs() {
    let seeds = Seeds::new();
    let mut outcomes = Outcomes::default();
    let video = seeds.path("video").display().to_string();
    let out = seeds.path("x").display().to_string();
    for option in [
        &["--threads", "100000"][..],
        &["--fps", "1e300"],
        &["--size", "8192x8192"],
        &["--size", "32x32"],
        &["--set", "slam.depth.sensor_sigma=0"],
        &["--set", "slam.publication.min_validity=-3"],
        &["--set", "slam.sparse.points_per_keyframe=20000"],
        &["--set", "slam.sparse.window_newest=1000"],
        &["--resolution", "1e-4"],
        &["--local-radius", "1e300"],
        &["--start", "18446744073709551615"],
    ] {
        attempt(
            &mut outcomes,
            &seeds,
            &[
                &["run", &video, "--max-frames", "60", "--out", &out],
                option,
            ]
            .concat(),
        );
    }
    outcomes.conclude("extreme settings of runs");
}

#[test]
#[ignore = "takes minutes; see scripts/torture.sh"]
fn extreme_options_of_tools() {
    let seeds = Seeds::new();
    let mut outcomes = Outcomes::default();
    let map = seeds.path("run/global.ot").display().to_string();
    let to = seeds.path("x.ot").display().to_string();
    let out = seeds.path("x").display().to_string();
    for args in [
        &["slice", &map, &out, "--step", "1e-9"][..],
        &["slice", &map, &out, "--pixels", "1000000000"],
        &[
            "crop",
            &map,
            &to,
            "--min",
            "-1e300,0,0",
            "--max",
            "1e300,1,1",
        ],
        &["project", &map, &out, "--min-height", "1e300"],
        &[
            "thesis",
            "sensor-model",
            "--sensor-model",
            "thrun",
            "--buffer",
            "1e300",
            "--out",
            &out,
        ],
        &["evaluate", "paths", &map, &map, "--robot-radius", "1e300"],
        &["evaluate", "paths", &map, &map, "--robot-radius", "1e-300"],
        &["evaluate", "map", &map, &map, "--tolerance", "1e300"],
        &[
            "synth",
            "office",
            "--frames",
            "1000000000000",
            "--size",
            "32x32",
            "--out",
            &out,
            "--fps",
            "1e300",
        ],
    ] {
        attempt(&mut outcomes, &seeds, args);
    }
    outcomes.conclude("extreme options of tools");
}
