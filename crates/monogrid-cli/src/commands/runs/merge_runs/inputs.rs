//! The recordings that are merged, in an order that does not depend on how they were named.

use crate::commands::runs::rescale::SUMMARY;
use monogrid_app::process::failure::Failure;
use monogrid_app::run::align::Align;
use monogrid_app::run::sessions::{Earlier, Source};
use monogrid_datasets::{Scale, read_text};
use monogrid_slam::{FragmentId, MAIN_MAP, StoredKeyframe, StoredMap};
use serde_json::Value;
use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A recording that is merged with others.
#[derive(Debug)]
pub struct Part {
    /// Its number, from 1, as the command line has it.
    pub number: usize,
    /// What it was named.
    pub path: PathBuf,
    /// All that it holds.
    pub earlier: Earlier,
    /// What lies beside it as `summary.json`.
    pub summary: Value,
    /// Keyframes of all parts before it in the merged map, and its own.
    pub keyframes: std::ops::Range<usize>,
    /// Keyframes of its main map.
    num_in_main_map: usize,
    /// [Checksum](checksum) of its keyframes.
    crc: u32,
}

impl Part {
    fn read(number: usize, path: &Path) -> Result<Self, Failure> {
        let earlier = Earlier::read(path)?;
        let summary = Source::find(path)?.folder_of_run().join(SUMMARY);
        let summary = read_text(&summary).unwrap_or_default();
        let keyframes = &earlier.map.keyframes;
        let in_main_map = keyframes.iter().filter(|k| k.fragment == MAIN_MAP);
        Ok(Self {
            number,
            path: path.to_owned(),
            num_in_main_map: in_main_map.count(),
            keyframes: 0..keyframes.len(),
            summary: serde_json::from_str(&summary).unwrap_or_default(),
            crc: checksum(keyframes),
            earlier,
        })
    }

    /// Whether lengths of its results are metres.
    pub fn is_metric(&self) -> bool {
        let in_frame = match self.earlier.frame {
            Some(Align::Map { is_metric, .. }) => is_metric,
            _ => false,
        };
        in_frame || self.earlier.session.scale == Scale::Metric
    }

    /// Whether it is known where up is.
    fn is_level(&self) -> bool {
        let from = self.summary["up"]["from"].as_str();
        self.earlier.frame.is_some() && from.is_some_and(|from| from != "first-camera")
    }

    /// Its map, which is needed in the merged one only.
    pub fn take_map(&mut self) -> StoredMap {
        let map = &mut self.earlier.map;
        StoredMap {
            keyframes: std::mem::take(&mut map.keyframes),
            edges: std::mem::take(&mut map.edges),
            points: std::mem::take(&mut map.points),
            ..*map
        }
    }
}

/// Of what keyframes show and measured, and where they are: the same of a recording and of the
/// submaps of its run.
fn checksum(keyframes: &[StoredKeyframe]) -> u32 {
    let mut crc = crc32fast::Hasher::new();
    for stored in keyframes {
        let (keyframe, pose) = (&stored.keyframe, &stored.world_from_keyframe);
        crc.update(&(keyframe.frame_index as u64).to_le_bytes());
        crc.update(&keyframe.timestamp_ns.to_le_bytes());
        crc.update(keyframe.image.as_slice());
        for pixel in &keyframe.pixels {
            crc.update(&pixel.idepth.to_le_bytes());
        }
        for number in pose.translation.iter().chain([&pose.scale]) {
            crc.update(&number.to_le_bytes());
        }
    }
    crc.finalize()
}

/// Reads all recordings. What is joined lies in the world of the first of them: those in metres
/// come first, then those that know where up is, then those with most keyframes; checksums decide
/// about the rest.
pub fn read_parts(paths: &[PathBuf]) -> Result<Vec<Part>, Failure> {
    let parts = (1..)
        .zip(paths)
        .map(|(number, path)| Part::read(number, path));
    let mut parts = parts.collect::<Result<Vec<Part>, _>>()?;
    parts.sort_by_key(|part| {
        (
            !part.is_metric(),
            !part.is_level(),
            Reverse(part.num_in_main_map),
            part.crc,
            part.number,
        )
    });
    let same = parts
        .windows(2)
        .find(|pair| pair[0].crc == pair[1].crc && pair[0].keyframes == pair[1].keyframes);
    if let Some([a, b]) = same {
        return Err(Failure::input(format!(
            "{} and {} are the same recording; expected each once",
            a.path.display(),
            b.path.display()
        )));
    }
    let mut begin = 0;
    for part in &mut parts {
        part.keyframes = begin..begin + part.keyframes.len();
        begin = part.keyframes.end;
    }
    Ok(parts)
}

/// Of every fragment of the map that the parts make side by side, the number of the recording that
/// it came from.
pub fn owners(parts: &[Part], side_by_side: &StoredMap) -> BTreeMap<FragmentId, usize> {
    let of_part = |part: &Part| {
        let (number, keyframes) = (part.number, part.keyframes.clone());
        let keyframes = side_by_side.keyframes[keyframes].iter();
        keyframes.map(move |keyframe| (keyframe.fragment, number))
    };
    parts.iter().flat_map(of_part).collect()
}
