//! A run that goes on with the map of an earlier one.
//!
//! It records everything again: the folder of the earlier run is only read.

mod source;
mod stored;

pub use source::{Source, files_of};
pub use stored::tracked_frame;

use crate::process::failure::{Classify, Failure};
use crate::run::align::{Align, KnownGround, UpSummary};
use monogrid_datasets::{
    Continuation, FragmentKeyframe, KeyframeLink, RecordedFrame, RecordedSession, SessionInfo,
    read_sim3, read_text,
};
use monogrid_geometry::Pinhole;
use monogrid_pipeline::Preparation;
use monogrid_report::colours::Colours;
use monogrid_slam::{MAIN_MAP, Purpose, Slam, StoredKeyframe, StoredLink, StoredMap};
use std::path::{Path, PathBuf};
use stored::{recorded_edge, recorded_point, stored_map};

/// Name of the recording of a run.
pub const RECORDING: &str = "recording.mgk";
/// File with the transform from the world of a run to the frame of its results.
pub const MAP_FROM_WORLD: &str = "map_from_world.txt";

/// The earlier run.
#[derive(Clone, Debug)]
pub struct Earlier {
    /// Where it lies.
    pub path: PathBuf,
    /// Camera, scale and settings.
    pub session: SessionInfo,
    /// Its map.
    pub map: StoredMap,
    /// Its keyframes in colour.
    pub colours: Colours,
    /// Runs that made the map.
    pub sessions: Vec<RecordedSession>,
    /// Their frames.
    pub frames: Vec<RecordedFrame>,
    /// The frame of its results, where they lie beside the recording.
    pub frame: Option<Align>,
    /// What the user should know.
    pub warnings: Vec<String>,
}

/// A map to go on with, and how.
#[derive(Clone, Debug)]
pub struct Continued {
    /// The map.
    pub earlier: Earlier,
    /// Whether it grows.
    pub purpose: Purpose,
}

impl Earlier {
    /// Reads the recording in the folder of a run, a recording, or submaps.
    pub fn read(path: &Path) -> Result<Self, Failure> {
        let source = Source::find(path)?;
        let recording = source.read()?;
        let file = source.file;
        let (name, mut warnings) = (file.display(), Vec::new());
        let (lost, invalid) = (recording.damage.lost_bytes, recording.num_invalid_links);
        if recording.damage.num_gaps > 0 {
            warnings.push(format!("{lost} bytes of {name} are damaged"));
        }
        if invalid > 0 {
            warnings.push(format!(
                "{invalid} edges, points and frames of {name} name what does not exist and were \
                 left out"
            ));
        }
        let continuation = recording.continuation.clone().unwrap_or_else(|| {
            warnings.push(format!(
                "{name} says nothing of edges, points and frames (not finished, a part of a run, \
                 or by an earlier version): only keyframes and poses are taken over"
            ));
            Continuation::default()
        });
        let map = stored_map(&recording, &continuation, &file)?;
        let mut sessions = continuation.sessions;
        if sessions.is_empty() {
            sessions.push(RecordedSession {
                source: recording.session.source.clone(),
                first_keyframe: 0,
            });
        }
        Ok(Self {
            path: path.to_owned(),
            colours: Colours::of(&recording.keyframes),
            session: recording.session,
            map,
            sessions,
            frames: continuation.frames,
            frame: frame_beside(&file)?,
            warnings,
        })
    }

    /// Refuses the images of a source whose camera is not that of the map.
    pub fn check_camera(&self, images: &Preparation, source: &str) -> Result<(), Failure> {
        let (found, expected) = (images.pinhole(), &self.session.pinhole);
        let size @ (of_width, of_height) = (self.session.width, self.session.height);
        let focal = |a: f64, b: f64| (a / b - 1.0).abs() < 0.01;
        let centre = |a: f64, b: f64| (a - b).abs() < 2.0;
        let is_same = images.size() == size
            && focal(found.fx, expected.fx)
            && focal(found.fy, expected.fy)
            && centre(found.cx, expected.cx)
            && centre(found.cy, expected.cy);
        if is_same {
            let checked = self.map.check(size);
            let said = |error| Failure::input(format!("{}: {error}", self.path.display()));
            return checked.map_err(said);
        }
        let (width, height) = images.size();
        Err(Failure::input(format!(
            "the map of {} was made with images of {of_width}x{of_height} pixels, {}; {source} \
             gives {width}x{height}, {}: expected the same camera and working size",
            self.path.display(),
            describe(expected),
            describe(found)
        )))
    }
}

/// The frame of the results that lie beside a recording: what a map of it, or a run that goes on
/// with it, has in common with them. `None` where there are none.
pub fn frame_beside(recording: &Path) -> Result<Option<Align>, Failure> {
    let folder = source::folder_of_run(recording);
    let frame_file = folder.join(MAP_FROM_WORLD);
    if !frame_file.is_file() {
        return Ok(None);
    }
    let summary = read_text(&folder.join("summary.json")).unwrap_or_default();
    let summary: serde_json::Value = serde_json::from_str(&summary).unwrap_or_default();
    let said = |key: &str| summary.get(key)?.as_str().map(str::to_owned);
    let level = |key: &str| serde_json::from_value(summary.get(key)?.clone()).ok();
    let ground = KnownGround {
        up: UpSummary::read(&summary["up"]),
        floor: level("floor"),
        level_surface: level("level_surface"),
    };
    Ok(Some(Align::Map {
        map_from_world: read_sim3(&frame_file).bad_input()?,
        description: said("frame").unwrap_or_else(|| "the frame of the run".to_owned()),
        is_metric: said("scale").as_deref() == Some("metric"),
        ground,
        has_grown: false,
    }))
}

