//! Ground truth, its comparison with maps, and synthetic datasets, through the program.
#![allow(clippy::too_many_lines, reason = "a test tells its story in one place")]

use crate::common::{assert_fails, code, json, monogrid, stderr};
use monogrid_occupancy::{MapConfig, Occupancy, OccupancyMap, VoxelKey, read_ot, write_ot};
use serde_json::Value;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

struct Folder(TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> String {
        self.0.path().join(name).display().to_string()
    }

    fn write(&self, name: &str, content: &str) -> String {
        fs::write(self.path(name), content).unwrap();
        self.path(name)
    }

    fn write_map(&self, name: &str, map: &OccupancyMap) -> String {
        let mut bytes = Vec::new();
        write_ot(map, &mut bytes).unwrap();
        fs::write(self.path(name), bytes).unwrap();
        self.path(name)
    }
}

fn read_map(path: impl AsRef<Path>) -> OccupancyMap {
    read_ot(fs::File::open(path).unwrap(), usize::MAX).unwrap()
}

fn ok(args: &[&str]) -> Value {
    let output = monogrid(args.iter().chain(&["--json"]));
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    json(&output)
}

/// A closed box from (0, 0, 0) to (2, 1, 1), its corners off the cell boundaries.
const BOX_OBJ: &str = "\
v 0.05 0.05 0.05\nv 2.05 0.05 0.05\nv 2.05 1.05 0.05\nv 0.05 1.05 0.05
v 0.05 0.05 1.05\nv 2.05 0.05 1.05\nv 2.05 1.05 1.05\nv 0.05 1.05 1.05
f 1 2 3 4\nf 5 6 7 8\nf 1 2 6 5\nf 4 3 7 8\nf 1 4 8 5\nf 2 3 7 6\n";
const INSIDE: &str = "0 1.0 0.5 0.5 0 0 0 1\n0.1 1.1 0.5 0.5 0 0 0 1\n";

#[test]
fn the_truth_of_a_box_is_its_walls_and_its_inside() {
    let folder = Folder::new();
    let mesh = folder.write("box.obj", BOX_OBJ);
    let poses = folder.write("poses.txt", INSIDE);
    let out = folder.path("truth.ot");
    let report = ok(&[
        "truth",
        &mesh,
        "--trajectory",
        &poses,
        "--resolution",
        "0.1",
        "--out",
        &out,
    ]);
    // walls lie in the middle of cells: 21 x 11 x 11 cells of which 19 x 9 x 9 are inside
    assert_eq!(report["free"], 19 * 9 * 9);
    assert_eq!(report["occupied"], 21 * 11 * 11 - 19 * 9 * 9);
    assert_eq!(report["reaches_border"], false);
    let map = read_map(&out);
    assert_eq!(map.state([1.0, 0.5, 0.5]), Occupancy::Free);
    assert_eq!(map.state([0.05, 0.5, 0.5]), Occupancy::Occupied);
    assert_eq!(map.state([-0.15, 0.5, 0.5]), Occupancy::Unknown);

    // without a camera inside nobody knows where free is
    let other = folder.path("other.ot");
    assert_fails(
        &monogrid(["truth", &mesh, "--out", &other]),
        2,
        &["--trajectory"],
    );
    let outside = folder.write("outside.txt", "0 0.05 0.5 0.5 0 0 0 1\n");
    let args = ["truth", &mesh, "--trajectory", &outside, "--out", &other];
    assert_fails(&monogrid(args), 2, &["camera", "free space"]);
    assert_fails(
        &monogrid(["truth", "no-such-world", "--out", &other]),
        2,
        &["no-such-world", "living-room"],
    );
}

