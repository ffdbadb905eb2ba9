//! What is saved while a run goes on: the recording and the pictures of keyframes.
//!
//! The recording has the depth of the filter, before mapping has made anything of it:
//! `monogrid map` builds the map of the run again, byte for byte, or another one.

use crate::keyframe_colours::ColourSource;
use crate::output::{Content, OutputFolder};
use crate::process::failure::{Classify, Failure};
use crate::process::memory;
use crate::run::live::Ear;
use crate::run::sessions::{Earlier, RECORDING, continuation, sessions};
use crate::run::tracking::submaps::{SubmapPolicy, Submaps};
use monogrid_datasets::{
    ColourRecord, Continuation, DepthRevision, EndRecord, KeyframeRecord, PoseSnapshot, Record,
    RecordedCamera, RecordingWriter, SessionInfo, encode_png, encode_png_rgb,
};
use monogrid_pipeline::{Event, Listener, ListenerError, Run};
use monogrid_report::picture::keyframe::{Measured, depth_picture, uncertainty_picture};
use monogrid_slam::{KeptKeyframe, Keyframe, fault};
use std::path::Path;
use std::sync::Arc;

/// Folder with pictures of the keyframes.
pub const KEYFRAME_FOLDER: &str = "keyframes";

/// Hears of keyframes and writes them.
pub struct Recorder {
    writer: Option<RecordingWriter>,
    submaps: Option<Submaps>,
    folder: Arc<OutputFolder>,
    /// What a later run is told of this one.
    source: String,
    earlier: Option<Earlier>,
    /// Colour of the frames of this run.
    source_colours: Option<ColourSource>,
    /// Hears the colours of keyframes.
    viewer: Option<Ear>,
}

/// What is said of a recording that cannot be written.
const DOING: &str = "the recording cannot be written";

impl Recorder {
    /// Begins the recording; closes submaps as well, where they are wanted.
    pub fn start(
        folder: Arc<OutputFolder>,
        session: &SessionInfo,
        (earlier, source_colours): (Option<Earlier>, Option<ColourSource>),
        policy: Option<SubmapPolicy>,
    ) -> Result<Self, Failure> {
        let writer =
            RecordingWriter::create(&folder.begin(RECORDING)?, session).while_running(DOING)?;
        folder.list(RECORDING, Content::Begins)?;
        let submaps = |policy| Submaps::new(Arc::clone(&folder), session.clone(), policy);
        Ok(Self {
            writer: Some(writer),
            submaps: policy.map(submaps),
            folder,
            source: session.source.clone(),
            earlier,
            source_colours,
            viewer: None,
        })
    }

    /// Tells a viewer of the colours of keyframes.
    #[must_use]
    pub fn telling(mut self, viewer: Option<Ear>) -> Self {
        self.viewer = viewer;
        self
    }

    fn save(&mut self, event: &Event) -> Result<(), Failure> {
        let Some(writer) = &mut self.writer else {
            return Ok(());
        };
        match event {
            Event::Finished(kept, snapshot) => {
                let keyframe = &loaded(kept, DOING)?;
                let record = keyframe_record(keyframe, None);
                writer.append_keyframe(record).while_running(DOING)?;
                let sources = (self.earlier.as_ref(), self.source_colours.as_ref());
                let jpeg = colour(keyframe, sources);
                if let (Some(viewer), Some(jpeg)) = (&self.viewer, &jpeg) {
                    viewer.colour(keyframe.id, jpeg);
                }
                if let Some(jpeg) = jpeg.clone() {
                    let keyframe_id = keyframe.id;
                    let record = Record::Colour(ColourRecord { keyframe_id, jpeg });
                    writer.append(&record).while_running(DOING)?;
                }
                writer.append_poses(poses(snapshot)).while_running(DOING)?;
                if let Some(submaps) = &mut self.submaps {
                    submaps.finished(kept, jpeg, snapshot)?;
                }
                save_pictures(&self.folder, keyframe)
            }
            Event::Revised(kept) => {
                let keyframe = &loaded(kept, DOING)?;
                if let Some(submaps) = &mut self.submaps {
                    submaps.revised(kept);
                }
                let depth = depth_revision(keyframe);
                writer.append_depth(depth).while_running(DOING)?;
                save_pictures(&self.folder, keyframe)
            }
            // poses are recorded with the next keyframe, or at the end; the rest is in the tables
            _ => Ok(()),
        }
    }

