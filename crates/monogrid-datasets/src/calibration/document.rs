//! Keys and values of files that describe a camera: the YAML and XML that programs write, and ROS'
//! `ost.txt`.
//!
//! Not a YAML parser: keys with a scalar or numbers (in brackets over several lines, or one dash
//! per line) below other keys. Files of OpenCV's older versions, and those edited by hand, are YAML
//! for no library.

use crate::DatasetError;
use quick_xml::events::Event;
use std::path::Path;

/// A key with what stands behind it.
#[derive(Debug, PartialEq)]
struct Entry {
    /// The keys above it and its own, in lower case, each behind a `/`.
    path: String,
    /// What stands on its line, without quotes.
    text: String,
    /// The items of its list.
    items: Option<Vec<String>>,
}

/// The keys of a file in their order. Capitals do not count, and of equal keys the first does.
#[derive(Debug, Default)]
pub(super) struct Document {
    entries: Vec<Entry>,
}

impl Document {
    /// Reads YAML, as far as it is understood.
    pub(super) fn yaml(text: &str) -> Self {
        let text = without_comments(text);
        let text = match text.contains('{') {
            true => without_braces(&text),
            false => text,
        };
        let mut reader = YamlReader::default();
        for line in text.lines() {
            reader.read(line);
        }
        reader.document
    }

    /// Reads XML; elements are keys, attributes are not used.
    pub(super) fn xml(text: &str, path: &Path) -> Result<Self, DatasetError> {
        if text.len() > MAX_BYTES {
            let found = format!("{} bytes of XML", text.len());
            let expected = format!("a calibration, of at most {MAX_BYTES}");
            return Err(DatasetError::content(path, found, expected));
        }
        let mut reader = quick_xml::Reader::from_str(text);
        let mut document = Self::default();
        let (mut above, mut content) = (Vec::<String>::new(), String::new());
        loop {
            let event = reader.read_event();
            match event.map_err(|e| DatasetError::content(path, format!("{e}"), "complete XML"))? {
                Event::Start(_) if above.len() >= MAX_DEPTH => {
                    let found = format!("more than {MAX_DEPTH} elements in one another");
                    return Err(DatasetError::content(path, found, "XML of OpenCV"));
                }
                Event::Start(element) => {
                    let name: &str = element.name().0;
                    above.push(name.to_owned());
                    document.push(&above, "");
                    content.clear();
                }
                Event::Text(text) => content.push_str(&text),
                Event::End(_) => {
                    let text = content.trim();
                    if let Some(entry) = document.entries.last_mut().filter(|_| !text.is_empty()) {
                        text.trim_matches('"').clone_into(&mut entry.text);
                        entry.items = Some(text.split_whitespace().map(str::to_owned).collect());
                    }
                    content.clear();
                    above.pop();
                }
                Event::Eof if above.is_empty() => return Ok(document),
                Event::Eof => {
                    let found = format!("the end of the file within <{}>", above.join("> <"));
                    return Err(DatasetError::content(path, found, "complete XML"));
                }
                _ => {}
            }
        }
    }

    /// Reads ROS' `ost.txt`: a name on its line, its numbers on the next ones.
    pub(super) fn ost(text: &str) -> Self {
        let mut document = Self::default();
        for line in without_comments(text).lines().map(str::trim) {
            let is_number = line.starts_with(|c: char| c.is_ascii_digit() || "-+.".contains(c));
            match document.entries.last_mut().filter(|_| is_number) {
                Some(entry) => {
                    let words = line.split_whitespace().map(str::to_owned);
                    entry.items.get_or_insert_default().extend(words);
                    line.clone_into(&mut entry.text);
                }
                None if line.is_empty() || line.starts_with('[') => {}
                None => document.push(&[line.replace(' ', "_")], ""),
            }
        }
        document
    }

    fn push(&mut self, keys: &[impl AsRef<str>], text: &str) {
        let mut path = String::new();
        for key in keys {
            path.push('/');
            let lower = key.as_ref().chars().map(|c| c.to_ascii_lowercase());
            path.extend(lower.take(MAX_KEY));
        }
        self.entries.push(Entry {
            path,
            text: text.trim_matches(['"', '\'']).to_owned(),
            items: None,
        });
    }

