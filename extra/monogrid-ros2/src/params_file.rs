//! Files of parameters, as launch files and `--params-file` name them: names of nodes, below them
//! `ros__parameters`, below that names of parameters.

use saphyr_parser::{Event, Parser};
use std::path::Path;

/// A file is at most so large, bytes.
const MAX_BYTES: u64 = 1 << 20;
/// Keys in one another at most.
const MAX_DEPTH: usize = 16;
/// What stands between the name of a node and its parameters.
const PARAMETERS: &str = "ros__parameters";

/// A parameter that somebody gave a node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Given {
    /// Its name.
    pub name: String,
    /// Its value; items of a list with commas between them.
    pub value: String,
    /// Whether it was given to this node alone: otherwise it may be one of others.
    pub is_for_one: bool,
}

/// What a file gives the node of this full name.
///
/// # Errors
/// A file that cannot be read, or that is none of parameters.
pub fn read(path: &Path, node: &str) -> Result<Vec<Given>, String> {
    let said = |why: String| format!("parameters {}: {why}", path.display());
    let size = std::fs::metadata(path).map_err(|error| said(error.to_string()))?;
    if !size.is_file() || size.len() > MAX_BYTES {
        return Err(said(format!(
            "expected a file of at most {MAX_BYTES} bytes"
        )));
    }
    let text = std::fs::read_to_string(path).map_err(|error| said(error.to_string()))?;
    parse(&text, node).map_err(said)
}

fn parse(text: &str, node: &str) -> Result<Vec<Given>, String> {
    let mut given = Vec::new();
    for (keys, value) in entries(text)? {
        let at = keys.iter().position(|key| key == PARAMETERS);
        let Some(at) = at.filter(|at| *at > 0 && at + 1 < keys.len()) else {
            let found = keys.join("/");
            return Err(format!(
                "found {found:?}, expected a node's name, {PARAMETERS} and a parameter's name"
            ));
        };
        let pattern = keys[..at].join("/");
        let pattern: Vec<&str> = pattern.split('/').filter(|part| !part.is_empty()).collect();
        let name: Vec<&str> = node.split('/').filter(|part| !part.is_empty()).collect();
        if is_meant(&pattern, &name) {
            given.push(Given {
                name: keys[at + 1..].join("."),
                value,
                is_for_one: !pattern.iter().any(|part| part.starts_with('*')),
            });
        }
    }
    Ok(given)
}

/// Whether a pattern names a node: `*` stands for a part of its name, `**` for any number of them.
fn is_meant(pattern: &[&str], name: &[&str]) -> bool {
    match pattern.split_first() {
        None => name.is_empty(),
        Some((&"**", rest)) => (0..=name.len()).any(|skip| is_meant(rest, &name[skip..])),
        Some((first, rest)) => {
            let is_same = |part: &&str| *first == "*" || first == part;
            name.first().is_some_and(is_same) && is_meant(rest, &name[1..])
        }
    }
}

/// The value of a parameter on a command line, which is YAML too.
///
/// # Errors
/// What is neither a scalar nor a list of them.
pub fn value_of(text: &str) -> Result<String, String> {
    let [(keys, value)] = &entries(text)?[..] else {
        return Err(format!("{text:?} is not one value"));
    };
    match keys[..] {
        [] => Ok(value.clone()),
        _ => Err(format!("{text:?} is not a value: it has keys")),
    }
}

/// What a value stands in.
enum Around {
    /// A mapping, and its key that waits for a value.
    Keys(Option<String>),
    /// A list, and its items.
    List(Vec<String>),
}

