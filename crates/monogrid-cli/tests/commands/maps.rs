//! `map`, `info` and `convert` on data with given poses.

use crate::common::{code, json, monogrid, small_sequence, stderr, write_scans};
use std::fs;
use std::path::Path;

#[test]
fn scans_become_a_map_that_is_independent_of_threads() {
    let dir = tempfile::tempdir().unwrap();
    let scans = dir.path().join("wall.scans");
    write_scans(&scans);
    let build = |name: &str, more: &[&str]| {
        let map = dir.path().join(name);
        let mut args = vec![
            "map".to_owned(),
            scans.display().to_string(),
            "--out".to_owned(),
            map.display().to_string(),
            "--json".to_owned(),
        ];
        args.extend(more.iter().map(|s| (*s).to_owned()));
        let output = monogrid(args);
        assert_eq!(code(&output), 0, "{}", stderr(&output));
        (json(&output), map)
    };
    let (report, map) = build("a.ot", &["--integration", "rays", "--threads", "1"]);
    assert_eq!(report["points"], 81 * 81);
    let (_, other) = build("b.ot", &["--integration", "rays", "--threads", "3"]);
    assert_eq!(fs::read(&map).unwrap(), fs::read(other).unwrap());
    let info = json(&monogrid([Path::new("info"), &map, Path::new("--json")]));
    // the wall is 1.6 m by 1.6 m of cells of 5 cm, about one cell thick
    let occupied = info["cells_occupied"].as_u64().unwrap();
    assert!((33 * 33..=40 * 40 * 3).contains(&occupied), "{info}");
    let low = info["bounds_min"][0].as_f64().unwrap();
    let high = info["bounds_max"][0].as_f64().unwrap();
    assert!(low <= 0.0 && (2.0..2.5).contains(&high), "{info}");

    // none: end points only
    let (_, map) = build("c.ot", &["--sensor-model", "none", "--integration", "rays"]);
    let info = json(&monogrid([Path::new("info"), &map, Path::new("--json")]));
    assert_eq!(info["cells_free"], 0);
    assert!(info["cells_occupied"].as_u64().unwrap() > 0);

    // a Sim(3) moves and scales the map
    let sim3 = dir.path().join("sim3.txt");
    fs::write(&sim3, "2 10 0 0 0 0 0 1\n").unwrap();
    let align = format!("sim3:{}", sim3.display());
    let (_, map) = build(
        "d.ot",
        &[
            "--align",
            &align,
            "--resolution",
            "0.1",
            "--integration",
            "rays",
        ],
    );
    let info = json(&monogrid([Path::new("info"), &map, Path::new("--json")]));
    let high = info["bounds_max"][0].as_f64().unwrap();
    assert!((14.0..15.0).contains(&high), "{info}");
}

#[test]
fn formats_convert_into_each_other() {
    let dir = tempfile::tempdir().unwrap();
    let scans = dir.path().join("wall.scans");
    write_scans(&scans);
    let path = |name: &str| dir.path().join(name).display().to_string();
    let ok = |args: &[&str]| {
        let output = monogrid(args);
        assert_eq!(code(&output), 0, "{}", stderr(&output));
    };
    ok(&["map", &path("wall.scans"), "--out", &path("a.ot")]);
    ok(&["map", &path("wall.scans"), "--out", &path("a.bt")]);
    ok(&["convert", &path("a.ot"), &path("b.ot")]);
    assert_eq!(
        fs::read(path("a.ot")).unwrap(),
        fs::read(path("b.ot")).unwrap()
    );
    ok(&["convert", &path("a.ot"), &path("b.bt")]);
    assert_eq!(
        fs::read(path("a.bt")).unwrap(),
        fs::read(path("b.bt")).unwrap()
    );
    // whatever a file is called, its content decides
    fs::copy(path("a.bt"), path("c.ot")).unwrap();
    let info = json(&monogrid(["info", &path("c.ot"), "--json"]));
    assert!(info["format"].as_str().unwrap().contains(".bt"));
    for (name, start) in [("a.ply", &b"ply\n"[..]), ("a.pcd", b"# .PCD")] {
        ok(&["convert", &path("a.ot"), &path(name)]);
        assert!(fs::read(path(name)).unwrap().starts_with(start));
    }
    // a truncated file is refused
    let whole = fs::read(path("a.ot")).unwrap();
    fs::write(path("cut.ot"), &whole[..whole.len() / 2]).unwrap();
    crate::common::assert_fails(&monogrid(["info", &path("cut.ot")]), 2, &["cut.ot"]);
}

#[test]
fn posed_depth_images_become_a_map() {
    let dir = tempfile::tempdir().unwrap();
    let map = dir.path().join("room.ot");
    let output = monogrid([
        Path::new("map"),
        small_sequence(),
        Path::new("--out"),
        &map,
        Path::new("--json"),
    ]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let report = json(&output);
    assert_eq!(report["scans"], crate::common::SMALL_FRAMES.div_ceil(5));
    assert!(report["points"].as_u64().unwrap() > 100_000);
    let info = json(&monogrid([Path::new("info"), &map, Path::new("--json")]));
    // the floor of the room is at z = 0, its ceiling below 4 m
    let low = info["bounds_min"][2].as_f64().unwrap();
    let high = info["bounds_max"][2].as_f64().unwrap();
    assert!(low > -0.5 && high < 4.5, "{info}");
}

#[test]
fn settings_of_map_can_be_set_and_its_own_format_is_exact() {
    let dir = tempfile::tempdir().unwrap();
    let scans = dir.path().join("wall.scans");
    write_scans(&scans);
    let path = |name: &str| dir.path().join(name).display().to_string();
    let run = |args: &[&str]| {
        let output = monogrid(args);
        assert_eq!(code(&output), 0, "{args:?}: {}", stderr(&output));
        output
    };
    let scans = scans.display().to_string();
    let set = "mapping.resolution=0.1";
    run(&["map", &scans, "--set", set, "--out", &path("a.mgo")]);
    run(&["map", &scans, "--resolution", "0.1", "--out", &path("b.ot")]);
    // The same evidence, whichever way it went through files.
    run(&["convert", &path("a.mgo"), &path("a.ot")]);
    assert_eq!(
        fs::read(path("a.ot")).unwrap(),
        fs::read(path("b.ot")).unwrap()
    );
    let facts = |name: &str| json(&run(&["info", &path(name), "--json"]));
    let (own, octomap) = (facts("a.mgo"), facts("b.ot"));
    assert!(own["format"].as_str().unwrap().contains(".mgo"), "{own}");
    for fact in ["resolution", "leaves", "cells_occupied", "cells_free"] {
        assert_eq!(own[fact], octomap[fact], "{fact}");
    }
    assert!(own["file_bytes"].as_u64() < octomap["file_bytes"].as_u64());
    let bad = monogrid([
        "map",
        &scans,
        "--set",
        "mapping.sizes=1",
        "--out",
        &path("c.ot"),
    ]);
    assert_eq!(code(&bad), 2);
    assert!(stderr(&bad).contains("mapping.sizes=1"), "{}", stderr(&bad));
}