#[test]
fn a_point_cloud_gives_the_same_truth_as_the_mesh_it_samples() {
    let folder = Folder::new();
    // the same box, sampled every 5 cm
    let mut points = Vec::new();
    for (i, j, k) in
        (0..=40).flat_map(|i| (0..=20).flat_map(move |j| (0..=20).map(move |k| (i, j, k))))
    {
        if i == 0 || i == 40 || j == 0 || j == 20 || k == 0 || k == 20 {
            let [x, y, z] = [i, j, k].map(|n| 0.051 + 0.05 * f64::from(n) * 0.999);
            points.push(format!("{x} {y} {z}"));
        }
    }
    let header = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty \
         float z\nend_header\n",
        points.len()
    );
    let rows = points.join("\n");
    let cloud = folder.write("box.ply", &(header.clone() + &rows + "\n"));
    // with a point that has no place, which is left out; and the same as PCL writes it
    let with_hole = header.replace(&points.len().to_string(), &(points.len() + 1).to_string());
    let with_hole = folder.write("hole.ply", &format!("{with_hole}nan 0 0\n{rows}\n"));
    let pcd = format!(
        "FIELDS x y z\nWIDTH {}\nHEIGHT 1\nDATA ascii\n{rows}\n",
        points.len()
    );
    let pcd = folder.write("box.pcd", &pcd);
    let mesh = folder.write("box.obj", BOX_OBJ);
    let poses = folder.write("poses.txt", INSIDE);
    let make = |source: &str, out: &str| {
        ok(&[
            "truth",
            source,
            "--trajectory",
            &poses,
            "--resolution",
            "0.1",
            "--out",
            out,
        ])
    };
    make(&cloud, &folder.path("cloud.ot"));
    make(&mesh, &folder.path("mesh.ot"));
    let report = make(&with_hole, &folder.path("hole.ot"));
    assert!(
        report["warnings"].to_string().contains("1 points"),
        "{report}"
    );
    make(&pcd, &folder.path("pcd.ot"));
    for other in ["mesh.ot", "hole.ot", "pcd.ot"] {
        assert_eq!(
            fs::read(folder.path("cloud.ot")).unwrap(),
            fs::read(folder.path(other)).unwrap(),
            "{other}"
        );
    }
}

#[test]
fn counts_of_a_map_are_those_that_were_put_into_it() {
    let folder = Folder::new();
    let mut truth = OccupancyMap::new(MapConfig::with_resolution(0.1)).unwrap();
    let mut estimate = truth.clone();
    for x in 0..10 {
        let key = VoxelKey::new(x, 0, 0);
        let is_occupied = x < 4;
        truth
            .set_log_odds(key, Some(if is_occupied { 3.5 } else { -2.0 }))
            .unwrap();
        // found: 0, 1; missed: 2; never seen: 3; false alarm: 4; right: 5 to 8; never seen: 9
        let log_odds = match x {
            0 | 1 | 4 => Some(1.0),
            2 | 5..=8 => Some(-1.0),
            _ => None,
        };
        estimate.set_log_odds(key, log_odds).unwrap();
    }
    let (truth, estimate) = (
        folder.write_map("truth.ot", &truth),
        folder.write_map("estimate.ot", &estimate),
    );
    let report = ok(&["evaluate", "map", &estimate, &truth]);
    let observed = &report["policies"]["observed"];
    for (name, count) in [("tp", 2), ("fp", 1), ("tn", 4), ("fn", 1)] {
        assert_eq!(observed[name], count, "{name} in {observed}");
    }
    let number = |value: &Value| value.as_f64().unwrap();
    assert!((number(&observed["precision"]) - 2.0 / 3.0).abs() < 1e-12);
    assert!((number(&observed["recall"]) - 2.0 / 3.0).abs() < 1e-12);
    assert!((number(&observed["f1"]) - 2.0 / 3.0).abs() < 1e-12);
    // 3 occupied against 5 free: 2*4 pairs in order, 2*1 + 1*4 ties, 1 in disorder
    assert!(
        (number(&observed["auc"]) - (8.0 + 3.0) / 15.0).abs() < 1e-12,
        "{observed}"
    );
    assert!((number(&report["coverage_free"]) - 5.0 / 6.0).abs() < 1e-12);
    assert!((number(&report["coverage_occupied"]) - 0.75).abs() < 1e-12);
    // a robot keeps out of the cells it never saw: one hit and one false alarm more
    let safety = &report["policies"]["safety"];
    for (name, count) in [("tp", 3), ("fp", 2), ("tn", 4), ("fn", 1)] {
        assert_eq!(safety[name], count, "{name} in {safety}");
    }
    for name in ["brier", "accuracy_m", "completeness", "ssd", "roc"] {
        assert!(!report[name].is_null(), "{name} is missing");
    }
    for policy in ["known", "everything"] {
        for name in ["auc", "auc_26", "mcc", "precision", "recall", "f1"] {
            assert!(report["policies"][policy][name].is_f64(), "{policy} {name}");
        }
    }
    let text = monogrid(["evaluate", "map", &estimate, &truth]);
    assert!(String::from_utf8_lossy(&text.stdout).contains("observed"));

    let coarse = OccupancyMap::new(MapConfig::with_resolution(0.15)).unwrap();
    let coarse = folder.write_map("coarse.ot", &coarse);
    let other = monogrid(["evaluate", "map", &coarse, &truth]);
    assert_fails(&other, 2, &["0.15", "0.1"]);
}

