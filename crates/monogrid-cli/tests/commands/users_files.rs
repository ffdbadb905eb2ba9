//! The program deletes and overwrites nothing that it did not write: every way that we know is
//! tried on every command that writes.

use crate::common::{assert_fails, code, monogrid, program, stderr};
use monogrid_datasets::{
    DepthPixel, EndRecord, KeyframeRecord, PoseSnapshot, RecordingWriter, Scale, SessionInfo,
    encode_png,
};
use monogrid_geometry::{Pinhole, Sim3};
use monogrid_image::Image;
use monogrid_occupancy::{MapConfig, OccupancyMap, VoxelKey, save_atomically, write_ot};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use tempfile::TempDir;

/// A call that succeeds (or ends without a map) and writes.
struct Call {
    /// As the command line has it, such as `evaluate trajectory`.
    command: &'static str,
    /// Extension of an output file; none for a folder.
    extension: &'static str,
    /// Arguments without the output.
    arguments: Vec<String>,
    /// Option before the output; none where it is positional and comes last of the positional ones.
    option: &'static str,
    /// Every file that it reads.
    inputs: Vec<PathBuf>,
}

/// Files that calls read.
struct Sources {
    dir: TempDir,
}

/// A closed box from (0, 0, 0) to (2, 1, 1).
const BOX_OBJ: &str = "\
v 0.05 0.05 0.05\nv 2.05 0.05 0.05\nv 2.05 1.05 0.05\nv 0.05 1.05 0.05
v 0.05 0.05 1.05\nv 2.05 0.05 1.05\nv 2.05 1.05 1.05\nv 0.05 1.05 1.05
f 1 2 3 4\nf 5 6 7 8\nf 1 2 6 5\nf 4 3 7 8\nf 1 4 8 5\nf 2 3 7 6\n";
const INSIDE: &str = "0 1.0 0.5 0.5 0 0 0 1\n0.5 1.05 0.5 0.5 0 0 0 1\n1 1.1 0.5 0.5 0 0 0 1\n";

/// Two keyframes that see a wall.
fn write_recording(path: &Path, idepth: f32) {
    let (width, height) = (80, 60);
    let session = SessionInfo {
        pinhole: Pinhole::new(60.0, 60.0, 39.5, 29.5),
        width,
        height,
        scale: Scale::Arbitrary,
        seed: 0,
        profile: "default".to_owned(),
        source: "wall".to_owned(),
        config: String::new(),
    };
    let mut writer = RecordingWriter::create(path, &session).unwrap();
    for id in 0..2 {
        let pixels = (0..400u16).map(|i| DepthPixel {
            x: 20 + i % 20,
            y: 20 + i / 20,
            idepth,
            idepth_var: 1e-4,
        });
        writer
            .append_keyframe(KeyframeRecord {
                id,
                frame_index: 10 * u64::from(id),
                timestamp_ns: 1_000_000_000 * i64::from(id),
                camera: None,
                image: Some(Image::from_fn(width, height, |x, y| {
                    ((x * 7 + y * 13) % 251) as u8
                })),
                pixels: pixels.collect(),
            })
            .unwrap();
    }
    let poses = (0..2).map(|id| (id, Sim3::identity())).collect();
    writer
        .append_poses(PoseSnapshot { revision: 1, poses })
        .unwrap();
    let end = EndRecord {
        num_frames: 11,
        num_tracked: 11,
        summary: String::new(),
    };
    writer.finish(end).unwrap();
}