    fn entry(&self, key: &str) -> Option<&Entry> {
        let is_it = |entry: &&Entry| entry.path.rsplit('/').next() == Some(key);
        self.entries.iter().find(is_it)
    }

    /// What is below the first of a key (lower case); `None` where it is not there.
    pub(super) fn below(&self, key: &str) -> Option<Document> {
        let top = &self.entry(key)?.path;
        let is_below = |entry: &&Entry| {
            let rest = entry.path.strip_prefix(top);
            rest.is_some_and(|rest| rest.starts_with('/'))
        };
        let start = self.entries.iter().position(|entry| entry.path == *top)? + 1;
        let below = self.entries[start..].iter().take_while(is_below);
        let copy = |entry: &Entry| Entry {
            path: entry.path[top.len()..].to_owned(),
            text: entry.text.clone(),
            items: entry.items.clone(),
        };
        let entries = below.map(copy).collect();
        Some(Self { entries })
    }

    /// The keys that stand below no other.
    pub(super) fn top(&self) -> impl Iterator<Item = &str> {
        let keys = self.entries.iter().map(|entry| &entry.path[1..]);
        keys.filter(|key| !key.contains('/'))
    }

    /// The text of a key (lower case), of the first of these that is there; `None` where there is
    /// nothing behind it.
    pub(super) fn text(&self, keys: &[&str]) -> Option<&str> {
        let text = |key: &&str| {
            let text = self.entry(key)?.text.as_str();
            (!text.is_empty()).then_some(text)
        };
        keys.iter().find_map(text)
    }

    /// The number of the first of these keys (lower case) that is there.
    ///
    /// # Errors
    /// When it is no number.
    pub(super) fn number(&self, keys: &[&str], path: &Path) -> Result<Option<f64>, DatasetError> {
        let found = keys
            .iter()
            .find_map(|key| Some((*key, self.text(&[*key])?)));
        found.map(|(key, text)| number(key, text, path)).transpose()
    }

    /// The numbers of the list of the first of these keys (lower case) that has one, or of the
    /// `data` below it.
    ///
    /// # Errors
    /// When one of them is no number.
    pub(super) fn list(
        &self,
        keys: &[&str],
        path: &Path,
    ) -> Result<Option<Vec<f64>>, DatasetError> {
        let found = keys.iter().find_map(|key| {
            let entry = self.entry(key)?;
            let data = format!("{}/data", entry.path);
            let of_data = || self.entries.iter().find(|entry| entry.path == data);
            let items = entry.items.as_ref();
            let items = items.or_else(|| of_data()?.items.as_ref())?;
            Some((*key, items))
        });
        let Some((key, items)) = found else {
            return Ok(None);
        };
        let numbers = items.iter().map(|item| number(key, item, path));
        numbers.collect::<Result<_, _>>().map(Some)
    }
}

fn number(key: &str, text: &str, path: &Path) -> Result<f64, DatasetError> {
    text.parse().map_err(|_| {
        let found = format!("{key}: {text} is not a number");
        DatasetError::content(path, found, "a number, its decimals behind a point")
    })
}

/// The beginning of a text, without what is behind `#` at the start of a line or behind a blank.
fn without_comments(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for line in text.lines() {
        if out.len() > MAX_BYTES {
            break;
        }
        let is_comment = |(i, _): &(usize, &str)| line[..*i].trim_end().len() < *i || *i == 0;
        let end = line.match_indices('#').find(is_comment);
        out.push_str(&line[..end.map_or(line.len(), |(i, _)| i)]);
        out.push('\n');
    }
    out
}

