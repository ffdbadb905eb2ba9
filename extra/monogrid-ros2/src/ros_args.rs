//! What ROS and its launch files add to a command line: from `--ros-args` to the end or to `--`.
//!
//! Names become options of the program, and so do parameters: each option is one, with `_` for
//! `-`.

use crate::args::{Args, rule};
use crate::params_file::{self, Given};
use clap::builder::ArgAction;
use clap::error::ErrorKind;
use clap::{CommandFactory, Parser};
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::Path;

/// Options that are no parameters: they say which node this is.
const NAMES: [&str; 6] = ["name", "namespace", "remap", "log-level", "help", "version"];

/// Where parameters stand.
enum Parameters {
    /// On the command line: name and value.
    One(String, String),
    File(String),
}

impl Args {
    /// Reads a command line, with what ROS and its launch files add to it.
    ///
    /// # Errors
    /// What is not understood, and the help and the version that were asked for.
    pub fn read(arguments: impl IntoIterator<Item = OsString>) -> Result<Self, clap::Error> {
        let (mut own, mut parameters) = (Vec::new(), Vec::new());
        let mut arguments = arguments.into_iter();
        while let Some(argument) = arguments.next() {
            if argument == "--ros-args" {
                let block = arguments.by_ref().take_while(|argument| argument != "--");
                let block = block.map(|argument| argument.to_string_lossy().into_owned());
                let added = names_of(block, &mut parameters).map_err(refused)?;
                own.extend(added.into_iter().map(OsString::from));
            } else {
                own.push(argument);
            }
        }
        // files of parameters are for nodes by their names
        let named = Self::try_parse_from(&own)?;
        let given = given_to(&named, &parameters).map_err(refused)?;
        let added = options_of(given).map_err(refused)?;
        own.extend(added.options.into_iter().map(OsString::from));
        Ok(Self {
            ignored: added.ignored,
            ..Self::try_parse_from(own)?
        })
    }
}

fn refused(why: String) -> clap::Error {
    clap::Error::raw(ErrorKind::InvalidValue, why + "\n")
}

/// The names that ROS gives, as options of the program; its parameters apart.
fn names_of(
    mut arguments: impl Iterator<Item = String>,
    parameters: &mut Vec<Parameters>,
) -> Result<Vec<String>, String> {
    let mut own = Vec::new();
    while let Some(argument) = arguments.next() {
        let mut value = || {
            let value = arguments.next();
            value.ok_or_else(|| format!("{argument} has no value"))
        };
        match argument.as_str() {
            "-r" | "--remap" => {
                let (from, to) = rule(&value()?)?;
                own.push(match from.as_str() {
                    "__node" | "__name" => format!("--name={to}"),
                    "__ns" => format!("--namespace={to}"),
                    _ => format!("--remap={from}:={to}"),
                });
            }
            "-p" | "--param" => {
                let (name, value) = rule(&value()?)?;
                parameters.push(Parameters::One(name, value));
            }
            "--params-file" => parameters.push(Parameters::File(value()?)),
            "--log-level" => own.push(format!("--log-level={}", value()?)),
            "-e" | "--enclave" => drop(value()?),
            other if other.starts_with("--enable-") || other.starts_with("--disable-") => {}
            other => return Err(format!("{other:?} after --ros-args is not understood")),
        }
    }
    Ok(own)
}

/// Parameters in options of the program, and names of those that are none of this node.
#[derive(Default)]
struct Added {
    options: Vec<String>,
    ignored: Vec<String>,
}

/// What all of them give a node, one after the other.
fn given_to(node: &Args, parameters: &[Parameters]) -> Result<Vec<Given>, String> {
    let mut given = Vec::new();
    for parameter in parameters {
        match parameter {
            Parameters::One(name, value) => {
                let (of, name) = name.split_once(':').unwrap_or((&node.name, name));
                if of == node.name {
                    given.push(Given {
                        name: name.to_owned(),
                        value: params_file::value_of(value)?,
                        is_for_one: true,
                    });
                }
            }
            Parameters::File(path) => {
                given.extend(params_file::read(Path::new(path), &node.full_name())?);
            }
        }
    }
    Ok(given)
}