/// A chessboard of 4 by 3 inner corners as a camera sees it that turned by these angles around x
/// and y.
fn chessboard(turn_x: f64, turn_y: f64) -> Image<u8> {
    let (sin_x, cos_x, sin_y, cos_y) = (turn_x.sin(), turn_x.cos(), turn_y.sin(), turn_y.cos());
    Image::from_fn(320, 240, |column, row| {
        let mut sum = 0.0;
        for sample in 0..16 {
            let x = (column as f64 + 0.25 * f64::from(sample % 4) - 159.0) / 400.0;
            let y = (row as f64 + 0.25 * f64::from(sample / 4) - 119.0) / 400.0;
            // the board: through (0, 0, 8), along (cos y, 0, sin y) and its normal's other side
            let normal = [-sin_y * cos_x, sin_x, cos_y * cos_x];
            let far = 8.0 * normal[2] / (normal[0] * x + normal[1] * y + normal[2]);
            let at = [x * far, y * far, far - 8.0];
            let across = [cos_y, 0.0, sin_y];
            let down = [
                normal[1] * across[2] - normal[2] * across[1],
                normal[2] * across[0] - normal[0] * across[2],
                normal[0] * across[1] - normal[1] * across[0],
            ];
            let along = |axis: [f64; 3]| axis[0] * at[0] + axis[1] * at[1] + axis[2] * at[2];
            let (u, v) = (along(across) + 2.5, along(down) + 2.0);
            let is_on = (0.0..5.0).contains(&u) && (0.0..4.0).contains(&v);
            let is_black = is_on && (u.floor() + v.floor()).rem_euclid(2.0) < 0.5;
            sum += if is_black { 30.0 } else { 220.0 };
        }
        (sum / 16.0) as u8
    })
}

const TASK: &str = r#"{"format": 1, "name": "one", "source": "one.mp4", "options": [],
"class": "failed", "reason": "", "attempts": 1, "version": "0.1.0", "settings_sha256": "",
"began_unix_s": 0, "wall_s": 0, "outputs": {}}"#;
const CALIBRATION: &str = "60 60 39.5 29.5 80 60\n";
const POSES: &str =
    "0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n2 1 1 0 0 0 0 1\n3 1 1 1 0 0 0 1\n4 0 1 1 0 0 0 1\n";

/// What a batch leaves of a recording.
fn write_batch(task: &Path) {
    fs::create_dir_all(task).unwrap();
    fs::write(task.join("task.json"), TASK).unwrap();
}