#[test]
fn a_finer_truth_is_made_coarser() {
    let folder = Folder::new();
    let mesh = folder.write("box.obj", BOX_OBJ);
    let poses = folder.write("poses.txt", INSIDE);
    for (name, resolution) in [("fine.ot", "0.05"), ("coarse.ot", "0.1")] {
        let out = folder.path(name);
        ok(&[
            "truth",
            &mesh,
            "--trajectory",
            &poses,
            "--resolution",
            resolution,
            "--out",
            &out,
        ]);
    }
    let report = ok(&[
        "evaluate",
        "map",
        &folder.path("coarse.ot"),
        &folder.path("fine.ot"),
    ]);
    assert_eq!(report["policies"]["observed"]["fn"], 0, "{report}");
    assert_eq!(report["coverage_occupied"], 1.0);
}

#[test]
fn paths_are_free_in_the_truth_and_blocked_by_a_wall() {
    let folder = Folder::new();
    let mesh = folder.write("box.obj", BOX_OBJ);
    let poses = folder.write("poses.txt", INSIDE);
    let truth = folder.path("truth.ot");
    ok(&[
        "truth",
        &mesh,
        "--trajectory",
        &poses,
        "--resolution",
        "0.05",
        "--out",
        &truth,
    ]);
    let evaluate = |estimate: &str| {
        ok(&[
            "evaluate",
            "paths",
            estimate,
            &truth,
            "--robot-radius",
            "0.1",
            "--pairs",
            "50",
            "--min-distance",
            "0.8",
        ])
    };
    let same = evaluate(&truth);
    assert_eq!(same["robot_radius"], 0.1);
    for rule in ["unknown_blocked", "unknown_free"] {
        let all = &same[rule]["all"];
        assert_eq!(all["pairs"], 50);
        for name in ["false_positive", "unreachable", "false_negative"] {
            assert_eq!(all[name], 0.0, "{rule} {name}: {same}");
        }
    }
    // a wall that is not there cuts the box in two
    let mut map = read_map(&truth);
    for y in 0..21 {
        for z in 0..21 {
            map.set_log_odds(VoxelKey::new(20, y, z), Some(3.5))
                .unwrap();
        }
    }
    let walled = evaluate(&folder.write_map("walled.ot", &map));
    let all = &walled["unknown_free"]["all"];
    assert!(all["false_positive"].as_f64().unwrap() > 0.3, "{walled}");
    assert!(all["unreachable"].as_f64().unwrap() > 0.3, "{walled}");
    // maps in different frames hardly overlap, which is said before it is taken for a bad map
    let options = [
        "--robot-radius",
        "0.1",
        "--pairs",
        "20",
        "--min-distance",
        "0.8",
    ];
    let said = |estimate: &str| {
        let output = monogrid(
            ["evaluate", "paths", estimate, &truth]
                .iter()
                .chain(&options),
        );
        assert_eq!(code(&output), 0, "{}", stderr(&output));
        stderr(&output)
    };
    let (move_by, far) = (folder.path("by.txt"), folder.path("far.ot"));
    fs::write(&move_by, "1 0.9 0.9 0 0 0 0 1\n").unwrap();
    ok(&["transform", &truth, &far, "--sim3", &move_by]);
    let hint = "expected maps of the same place, in one frame and one unit";
    assert!(said(&far).contains(hint), "{}", said(&far));
    assert!(!said(&truth).contains("warning"), "{}", said(&truth));
    let too_wide = ["evaluate", "paths", &truth, &truth, "--robot-radius", "3"];
    assert_fails(&monogrid(too_wide), 2, &["radius 3"]);
}