/// Mappings in braces as mappings in lines, which are farther to the right than what is around
/// them.
fn without_braces(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let (mut depth, mut in_list, mut is_start) = (0_usize, 0_usize, false);
    for c in text.chars() {
        match c {
            // keys of one mapping begin in one column
            ' ' | '\t' | '\n' if depth > 0 && is_start => continue,
            '{' => depth += 1,
            '}' => depth = depth.saturating_sub(1),
            '[' => in_list += 1,
            ']' => in_list = in_list.saturating_sub(1),
            _ => {}
        }
        is_start = matches!(c, '{' | '}') || (c == ',' && depth > 0 && in_list == 0);
        match c {
            _ if is_start => {
                // farther to the right than anybody indents, and deeper ones still farther
                let blanks = match depth {
                    0 => 0,
                    _ => BRACE_INDENT + depth.min(MAX_DEPTH),
                };
                out.push('\n');
                out.extend(std::iter::repeat_n(' ', blanks));
            }
            '\n' if depth > 0 => out.push(' '),
            other => out.push(other),
        }
    }
    out
}

/// Longest text that is looked at: a key is kept with those above it. What programs add to a
/// calibration, such as the corners of its images, stands behind it.
const MAX_BYTES: usize = 1 << 21;

/// Longest key; the rest of it is not used.
const MAX_KEY: usize = 48;

/// Blanks before what is in braces.
const BRACE_INDENT: usize = 64;

/// Keys above a key that are kept; files have four.
const MAX_DEPTH: usize = 8;

/// Reads one line after the other.
#[derive(Default)]
struct YamlReader {
    document: Document,
    /// Columns and names of the keys above.
    above: Vec<(usize, String)>,
    /// Whether a list in brackets goes on.
    in_brackets: bool,
}

impl YamlReader {
    fn read(&mut self, line: &str) {
        if self.in_brackets {
            self.read_items(line);
            return;
        }
        let mut content = line.trim();
        let mut column = line.len() - line.trim_start().len();
        if content.is_empty() || content.starts_with('%') || content.starts_with("---") {
            return;
        }
        let mut is_item = false;
        while let Some(rest) = content
            .strip_prefix('-')
            .filter(|rest| rest.is_empty() || rest.starts_with([' ', '[']))
        {
            is_item = true;
            column += content.len() - rest.trim_start().len();
            content = rest.trim_start();
        }
        match content.split_once(':') {
            Some((key, value)) if !content.starts_with('[') => self.read_key(column, key, value),
            _ if is_item => self.read_item(content),
            _ => {}
        }
    }

    fn read_key(&mut self, column: usize, key: &str, value: &str) {
        let is_above = |(above, _): &(usize, String)| *above < column;
        let num_above = self.above.iter().take_while(|key| is_above(key)).count();
        self.above.truncate(num_above.min(MAX_DEPTH));
        let key = key.trim().trim_matches(['"', '\'']);
        self.above.push((column, key.to_owned()));
        let keys: Vec<&str> = self.above.iter().map(|(_, key)| key.as_str()).collect();
        let value = value.trim();
        // a tag such as !!opencv-matrix says what follows
        let value = match value.strip_prefix('!') {
            Some(tagged) => tagged.split_once(' ').map_or("", |(_, rest)| rest.trim()),
            None => value,
        };
        if value.starts_with('[') {
            self.document.push(&keys, "");
            self.read_items(value);
        } else {
            self.document.push(&keys, value);
        }
    }

    fn read_item(&mut self, content: &str) {
        if content.starts_with('[') {
            self.read_items(content);
        } else if let Some(entry) = self.document.entries.last_mut() {
            entry.items.get_or_insert_default().push(content.to_owned());
        }
    }