impl Sources {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let this = Self { dir };
        let images = this.path("images");
        fs::create_dir(&images).unwrap();
        for i in 0..12 {
            let image = Image::from_fn(80, 60, |x, y| ((x * 7 + y * 13 + i * 3) % 251) as u8);
            fs::write(images.join(format!("{i}.png")), encode_png(&image)).unwrap();
        }
        fs::write(images.join("calibration.txt"), CALIBRATION).unwrap();
        let board = this.path("board");
        fs::create_dir(&board).unwrap();
        let turns = [(0.0, 0.5), (0.0, -0.5), (0.5, 0.0), (-0.5, 0.0), (0.4, 0.4)];
        for (i, (turn_x, turn_y)) in turns.into_iter().enumerate() {
            // an image without the board between two: it is shown anew each time
            let blank = Image::from_fn(320, 240, |_, _| 200);
            fs::write(board.join(format!("{}.png", 2 * i)), encode_png(&blank)).unwrap();
            let shown = encode_png(&chessboard(turn_x, turn_y));
            fs::write(board.join(format!("{}.png", 2 * i + 1)), shown).unwrap();
        }
        for name in ["poses.txt", "estimate.txt"] {
            fs::write(this.path(name), POSES).unwrap();
        }
        fs::write(
            this.path("list.txt"),
            "0.0 images/0.png\n0.1 images/1.png\n",
        )
        .unwrap();
        fs::write(this.path("camera.txt"), CALIBRATION).unwrap();
        fs::write(this.path("settings.toml"), "seed = 1\n").unwrap();
        fs::write(
            this.path("mask.png"),
            encode_png(&Image::filled(80, 60, 255u8)),
        )
        .unwrap();
        fs::write(this.path("sim3.txt"), "1 0 0 0 0 0 0 1\n").unwrap();
        fs::write(this.path("mesh.obj"), BOX_OBJ).unwrap();
        fs::write(this.path("inside.txt"), INSIDE).unwrap();
        let batch = format!(
            "{}\tname=images\tcalibration={}\n",
            this.text("images"),
            this.text("camera.txt")
        );
        fs::write(this.path("recordings.tsv"), batch).unwrap();
        write_batch(&this.path("batch/tasks/one"));
        write_recording(&this.path("recording.mgk"), 0.5);
        write_recording(&this.path("later.mgk"), 0.4);
        // what a run leaves
        fs::create_dir(this.path("run")).unwrap();
        write_recording(&this.path("run/recording.mgk"), 0.5);
        fs::write(this.path("run/trajectory.txt"), POSES).unwrap();
        fs::write(this.path("run/map_from_world.txt"), "1 0 0 0 0 0 0 1\n").unwrap();
        fs::write(this.path("run/summary.json"), "{\"scale\": \"arbitrary\"}").unwrap();
        this.write_maps();
        this
    }

    /// A row of cells twice, and a room that is free.
    fn write_maps(&self) {
        for name in ["map.ot", "other.ot"] {
            let mut map = OccupancyMap::new(MapConfig::with_resolution(0.1)).unwrap();
            for x in 0..20 {
                let log_odds = if x < 10 { 1.0 } else { -1.0 };
                let key = VoxelKey::new(x, 2, 0);
                map.set_log_odds(key, Some(log_odds)).unwrap();
            }
            save_atomically(&self.path(name), |file| write_ot(&map, file)).unwrap();
        }
        let mut free = OccupancyMap::new(MapConfig::with_resolution(0.1)).unwrap();
        for k in 0..1000 {
            let key = VoxelKey::new(k % 10, k / 10 % 10, k / 100);
            free.set_log_odds(key, Some(-1.0)).unwrap();
        }
        save_atomically(&self.path("free.ot"), |file| write_ot(&free, file)).unwrap();
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn text(&self, name: &str) -> String {
        self.path(name).display().to_string()
    }

    /// A call; arguments that name a file here have `@` before it, those of `reads` are files here.
    fn call(
        &self,
        command: &'static str,
        option: &'static str,
        extension: &'static str,
        arguments: &str,
        reads: &str,
    ) -> Call {
        let full = |word: &str| match word.split_once('@') {
            Some((before, name)) => format!("{before}{}", self.path(name).display()),
            None => word.to_owned(),
        };
        Call {
            command,
            extension,
            arguments: arguments.split_whitespace().map(full).collect(),
            option,
            inputs: reads
                .split_whitespace()
                .map(|name| self.path(name))
                .collect(),
        }
    }

    /// One call of every command that writes a folder.
    fn folder_calls(&self) -> Vec<Call> {
        let run = "@list.txt --calibration @camera.txt --mask @mask.png --config @settings.toml \
            --align gt:@poses.txt";
        let read_by_run = "list.txt images/0.png camera.txt mask.png settings.toml poses.txt";
        let synth =
            "@mesh.obj --trajectory @inside.txt --frames 2 --size 64x48 --truth-resolution 0.1";
        let sweep = "@recording.mgk --truth @map.ot --resolutions 0.2";
        let rescale = "@run --scale-from trajectory:@poses.txt";
        let merge_runs = "@run @later.mgk --config @settings.toml";
        let read_by_merge_runs = "run/recording.mgk run/map_from_world.txt later.mgk settings.toml";
        let read_by_export = "run/recording.mgk run/map_from_world.txt";
        let read_by_rescale = "run/recording.mgk run/summary.json poses.txt";
        vec![
            self.call("run", "--out", "", run, read_by_run),
            self.call("demo", "--out", "", "--max-frames 1", ""),
            self.call(
                "batch",
                "--out",
                "",
                "@recordings.tsv",
                "recordings.tsv camera.txt",
            ),
            self.call("report", "--out", "", "@batch", "batch/tasks/one/task.json"),
            self.call("calibrate", "--out", "", "@board", "board/1.png"),
            self.call("synth", "--out", "", synth, "mesh.obj inside.txt"),
            self.call("thesis sensor-model", "--plot", "", "", ""),
            self.call("man", "--out", "", "", ""),
            self.call("slice", "", "", "@map.ot", "map.ot"),
            self.call("thesis sweep", "--out", "", sweep, "recording.mgk map.ot"),
            self.call("rescale", "--out", "", rescale, read_by_rescale),
            self.call("export", "--out", "", "@run --to colmap", read_by_export),
            self.call("merge-runs", "--out", "", merge_runs, read_by_merge_runs),
        ]
    }

    /// One call of every command that writes a file.
    fn file_calls(&self) -> Vec<Call> {
        let map = "@recording.mgk --config @settings.toml";
        let read_by_map = "recording.mgk settings.toml";
        let truth = "@mesh.obj --trajectory @inside.txt";
        let crop = "--min -1,-1,-1 --max 1,1,1 @map.ot";
        let plan = "--robot-radius 0.1 @free.ot 0.4,0.5,0.5 0.6,0.5,0.5";
        let images = "images/0.png images/2.png";
        let evaluate = "@estimate.txt @poses.txt --align none";
        let transform = "--sim3 @sim3.txt @map.ot";
        vec![
            self.call("map", "--out", "ot", map, read_by_map),
            self.call("truth", "--out", "ot", truth, "mesh.obj inside.txt"),
            self.call("convert", "", "ot", "@map.ot", "map.ot"),
            self.call("transform", "", "ot", transform, "map.ot sim3.txt"),
            self.call("crop", "", "ot", crop, "map.ot"),
            self.call(
                "merge",
                "--out",
                "ot",
                "@map.ot @other.ot",
                "map.ot other.ot",
            ),
            self.call("project", "", "pgm", "@map.ot", "map.ot"),
            self.call("mesh", "", "glb", "@map.ot", "map.ot"),
            self.call("distances", "", "npy", "@map.ot", "map.ot"),
            self.call("plan", "--out", "csv", plan, "free.ot"),
            self.call("view", "--html", "html", "@map.ot", "map.ot"),
            self.call(
                "thesis vocabulary",
                "--out",
                "vocabulary",
                "@images --every 1",
                images,
            ),
            self.call(
                "evaluate trajectory",
                "--write-sim3",
                "txt",
                evaluate,
                "estimate.txt poses.txt",
            ),
        ]
    }

    /// One call of every command that writes.
    fn calls(&self) -> Vec<Call> {
        self.folder_calls()
            .into_iter()
            .chain(self.file_calls())
            .collect()
    }
}