#[test]
fn a_written_dataset_agrees_with_its_own_truth() {
    let folder = Folder::new();
    let out = folder.path("room");
    let args = [
        "synth",
        "living-room",
        "--out",
        &out,
        "--frames",
        "40",
        "--size",
        "80x60",
        "--noise",
        "off",
        "--depth-every",
        "2",
        "--truth-resolution",
        "0.1",
        "--quick-light",
    ];
    let report = ok(&args);
    assert_eq!(report["frames"], 40);
    assert_eq!(report["depth_images"], 20);
    let truth = format!("{out}/truth.ot");
    let free = report["truth_free"].as_u64().unwrap();
    assert!(free > 10_000, "{report}");

    // the same from the mesh that was written, with the poses that were written
    let (mesh, poses) = (format!("{out}/mesh.ply"), format!("{out}/groundtruth.txt"));
    let again = folder.path("again.ot");
    let of_mesh = ok(&[
        "truth",
        &mesh,
        "--trajectory",
        &poses,
        "--resolution",
        "0.1",
        "--out",
        &again,
    ]);
    assert_eq!(of_mesh["occupied"], report["truth_occupied"]);

    // what the depth images saw is a part of it
    let seen = folder.path("seen.ot");
    let of_depth = ok(&["truth", &out, "--resolution", "0.1", "--out", &seen]);
    assert_eq!(of_depth["cameras"], 20);
    let compared = ok(&["evaluate", "map", &seen, &truth]);
    let observed = &compared["policies"]["observed"];
    // cells that a surface only grazes are occupied in the exact truth and free to most small
    // images
    assert!(observed["recall"].as_f64().unwrap() > 0.6, "{observed}");
    assert!(observed["precision"].as_f64().unwrap() > 0.8, "{observed}");
    assert!(
        observed["specificity"].as_f64().unwrap() > 0.95,
        "{observed}"
    );

    // the program reads what it wrote, replaces it, and nothing else
    ok(&["check", &out]);
    ok(&args);
    let photos = folder.path("photos");
    fs::create_dir(&photos).unwrap();
    fs::write(format!("{photos}/cat.jpg"), "x").unwrap();
    assert_fails(
        &monogrid(["synth", "office", "--out", &photos]),
        2,
        &["photos", "--force"],
    );
    assert_fails(
        &monogrid(["synth", "attic", "--out", &out]),
        2,
        &["attic", "living-room"],
    );
    let flying = ["synth", "office", "--out", &out, "--motion", "carpet"];
    assert_fails(&monogrid(flying), 2, &["carpet", "drone"]);
    assert!(Path::new(&truth).exists(), "bad requests touch nothing");
}