/// Parameters in options: of equal ones the last counts.
fn options_of(given: Vec<Given>) -> Result<Added, String> {
    let command = Args::command();
    let options: BTreeMap<String, &clap::Arg> = command
        .get_arguments()
        .filter_map(|option| Some((option.get_long()?, option)))
        .filter(|(name, _)| !NAMES.contains(name))
        .map(|(name, option)| (name.replace('-', "_"), option))
        .collect();
    let (mut values, mut ignored) = (BTreeMap::new(), Vec::new());
    for Given {
        name,
        value,
        is_for_one,
    } in given
    {
        if options.contains_key(&name) {
            values.insert(name, value);
        } else if is_for_one {
            let known: Vec<&str> = options.keys().map(String::as_str).collect();
            let known = known.join(", ");
            return Err(format!(
                "there is no parameter {name:?}, expected one of {known}"
            ));
        } else {
            ignored.push(name);
        }
    }
    let option = |(name, value): (String, String)| {
        let option = name.replace('_', "-");
        let is_flag = matches!(options[&name].get_action(), ArgAction::SetTrue);
        match value.as_str() {
            _ if !is_flag => Ok(Some(format!("--{option}={value}"))),
            "true" => Ok(Some(format!("--{option}"))),
            "false" => Ok(None),
            _ => Err(format!(
                "parameter {name} is {value:?}, expected true or false"
            )),
        }
    };
    let options: Result<Vec<Option<String>>, String> = values.into_iter().map(option).collect();
    Ok(Added {
        options: options?.into_iter().flatten().collect(),
        ignored,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::Severity;
    use std::fs;

    fn read(line: &str) -> Result<Args, clap::Error> {
        Args::read(line.split(' ').map(OsString::from))
    }

    #[test]
    fn what_ros_says_after_ros_args() {
        let args = read(
            "node --image /a --metres-per-unit 2 --ros-args -r __node:=eye -r __ns:=/robot \
             --remap map:=/floor -p use_sim_time:=true -p metres_per_unit:=0.5 -p image:=/b \
             -p height_band:=[-0.1,1.5] -p other:speed:=1 -p eye:map_period:=2 -p no_tf:=false \
             --log-level warn --log-level robot.eye:=debug -- --compressed",
        );
        let args = args.unwrap();
        assert_eq!(
            (args.name.as_str(), args.namespace.as_str()),
            ("eye", "/robot")
        );
        assert_eq!(args.remap, [("map".to_owned(), "/floor".to_owned())]);
        assert_eq!((args.metres_per_unit, args.compressed), (Some(0.5), true));
        assert_eq!((args.image.as_str(), args.map_period), ("/b", 2.0));
        assert_eq!(args.height_band, Some([-0.1, 1.5]));
        assert!(args.use_sim_time && !args.frames.no_tf);
        assert_eq!(args.least_severity(), Severity::Debug);
        for (wrong, named) in [
            ("node --ros-args -r map", "FROM:=TO"),
            ("node --ros-args -r", "-r"),
            ("node --ros-args -p speed:=1", "speed"),
            ("node --ros-args -p name:=eye", "name"),
            ("node --ros-args -p no_tf:=3", "no_tf"),
            ("node --ros-args -p height_band:={a:1}", "value"),
            ("node --ros-args --params-file", "--params-file"),
            (
                "node --ros-args --params-file /nowhere.yaml",
                "/nowhere.yaml",
            ),
            ("node --ros-args -p metres_per_unit:=-1", "metres-per-unit"),
            ("node --ros-args --log-level loud", "loud"),
        ] {
            let error = read(wrong).unwrap_err().to_string();
            assert!(error.contains(named), "{error}");
        }
    }

    #[test]
    fn files_of_parameters_are_for_nodes_by_their_names() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("robot.yaml");
        let with = |text: &str, more: &str| {
            fs::write(&path, text).unwrap();
            read(&format!(
                "node --ros-args --params-file {}{more}",
                path.display()
            ))
        };
        let text = "/**:\n  ros__parameters:\n    use_sim_time: true\n    speed: 3\n\
            eye:\n  ros__parameters:\n    base_from_camera: [0.1, 0, 0.3, 0, 0.26, 0]\n\
            \x20   metres_per_unit: 0.4\n\
            /robot/eye:\n  ros__parameters:\n    image: /left\n    rectified: true\n";
        let args = with(text, " -r __node:=eye -p metres_per_unit:=0.5").unwrap();
        assert!(args.use_sim_time && !args.rectified);
        // what comes later counts
        assert_eq!(args.metres_per_unit, Some(0.5));
        let there = args.frames.base_from_camera.unwrap();
        assert_eq!(there, [0.1, 0.0, 0.3, 0.0, 0.26, 0.0]);
        // it may be one of another node, but somebody may have mistyped it
        assert_eq!(args.ignored, ["speed"]);
        let args = with(text, " -r __node:=eye -r __ns:=/robot").unwrap();
        assert_eq!((args.image.as_str(), args.rectified), ("/left", true));
        assert_eq!(args.metres_per_unit, None);
        for (wrong, named) in [
            ("monogrid:\n  ros__parameters:\n    speed: 3\n", "speed"),
            (
                "monogrid:\n  ros__parameters:\n    map_period: -1\n",
                "map-period",
            ),
            (
                "monogrid:\n  ros__parameters:\n    use_sim_time: 3\n",
                "use_sim_time",
            ),
            ("monogrid:\n  use_sim_time: true\n", "ros__parameters"),
            ("monogrid: {", "robot.yaml"),
        ] {
            let error = with(wrong, "").unwrap_err().to_string();
            assert!(error.contains(named), "{error}");
        }
    }
}