impl Call {
    fn arguments(&self, out: &Path, more: &[&str]) -> Vec<String> {
        let mut arguments: Vec<String> = self.command.split(' ').map(str::to_owned).collect();
        arguments.extend(self.arguments.iter().cloned());
        if !self.option.is_empty() {
            arguments.push(self.option.to_owned());
        }
        arguments.push(out.display().to_string());
        arguments.extend(more.iter().map(|a| (*a).to_owned()));
        arguments
    }

    fn call(&self, out: &Path, more: &[&str]) -> Output {
        monogrid(self.arguments(out, more))
    }

    /// Calls it and expects that it does what it is for.
    fn succeed(&self, out: &Path, more: &[&str]) {
        let output = self.call(out, more);
        let is_good = matches!(code(&output), 0 | 3);
        assert!(is_good, "{}: {}", self.command, stderr(&output));
    }

    /// Calls it and expects that it refuses and leaves everything in `root` as it is.
    fn refuse(&self, root: &Path, out: &Path, more: &[&str], why: &str) {
        let before = files(root);
        let output = self.call(out, more);
        let what = format!("{}, {why}: {}", self.command, stderr(&output));
        assert_eq!(code(&output), 2, "{what}");
        assert!(!stderr(&output).contains("panicked"), "{what}");
        assert!(files(root) == before, "{what}");
    }

    /// Names that it writes into its folder, one of them in a subfolder where there are any.
    fn written(&self) -> &'static [&'static str] {
        match self.command {
            "run" => &["config.toml", "recording.mgk", "summary.json"],
            "demo" => &["config.toml"],
            "batch" => &["tasks/images/task.json", "tasks/images/log.txt"],
            "report" => &["report.html"],
            "calibrate" => &["calibration.txt", "residuals.svg"],
            "synth" => &["truth.ot", "rgb.txt", "rgb/000000.png", "mesh.ply"],
            "thesis sensor-model" => &["sensor-models.html"],
            "man" => &["monogrid.1", "monogrid-evaluate-map.1"],
            "slice" => &["slice_0000.png"],
            "merge-runs" => &["recording.mgk", "apart_1/recording.mgk", "global.ot"],
            "export" => &["images/00000.png", "sparse/0/images.txt"],
            "rescale" => &["recording.mgk", "summary.json", "global.ot"],
            "thesis sweep" => &["sweep.json", "sweep.html", "maps.csv"],
            other => panic!("what does {other} write?"),
        }
    }
}

/// Every file below a folder with its content, and every link with where it leads to.
fn files(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut out = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let entry = entry.unwrap();
        let (path, kind) = (entry.path(), entry.file_type().unwrap());
        if kind.is_symlink() {
            let target = fs::read_link(&path).unwrap();
            out.push((path, target.display().to_string().into_bytes()));
        } else if kind.is_dir() {
            out.extend(files(&path));
            out.push((path, Vec::new()));
        } else {
            let content = fs::read(&path).unwrap();
            out.push((path, content));
        }
    }
    out.sort();
    out
}

