//! Many recordings, each by a run of its own: what is done stays done, and whatever ends halfway is
//! ended by the next call.

use crate::common::{assert_fails, code, files, json, monogrid, program, small_sequence, stderr};
use monogrid_datasets::encode_png;
use monogrid_image::Image;
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// A folder with a list, and a destination beside it.
struct Batch {
    dir: TempDir,
}

impl Batch {
    fn new(lines: &[String]) -> Self {
        let this = Self {
            dir: tempfile::tempdir().unwrap(),
        };
        this.list(lines);
        this
    }

    fn list(&self, lines: &[String]) {
        fs::write(self.path("list.tsv"), lines.join("\n")).unwrap();
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn command(&self, more: &[&str]) -> Command {
        let mut command = program();
        command.arg("batch").arg(self.path("list.tsv"));
        command.arg("--out").arg(self.path("out")).args(more);
        command
    }

    fn call(&self, more: &[&str]) -> Output {
        self.command(more).output().unwrap()
    }

    /// Calls it with `--json` and expects an exit code.
    fn report(&self, expected: i32, more: &[&str]) -> Value {
        let mut all = vec!["--json"];
        all.extend(more);
        let output = self.call(&all);
        assert_eq!(code(&output), expected, "{}", stderr(&output));
        json(&output)
    }

    fn spawn(&self, more: &[&str]) -> Child {
        let mut command = self.command(more);
        command.stdout(Stdio::null()).stderr(Stdio::null());
        command.spawn().unwrap()
    }

    fn record(&self, name: &str) -> Value {
        let text = fs::read_to_string(self.path("out/tasks").join(name).join("task.json"));
        serde_json::from_str(&text.unwrap()).unwrap()
    }

    /// Waits until the run of a task has recorded its first keyframe.
    fn wait_for_keyframe(&self, name: &str) {
        let keyframes = self.path("out/runs").join(name).join("keyframes");
        let begin = Instant::now();
        while !keyframes.join("00000_image.png").exists() {
            assert!(begin.elapsed() < Duration::from_secs(120), "no keyframe");
            std::thread::sleep(Duration::from_millis(2));
        }
    }
}

/// Images that show nothing to track.
fn noise(folder: &Path) {
    fs::create_dir(folder).unwrap();
    for i in 0..12 {
        let image = Image::from_fn(80, 60, |x, y| ((x * 7 + y * 13 + i * 3) % 251) as u8);
        fs::write(folder.join(format!("{i}.png")), encode_png(&image)).unwrap();
    }
    fs::write(folder.join("calibration.txt"), "60 60 39.5 29.5 80 60\n").unwrap();
}

fn video_line(more: &str) -> String {
    let video = small_sequence().display();
    format!("{video}\tseed-depth=dataset{more}")
}

/// What a run wrote but for what holds times.
fn results(run: &Path) -> Vec<(String, Vec<u8>)> {
    let times = [
        "summary.json",
        "report.html",
        "frames.csv",
        "monogrid-manifest.txt",
    ];
    let mut all = files(run);
    all.retain(|(name, _)| !times.contains(&name.as_str()));
    all
}

#[test]
fn results_are_those_of_plain_runs_and_what_is_done_stays_done() {
    let batch = Batch::new(&[]);
    let odd = batch.path("a b [ü] 'x' \"y\" $(z);");
    noise(&odd);
    let lines = [
        "# three recordings".to_owned(),
        video_line("\tname=video\tmax-frames=45"),
        odd.display().to_string(),
        "missing.mp4".to_owned(),
    ];
    batch.list(&lines);
    let report = batch.report(3, &["--jobs", "3", "--threads", "5"]);
    assert_eq!(report["carried_out"], 3, "{report}");
    let classes = &report["classes"];
    assert_eq!(
        [
            &classes["ok"],
            &classes["not-started"],
            &classes["bad-input"]
        ],
        [1, 1, 1]
    );

    let plain = plain_results(&batch);
    let run = batch.path("out/runs/video");
    assert!(results(&run) == plain, "the same bytes");
    let summary = fs::read(run.join("summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_slice(&summary).unwrap();
    assert_eq!(summary["threads"], 5);
    the_record_says_it(&batch, &run);
    the_page_shows_all(&batch);
    what_changes_is_done_again(&batch, lines.to_vec(), &odd);
    fs::remove_file(run.join("global.ot")).unwrap();
    let report = batch.report(3, &[]);
    assert_eq!(report["carried_out"], 1, "a result is missing");
    assert!(results(&run) == plain);
}

/// What `monogrid run` makes of the same frames.
fn plain_results(batch: &Batch) -> Vec<(String, Vec<u8>)> {
    let plain = batch.path("plain");
    let video = small_sequence().display().to_string();
    let arguments = [
        "run",
        &video,
        "--seed-depth",
        "dataset",
        "--max-frames",
        "45",
        "--out",
    ];
    let output = monogrid(arguments.into_iter().chain([plain.to_str().unwrap()]));
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    results(&plain)
}

fn the_record_says_it(batch: &Batch, run: &Path) {
    let record = batch.record("video");
    assert_eq!(record["class"], "ok");
    assert!(record["cpu_s"].as_f64().unwrap() > 0.1, "{record}");
    assert!(
        record["peak_rss_bytes"].as_u64().unwrap() > 10_000_000,
        "{record}"
    );
    assert!(
        record["metrics"]["ate_rmse_m"].as_f64().unwrap() < 0.05,
        "{record}"
    );
    let written: Vec<&String> = record["outputs"].as_object().unwrap().keys().collect();
    assert!(written.len() > 15 && written.iter().all(|name| run.join(name).is_file()));
    assert!(record["input"]["files"].as_u64().unwrap() > 100);
    assert!(
        batch.record("missing")["reason"]
            .as_str()
            .unwrap()
            .contains("missing.mp4")
    );
}

fn the_page_shows_all(batch: &Batch) {
    let out = batch.path("out");
    let output = monogrid([Path::new("report"), &out]);
    assert_eq!(code(&output), 0, "{}", stderr(&output));
    let html = fs::read_to_string(out.join("report/report.html")).unwrap();
    assert!(html.contains("3 recordings: 1 ok, 1 not-started, 1 bad-input"));
    assert!(html.contains("href=\"../runs/video/report.html\""));
    let preview = fs::read(out.join("runs/video/preview.png")).unwrap();
    assert!(!preview.is_empty() && html.matches("data:image/png;base64,").count() == 1);
    let worst_first =
        ["<b>missing</b>", "not-started<br>", "video</a></b>"].map(|text| html.find(text));
    assert!(
        worst_first.is_sorted() && worst_first[0].is_some(),
        "{worst_first:?}"
    );
    // again, when there is more to tell
    assert_eq!(code(&monogrid([Path::new("report"), &out])), 0);
    let nothing = monogrid([Path::new("report"), &batch.path("nowhere")]);
    assert_fails(&nothing, 2, &["nowhere", "monogrid batch"]);
}

fn what_changes_is_done_again(batch: &Batch, mut lines: Vec<String>, odd: &Path) {
    // nothing has changed: nothing is done, not even written
    let tasks = files(&batch.path("out/tasks"));
    let report = batch.report(3, &[]);
    assert_eq!([&report["carried_out"], &report["done_before"]], [0, 3]);
    assert!(files(&batch.path("out/tasks")) == tasks);
    // as `touch` does
    let image = odd.join("3.png");
    fs::write(&image, fs::read(&image).unwrap()).unwrap();
    assert_eq!(
        batch.report(3, &[])["carried_out"],
        0,
        "the content is the same"
    );
    fs::copy(odd.join("4.png"), &image).unwrap();
    let report = batch.report(3, &[]);
    assert_eq!(report["carried_out"], 1, "one recording has changed");
    assert_eq!(batch.report(3, &["--retry", "bad-input"])["carried_out"], 1);
    lines[2] += "\tset=seed=7";
    batch.list(&lines);
    assert_eq!(batch.report(3, &[])["carried_out"], 1, "other settings");
}

#[cfg(target_os = "linux")]
#[test]
fn a_batch_that_is_killed_leaves_nothing_behind_and_is_ended_by_the_next_one() {
    let batch = Batch::new(&[
        video_line("\tname=first\tmax-frames=45"),
        video_line("\tname=second\tmax-frames=45"),
    ]);
    let mut child = batch.spawn(&["--jobs", "1"]);
    batch.wait_for_keyframe("first");
    child.kill().unwrap();
    child.wait().unwrap();
    assert_eq!(batch.record("first")["class"], "unfinished");
    let processes = || {
        let mine = batch.path("out").display().to_string();
        let all = fs::read_dir("/proc").unwrap().flatten();
        all.filter(|entry| {
            let line = fs::read(entry.path().join("cmdline")).unwrap_or_default();
            String::from_utf8_lossy(&line).contains(&mine)
        })
        .count()
    };
    let begin = Instant::now();
    while processes() > 0 {
        assert!(
            begin.elapsed() < Duration::from_secs(20),
            "the run goes on alone"
        );
        std::thread::sleep(Duration::from_millis(5));
    }
    // two at once share the work
    let other = batch.spawn(&["--jobs", "1"]);
    let report = batch.report(0, &["--jobs", "1"]);
    assert!(report["carried_out"].as_u64().unwrap() <= 2, "{report}");
    assert!(other.wait_with_output().unwrap().status.success());
    assert_eq!(batch.report(0, &[])["done_before"], 2);
    let [first, second] = ["first", "second"].map(|name| batch.record(name));
    assert_eq!(first["result_sha256"], second["result_sha256"]);
}

/// Sends a signal.
#[cfg(unix)]
fn signal(name: &str, process: &str) {
    let sent = Command::new("kill").args([name, process]).status();
    assert!(sent.unwrap().success());
}

#[cfg(target_os = "linux")]
#[test]
fn every_end_of_a_run_is_told_and_harms_no_other() {
    let batch = Batch::new(&[]);
    noise(&batch.path("noise"));
    let noise = batch.path("noise").display().to_string();
    batch.list(&[
        video_line("\tname=video\tmax-frames=45"),
        format!("{noise}\tname=noise"),
    ]);
    // a run that is killed, as the system does when memory runs out, is tried once more
    let mut child = batch.spawn(&[]);
    batch.wait_for_keyframe("video");
    let children = format!("/proc/{0}/task", child.id());
    let runs: String = fs::read_dir(children)
        .unwrap()
        .flatten()
        .map(|thread| fs::read_to_string(thread.path().join("children")).unwrap_or_default())
        .collect();
    for run in runs.split_whitespace() {
        signal("-KILL", run);
    }
    assert_eq!(
        child.wait().unwrap().code(),
        Some(3),
        "the noise has no map"
    );
    let record = batch.record("video");
    assert_eq!(
        [&record["class"], &record["attempts"]],
        [&Value::from("ok"), &Value::from(2)]
    );
    assert_eq!(batch.record("noise")["class"], "not-started");

    // too slow: what it has mapped is saved; done again when it gets more time
    batch.list(&[video_line("\tname=slow")]);
    let output = batch.call(&["--timeout", "0.5"]);
    assert_fails(&output, 1, &["1 runs"]);
    assert_eq!(batch.record("slow")["class"], "timeout");
    assert!(batch.path("out/runs/slow/summary.json").is_file());
    assert_eq!(code(&batch.call(&["--timeout", "0.5"])), 1);
    assert_eq!(batch.record("slow")["attempts"], 1);

    fs::remove_dir_all(batch.path("out/runs/slow")).unwrap();
    let mut child = batch.spawn(&[]);
    batch.wait_for_keyframe("slow");
    signal("-INT", &child.id().to_string());
    assert_eq!(child.wait().unwrap().code(), Some(4));
    assert_eq!(batch.record("slow")["class"], "interrupted");
    assert_eq!(batch.report(0, &[])["carried_out"], 1);
}

#[test]
fn one_task_of_a_list_by_name_or_by_number() {
    let batch = Batch::new(&[]);
    for name in ["one", "two", "three"] {
        noise(&batch.path(name));
    }
    let lines = ["one", "two", "three"].map(|name| batch.path(name).display().to_string());
    batch.list(&lines);
    let plan = batch.report(0, &["--dry-run"]);
    assert_eq!(plan[1]["name"], "two");
    assert!(!batch.path("out").exists(), "nothing is written");
    assert_eq!(batch.report(3, &["--number", "2"])["recordings"], 1);
    assert_eq!(batch.report(3, &["--task", "three"])["carried_out"], 1);
    assert!(!batch.path("out/tasks/one").exists());
    assert_fails(&batch.call(&["--number", "4"]), 2, &["1 to 3"]);
    assert_fails(&batch.call(&["--task", "four"]), 2, &["four", "--dry-run"]);
    assert_eq!(batch.report(3, &[])["done_before"], 2);
    // a folder of recordings, and standard input
    fs::write(batch.path("notes.pdf"), "").unwrap();
    let mut command = program();
    command.arg("batch").arg(batch.dir.path()).arg("--dry-run");
    let output = command
        .arg("--out")
        .arg(batch.path("out"))
        .output()
        .unwrap();
    let text = String::from_utf8(output.stdout.clone()).unwrap();
    let names: Vec<&str> = text
        .lines()
        .filter_map(|line| line.split('\t').next())
        .collect();
    assert_eq!(names, ["one", "three", "two"], "{}", stderr(&output));
    assert!(
        stderr(&output).contains("no recordings"),
        "{}",
        stderr(&output)
    );
}

#[test]
fn lists_that_cannot_be_meant_are_refused_before_anything_is_written() {
    let batch = Batch::new(&[]);
    noise(&batch.path("good"));
    let good = batch.path("good").display().to_string();
    for (bad, said) in [
        ("video.mp4\tmax-frames=many", &["line 2", "max-frames"][..]),
        ("video.mp4\tnonsense=1", &["line 2", "nonsense"]),
        ("video.mp4\tout=/tmp/elsewhere", &["line 2", "out"]),
        ("video.mp4\tname=../../elsewhere", &["line 2", "name"]),
        ("video.mp4\tname=GOOD", &["name", "another"]),
        ("\tname=x", &["line 2", "tab"]),
        ("-", &["line 2", "read again"]),
        ("rtsp://camera", &["line 2", "read again"]),
    ] {
        batch.list(&[format!("{good}\tname=good"), bad.to_owned()]);
        assert_fails(&batch.call(&[]), 2, said);
        assert!(!batch.path("out").exists(), "{bad}");
    }
    for bytes in [&b"a.mp4\n\xff\xfe.mp4\n"[..], b"", b"# nothing\n\n"] {
        fs::write(batch.path("list.tsv"), bytes).unwrap();
        assert_fails(&batch.call(&[]), 2, &[]);
    }
    fs::remove_file(batch.path("list.tsv")).unwrap();
    assert_fails(&batch.call(&[]), 2, &["list.tsv", "cannot be read"]);
    assert!(!batch.path("out").exists());
}

#[test]
fn commands_of_the_documentation_work() {
    let batch = Batch::new(&[]);
    noise(&batch.path("kitchen"));
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/batch.md");
    let page = fs::read_to_string(page).unwrap();
    let list = page
        .split("```\n")
        .find(|text| text.starts_with("# source"));
    fs::write(batch.path("recordings.tsv"), list.unwrap()).unwrap();
    let blocks = page.split("```sh\n").skip(1);
    let commands = blocks.flat_map(|block| block.split("```").next().unwrap().lines());
    let commands: Vec<&str> = commands.collect();
    assert!(commands.len() >= 5, "{commands:?}");
    for command in commands {
        let words = command.split_whitespace().skip(1);
        let mut program = program();
        let output = program.args(words).current_dir(batch.dir.path()).output();
        let output = output.unwrap();
        // the recordings show nothing
        let is_good = matches!(code(&output), 0 | 3);
        assert!(is_good, "{command}: {}", stderr(&output));
    }
    assert!(batch.path("maps/tasks/tuesday/task.json").is_file());
}

#[test]
fn a_file_beside_the_results_is_an_output_and_no_other_call_takes_it_for_an_input() {
    let batch = Batch::new(&[]);
    let video = batch.path("video");
    crate::common::copy_of_small_sequence(&video);
    // in the folder of its own recording, and elsewhere
    let (inside, beside) = (video.join("a.mcap"), batch.path("b.mcap"));
    let line = |name: &str, file: &Path| {
        let (video, file) = (video.display(), file.display());
        format!("{video}\tseed-depth=dataset\tmax-frames=45\tname={name}\tmcap={file}")
    };
    batch.list(&[line("a", &inside), line("b", &beside)]);
    assert_eq!(batch.report(0, &[])["classes"]["ok"], 2);
    let [first, second] = [&inside, &beside].map(|file| fs::read(file).unwrap());
    assert!(first == second && first.len() > 1000);
    let report = batch.report(0, &[]);
    assert_eq!([&report["done_before"], &report["classes"]["ok"]], [2, 2]);
    // what is gone is made again, and what it wrote goes with it
    fs::remove_file(batch.path("out/runs/a/global.ot")).unwrap();
    fs::remove_dir_all(batch.path("out/runs/b")).unwrap();
    assert_eq!(batch.report(0, &[])["carried_out"], 2);
    fs::remove_file(&beside).unwrap();
    assert_eq!(batch.report(0, &[])["carried_out"], 1);
    assert!([&inside, &beside].map(|file| fs::read(file).unwrap()) == [first, second]);
    // a call that was killed before it could say so: the folder of the run knows what it wrote
    fs::remove_dir_all(batch.path("out/tasks/b")).unwrap();
    assert_eq!(batch.report(0, &[])["carried_out"], 1);
    what_others_wrote_stays(&batch, &beside);
}

fn what_others_wrote_stays(batch: &Batch, file: &Path) {
    fs::write(file, "of somebody else").unwrap();
    let output = batch.call(&[]);
    assert_fails(&output, 3, &["b.mcap", "exists", "--force"]);
    assert_eq!(fs::read(file).unwrap(), b"of somebody else");
    assert_eq!(batch.record("b")["class"], "ok", "what came of it stays");
    assert_eq!(batch.report(0, &["--force"])["carried_out"], 1);
    assert_eq!(batch.report(0, &[])["done_before"], 2);
}

#[test]
fn a_run_replaces_the_messages_that_it_wrote_with_its_folder_and_no_others() {
    let dir = tempfile::tempdir().unwrap();
    let (out, file) = (dir.path().join("out"), dir.path().join("run.mcap"));
    let video = small_sequence().display().to_string();
    let call = || {
        let mut command = program();
        command.args([
            "run",
            &video,
            "--seed-depth",
            "dataset",
            "--max-frames",
            "30",
        ]);
        command.args(crate::common::WITHOUT_DENSE_DEPTH);
        command.arg("--out").arg(&out).arg("--mcap").arg(&file);
        command.output().unwrap()
    };
    for _ in 0..2 {
        let output = call();
        assert_eq!(code(&output), 0, "{}", stderr(&output));
    }
    let mut changed = fs::read(&file).unwrap();
    changed.push(0);
    fs::write(&file, &changed).unwrap();
    assert_fails(&call(), 2, &["run.mcap", "exists", "--force"]);
    assert!(fs::read(&file).unwrap() == changed);
    assert!(out.join("global.ot").is_file(), "nothing was removed");
}

#[cfg(unix)]
#[test]
fn outputs_that_collide_are_refused_before_anything_starts() {
    let batch = Batch::new(&[]);
    for name in ["one", "two"] {
        noise(&batch.path(name));
    }
    fs::create_dir(batch.path("real")).unwrap();
    std::os::unix::fs::symlink("real", batch.path("link")).unwrap();
    std::os::unix::fs::symlink("real/x.mcap", batch.path("dangling.mcap")).unwrap();
    let at = |name: &str| batch.path(name).display().to_string();
    let [one, two] = ["one", "two"].map(at);
    for (first, second, said) in [
        ("real/x.mcap", "real/x.mcap", "that of one"),
        ("real/x.mcap", "real/../real/./x.mcap", "that of one"),
        ("real/x.mcap", "link/x.mcap", "that of one"),
        ("real/x.mcap", "dangling.mcap", "that of one"),
        ("real/x.mcap", "link/x.mcap/y.mcap", "that of one"),
        ("link/x.mcap/y.mcap", "real/x.mcap", "that of one"),
        ("out/x.mcap", "real/y.mcap", "the folder of the batch"),
        (
            "out/runs/two/x.mcap",
            "real/y.mcap",
            "the folder of the batch",
        ),
        ("list.tsv", "real/y.mcap", "a file that is read"),
        ("one/calibration.txt", "real/y.mcap", "a file that is read"),
        ("film.mp4", "real/y.mcap", "the recording of film"),
    ] {
        let (first, second) = (at(first), at(second));
        batch.list(&[
            format!("{one}\tmcap={first}"),
            format!("{two}\tmcap={second}\tcalibration={one}/calibration.txt"),
            at("film.mp4"),
        ]);
        for more in [&[][..], &["--dry-run"], &["--force"], &["--task", "film"]] {
            assert_fails(&batch.call(more), 2, &["line ", "the output", said]);
        }
        assert!(!batch.path("out").exists(), "{first} {second}");
    }
    // for all alike
    let each = format!("mcap={}", at("real/x.mcap"));
    batch.list(&[one, two]);
    assert_fails(&batch.call(&["--each", &each]), 2, &["that of one"]);
    // files of their own are fine
    batch.list(&[
        format!("{}\tmcap={}", at("one"), at("link/x.mcap")),
        format!("{}\tmcap={}", at("two"), at("real/y.mcap")),
    ]);
    assert_eq!(batch.report(3, &[])["classes"]["not-started"], 2);
}

#[test]
fn an_output_in_a_folder_of_recordings_is_none_of_them() {
    let batch = Batch::new(&[]);
    let folder = batch.path("folder");
    fs::create_dir(&folder).unwrap();
    crate::common::copy_of_small_sequence(&folder.join("video"));
    let call = || {
        let mut command = program();
        command
            .arg("batch")
            .arg(&folder)
            .arg("--out")
            .arg(batch.path("out"));
        for each in ["seed-depth=dataset", "max-frames=30"] {
            command.args(["--each", each]);
        }
        let mcap = folder.join("video.mcap");
        command
            .arg("--each")
            .arg(format!("mcap={}", mcap.display()));
        let output = command.arg("--json").output().unwrap();
        assert_eq!(code(&output), 0, "{}", stderr(&output));
        json(&output)
    };
    assert_eq!(call()["classes"]["ok"], 1);
    let report = call();
    assert_eq!([&report["recordings"], &report["done_before"]], [1, 1]);
}

#[test]
fn what_came_of_a_recording_stays_when_it_is_gone() {
    let batch = Batch::new(&[]);
    let video = batch.path("video");
    crate::common::copy_of_small_sequence(&video);
    let calibration = batch.path("camera.txt");
    fs::copy(video.join("calibration.txt"), &calibration).unwrap();
    batch.list(&[format!(
        "{}\tname=a\tseed-depth=dataset\tmax-frames=30\tcalibration={}",
        video.display(),
        calibration.display()
    )]);
    batch.report(0, &[]);
    let before = files(&batch.path("out"));
    // a file of its options, or all of it
    for gone in [&calibration, &video] {
        fs::rename(gone, batch.path("aside")).unwrap();
        let report = batch.report(0, &[]);
        assert_eq!([&report["done_before"], &report["classes"]["ok"]], [1, 1]);
        assert_fails(
            &batch.call(&["--retry", "ok"]),
            3,
            &["cannot be read now", "stays"],
        );
        let same = files(&batch.path("out"))
            .into_iter()
            .filter(|(name, _)| !name.ends_with("manifest.txt"));
        assert!(
            same.eq(before
                .iter()
                .filter(|(name, _)| !name.ends_with("manifest.txt"))
                .cloned())
        );
        fs::rename(batch.path("aside"), gone).unwrap();
    }
    assert_eq!(batch.report(0, &[])["done_before"], 1);
}

#[test]
fn a_failure_that_can_pass_is_tried_again_by_the_next_call() {
    let batch = Batch::new(&[]);
    noise(&batch.path("noise"));
    let folder = batch.path("later");
    let line = video_line("\tname=video\tmax-frames=30");
    let noise = batch.path("noise").display().to_string();
    batch.list(&[
        format!("{line}\tmcap={}", folder.join("x.mcap").display()),
        noise,
    ]);
    // the folder is not there yet
    assert_fails(&batch.call(&[]), 1, &["1 runs"]);
    assert_eq!(batch.record("video")["class"], "failed");
    assert_eq!(batch.record("noise")["class"], "not-started");
    fs::create_dir(&folder).unwrap();
    let report = batch.report(3, &[]);
    assert_eq!(
        report["carried_out"], 1,
        "what never starts does not do so now"
    );
    assert_eq!(batch.record("video")["class"], "ok");
}

#[cfg(target_os = "linux")]
#[test]
fn a_recording_that_vanishes_while_it_is_read_is_done_when_it_is_back() {
    let batch = Batch::new(&[]);
    let (video, aside) = (batch.path("video"), batch.path("aside"));
    crate::common::copy_of_small_sequence(&video);
    let line = format!("{}\tname=video\tseed-depth=dataset", video.display());
    batch.list(&[line]);
    let mut child = batch.spawn(&[]);
    batch.wait_for_keyframe("video");
    // all of it, with its times
    fs::rename(&video, &aside).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(1));
    let record = batch.record("video");
    assert_eq!(record["class"], "failed", "{record}");
    assert!(
        record["reason"].as_str().unwrap().contains("vanished"),
        "{record}"
    );
    fs::rename(&aside, &video).unwrap();
    let report = batch.report(0, &[]);
    assert_eq!([&report["carried_out"], &report["classes"]["ok"]], [1, 1]);
}
