//! The commands of the book are understood.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use clap::{CommandFactory, Parser};
use monogrid_ros2::args::Args;
use monogrid_ros2::convert::MAX_MESSAGE_BYTES;

fn chapter() -> String {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/book/ros2.md");
    std::fs::read_to_string(path).unwrap()
}

#[test]
fn commands_of_the_chapter_are_understood() {
    let chapter = chapter();
    let commands: Vec<&str> = chapter
        .lines()
        .filter(|line| line.starts_with("monogrid-ros2 "))
        .collect();
    assert!(commands.len() >= 4, "{commands:?}");
    for command in commands {
        let parsed = Args::try_parse_from(command.split_whitespace());
        assert!(parsed.is_ok(), "{command}: {}", parsed.unwrap_err());
    }
}

#[test]
fn the_unit_and_the_container_call_what_there_is() {
    let here = env!("CARGO_MANIFEST_DIR");
    let read = |name: &str| std::fs::read_to_string(format!("{here}/{name}")).unwrap();
    let (unit, docker) = (read("deploy/monogrid-ros2.service"), read("Dockerfile"));
    let unit = unit.replace("/etc/monogrid", &format!("{here}/deploy"));
    let of_unit = unit
        .lines()
        .find_map(|line| line.strip_prefix("ExecStart="));
    let of_docker = docker
        .lines()
        .find_map(|line| line.split_once("/data monogrid-ros2 "));
    let of_docker = format!("monogrid-ros2 {}", of_docker.unwrap().1);
    let launch = read("launch/monogrid.launch.py");
    for file in ["monogrid.yaml", "monogrid.rviz"] {
        assert!(launch.contains(file) && !read(&format!("deploy/{file}")).is_empty());
    }
    // the chapter shows what is there
    let nav2 = read("deploy/nav2.yaml");
    let shown = chapter();
    let shown = shown
        .split("```yaml\n")
        .find(|text| text.starts_with("global_costmap"));
    assert!(nav2.ends_with(shown.unwrap().split("```").next().unwrap()));
    let launched =
        format!("monogrid-ros2 --ros-args --params-file {here}/deploy/monogrid.yaml -r __ns:=/");
    for line in [of_unit.unwrap(), &of_docker, &launched] {
        let args = Args::read(line.split_whitespace().map(Into::into));
        let args = args.unwrap_or_else(|error| panic!("{line}: {error}"));
        assert_eq!(
            (args.image.as_str(), args.ignored.len()),
            ("/camera/image_raw", 0)
        );
    }
    let distribution = docker
        .lines()
        .find_map(|line| line.strip_prefix("ARG DISTRO="));
    let features = read("Cargo.toml");
    assert!(features.contains(&format!("\n{} = [", distribution.unwrap())));
}

#[test]
fn options_that_the_chapter_names_exist() {
    let chapter = chapter();
    let command = Args::command();
    let options: Vec<&str> = command
        .get_arguments()
        .filter_map(|a| a.get_long())
        .collect();
    let named = chapter.split("`--").skip(1);
    let names = named.map(|rest| {
        rest.split(|c: char| !(c.is_alphanumeric() || c == '-'))
            .next()
            .unwrap()
    });
    // those of cargo and of every program
    let names: Vec<&str> = names
        .filter(|name| !["no-default-features", "help", "ros-args", "params-file"].contains(name))
        .collect();
    assert!(names.len() > 5, "{names:?}");
    for name in names {
        assert!(options.contains(&name), "--{name}");
    }
    assert_eq!(MAX_MESSAGE_BYTES, 4_000_000, "the chapter says 4 MB");
}

#[test]
fn what_a_terminal_obeys_is_only_shown() {
    let said = |arguments: &[&str]| {
        let program = std::process::Command::new(env!("CARGO_BIN_EXE_monogrid-ros2"));
        let ended = { program }.args(arguments).output().unwrap();
        (
            ended.status.code(),
            String::from_utf8(ended.stderr).unwrap(),
        )
    };
    for (arguments, code) in [
        (&["--calibration", "/nothing\x1b[2J\u{202e}.txt"][..], 1),
        (&["--metres-per-unit", "\x1b]0;title\x07"], 2),
    ] {
        let (ended, said) = said(arguments);
        assert_eq!(ended, Some(code), "{said}");
        assert!(!said.contains(monogrid_datasets::is_obeyed), "{said:?}");
        // the parser of arguments may leave it out
        let is_shown = said.contains("\\u{1b}") || said.contains("\\u001b");
        assert!(is_shown || code == 2, "{said}");
    }
}