/// The names of all commands, as the program says them.
fn commands_of(prefix: &[&str]) -> Vec<String> {
    let output = monogrid(prefix.iter().chain(&["--help"]));
    let text = String::from_utf8(output.stdout).unwrap();
    let mut names = Vec::new();
    let lines = text
        .lines()
        .skip_while(|line| !line.starts_with("Commands:"))
        .skip(1);
    for line in lines.take_while(|line| !line.is_empty()) {
        let is_name = line.starts_with("  ") && !line.starts_with("   ");
        let name = line
            .split_whitespace()
            .next()
            .filter(|name| is_name && *name != "help");
        let Some(name) = name else { continue };
        let path: Vec<&str> = prefix.iter().copied().chain([name]).collect();
        let below = commands_of(&path);
        if below.is_empty() {
            names.push(path.join(" "));
        }
        names.extend(below);
    }
    names
}

/// Commands that write nothing.
const READERS: [&str; 8] = [
    "cameras",
    "check",
    "completions",
    "info",
    "diff",
    "evaluate depth",
    "evaluate map",
    "evaluate paths",
];

#[test]
fn every_command_that_writes_is_tried_here() {
    let sources = Sources::new();
    let mut tried: Vec<String> = sources
        .calls()
        .iter()
        .map(|call| call.command.to_owned())
        .collect();
    tried.extend(READERS.map(str::to_owned));
    tried.sort();
    let mut all = commands_of(&[]);
    all.sort();
    assert_eq!(
        all, tried,
        "is there a new command? say how it treats files"
    );
    for reader in READERS {
        let help = monogrid(reader.split(' ').chain(["--help"]));
        let help = String::from_utf8(help.stdout).unwrap();
        for option in ["--out", "--force", "--write"] {
            assert!(!help.contains(option), "{reader} has {option}");
        }
    }
}

#[test]
fn folders_with_anything_else_in_them_are_refused() {
    let sources = Sources::new();
    for call in sources.folder_calls() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path();
        let out = root.join("out");
        fs::create_dir_all(out.join("empty/folder")).unwrap();
        if call.command == "demo" {
            // takes long; the others show what becomes of a folder of their own
            fs::write(
                out.join("config.toml"),
                "# effective configuration of a monogrid run\n",
            )
            .unwrap();
            call.refuse(root, &out, &[], "an earlier version's folder");
            continue;
        }
        call.succeed(&out, &[]);
        assert!(out.join("empty/folder").is_dir(), "{}", call.command);
        fs::write(out.join("notes.txt"), "mine").unwrap();
        call.refuse(root, &out, &[], "a note");
        fs::remove_file(out.join("notes.txt")).unwrap();

        fs::create_dir(out.join("below")).unwrap();
        fs::write(out.join("below/notes.txt"), "mine").unwrap();
        call.refuse(root, &out, &[], "a note in a subfolder");
        fs::remove_dir_all(out.join("below")).unwrap();

        for name in call.written() {
            let written = fs::read(out.join(name)).unwrap();
            fs::write(out.join(name), "changed by hand").unwrap();
            call.refuse(root, &out, &[], "a file that changed");
            let mut same_size = written.clone();
            same_size[written.len() / 2] ^= 1;
            fs::write(out.join(name), same_size).unwrap();
            call.refuse(root, &out, &[], "a file that changed and is as long");
            fs::write(out.join(name), written).unwrap();
        }
        links(&call, root, &out);
        // as it was written: replaced, or gone on with
        call.succeed(&out, &[]);
        fs::remove_file(out.join("monogrid-manifest.txt")).unwrap();
        call.refuse(root, &out, &[], "no manifest");
        fs::write(out.join("monogrid-manifest.txt"), "mine").unwrap();
        call.refuse(root, &out, &[], "a foreign manifest");
        call.refuse(root, &out, &["--force"], "a foreign manifest and --force");
    }
}

#[cfg(not(unix))]
fn links(_: &Call, _: &Path, _: &Path) {}