    /// The last poses, and what a later run needs to go on.
    fn save_end(&mut self, run: Run) -> Result<(), Failure> {
        let Some(mut writer) = self.writer.take() else {
            return Ok(());
        };
        let snapshot = run.slam.snapshot();
        writer.append_poses(poses(&snapshot)).while_running(DOING)?;
        let end = EndRecord {
            num_frames: run.num_frames as u64,
            num_tracked: run.slam.trajectory().len() as u64,
            summary: String::new(),
        };
        let earlier = self.earlier.as_ref();
        let sessions = sessions(run.slam, earlier, &self.source);
        let frames = earlier.map_or_else(Vec::new, |earlier| earlier.frames.clone());
        let continuation = continuation(run.slam, sessions, frames);
        let continuation = Record::Continuation(continuation);
        writer.append(&continuation).while_running(DOING)?;
        writer.finish(end.clone()).while_running(DOING)?;
        self.folder.list(RECORDING, Content::Whole)?;
        match self.submaps.take() {
            Some(submaps) => submaps.end(&snapshot, &[continuation, Record::End(end)]),
            None => Ok(()),
        }
    }
}

impl Listener for Recorder {
    fn hear(&mut self, event: &Event) -> Result<(), ListenerError> {
        fault::pass("recorder");
        let saved = self.save(event).map_err(Failure::into_error);
        if let Event::Finished(..) = event {
            // what was made with it and dropped lies between what stays
            memory::give_back();
        }
        saved
    }

    fn end(&mut self, run: Run) -> Result<(), ListenerError> {
        self.save_end(run).map_err(Failure::into_error)
    }
}

/// A map in the middle of a run.
#[derive(Clone, Debug)]
pub struct MapNow {
    /// Its camera and scale, and the settings of the run.
    pub session: SessionInfo,
    /// Its keyframes, by identity.
    pub keyframes: Vec<KeptKeyframe>,
    /// Where they are.
    pub poses: Arc<monogrid_slam::PoseSnapshot>,
    /// What a later run needs to go on.
    pub continuation: Continuation,
}

impl MapNow {
    /// Writes the recording that a run would leave that ends now.
    pub fn write(self, file: &Path) -> Result<(), Failure> {
        let mut writer = RecordingWriter::create(file, &self.session).while_running(DOING)?;
        for kept in &self.keyframes {
            let record = keyframe_record(&loaded(kept, DOING)?, None);
            writer.append_keyframe(record).while_running(DOING)?;
        }
        let poses = poses(&self.poses);
        writer.append_poses(poses).while_running(DOING)?;
        let num_frames = self.continuation.frames.len() as u64;
        let continuation = Record::Continuation(self.continuation);
        writer.append(&continuation).while_running(DOING)?;
        let end = EndRecord {
            num_frames,
            num_tracked: num_frames,
            summary: String::new(),
        };
        writer.finish(end).while_running(DOING)?;
        Ok(())
    }
}

/// A keyframe that was finished or revised.
pub fn loaded(keyframe: &KeptKeyframe, doing: &'static str) -> Result<Keyframe, Failure> {
    let lost = || anyhow::anyhow!("keyframe {} cannot be read back", keyframe.id);
    keyframe.load().ok_or_else(lost).while_running(doing)
}

/// A keyframe as it is first recorded; with its camera where that is not the one of the recording.
pub fn keyframe_record(keyframe: &Keyframe, camera: Option<RecordedCamera>) -> KeyframeRecord {
    KeyframeRecord {
        id: keyframe.id,
        frame_index: keyframe.frame_index as u64,
        timestamp_ns: keyframe.timestamp_ns,
        camera,
        image: Some(keyframe.image.clone()),
        pixels: keyframe.pixels.clone(),
    }
}

/// The depth of a keyframe that became better.
pub fn depth_revision(keyframe: &Keyframe) -> DepthRevision {
    DepthRevision {
        keyframe_id: keyframe.id,
        revision: keyframe.revision,
        pixels: keyframe.pixels.clone(),
    }
}

/// The colour of a keyframe, as JPEG: of an earlier run, or of the source of this one.
fn colour(
    keyframe: &Keyframe,
    (earlier, source): (Option<&Earlier>, Option<&ColourSource>),
) -> Option<Vec<u8>> {
    match earlier {
        Some(earlier) if (keyframe.id as usize) < earlier.map.keyframes.len() => {
            earlier.colours.jpeg(keyframe.id).map(<[u8]>::to_vec)
        }
        _ => source?.keyframe(keyframe),
    }
}

/// Poses of the keyframes of the main map: nothing else has a place in a map.
fn poses(snapshot: &monogrid_slam::PoseSnapshot) -> PoseSnapshot {
    let all = (0u32..).zip(snapshot.world_from_keyframe.iter().copied());
    let in_map = all.filter(|(id, _)| snapshot.in_main_map(*id).is_some());
    PoseSnapshot {
        revision: snapshot.revision,
        poses: in_map.collect(),
    }
}

fn save_pictures(folder: &OutputFolder, keyframe: &Keyframe) -> Result<(), Failure> {
    let measured: Vec<Measured> = measured(keyframe).collect();
    let name = |kind| format!("{KEYFRAME_FOLDER}/{:05}_{kind}.png", keyframe.id);
    let [image, depth, uncertainty] = ["image", "depth", "uncertainty"].map(name);
    folder.write(&image, encode_png(&keyframe.image))?;
    let depths = depth_picture(&keyframe.image, &measured);
    folder.write(&depth, encode_png_rgb(&depths))?;
    let uncertainties = uncertainty_picture(&keyframe.image, &measured);
    folder.write(&uncertainty, encode_png_rgb(&uncertainties))
}

