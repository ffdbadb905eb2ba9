//! Runs that are killed at any moment leave what was complete.

use super::limits::{limited, run};
use super::seeds::Seeds;
use crate::{from_environment, row};
use rand::rngs::SmallRng;
use rand::{RngExt, SeedableRng};
use std::fs;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

/// Names of the files of a folder, but for those that are not finished, which begin with a point.
fn final_names(folder: &std::path::Path) -> Vec<String> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
    names.filter(|name| !name.starts_with('.')).collect()
}

/// Pictures of keyframes in the folder of a run.
fn num_pictures(out: &std::path::Path) -> usize {
    let names = final_names(&out.join("keyframes"));
    names.iter().filter(|n| n.ends_with("image.png")).count()
}

/// Until the first keyframe is recorded, or the run ends: most of a short run is over before.
fn wait_for_keyframe(run: &mut Child, out: &std::path::Path) {
    while num_pictures(out) == 0 && run.try_wait().unwrap().is_none() {
        std::thread::sleep(Duration::from_millis(2));
    }
}

#[test]
#[ignore = "takes minutes; see scripts/torture.sh"]
fn killed_runs_lose_only_the_keyframe_in_progress() {
    let kills = from_environment("TORTURE_KILLS", 50);
    let seeds = Seeds::new();
    let video = seeds.path("video").display().to_string();
    let whole = limited_run(&seeds, &video, "whole");
    let begin = Instant::now();
    assert_eq!(run(whole, seeds.root()).code, Some(0));
    let duration = begin.elapsed();
    let (mut maps, mut nothing, mut harmed, mut slowest) = (0, 0, 0, Duration::ZERO);
    for number in 0..kills {
        let mut rng = SmallRng::seed_from_u64(number);
        let moment = duration.mul_f64(rng.random_range(0.0..1.1));
        let after_a_keyframe = number % 5 != 0;
        let out = seeds.path("killed");
        let _ = fs::remove_dir_all(&out);
        let mut command = limited_run(&seeds, &video, "killed");
        let mut child = command
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        if after_a_keyframe {
            wait_for_keyframe(&mut child, &out);
        }
        std::thread::sleep(moment);
        child.kill().unwrap();
        child.wait().unwrap();
        // keyframes whose picture is on the disk were recorded before it
        let pictures = num_pictures(&out);
        let recording = out.join("recording.mgk");
        let map = seeds.path("again.ot");
        let _ = fs::remove_file(&map);
        let args = [
            "map",
            &recording.display().to_string(),
            "--out",
            &map.display().to_string(),
        ];
        let ended = run(limited("", args), seeds.root());
        slowest = slowest.max(ended.took);
        let recorded = monogrid_datasets::Recording::read(&recording, Default::default());
        let keyframes = recorded
            .as_ref()
            .map_or(0, |recording| recording.keyframes.len());
        let is_mapped = ended.code == Some(0) && map.is_file();
        maps += usize::from(is_mapped);
        nothing += usize::from(!is_mapped && keyframes == 0);
        // a keyframe has a pose when the next one is recorded
        let lost = ended.harm().is_some() || keyframes < pictures || (!is_mapped && keyframes > 1);
        if lost {
            harmed += 1;
            println!(
                "  kill {number} after {moment:?}: {keyframes} keyframes, {pictures} pictures, {}",
                ended.said
            );
        }
        for name in final_names(&out) {
            let text = fs::read(out.join(&name)).unwrap_or_default();
            let is_half = match name.rsplit_once('.').map(|parts| parts.1) {
                Some("json") => serde_json::from_slice::<serde_json::Value>(&text).is_err(),
                Some("ot" | "bt") => {
                    let path = out.join(&name).display().to_string();
                    run(limited("", ["info", &path]), seeds.root()).code != Some(0)
                }
                Some("html") => !String::from_utf8_lossy(&text).contains("</html>"),
                _ => false,
            };
            if is_half {
                harmed += 1;
                println!("  kill {number}: {name} is half a file");
            }
        }
    }
    let outcome = format!("{maps} mapped, {nothing} before the first keyframe");
    row(
        "kill -9 at a random moment",
        kills as usize,
        &outcome,
        slowest,
        harmed,
    );
    assert_eq!(harmed, 0, "see above");
}

fn limited_run(seeds: &Seeds, video: &str, out: &str) -> std::process::Command {
    let out = seeds.path(out).display().to_string();
    limited("", ["run", video, "--out", &out, "--threads", "2"])
}
