//! Options from a file.

use crate::program::Cli;
use clap::parser::ValueSource;
use clap::{ArgMatches, Command, CommandFactory};
use monogrid_datasets::read_file;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use toml::{Table, Value};

/// Bytes of a file at most.
const MAX_FILE_BYTES: u64 = 1 << 20;

/// A command line with what the file of its `--config` says, where it does not say so itself.
///
/// # Errors
/// A file that cannot be read, that holds no TOML, or that names what is no option.
pub fn with_file(arguments: Vec<OsString>) -> Result<Vec<OsString>, String> {
    let mut all = Cli::command().ignore_errors(true);
    all.build();
    // what is wrong with it is said by whoever reads the result
    let Ok(given) = all.clone().try_get_matches_from(&arguments) else {
        return Ok(arguments);
    };
    let Some((name, given)) = given.subcommand() else {
        return Ok(arguments);
    };
    let path = given.try_get_one::<PathBuf>("config").ok().flatten();
    let (Some(path), Some(command)) = (path, all.find_subcommand(name)) else {
        return Ok(arguments);
    };
    let options = options(path, command, given);
    let (before, behind) = options.map_err(|error| format!("{}: {error}", path.display()))?;
    let is_name = |argument: &OsString| argument == name;
    let (mut with, mut rest) = (arguments, Vec::new());
    if let Some(at) = with.iter().position(is_name) {
        rest = with.split_off(at + 1);
    }
    with.extend(before);
    with.extend(rest);
    with.extend(behind);
    Ok(with)
}

/// What a file says and the command line does not: options, and what stands behind `--`.
fn options(
    path: &Path,
    command: &Command,
    given: &ArgMatches,
) -> Result<(Vec<OsString>, Vec<OsString>), String> {
    let bytes = read_file(path, MAX_FILE_BYTES).map_err(|error| error.to_string())?;
    let text = String::from_utf8(bytes).map_err(|error| error.to_string())?;
    let table: Table = text.parse().map_err(|error| format!("{error}"))?;
    let is_key = |id: &str| !matches!(id, "config" | "help" | "version");
    let known = || {
        command
            .get_arguments()
            .filter(|a| is_key(a.get_id().as_str()))
    };
    let (mut before, mut behind) = (Vec::new(), Vec::new());
    for (key, value) in &table {
        let Some(option) = known().find(|option| option.get_id() == key) else {
            let names: Vec<&str> = known().map(|option| option.get_id().as_str()).collect();
            let names = names.join(", ");
            return Err(format!("there is no setting `{key}`; expected {names}"));
        };
        if given.value_source(key) == Some(ValueSource::CommandLine) {
            continue;
        }
        let texts = texts(value).map_err(|found| {
            format!("{key} is {found}; expected a text, a number, or a list of them")
        })?;
        for text in texts {
            match option.get_long() {
                Some(long) => before.push(format!("--{long}={text}").into()),
                None if option.is_last_set() => behind.push(text.into()),
                None => before.push(text.into()),
            }
        }
    }
    if !behind.is_empty() {
        behind.insert(0, "--".into());
    }
    Ok((before, behind))
}

/// A value, or those of a list, as a command line has them; else what is none.
fn texts(value: &Value) -> Result<Vec<String>, &Value> {
    match value {
        Value::String(text) => Ok(vec![text.clone()]),
        Value::Integer(_) | Value::Float(_) => Ok(vec![value.to_string()]),
        Value::Array(values) if !values.iter().any(Value::is_array) => {
            values.iter().try_fold(Vec::new(), |mut all, value| {
                all.extend(texts(value)?);
                Ok(all)
            })
        }
        other => Err(other),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::program::Command;
    use clap::Parser;

    fn with(file: &str, line: &str) -> Result<Command, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("fleet.toml");
        std::fs::write(&path, file).unwrap();
        let line = line.replace("FILE", &path.display().to_string());
        let line = line.split(' ').map(OsString::from);
        let line = with_file(
            std::iter::once("monogrid-fleet".into())
                .chain(line)
                .collect(),
        )?;
        let parsed = Cli::try_parse_from(line);
        parsed
            .map(|cli| cli.command)
            .map_err(|error| error.to_string())
    }

    #[test]
    fn a_file_says_what_the_command_line_does_not() {
        let file = "listen = [\"tcp/[::]:1\", \"tcp/[::]:2\"]\nout = \"fleet\"\nmax_runs = 8\n\
                    max_disk = 0.5\nmetrics = \"127.0.0.1:9464\"\nmerge = [\"--resolution\", \
                    0.1]\nlog_level = \"warn\"\n";
        let Ok(Command::Server(server)) = with(file, "server --config FILE") else {
            panic!("no server");
        };
        assert_eq!(server.listen, ["tcp/[::]:1", "tcp/[::]:2"]);
        assert_eq!((server.max_runs, server.max_disk), (8, 0.5));
        assert_eq!(server.out, Path::new("fleet"));
        assert!(server.metrics.is_some());
        assert_eq!(server.merge, ["--resolution", "0.1"]);
        assert_eq!(server.join_every, 10);

        let line = "server --listen tcp/a:3 --config FILE --max-runs=9 --out=here -- --json";
        let Ok(Command::Server(server)) = with(file, line) else {
            panic!("no server");
        };
        assert_eq!(server.listen, ["tcp/a:3"]);
        assert_eq!((server.max_runs, server.max_disk), (9, 0.5));
        assert_eq!(server.out, Path::new("here"));
        assert_eq!(server.merge, ["--json"]);

        let file = "source = \"/dev/video0\"\nname = \"drone-1\"\nconnect = \"tcp/a:1\"\nout = \
                    \"run\"\nrun = [\"--realtime\"]\n";
        let Ok(Command::Agent(agent)) = with(file, "agent --config FILE") else {
            panic!("no agent");
        };
        assert_eq!(agent.source.as_deref(), Some(Path::new("/dev/video0")));
        assert_eq!((agent.name.as_str(), agent.run.len()), ("drone-1", 1));
    }

    #[test]
    fn what_is_no_setting_is_named() {
        let line = "server --config FILE";
        for (file, found) in [
            ("port = 1", "no setting `port`; expected listen"),
            ("config = \"a\"", "no setting `config`"),
            ("name = \"a\"", "no setting `name`"),
            ("[server]\nout = \"a\"", "no setting `server`"),
            ("out = true", "out is true; expected a text"),
            ("listen = [[\"a\"]]", "listen is [[\"a\"]]"),
            ("out = ", "fleet.toml"),
            ("max_runs = 0\nout = \"a\"", "--max-runs"),
        ] {
            let error = with(file, line).unwrap_err();
            assert!(error.contains(found), "{file}: {error}");
        }
        assert!(with("", "server --config nowhere.toml").is_err());
    }
}