/// Links to files and folders elsewhere are not ours, whatever their names.
#[cfg(unix)]
fn links(call: &Call, root: &Path, out: &Path) {
    use std::os::unix::fs::symlink;
    fs::create_dir(root.join("elsewhere")).unwrap();
    fs::write(root.join("elsewhere/precious.txt"), "mine").unwrap();
    for target in ["elsewhere", "elsewhere/precious.txt", "nowhere"] {
        symlink(root.join(target), out.join("link")).unwrap();
        call.refuse(root, out, &[], "a link");
        fs::remove_file(out.join("link")).unwrap();
    }
    // the same bytes, but through a link
    let name = call.written()[0];
    fs::rename(out.join(name), root.join("elsewhere/moved")).unwrap();
    symlink(root.join("elsewhere/moved"), out.join(name)).unwrap();
    call.refuse(root, out, &[], "a file replaced by a link to it");
    fs::remove_file(out.join(name)).unwrap();
    fs::rename(root.join("elsewhere/moved"), out.join(name)).unwrap();
    // the folder itself by a link
    symlink(out, root.join("alias")).unwrap();
    fs::write(out.join("notes.txt"), "mine").unwrap();
    call.refuse(root, &root.join("alias"), &[], "the folder by a link");
    fs::remove_file(out.join("notes.txt")).unwrap();
    call.succeed(&root.join("alias"), &[]);
}

#[cfg(unix)]
#[test]
fn force_leaves_other_files_and_what_links_lead_to() {
    use std::os::unix::fs::symlink;
    let sources = Sources::new();
    for call in sources.folder_calls() {
        let dir = tempfile::tempdir().unwrap();
        let (out, elsewhere) = (dir.path().join("out"), dir.path().join("elsewhere"));
        fs::create_dir_all(out.join("below")).unwrap();
        fs::create_dir(&elsewhere).unwrap();
        fs::write(out.join("below/notes.txt"), "mine").unwrap();
        for (number, name) in call.written().iter().enumerate() {
            let precious = elsewhere.join(format!("{number}"));
            fs::write(&precious, "mine").unwrap();
            fs::create_dir_all(out.join(name).parent().unwrap()).unwrap();
            // a link of either kind under a name that is written
            if number % 2 == 0 {
                symlink(&precious, out.join(name)).unwrap();
            } else {
                fs::hard_link(&precious, out.join(name)).unwrap();
            }
        }
        call.succeed(&out, &["--force"]);
        assert_eq!(fs::read(out.join("below/notes.txt")).unwrap(), b"mine");
        for (name, content) in files(&elsewhere) {
            assert_eq!(
                content,
                b"mine",
                "{} wrote through {}",
                call.command,
                name.display()
            );
        }
        for subfolder in ["keyframes", "rgb", "recording", "below"] {
            let link = dir.path().join("linked").join(subfolder);
            fs::create_dir_all(link.parent().unwrap()).unwrap();
            symlink(&elsewhere, &link).unwrap();
            let linked = dir.path().join("linked");
            call.refuse(&elsewhere, &linked, &["--force"], "a link to a folder");
            fs::remove_file(link).unwrap();
        }
    }
}

#[test]
fn what_a_call_reads_is_never_in_its_output_folder() {
    let sources = Sources::new();
    let root = sources.dir.path();
    for call in sources.folder_calls() {
        for input in &call.inputs {
            let holds = input.parent().unwrap();
            call.refuse(root, holds, &["--force"], "an input in the folder");
            call.refuse(root, root, &["--force"], "an input in or below the folder");
            by_links(&call, input, root);
        }
    }
    // a folder of ours, one of whose files is read
    let out = sources.path("ours");
    sources.calls()[0].succeed(&out, &[]);
    let settings = out.join("config.toml").display().to_string();
    let before = files(&out);
    for force in [&[][..], &["--force"]] {
        let images = sources.text("images");
        let mut arguments = vec!["run", &images, "--config", &settings];
        let out_text = out.display().to_string();
        arguments.extend(["--out", &out_text]);
        arguments.extend(force);
        assert_fails(&monogrid(arguments), 2, &["the settings"]);
        assert!(files(&out) == before);
    }
}

#[cfg(not(unix))]
fn by_links(_: &Call, _: &Path, _: &Path) {}