#[test]
fn maps_are_cropped_merged_moved_compared_and_projected() {
    let folder = Folder::new();
    let mut map = OccupancyMap::new(MapConfig::with_resolution(0.1)).unwrap();
    for x in 0..10 {
        for y in 0..4 {
            let log_odds = if y == 0 { 1.0 } else { -1.0 };
            map.set_log_odds(VoxelKey::new(x, y, 0), Some(log_odds))
                .unwrap();
        }
    }
    let map = folder.write_map("map.ot", &map);
    let [left, right, both] = ["left.ot", "right.ot", "both.ot"].map(|name| folder.path(name));
    let crop =
        |out: &str, min: &str, max: &str| ok(&["crop", &map, out, "--min", min, "--max", max]);
    let report = crop(&left, "-1,-1,-1", "0.45,1,1");
    assert_eq!(report["cells_occupied"], 5);
    assert_eq!(report["cells_free"], 15);
    crop(&right, "0.55,-1,-1", "5,1,1");
    ok(&["merge", &left, &right, "--out", &both]);
    let same = ok(&["diff", &map, &both]);
    assert_eq!(same["same"], 40, "{same}");
    assert_eq!(same["mean_log_odds_difference"], 0.0);
    let half = ok(&["diff", &map, &left]);
    assert_eq!(
        (&half["same"], &half["only_before"]),
        (&20.into(), &20.into())
    );

    // a quarter turn about z, twice as large: x becomes y, y becomes -x
    let quarter = "2 0 0 0 0 0 0.7071067811865476 0.7071067811865476\n";
    let sim3 = folder.write("sim3.txt", quarter);
    let turned = folder.path("turned.ot");
    let report = ok(&["transform", &map, &turned, "--sim3", &sim3]);
    assert_eq!(report["cells_occupied"], 10, "{report}");
    assert_eq!(report["cells_free"], 30, "{report}");
    let turned = read_map(&turned);
    assert_eq!(turned.state([-0.1, 1.9, 0.1]), Occupancy::Occupied);
    assert_eq!(turned.state([-0.7, 0.1, 0.1]), Occupancy::Free);
    assert_eq!(turned.state([0.1, 0.1, 0.1]), Occupancy::Unknown);

    let pgm = folder.path("plan.pgm");
    let report = ok(&["project", &map, &pgm]);
    assert_eq!(
        (&report["width"], &report["height"]),
        (&10.into(), &4.into())
    );
    assert!(fs::read(&pgm).unwrap().starts_with(b"P5\n10 4\n255\n"));
    assert!(
        fs::read_to_string(folder.path("plan.yaml"))
            .unwrap()
            .contains("image: plan.pgm")
    );
    let described = || fs::read_to_string(folder.path("plan.yaml")).unwrap();
    assert!(described().contains("WARNING: nothing beside the map"));
    // beside a run: the band over the floor, and what is known of the unit
    folder.write(
        "summary.json",
        r#"{"scale": "arbitrary", "floor": {"camera_height": 0.8}}"#,
    );
    ok(&["project", &map, &pgm, "--force", "--min-height", "0"]);
    assert!(described().contains("z = 0.000 to 0.880 map units\n# WARNING: the scale"));
    folder.write(
        "summary.json",
        r#"{"scale": "metric", "floor": {"camera_height": 7}}"#,
    );
    assert_fails(
        &monogrid(["project", &map, &pgm, "--force"]),
        2,
        &["between the heights 0.7"],
    );
    // the heights of the grid that the run itself wrote stand above what follows from the floor
    folder.write(
        "summary.json",
        r#"{"scale": "metric", "floor": {"camera_height": 7}, "map": {"band": [0.0, 0.75]}}"#,
    );
    ok(&["project", &map, &pgm, "--force"]);
    assert!(described().contains("z = 0.000 to 0.750 m"));
    folder.write(
        "summary.json",
        r#"{"scale": "metric", "floor": {"camera_height": 7}}"#,
    );
    // a floor of a run that did not know what is up is none
    folder.write(
        "summary.json",
        r#"{"scale": "metric", "up": {"is_certain": false}, "floor": {"camera_height": 7}}"#,
    );
    ok(&["project", &map, &pgm, "--force"]);
    assert!(described().contains(" m (up is uncertain)"));
    let high = folder.path("high.pgm");
    let empty = ["project", &map, &high, "--min-height", "7"];
    assert_fails(&monogrid(empty), 2, &["no known cells"]);
    let nothing = folder.path("nothing.ot");
    let outside = ["crop", &map, &nothing, "--min", "5,5,5", "--max", "6,6,6"];
    assert_fails(&monogrid(outside), 2, &["no known cells", "--min", "reach"]);
}

/// The numbers of an array of floats.
fn npy(path: &str) -> Vec<f32> {
    let bytes = fs::read(path).unwrap();
    let begin = 10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
    let numbers = bytes[begin..].chunks_exact(4);
    numbers
        .map(|four| f32::from_le_bytes(four.try_into().unwrap()))
        .collect()
}

