//! Disks that are full, folders that cannot be written, pipes that are closed.

use super::limits::{Ended, limited, run};
use super::seeds::Seeds;
use crate::Outcomes;
use std::path::Path;
use std::process::Command;

/// What is wrong after a write that could not succeed: it must be said, and leave no half file
/// under a final name.
fn harms(ended: &Ended, codes: &[i32], map: &Path) -> Vec<String> {
    let mut harms: Vec<String> = ended.harm().into_iter().collect();
    if !ended.code.is_some_and(|code| codes.contains(&code)) {
        harms.push(format!(
            "exit code {:?}, expected one of {codes:?}",
            ended.code
        ));
    }
    if ended.code == Some(1) && ended.said.trim().is_empty() {
        harms.push("nothing was said".to_owned());
    }
    if ended.code != Some(0) && map.is_file() {
        let path = map.display().to_string();
        if run(limited("", ["info", &path]), &std::env::temp_dir()).code != Some(0) {
            harms.push(format!("{path} is half a map"));
        }
    }
    harms
}

#[test]
#[ignore = "takes minutes; see scripts/torture.sh"]
fn files_that_may_not_grow() {
    let seeds = Seeds::new();
    let video = seeds.path("video").display().to_string();
    let map = seeds.path("run/global.ot").display().to_string();
    let recording = seeds.path("run/recording.mgk").display().to_string();
    let mut outcomes = Outcomes::default();
    // no file may have more than so many blocks of 512 bytes: every write fails at some size
    for blocks in [0, 1, 8, 64, 512, 4096] {
        let before = format!("trap '' XFSZ; ulimit -f {blocks};");
        let out = seeds.path(&format!("limited-{blocks}"));
        let (bt, ot) = (out.with_extension("bt"), out.with_extension("ot"));
        let [to, to_bt, to_ot] = [&out, &bt, &ot].map(|path| path.display().to_string());
        for (args, file) in [
            (vec!["run", &video, "--out", &to], out.join("global.ot")),
            (vec!["convert", &map, &to_bt], bt.clone()),
            (vec!["map", &recording, "--out", &to_ot], ot.clone()),
        ] {
            let ended = through_pipe(limited(&before, args.iter()));
            let what = format!("{blocks} blocks, {}", args[0]);
            outcomes.count(&what, &ended, &harms(&ended, &[0, 1, 2], &file));
        }
    }
    outcomes.conclude("full disk (limit of file sizes)");
}

#[test]
#[ignore = "takes minutes; see scripts/torture.sh"]
fn small_and_read_only_disks() {
    let seeds = Seeds::new();
    let video = seeds.path("video").display().to_string();
    let map = seeds.path("run/global.ot").display().to_string();
    let disk = seeds.path("disk");
    std::fs::create_dir(&disk).unwrap();
    let mut outcomes = Outcomes::default();
    for kilobytes in [16, 200, 1000] {
        let size = format!("size={kilobytes}k");
        if !mount(&["-t", "tmpfs", "-o", &size, "tmpfs"], &disk) {
            println!("  no file system can be mounted here: left out");
            return;
        }
        let out = disk.join("out").display().to_string();
        let ended = run(limited("", ["run", &video, "--out", &out]), seeds.root());
        let harm = harms(&ended, &[0, 1], &disk.join("out/global.ot"));
        outcomes.count(&format!("disk of {kilobytes} kB"), &ended, &harm);
        if mount(&["-o", "remount,ro"], &disk) {
            let to = disk.join("m.bt").display().to_string();
            for args in [
                &["run", &video, "--out", &out, "--force"][..],
                &["convert", &map, &to],
            ] {
                let ended = run(limited("", args), seeds.root());
                outcomes.count(
                    "read-only disk",
                    &ended,
                    &harms(&ended, &[1, 2], Path::new("")),
                );
            }
        }
        assert!(
            Command::new("umount")
                .arg(&disk)
                .status()
                .unwrap()
                .success()
        );
    }
    outcomes.conclude("small and read-only disks");
}

fn mount(options: &[&str], at: &Path) -> bool {
    let mounted = Command::new("mount").args(options).arg(at).status();
    mounted.is_ok_and(|status| status.success())
}

#[test]
#[ignore = "takes minutes; see scripts/torture.sh"]
fn standard_output_that_is_full_or_closed() {
    let seeds = Seeds::new();
    let video = seeds.path("video").display().to_string();
    let map = seeds.path("run/global.ot").display().to_string();
    let trajectory = seeds.path("run/trajectory.txt").display().to_string();
    let truth = format!("{video}/groundtruth.txt");
    let mut outcomes = Outcomes::default();
    for args in [
        &["info", &map, "--json"][..],
        &["evaluate", "trajectory", &trajectory, &truth, "--json"],
        &["check", &video, "--json"],
    ] {
        for (how, codes) in [
            ("> /dev/full", &[1][..]),
            (">&-", &[0, 1]),
            ("| head -c 1", &[0]),
        ] {
            let ended = run(redirected(how, args), seeds.root());
            let what = format!("{} {how}", args[0]);
            outcomes.count(&what, &ended, &harms(&ended, codes, Path::new("")));
        }
    }
    outcomes.conclude("standard output full or closed");
}

/// The program with its output redirected by the shell.
fn redirected(how: &str, args: &[&str]) -> Command {
    let mut command = Command::new("sh");
    command
        .arg("-c")
        .arg(format!("\"$0\" \"$@\" {how}"))
        .arg(env!("CARGO_BIN_EXE_monogrid"))
        .args(args);
    command
}

/// As [`run`], for a program that may not write files: what it says goes through a pipe.
fn through_pipe(mut command: Command) -> Ended {
    let begin = std::time::Instant::now();
    let output = command.output().unwrap();
    Ended {
        code: output.status.code(),
        said: String::from_utf8_lossy(&output.stderr).into_owned(),
        took: begin.elapsed(),
    }
}