#[test]
fn the_messages_of_a_run_replace_nothing_that_was_not_given_away() {
    let sources = Sources::new();
    let run = sources.folder_calls().remove(0);
    let other = sources.path("other.mcap");
    fs::write(&other, "mine").unwrap();
    let root = sources.dir.path();
    for path in run.inputs.iter().chain([&other]) {
        let mcap = ["--mcap", path.to_str().unwrap()];
        run.refuse(root, &root.join("out"), &mcap, "--mcap");
    }
    let mcap = ["--mcap", other.to_str().unwrap(), "--force"];
    run.succeed(&root.join("out"), &mcap);
    assert!(fs::read(&other).unwrap().starts_with(b"\x89MCAP"));
}

/// The output folder holds another name of what is read.
#[cfg(unix)]
fn by_links(call: &Call, input: &Path, root: &Path) {
    let dir = tempfile::tempdir_in(root).unwrap();
    fs::hard_link(input, dir.path().join("other-name")).unwrap();
    call.refuse(root, dir.path(), &["--force"], "a hard link to an input");
    let alias = dir.path().join("alias");
    std::os::unix::fs::symlink(input.parent().unwrap(), &alias).unwrap();
    call.refuse(root, &alias, &["--force"], "an input's folder by a link");
}

#[test]
fn files_that_exist_are_replaced_with_force_only_and_inputs_never() {
    let sources = Sources::new();
    let root = sources.dir.path();
    for call in sources.file_calls() {
        let dir = tempfile::tempdir_in(root).unwrap();
        let out = dir.path().join(format!("out.{}", call.extension));
        fs::write(&out, "mine").unwrap();
        call.refuse(root, &out, &[], "a file that exists");
        fs::copy(sources.path("map.ot"), &out).unwrap();
        call.refuse(root, &out, &[], "a map that exists");
        call.succeed(&out, &["--force"]);
        call.refuse(root, &out, &[], "its own result");
        fs::remove_file(&out).unwrap();
        fs::create_dir(&out).unwrap();
        call.refuse(root, &out, &["--force"], "a folder");
        fs::remove_dir(&out).unwrap();
        if call.command == "project" {
            fs::remove_file(out.with_extension("yaml")).unwrap();
            fs::write(out.with_extension("yaml"), "mine").unwrap();
            call.refuse(root, &out, &[], "the description that exists");
            fs::remove_file(out.with_extension("yaml")).unwrap();
        }
        output_through_links(&call, root, &out);
        for input in &call.inputs {
            if input.extension().is_none_or(|e| e != call.extension) {
                continue;
            }
            for force in [&[][..], &["--force"]] {
                call.refuse(root, input, force, "an input as the output");
            }
        }
    }
}

#[cfg(not(unix))]
fn output_through_links(_: &Call, _: &Path, _: &Path) {}

/// The output is a link to a file that must stay, or to an input.
#[cfg(unix)]
fn output_through_links(call: &Call, root: &Path, out: &Path) {
    use std::os::unix::fs::symlink;
    let precious = out.with_file_name("precious");
    fs::write(&precious, "mine").unwrap();
    for is_symbolic in [true, false] {
        let link = |target: &Path| {
            if is_symbolic {
                symlink(target, out).unwrap();
            } else {
                fs::hard_link(target, out).unwrap();
            }
        };
        link(&precious);
        call.refuse(root, out, &[], "a link");
        call.succeed(out, &["--force"]);
        assert_eq!(fs::read(&precious).unwrap(), b"mine", "{}", call.command);
        fs::remove_file(out).unwrap();
        for input in &call.inputs {
            link(input);
            call.refuse(root, out, &["--force"], "a link to an input");
            fs::remove_file(out).unwrap();
        }
        let _ = fs::remove_file(out.with_extension("yaml"));
    }
    symlink(out.with_file_name("nowhere"), out).unwrap();
    call.refuse(root, out, &[], "a link to nowhere");
    fs::remove_file(out).unwrap();
}

