//! Folders with several files for a frame, as 7-Scenes (`[SHOTTON13]`) has them:
//! `frame-000000.color.png`, `.depth.png` and `.pose.txt`.

use crate::files::is_file;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Last words of names that say what an image shows.
const COLOUR: [&str; 3] = ["color", "colour", "rgb"];
const DEPTH: [&str; 1] = ["depth"];
const POSE: &str = "pose";

/// The images of a folder by what they show.
pub(super) struct Kinds {
    pub colours: Vec<PathBuf>,
    pub depths: OfFrames,
    pub poses: OfFrames,
}

/// Files by the name of the frame that they belong to.
#[derive(Default)]
pub(super) struct OfFrames(BTreeMap<String, PathBuf>);

impl OfFrames {
    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The files of these frames, with their times.
    pub(super) fn timed(&self, frames: &[(i64, PathBuf)]) -> Vec<(i64, PathBuf)> {
        let of_frame = |(time_ns, frame): &(i64, PathBuf)| {
            let file = self.0.get(&parts(frame)?.name)?;
            Some((*time_ns, file.clone()))
        };
        frames.iter().filter_map(of_frame).collect()
    }
}

/// Tells colour images from depth images where both are there, in the order given; all images are
/// colour images otherwise.
pub(super) fn kinds_of(images: Vec<PathBuf>) -> Kinds {
    let is = |path: &Path, words: &[&str]| {
        let word = parts(path).and_then(|parts| parts.word);
        word.is_some_and(|word| words.contains(&word.as_str()))
    };
    let (depths, others): (Vec<PathBuf>, Vec<PathBuf>) =
        images.into_iter().partition(|path| is(path, &DEPTH));
    if depths.is_empty() || others.is_empty() {
        let images = if others.is_empty() { depths } else { others };
        return Kinds {
            poses: poses_of(&images),
            colours: images,
            depths: OfFrames::default(),
        };
    }
    let colours = others.iter().filter(|path| is(path, &COLOUR));
    let colours: Vec<PathBuf> = colours.cloned().collect();
    let colours = if colours.is_empty() { others } else { colours };
    let named = |path: PathBuf| Some((parts(&path)?.name, path));
    Kinds {
        poses: poses_of(&colours),
        colours,
        depths: OfFrames(depths.into_iter().filter_map(named).collect()),
    }
}

/// The files with poses beside images that say what they show.
fn poses_of(images: &[PathBuf]) -> OfFrames {
    let pose = |image: &PathBuf| {
        let Parts { name, word, mark } = parts(image)?;
        word?;
        let path = image.with_file_name(format!("{name}{}{POSE}.txt", mark?));
        is_file(&path).then_some((name, path))
    };
    OfFrames(images.iter().filter_map(pose).collect())
}

/// A file name: that of its frame, and the word behind it that says what the file holds with the
/// mark between them.
struct Parts {
    name: String,
    word: Option<String>,
    mark: Option<char>,
}

fn parts(path: &Path) -> Option<Parts> {
    let stem = path.file_stem()?.to_str()?;
    let cut = stem.rfind(['.', '-', '_']).map(|at| stem.split_at(at));
    let known = cut.and_then(|(name, rest)| {
        let mark = rest.chars().next()?;
        let word = rest[1..].to_ascii_lowercase();
        let is_known = COLOUR.contains(&word.as_str()) || DEPTH.contains(&word.as_str());
        is_known.then(|| Parts {
            name: name.to_owned(),
            word: Some(word),
            mark: Some(mark),
        })
    });
    Some(known.unwrap_or_else(|| Parts {
        name: stem.to_owned(),
        word: None,
        mark: None,
    }))
}
