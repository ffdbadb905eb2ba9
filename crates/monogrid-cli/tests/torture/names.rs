//! Files that are no files, names that nobody expects, links that lead astray.

use super::limits::{limited, run};
use super::seeds::Seeds;
use crate::Outcomes;
use std::ffi::OsString;
use std::fs;
use std::os::unix::ffi::OsStringExt;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Names of files or folders, all of which the system allows.
fn names() -> Vec<OsString> {
    let mut names: Vec<OsString> = [
        "with space",
        "-dash",
        "--out",
        "new\nline",
        "quo\"te",
        "apo'strophe",
        "$(reboot)",
        "per%cent",
        "semi;colon",
        "back\\slash",
        "<html>&amp;",
        "ünïcödé",
        "\u{202e}backwards",
        "#comment",
        "tab\there",
        "*",
        "~",
        ".hidden",
    ]
    .map(OsString::from)
    .to_vec();
    names.push(OsString::from_vec(b"not\xffutf8".to_vec()));
    names.push("n".repeat(200).into());
    names
}

/// Runs the program and counts whether it ended as expected.
fn attempt(
    outcomes: &mut Outcomes,
    seeds: &Seeds,
    what: &str,
    args: &[OsString],
    expected: &[i32],
) {
    let ended = run(limited("", args), seeds.root());
    let mut harms: Vec<String> = ended.harm().into_iter().collect();
    if !ended.code.is_some_and(|code| expected.contains(&code)) {
        harms.push(format!("exit code {:?}, expected {expected:?}", ended.code));
    }
    outcomes.count(&format!("{what} ({:?})", args[0]), &ended, &harms);
}

#[test]
#[ignore = "takes minutes; see scripts/torture.sh"]
fn odd_names() {
    let seeds = Seeds::new();
    let mut outcomes = Outcomes::default();
    fs::create_dir_all(seeds.path("outs")).unwrap();
    for name in names() {
        // as a source, as a result, as a map
        let what = format!("name {name:?}");
        let source = seeds.path("sources").join(&name);
        copy_folder(&seeds.path("video"), &source);
        let out = seeds.path("outs").join(&name);
        let run = args(&["run", "--max-frames", "12", "--out"], &[&out, &source]);
        attempt(&mut outcomes, &seeds, &what, &run, &[0, 3]);
        attempt(
            &mut outcomes,
            &seeds,
            &what,
            &args(&["check"], &[&source]),
            &[0],
        );
        let mut map = out.into_os_string();
        map.push(".bt");
        let convert = args(
            &["convert"],
            &[&seeds.path("run/global.ot"), Path::new(&map)],
        );
        attempt(&mut outcomes, &seeds, &what, &convert, &[0]);
        fs::remove_dir_all(&source).unwrap();
    }
    outcomes.conclude("odd names");
}

#[test]
#[ignore = "takes minutes; see scripts/torture.sh"]
fn files_that_are_none() {
    let seeds = Seeds::new();
    let mut outcomes = Outcomes::default();
    let calibration = seeds.path("video/calibration.txt");
    let (video, out) = (seeds.path("video"), seeds.path("odd"));
    let few = fs::read_to_string(seeds.path("video/few.txt")).unwrap();
    for (what, path) in no_files(&seeds) {
        let list = seeds.path("video/odd.txt");
        fs::write(&list, format!("{few}\n5.0 {}\n", path.display())).unwrap();
        let to = Path::new("--out");
        let in_list = args(&["run", "--calibration"], &[&calibration, &list, to, &out]);
        let mut all = vec![
            (in_list, &[0, 3][..]),
            (args(&["info"], &[&path]), &[2]),
            (args(&["map", "--out"], &[&seeds.path("x.ot"), &path]), &[2]),
            (
                args(&["evaluate", "trajectory"], &[&path, &calibration]),
                &[2],
            ),
            // a pipe is waited for
            (args(&["check", "--source-timeout", "1"], &[&path]), &[1, 2]),
        ];
        for option in ["--calibration", "--config", "--mask", "--continue"] {
            all.push((args(&["run", option], &[&path, &video, to, &out]), &[2]));
        }
        for (args, expected) in all {
            let _ = fs::remove_dir_all(&out);
            attempt(&mut outcomes, &seeds, what, &args, expected);
        }
    }
    outcomes.conclude("pipes, devices, links that lead astray");
}

#[test]
#[ignore = "takes minutes; see scripts/torture.sh"]
fn lists_of_missing_images() {
    let seeds = Seeds::new();
    let mut outcomes = Outcomes::default();
    let calibration = seeds.path("video/calibration.txt");
    let (list, out) = (seeds.path("video/missing.txt"), seeds.path("missing"));
    let mut text = fs::read_to_string(seeds.path("video/few.txt")).unwrap();
    (0..100_000).for_each(|i| text += &format!("\n{}.0 none/{i}.png", i + 10));
    fs::write(&list, text).unwrap();
    let run = args(
        &["run", "--calibration"],
        &[&calibration, &list, Path::new("--out"), &out],
    );
    attempt(&mut outcomes, &seeds, "100,000 missing images", &run, &[1]);
    let check = args(&["check", "--calibration"], &[&calibration, &list]);
    attempt(
        &mut outcomes,
        &seeds,
        "100,000 missing images",
        &check,
        &[0],
    );
    outcomes.conclude("lists of 100,000 missing images");
}

/// Options and then paths.
fn args(options: &[&str], paths: &[&Path]) -> Vec<OsString> {
    let options = options.iter().map(OsString::from);
    options
        .chain(paths.iter().map(|path| path.as_os_str().to_owned()))
        .collect()
}

/// Things that are no regular files, by name.
fn no_files(seeds: &Seeds) -> Vec<(&'static str, PathBuf)> {
    let folder = seeds.path("no-files");
    fs::create_dir(&folder).unwrap();
    let mut all = Vec::new();
    let pipe = folder.join("pipe.mgk");
    if Command::new("mkfifo")
        .arg(&pipe)
        .status()
        .is_ok_and(|status| status.success())
    {
        all.push(("a pipe", pipe));
    }
    for (what, name, target) in [
        ("an endless device", "zero.mgk", "/dev/zero"),
        ("a link to itself", "loop.mgk", "loop.mgk"),
        ("a link to nowhere", "dangling.mgk", "nowhere"),
        ("a terminal", "tty.mgk", "/dev/tty"),
        ("a link to a folder", "folder.mgk", "."),
    ] {
        let link = folder.join(name);
        symlink(target, &link).unwrap();
        all.push((what, link));
    }
    all
}

fn copy_folder(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap().flatten() {
        let target = to.join(entry.file_name());
        if entry.file_type().unwrap().is_dir() {
            copy_folder(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}