#[test]
fn robots_get_distances_and_paths() {
    let folder = Folder::new();
    let mut map = wall();
    map.set_log_odds(VoxelKey::new(0, 0, 0), None).unwrap();
    let map = folder.write_map("wall.ot", &map);
    let [all, layer] = ["all.npy", "layer.npy"].map(|name| folder.path(name));
    let report = ok(&["distances", &map, &all, "--max-distance", "0.35"]);
    assert_eq!(report["shape"], serde_json::json!([10, 10, 6]));
    let distances = npy(&all);
    assert_eq!(distances.len(), 600);
    assert!(distances[0].is_nan(), "unknown");
    // x is fastest; the wall is at x = 5
    let row: Vec<i32> = distances[6..12]
        .iter()
        .map(|d| (d * 100.0).round() as i32)
        .collect();
    assert_eq!(row, [35, 35, 30, 20, 10, 0]);
    ok(&[
        "distances",
        &map,
        &layer,
        "--max-distance",
        "0.35",
        "--height",
        "0.55",
    ]);
    assert_eq!(npy(&layer), distances[300..360]);
    assert!(
        fs::read_to_string(folder.path("layer.yaml"))
            .unwrap()
            .contains("axes are y, x")
    );
    let outside = ["distances", &map, &folder.path("no.npy"), "--height", "7"];
    assert_fails(&monogrid(outside), 2, &["--height 7", "from 0 to 1"]);

    let plan = |to: &str, radius: &str| {
        ["plan", &map, "0.25,0.25,0.5", to, "--robot-radius", radius].map(str::to_owned)
    };
    let path = ok(&plan("0.25,0.75,0.5", "0.1").each_ref().map(String::as_str));
    assert!(
        (path["length"].as_f64().unwrap() - 0.5).abs() < 1e-6,
        "{path}"
    );
    assert_eq!(path["points"].as_array().unwrap().len(), 2);
    let text = monogrid(plan("0.25,0.75,0.5", "0.1"));
    assert!(String::from_utf8_lossy(&text.stdout).ends_with("\n0.2500 0.7500 0.5500\n"));
    // beside the wall: as near to it as the robot may come
    let near = monogrid(plan("0.45,0.55,0.55", "0.1"));
    let text = String::from_utf8_lossy(&near.stdout).into_owned();
    assert!(text.ends_with("\n0.3500 0.5500 0.5500\n"), "{text}");
    let said = stderr(&near);
    assert!(
        said.contains("does not fit at the goal: the path has it 0."),
        "{said}"
    );
    assert_fails(&monogrid(plan("0.4,0.5,0.5", "9")), 2, &["fits nowhere"]);
    // on the floor, into files
    let [csv, path, picture] = ["p.csv", "p.json", "p.png"].map(|name| folder.path(name));
    ok(&[
        "plan",
        &map,
        "0.25,0.25",
        "0.25,0.75",
        "--robot-radius",
        "0.1",
        "--heights",
        "0,0.6",
        "--out",
        &csv,
        "--out",
        &path,
        "--out",
        &picture,
    ]);
    let csv = fs::read_to_string(csv).unwrap();
    assert_eq!(csv, "x,y,z\n0.2500,0.2500,0.0000\n0.2500,0.7500,0.0000\n");
    let message: serde_json::Value = serde_json::from_slice(&fs::read(path).unwrap()).unwrap();
    assert_eq!(message["poses"][1]["pose"]["position"]["y"], 0.75);
    assert!(fs::read(picture).unwrap().starts_with(b"\x89PNG"));
    let lost = [
        "plan",
        &map,
        "0,0",
        "0,0",
        "--robot-radius",
        "0.1",
        "--on-floor",
    ];
    assert_fails(&monogrid(lost), 2, &["--heights LOW,HIGH"]);
    assert_fails(&monogrid(plan("3,0.5,0.5", "0.1")), 2, &["outside the map"]);
}

/// A wall with free space before it.
fn wall() -> OccupancyMap {
    let mut map = OccupancyMap::new(MapConfig::with_resolution(0.1)).unwrap();
    for y in 0..10 {
        for z in 0..10 {
            for x in 0..6 {
                let log_odds = if x == 5 { 2.0 } else { -1.0 };
                let key = VoxelKey::new(x, y, z);
                map.set_log_odds(key, Some(log_odds)).unwrap();
            }
        }
    }
    map
}

#[test]
fn the_folder_of_a_run_is_taken_wherever_a_map_is() {
    let folder = Folder::new();
    let run = folder.path("run");
    fs::create_dir(&run).unwrap();
    let map = folder.write_map("run/global.ot", &wall());
    let out = |name: &str| folder.path(name);
    let same = folder.write("same.txt", "1 0 0 0 0 0 0 1\n");
    let poses: String = (0..9)
        .map(|k| format!("{k} {k} {} 0 0 0 0 1\n", k * k))
        .collect();
    let path = folder.write("run/trajectory.txt", &poses);
    for (k, args) in [
        vec!["info", &run],
        vec!["diff", &run, &map],
        vec!["convert", &run, &out("c.bt")],
        vec!["crop", &run, &out("d.ot"), "--min=-9,-9,-9", "--max=9,9,9"],
        vec!["merge", &run, &map, "--out", &out("e.ot")],
        vec!["mesh", &run, &out("f.ply")],
        vec!["transform", &run, &out("l.ot"), "--sim3", &same],
        vec!["evaluate", "trajectory", &run, &path],
        vec!["project", &run, &out("g.svg")],
        vec!["project", &run, &out("g.png")],
        vec!["slice", &run, &out("h")],
        vec!["distances", &run, &out("i.npy"), "--max-distance", "1"],
        vec!["evaluate", "map", &run, &map],
        vec![
            "plan",
            &run,
            "0.15,0.15,0.15",
            "0.25,0.75,0.75",
            "--robot-radius",
            "0.1",
        ],
        vec!["view", &run, "--html", &out("k.html")],
    ]
    .into_iter()
    .enumerate()
    {
        let output = monogrid(&args);
        assert_eq!(code(&output), 0, "{k} {args:?}: {}", stderr(&output));
    }
    let args = ["evaluate", "paths", &run, &map, "--robot-radius", "0.1"];
    assert_fails(
        &monogrid(args),
        2,
        &["the truth has no two connected places"],
    );
    // what is read is not written over, and an empty folder says what it lacks
    let args = ["convert", &run, &map, "--force"];
    assert_fails(&monogrid(args), 2, &["the map"]);
    let empty = folder.path("empty");
    fs::create_dir(&empty).unwrap();
    assert_fails(&monogrid(["info", &empty]), 2, &["holds no global.ot"]);
}

