//! What units, containers and their settings call is understood.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use clap::Parser;
use monogrid_fleet::config::with_file;
use monogrid_fleet::program::{Cli, Command};
use std::ffi::OsString;
use std::fs::read_to_string;
use std::path::{Path, PathBuf};
use std::process;

fn here(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// What a line of arguments asks for; their settings are those beside the unit.
fn asked(line: &str) -> Command {
    let deploy = here("deploy").display().to_string();
    let line = line.replace("/etc/monogrid", &deploy).replace('\'', "");
    let words = std::iter::once("monogrid-fleet").chain(line.split_whitespace());
    let words = with_file(words.map(OsString::from).collect());
    let cli = Cli::try_parse_from(words.unwrap());
    cli.unwrap_or_else(|error| panic!("{line}: {error}"))
        .command
}

#[test]
fn units_and_containers_call_what_there_is() {
    let (mut lines, mut files) = (Vec::new(), 0);
    for file in [
        "deploy/monogrid-fleet-server.service",
        "deploy/monogrid-fleet-agent.service",
        "deploy/compose.yaml",
        "Dockerfile",
    ] {
        files += 1;
        let text = read_to_string(here(file)).unwrap();
        for line in text.lines() {
            let unit = line.starts_with("ExecStart=");
            let called = match unit {
                true => line.split_once("monogrid-fleet "),
                false => line.trim().split_once("command: "),
            };
            let docker = line.split_once("-p 7447:7447 monogrid-fleet ");
            if let Some((_, called)) = called.or(docker) {
                // the shell's part has a name of the time
                let called = called.split('"').next().unwrap();
                let is_timed = called.ends_with("--out ");
                lines.push(format!("{called}{}", if is_timed { "run" } else { "" }));
            }
        }
    }
    assert_eq!((files, lines.len()), (4, 5), "{lines:?}");
    for line in &lines {
        match asked(line) {
            Command::Server(server) => {
                assert!(server.out.is_absolute(), "{line}");
                assert_eq!(server.listen, ["tcp/[::]:7447"], "{line}");
            }
            Command::Agent(agent) => {
                let run = ["monogrid", "run", "no-source", "--out", "run"];
                let run = process::Command::new(env!("CARGO_BIN_EXE_monogrid-fleet"))
                    .args(run)
                    .args(agent.run)
                    .output();
                let said = String::from_utf8(run.unwrap().stderr).unwrap();
                // its options are understood
                assert!(
                    said.contains("no-source") && !said.contains("--help"),
                    "{said}"
                );
                assert_eq!(agent.connect.len(), 1, "{line}");
            }
            Command::Monogrid { .. } => panic!("{line}"),
        }
    }
}

#[test]
fn what_a_composition_builds_is_there() {
    let compose = read_to_string(here("deploy/compose.yaml")).unwrap();
    let value = |key: &str| {
        let mut lines = compose.lines();
        lines
            .find_map(|line| line.trim().strip_prefix(key))
            .unwrap()
    };
    let root = here("deploy").join(value("context: "));
    assert!(root.join(value("dockerfile: ")).is_file());
    assert!(root.join("Cargo.lock").is_file());
    for file in ["server.toml", "agent.toml"] {
        assert!(compose.contains(&format!("./{file}:/etc/monogrid/{file}:ro")));
    }
}