fn describe(&Pinhole { fx, fy, cx, cy }: &Pinhole) -> String {
    format!("fx {fx:.1} fy {fy:.1} cx {cx:.1} cy {cy:.1}")
}

/// The sessions of a map when this run is over.
pub fn sessions(slam: &Slam, earlier: Option<&Earlier>, source: &str) -> Vec<RecordedSession> {
    let mut sessions = earlier.map_or_else(Vec::new, |earlier| earlier.sessions.clone());
    let first = earlier.map_or(0, |earlier| earlier.map.keyframes.len());
    sessions.push(RecordedSession {
        source: source.to_owned(),
        first_keyframe: first.min(slam.num_keyframes()) as u32,
    });
    sessions
}

/// What a later run needs of the map as it is now: the sessions that made it, the last of which is
/// this one, and the frames of those before.
pub fn continuation(
    slam: &Slam,
    sessions: Vec<RecordedSession>,
    mut frames: Vec<RecordedFrame>,
) -> Continuation {
    let session = sessions.len() as u32 - 1;
    frames.extend(slam.tracked_frames().iter().map(|frame| RecordedFrame {
        session,
        frame_index: frame.frame_index as u64,
        timestamp_ns: frame.timestamp_ns,
        keyframe: frame.keyframe,
        keyframe_from_frame: frame.keyframe_from_frame,
    }));
    // one after the other: a list that is made into another is gone before the next one
    Continuation {
        edges: slam.edges().iter().map(recorded_edge).collect(),
        points: slam.points().map(|point| recorded_point(&point)).collect(),
        ..of_links(&slam.links(), sessions, frames)
    }
}

/// What a later run needs of a map, the sessions that made it, and their frames.
pub fn continuation_of(
    map: &StoredMap,
    sessions: Vec<RecordedSession>,
    frames: Vec<RecordedFrame>,
) -> Continuation {
    let links: Vec<StoredLink> = map.keyframes.iter().map(StoredKeyframe::link).collect();
    Continuation {
        edges: map.edges.iter().map(recorded_edge).collect(),
        points: map.points.iter().map(recorded_point).collect(),
        ..of_links(&links, sessions, frames)
    }
}

/// The same without edges and points.
fn of_links(
    links: &[StoredLink],
    sessions: Vec<RecordedSession>,
    frames: Vec<RecordedFrame>,
) -> Continuation {
    let link = |stored: &StoredLink| KeyframeLink {
        id: stored.id,
        parent: stored.parent,
        gain: stored.gain,
        bias: stored.bias,
    };
    let apart = links.iter().filter(|stored| stored.fragment != MAIN_MAP);
    let fragment = |stored: &StoredLink| FragmentKeyframe {
        keyframe: stored.id,
        fragment: stored.fragment,
        fragment_from_keyframe: stored.world_from_keyframe,
    };
    Continuation {
        sessions,
        keyframes: links.iter().map(link).collect(),
        edges: Vec::new(),
        points: Vec::new(),
        frames,
        fragments: apart.map(fragment).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::align::Scene;
    use crate::run::sensed::SensedFrame;

    #[test]
    fn what_is_known_of_up_and_floor_is_kept() {
        let folder = tempfile::tempdir().unwrap();
        let write =
            |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
        write(MAP_FROM_WORLD, "1 0 0 0.5 0 0 0 1\n");
        let frame_of = |summary: &str| {
            write("summary.json", summary);
            let beside = frame_beside(&folder.path().join(RECORDING))
                .unwrap()
                .unwrap();
            let mut never = || -> Scene { unreachable!("the frame is known") };
            beside.frame(&[], &SensedFrame::default(), &mut never).0
        };
        let floor = frame_of(
            r#"{"up": {"confidence": 0.3},
                "floor": {"camera_height": 1.2, "share": 0.4, "below": 0.0}}"#,
        );
        assert_eq!(floor.up.confidence, Some(0.3));
        assert!(!floor.up.is_certain);
        // of an earlier version, which took a wall for the floor where up was uncertain
        assert_eq!(floor.floor, None);
        assert_eq!(
            floor.level_surface.map(|floor| floor.camera_height),
            Some(1.2)
        );
        let held = frame_of(r#"{"up": {"from": "first-camera", "is_certain": false}}"#);
        assert_eq!((held.up.from, held.up.is_certain), ("first-camera", false));
        let given = frame_of(
            r#"{"up": {"from": "given", "is_certain": true},
                "floor": {"camera_height": 1.2, "share": 0.4, "below": 0.0}}"#,
        );
        assert_eq!((given.up.from, given.up.is_certain), ("earlier", true));
        assert_eq!(given.floor.map(|floor| floor.camera_height), Some(1.2));
        let table = frame_of(
            r#"{"up": {"confidence": 0.8}, "floor": null,
                "level_surface": {"camera_height": 0.5, "share": 0.4, "below": 0.1}}"#,
        );
        assert_eq!((table.floor, table.up.is_certain), (None, true));
        assert_eq!(table.level_surface.map(|table| table.below), Some(0.1));
        // of an earlier version
        let old = frame_of(r#"{"floor": {"camera_height": 1.2, "share": 0.4}}"#);
        assert!(old.floor.is_some());
    }
}