/// The depths of a keyframe as its pictures need them.
pub fn measured(keyframe: &Keyframe) -> impl Iterator<Item = Measured> {
    keyframe.pixels.iter().map(|pixel| Measured {
        x: usize::from(pixel.x),
        y: usize::from(pixel.y),
        idepth: f64::from(pixel.idepth),
        relative_sigma: f64::from(pixel.idepth_var.sqrt() / pixel.idepth),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::output::Inputs;
    use monogrid_datasets::{ReadOptions, Recording, Scale, SubmapTable};
    use monogrid_geometry::{Pinhole, Sim3, Vec7};
    use monogrid_image::Image;
    use monogrid_slam::DepthPixel;

    fn keyframe(id: u32, revision: u32) -> KeptKeyframe {
        let pixel = |x| DepthPixel {
            x,
            y: 20,
            idepth: 0.5 + 0.1 * f32::from(x) + revision as f32,
            idepth_var: 1e-4,
        };
        KeptKeyframe::from(Keyframe {
            id,
            frame_index: 10 * id as usize,
            timestamp_ns: 100 * i64::from(id),
            revision,
            image: Image::from_fn(40, 30, |x, y| (7 * x + 3 * y) as u8 ^ id as u8),
            pixels: (0..5).map(pixel).collect(),
        })
    }

    /// Poses of so many keyframes, all others than before; keyframes 3 and 4 are of a fragment.
    fn snapshot(count: u32) -> Arc<monogrid_slam::PoseSnapshot> {
        let pose = |id: u32| Sim3::exp(&(Vec7::repeat(0.01) * f64::from(id + count)));
        Arc::new(monogrid_slam::PoseSnapshot {
            revision: u64::from(count),
            world_from_keyframe: (0..count).map(pose).collect(),
            fragment: (0..count).map(|id| u32::from(id == 3 || id == 4)).collect(),
            ..monogrid_slam::PoseSnapshot::default()
        })
    }

    fn recorder(folder: &Path) -> Recorder {
        let session = SessionInfo {
            pinhole: Pinhole::new(40.0, 40.0, 19.5, 14.5),
            width: 40,
            height: 30,
            scale: Scale::Arbitrary,
            seed: 1,
            profile: "default".to_owned(),
            source: "somewhere".to_owned(),
            config: String::new(),
        };
        let folder = OutputFolder::replace(folder, true, &Inputs::default()).unwrap();
        let policy = SubmapPolicy {
            keyframes: 2,
            newest: 1,
        };
        Recorder::start(Arc::new(folder), &session, (None, None), Some(policy)).unwrap()
    }

    #[test]
    fn submaps_hold_what_the_recording_holds_whatever_moves_and_becomes_better() {
        let folder = tempfile::tempdir().unwrap();
        let mut recorder = recorder(folder.path());
        let finished = |id: u32| Event::Finished(keyframe(id, 0), snapshot(id + 1));
        let table = folder.path().join("submaps/submaps.json");
        for id in 0..3 {
            assert!(!table.exists());
            recorder.hear(&finished(id)).unwrap();
        }
        // of a keyframe that is closed, of one that is not, and again
        for (id, revision) in [(1, 1), (2, 1), (1, 2)] {
            recorder
                .hear(&Event::Revised(keyframe(id, revision)))
                .unwrap();
        }
        for id in 3..6 {
            recorder.hear(&finished(id)).unwrap();
        }
        let read = |name: &str| {
            Recording::read(&folder.path().join(name), ReadOptions::default()).unwrap()
        };
        // as a run leaves it that is killed now
        let closed = read("submaps/submaps.json");
        let recording = read("recording.mgk");
        assert_eq!(closed.keyframes, recording.keyframes[..5]);
        assert_eq!(closed.keyframes[1].depth_revision, 2);
        assert!(closed.keyframes[3].world_from_keyframe.is_none());
        recorder.hear(&Event::Revised(keyframe(0, 1))).unwrap();
        recorder.hear(&finished(6)).unwrap();
        let submaps = recorder.submaps.take().unwrap();
        submaps.end(&snapshot(7), &[]).unwrap();
        assert_eq!(read("submaps/submaps.json"), read("recording.mgk"));
        let entries = SubmapTable::read(&table).unwrap().submaps;
        let sizes: Vec<usize> = entries.iter().map(|entry| entry.keyframes).collect();
        assert_eq!(sizes, [2, 1, 2, 2], "a submap ends where a fragment does");
        let is_placed = entries
            .iter()
            .map(|entry| entry.world_from_submap.is_some());
        assert_eq!(is_placed.collect::<Vec<_>>(), [true, true, false, true]);
    }
}