#[test]
fn meshes_are_seen_as_surfaces() {
    let folder = Folder::new();
    let map = folder.write_map("wall.ot", &wall());
    for name in ["wall.ply", "wall.glb", "wall.obj"] {
        let mesh = folder.path(name);
        let made = ok(&["mesh", &map, &mesh, "--min-faces", "0"]);
        let page = folder.path(&format!("{name}.html"));
        let seen = ok(&["view", &mesh, "--html", &page]);
        assert_eq!(seen["triangles"], made["triangles"], "{name}: {seen}");
        assert!(seen["triangles"].as_u64() > Some(10), "{name}: {seen}");
        assert_eq!(seen["points"], 0, "{name}");
    }
}

#[test]
fn maps_and_points_are_seen_as_a_page_a_picture_and_over_loopback() {
    let folder = Folder::new();
    let map = folder.write_map("wall.ot", &wall());
    let (html, png) = (folder.path("wall.html"), folder.path("wall.png"));
    let report = ok(&["view", &map, "--html", &html, "--png", &png]);
    assert_eq!(report["cells"], 100);
    let page = fs::read_to_string(&html).unwrap();
    assert!(page.contains("\"count\":[100,"), "the wall is in the page");
    let picture = monogrid_datasets::read_gray(Path::new(&png)).unwrap();
    let mut levels = picture.as_slice().to_vec();
    levels.sort_by(f32::total_cmp);
    levels.dedup();
    assert!(levels.len() > 20, "the wall is in the picture");

    let points = folder.path("wall.ply");
    ok(&["convert", &map, &points]);
    let html = folder.path("points.html");
    assert_eq!(ok(&["view", &points, "--html", &html])["points"], 100);
    let failed = monogrid(["view", &folder.path("")]);
    assert_fails(&failed, 2, &["global.ot", "recording.mgk"]);
    served(&map, &page);
    // a page that says nothing of what it may load
    let own = "<!doctype html><script src=http://example.org></script>";
    let run = folder.path("run");
    fs::create_dir(&run).unwrap();
    fs::copy(&map, Path::new(&run).join("global.ot")).unwrap();
    fs::write(Path::new(&run).join("report.html"), own).unwrap();
    served(&run, own);
}

/// The page over a socket is that of the file, or that of a folder, and it ends when it is told to,
/// whatever clients do.
fn served(what: &str, page: &str) {
    use std::io::{BufRead, BufReader};
    let mut child = crate::common::program()
        .args(["view", what, "--json"])
        .stdout(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let url = lines.find_map(|line| {
        let line = line.unwrap();
        let url = line.split_once("\"url\": \"")?.1;
        Some(url.split('"').next()?.to_owned())
    });
    let url = url.expect("an address");
    let clients = crate::common::hostile_clients(&url);
    let answer = crate::common::get(&url);
    let head = String::from_utf8_lossy(&answer[..answer.len() - page.len()]);
    assert!(head.starts_with("HTTP/1.1 200"), "{head}");
    let policy = "\r\nContent-Security-Policy: default-src 'none'; script-src";
    assert!(head.contains(policy), "{head}");
    assert!(answer.ends_with(page.as_bytes()), "{} bytes", answer.len());
    #[cfg(unix)]
    {
        let begin = std::time::Instant::now();
        crate::common::interrupt(&child);
        assert_eq!(child.wait().unwrap().code(), Some(0));
        assert!(begin.elapsed() < std::time::Duration::from_secs(2));
    }
    // where nothing interrupts it
    let _ = child.kill();
    child.wait().unwrap();
    drop(clients);
}