/// All values of a document, with the keys above them.
fn entries(text: &str) -> Result<Vec<(Vec<String>, String)>, String> {
    let mut entries = Vec::new();
    let mut above: Vec<Around> = Vec::new();
    for event in Parser::new_from_str(text) {
        let (event, span) = event.map_err(|error| error.to_string())?;
        let line = span.start.line();
        let value = match event {
            Event::MappingStart(..) | Event::SequenceStart(..) => {
                if above.len() >= MAX_DEPTH || matches!(above.last(), Some(Around::List(_))) {
                    return Err(format!("line {line}: lists hold values, expected no more"));
                }
                if matches!(above.last(), Some(Around::Keys(None))) {
                    return Err(format!("line {line}: a key is text"));
                }
                above.push(match event {
                    Event::MappingStart(..) => Around::Keys(None),
                    _ => Around::List(Vec::new()),
                });
                continue;
            }
            Event::MappingEnd => {
                above.pop();
                None
            }
            Event::SequenceEnd => match above.pop() {
                Some(Around::List(items)) => Some(items.join(",")),
                _ => None,
            },
            Event::Scalar(text, ..) => match above.last_mut() {
                Some(Around::Keys(key @ None)) => {
                    *key = Some(text.into_owned());
                    continue;
                }
                Some(Around::List(items)) => {
                    items.push(text.into_owned());
                    continue;
                }
                _ => Some(text.into_owned()),
            },
            Event::Alias(_) => return Err(format!("line {line}: an alias is not understood")),
            _ => continue,
        };
        if let Some(value) = value {
            let keys = above.iter().filter_map(|around| match around {
                Around::Keys(key) => key.clone(),
                Around::List(_) => None,
            });
            entries.push((keys.collect(), value));
        }
        if let Some(Around::Keys(key)) = above.last_mut() {
            *key = None;
        }
    }
    Ok(entries)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(text: &str, node: &str) -> Vec<(String, String, bool)> {
        let given = parse(text, node).unwrap().into_iter();
        let given = given.map(|given| (given.name, given.value, given.is_for_one));
        given.collect()
    }

    #[test]
    fn a_node_gets_what_is_for_it() {
        let text = "/**:\n  ros__parameters:\n    use_sim_time: true\n\
            monogrid:\n  ros__parameters: {a: 1, list: [0.5, '2'], deep: {er: \"x: y\"}}\n\
            /robot/monogrid:\n  ros__parameters:\n    a: 2\n\
            robot:\n  monogrid: # nested names\n    ros__parameters:\n      b: -3e1\n\
            /*/monogrid:\n  ros__parameters:\n    c: yes\n\
            /**/other:\n  ros__parameters:\n    d: 1\n";
        let of = |name: &str, value: &str, is_for_one| (name.into(), value.into(), is_for_one);
        assert_eq!(
            names(text, "/monogrid"),
            [
                of("use_sim_time", "true", false),
                of("a", "1", true),
                of("list", "0.5,2", true),
                of("deep.er", "x: y", true),
            ]
        );
        assert_eq!(
            names(text, "/robot/monogrid"),
            [
                of("use_sim_time", "true", false),
                of("a", "2", true),
                of("b", "-3e1", true),
                of("c", "yes", false),
            ]
        );
        assert_eq!(names(text, "/a/b/other").len(), 2);
        assert_eq!(names("# nothing\n", "/monogrid"), []);
    }

    #[test]
    fn files_that_are_none_of_parameters_say_what_is_wrong() {
        let deep = "a: {".repeat(40) + &"}".repeat(40);
        for (wrong, named) in [
            ("a: 1\n", "ros__parameters"),
            ("ros__parameters:\n  a: 1\n", "ros__parameters"),
            ("monogrid:\n  ros__parameters: 3\n", "ros__parameters"),
            ("monogrid:\n  a: 1\n", "monogrid/a"),
            ("just words\n", "expected"),
            ("a: [1, 2\n", "line 2"),
            ("a: &x 1\nb: *x\n", "alias"),
            ("a: [[1]]\n", "lists"),
            ("? [a]\n: 1\n", "key"),
            ("a:\n\tb: 1\n", "line"),
            (&deep, "line 1"),
        ] {
            let error = parse(wrong, "/monogrid").unwrap_err();
            assert!(error.contains(named), "{wrong}: {error}");
        }
        let gone = read(Path::new("/nowhere.yaml"), "/monogrid").unwrap_err();
        assert!(gone.contains("/nowhere.yaml"), "{gone}");
        let folder = read(Path::new("/"), "/monogrid").unwrap_err();
        assert!(folder.contains("expected a file"), "{folder}");
    }

    #[test]
    fn values_of_a_command_line() {
        assert_eq!(value_of("0.5").unwrap(), "0.5");
        assert_eq!(value_of("[1, 2.5]").unwrap(), "1,2.5");
        assert_eq!(value_of("'/a b'").unwrap(), "/a b");
        for wrong in ["{a: 1}", "", "[[1]]", "a: b"] {
            assert!(value_of(wrong).is_err(), "{wrong}");
        }
    }
}