    /// Items of a list in brackets, or of one within it.
    fn read_items(&mut self, text: &str) {
        let Some(entry) = self.document.entries.last_mut() else {
            return;
        };
        let items = entry.items.get_or_insert_default();
        let words = text.split([',', '[', ']', ' ', '\t']);
        items.extend(words.filter(|word| !word.is_empty()).map(str::to_owned));
        let count = |bracket: char| text.matches(bracket).count();
        self.in_brackets = match self.in_brackets {
            true => count(']') <= count('['),
            false => count('[') > count(']'),
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn list(document: &Document, key: &str) -> Vec<f64> {
        let list = document.list(&[key], Path::new("x"));
        list.unwrap().expect(key)
    }

    #[test]
    fn lists_in_all_forms() {
        let text = "%YAML:1.0\n---\na: [1, 2.,\n   3e0]\nB: # remark\n - 1\n - -2\nc: \
            !!opencv-matrix\n  rows: 1\n  data: [ 4.,\n    5. ]\nd: [[1, 2], [3, 4]]\ne:\n- [1, \
            2]\n- [3]\nf: {rows: 1, data: [7, 8]}\ng: []\nh: 9";
        let document = Document::yaml(text);
        assert_eq!(list(&document, "a"), [1.0, 2.0, 3.0]);
        assert_eq!(list(&document, "b"), [1.0, -2.0]);
        assert_eq!(list(&document, "c"), [4.0, 5.0]);
        assert_eq!(list(&document, "d"), [1.0, 2.0, 3.0, 4.0]);
        assert_eq!(list(&document, "e"), [1.0, 2.0, 3.0]);
        assert_eq!(list(&document, "f"), [7.0, 8.0]);
        assert_eq!(list(&document, "g"), [0.0; 0]);
        assert_eq!(document.text(&["h"]), Some("9"));
    }

    #[test]
    fn keys_stand_below_keys() {
        let text = "cam0:\n  model: \"ds\" # double\n  T: [1]\ncam1:\n  model: pinhole\n- name: \
            x\n  model: y#1\n";
        let document = Document::yaml(text);
        assert_eq!(document.text(&["model"]), Some("ds"));
        let second = document.below("cam1").unwrap();
        assert_eq!(second.text(&["model"]), Some("pinhole"));
        assert_eq!(second.list(&["t"], Path::new("x")).unwrap(), None);
        assert!(document.below("cam2").is_none());
        assert_eq!(document.top().collect::<Vec<_>>(), ["cam0", "cam1"]);
    }

    #[test]
    fn xml_is_understood_alike() {
        let text = "<?xml version=\"1.0\"?>\n<opencv_storage>\n<!-- x -->\n<flags>4</flags>\n\
            <name>\"a b\"</name>\n<M type_id=\"opencv-matrix\"><rows>1</rows><data>\n 1. 2e0\n \
            -3</data></M>\n</opencv_storage>\n";
        let document = Document::xml(text, Path::new("x")).unwrap();
        assert_eq!(document.text(&["flags"]), Some("4"));
        assert_eq!(document.text(&["name"]), Some("a b"));
        assert_eq!(list(&document, "m"), [1.0, 2.0, -3.0]);
        assert!(Document::xml("<a><b></a>", Path::new("x")).is_err());
    }

    #[test]
    fn long_keys_and_deep_ones_take_no_more_than_the_file() {
        let key = "k".repeat(100_000);
        let nested: String = (0..10)
            .map(|n| format!("{}{key}:\n", " ".repeat(n)))
            .collect();
        let text = nested + &format!("{}x: 1\n", " ".repeat(10)).repeat(10_000);
        let document = Document::yaml(&text);
        let bytes: usize = document.entries.iter().map(|entry| entry.path.len()).sum();
        assert!(bytes < 5 * text.len(), "{bytes}");
        assert!(document.text(&["x"]).is_some());
        let deep = "<a>".repeat(100);
        let said = Document::xml(&deep, Path::new("x"))
            .unwrap_err()
            .to_string();
        assert!(said.contains("in one another"), "{said}");
        let long = "x".repeat(MAX_BYTES + 1);
        assert!(Document::xml(&long, Path::new("x")).is_err());
    }

    #[test]
    fn what_is_no_number_is_said() {
        let document = Document::yaml("fx: 517,3\nl: [1, two]");
        let said = document.number(&["fx"], Path::new("x")).unwrap_err();
        assert!(said.to_string().contains("517,3 is not a number"), "{said}");
        let said = document.list(&["l"], Path::new("x")).unwrap_err();
        assert!(said.to_string().contains("two is not a number"), "{said}");
    }
}