#[test]
fn folders_nobody_named_are_new_and_latest_leads_to_the_last() {
    let sources = Sources::new();
    let home = tempfile::tempdir().unwrap();
    let run = || {
        let output = program()
            .current_dir(home.path())
            .args(["run", &sources.text("images")])
            .output()
            .unwrap();
        assert_eq!(code(&output), 3, "{}", stderr(&output));
    };
    let latest = || {
        let path = home.path().join("runs/latest");
        let real = path.canonicalize().unwrap();
        real.file_name().unwrap().to_string_lossy().into_owned()
    };
    run();
    assert_eq!(latest(), "images");
    let first = files(&home.path().join("runs/images"));
    run();
    run();
    assert_eq!(latest(), "images-3");
    assert!(
        files(&home.path().join("runs/images")) == first,
        "the first run stays"
    );
    // what the user called so stays
    fs::remove_file(home.path().join("runs/latest")).unwrap();
    fs::write(home.path().join("runs/latest"), "mine").unwrap();
    run();
    assert_eq!(fs::read(home.path().join("runs/latest")).unwrap(), b"mine");
    assert!(home.path().join("runs/images-4/summary.json").exists());
}

#[test]
fn the_second_of_two_runs_into_one_folder_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let (out, images) = (dir.path().join("out"), dir.path().join("images"));
    fs::create_dir(&images).unwrap();
    for i in 0..100 {
        let image = Image::from_fn(80, 60, |x, y| ((x * 7 + y * 13 + i * 3) % 251) as u8);
        fs::write(images.join(format!("{i:03}.png")), encode_png(&image)).unwrap();
    }
    fs::write(images.join("calibration.txt"), CALIBRATION).unwrap();
    let command = |more: &[&str]| -> Command {
        let mut command = program();
        command
            .arg("run")
            .arg(&images)
            .arg("--out")
            .arg(&out)
            .args(more);
        command.stdout(Stdio::null()).stderr(Stdio::piped());
        command
    };
    // plays for ten seconds
    let mut first = command(&["--fps", "10", "--realtime"]).spawn().unwrap();
    while !out.join("recording.mgk").exists() {
        assert!(first.try_wait().unwrap().is_none(), "the run ended early");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    for force in [&[][..], &["--force"]] {
        let second = command(force).output().unwrap();
        assert_fails(&second, 2, &["another process", "out"]);
    }
    first.kill().unwrap();
    first.wait().unwrap();
    // the lock ends with the process, and what it left is replaced
    let third = command(&[]).output().unwrap();
    assert_eq!(code(&third), 3, "{}", stderr(&third));
}

/// Images that take the program some time, as a zip, a tar and a gzipped tar file.
fn write_archives(folder: &Path) {
    let image = encode_png(&Image::from_fn(1600, 1200, |x, y| (x * 7 + y * 3) as u8));
    let create = |name: &str| fs::File::create(folder.join(name)).unwrap();
    let mut zip = zip::ZipWriter::new(create("a.zip"));
    let mut tar = tar::Builder::new(Vec::new());
    for k in 0..40 {
        let name = format!("set/{k}.png");
        let how = zip::write::SimpleFileOptions::default();
        zip.start_file(&name, how).unwrap();
        std::io::Write::write_all(&mut zip, &image).unwrap();
        let mut header = tar::Header::new_gnu();
        header.set_size(image.len() as u64);
        tar.append_data(&mut header, name, &image[..]).unwrap();
    }
    zip.finish().unwrap();
    let tar = tar.into_inner().unwrap();
    fs::write(folder.join("a.tar"), &tar).unwrap();
    let mut gz = flate2::write::GzEncoder::new(create("a.tgz"), flate2::Compression::none());
    std::io::Write::write_all(&mut gz, &tar).unwrap();
    gz.finish().unwrap();
}

#[test]
fn images_of_an_archive_are_never_seen_in_the_folder_for_temporary_files() {
    let folder = TempDir::new().unwrap();
    write_archives(folder.path());
    let temporary = folder.path().join("temporary");
    fs::create_dir(&temporary).unwrap();
    let names = || fs::read_dir(&temporary).unwrap().count();
    for name in ["a.zip", "a.tar", "a.tgz"] {
        let mut child = program()
            .arg("check")
            .arg(folder.path().join(name))
            .args(["--fov", "60"])
            .env("TMPDIR", &temporary)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        for _ in 0..50 {
            assert_eq!(names(), 0, "{name}, while it runs");
            std::thread::sleep(std::time::Duration::from_millis(10));
        }
        // as if the computer lost power
        child.kill().unwrap();
        child.wait().unwrap();
        assert_eq!(names(), 0, "{name}, killed");
    }
}
