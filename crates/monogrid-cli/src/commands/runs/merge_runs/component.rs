//! Recordings that were joined, as one recording that every command understands.

use super::inputs::Part;
use crate::commands::runs::rescale::SUMMARY;
use monogrid_app::output::{Content, OutputFolder};
use monogrid_app::process::failure::{Classify, Failure};
use monogrid_app::recorded::Recorded;
use monogrid_app::run::align::{Align, MapFrame, Up, in_map};
use monogrid_app::run::outputs::path_of;
use monogrid_app::run::sessions::{MAP_FROM_WORLD, RECORDING, continuation_of, tracked_frame};
use monogrid_app::run::tracking::recorder::keyframe_record;
use monogrid_datasets::{
    ColourRecord, EndRecord, PoseSnapshot, Record, RecordedCamera, RecordedFrame, RecordedSession,
    RecordingWriter, Scale, SessionInfo, TimedPose, format_sim3, format_tum,
};
use monogrid_slam::{FragmentId, KeyframeId, StoredKeyframe, StoredMap};
use serde_json::{Value, json};
use std::ops::Range;

/// Keyframes that hold together, in one world.
#[derive(Debug)]
pub struct Component {
    /// Folder of its recording, ending in `/`; empty for the largest component.
    pub place: String,
    /// Their map.
    map: StoredMap,
    /// The identities that they had side by side with all others.
    ids: Vec<KeyframeId>,
    /// The part, by its place among all of them, in whose world they are.
    world_of: Option<usize>,
}

/// What was written of a component.
#[derive(Debug)]
pub struct Written {
    /// Its folder, as in the component.
    pub place: String,
    /// Numbers of the recordings that have keyframes in it, and how many.
    pub recordings: Vec<(usize, usize)>,
    /// Where the cameras were, in the frame of the results.
    pub path: Vec<[f64; 3]>,
    /// What is known about scale, frame and floor.
    pub facts: Value,
}

impl Component {
    /// The keyframes that came of a part.
    fn num_of(&self, part: &Part) -> usize {
        let is_its = |id: &&KeyframeId| part.keyframes.contains(&(**id as usize));
        self.ids.iter().filter(is_its).count()
    }

    /// The identity that a keyframe of a part has in this component, if it is here.
    fn renamed(&self, part: &Part, keyframe: u32) -> Option<u32> {
        let before = KeyframeId::try_from(part.keyframes.start).ok()? + keyframe;
        self.ids.binary_search(&before).ok().map(|id| id as u32)
    }
}

/// The components of a merged map, the largest first.
pub fn components(merged: &StoredMap, parts: &[Part]) -> Vec<Component> {
    let mut fragments: Vec<FragmentId> = merged.keyframes.iter().map(|k| k.fragment).collect();
    fragments.sort_unstable();
    fragments.dedup();
    let component = |fragment: FragmentId| {
        let (map, ids) = merged.fragment(fragment);
        Component {
            place: String::new(),
            map,
            ids,
            world_of: Some(fragment as usize).filter(|index| *index < parts.len()),
        }
    };
    let mut components: Vec<Component> = fragments.into_iter().map(component).collect();
    // stable: of two that are as large the one with the earlier fragment is first
    components.sort_by_key(|component| std::cmp::Reverse(component.ids.len()));
    for (number, apart) in components.iter_mut().enumerate().skip(1) {
        apart.place = format!("apart_{number}/");
    }
    components
}

/// Writes the recording of a component, its frame and the paths of the cameras in it.
pub fn write_component(
    folder: &OutputFolder,
    component: &Component,
    parts: &[Part],
) -> Result<Written, Failure> {
    let place = &component.place;
    let reference = component.world_of.map(|index| &parts[index]);
    let counts = parts
        .iter()
        .map(|part| (part.number, component.num_of(part)));
    let recordings: Vec<(usize, usize)> = counts.filter(|(_, count)| *count > 0).collect();
    let is_metric = reference.is_some_and(Part::is_metric);
    let scale = if is_metric { "metric" } else { "arbitrary" };
    let frames = frames(component, parts);
    write_recording(folder, component, reference, parts, &frames)?;
    let frame_file = format!("{place}{MAP_FROM_WORLD}");
    let write_facts = |facts: &Value| folder.write(&format!("{place}{SUMMARY}"), facts.to_string());
    let known = reference.and_then(|part| part.earlier.frame.as_ref());
    if let Some(Align::Map { map_from_world, .. }) = known {
        let frame = reference.map(|part| &part.summary["frame"]);
        write_facts(&json!({ "scale": scale, "frame": frame }))?;
        folder.write(&frame_file, format_sim3(map_from_world))?;
    }
    let recording = folder.path().join(format!("{place}{RECORDING}"));
    let frame = Recorded::read(&recording, &Align::Level(Up::Scene))?.frame;
    folder.write(&frame_file, format_sim3(&frame.map_from_world))?;
    let path = write_paths(folder, component, &frames, &frame, parts)?;
    let [up, floor, surface] = match reference.filter(|_| known.is_some()) {
        Some(part) => ["up", "floor", "level_surface"].map(|key| part.summary[key].clone()),
        None => [
            json!(frame.up),
            json!(frame.floor),
            json!(frame.level_surface),
        ],
    };
    let facts = json!({
        "scale": scale, "frame": frame.description, "up": up, "floor": floor,
        "level_surface": surface,
    });
    write_facts(&facts)?;
    Ok(Written {
        place: place.clone(),
        recordings,
        path,
        facts,
    })
}

/// What holds for the recording of a component. Its camera is that of its first keyframe.
fn session(component: &Component, reference: Option<&Part>, parts: &[Part]) -> SessionInfo {
    let first = &component.map.keyframes[0];
    let camera = camera_of(first);
    let sources = parts.iter().filter(|part| component.num_of(part) > 0);
    let sources: Vec<&str> = sources.map(|p| p.earlier.session.source.as_str()).collect();
    let of = &reference.unwrap_or(&parts[0]).earlier.session;
    SessionInfo {
        pinhole: camera.pinhole,
        width: camera.width,
        height: camera.height,
        scale: reference.map_or(Scale::Arbitrary, |part| part.earlier.session.scale),
        source: sources.join(" + "),
        ..of.clone()
    }
}

fn camera_of(stored: &StoredKeyframe) -> RecordedCamera {
    let (width, height) = stored.keyframe.size();
    RecordedCamera {
        pinhole: stored.pinhole,
        width,
        height,
    }
}

/// The sessions of all parts, with the first keyframe of each in the component.
fn sessions(component: &Component, parts: &[Part]) -> Vec<RecordedSession> {
    let mut sessions = Vec::new();
    for part in parts {
        sessions.extend(part.earlier.sessions.iter().map(|session| {
            let before = part.keyframes.start + session.first_keyframe as usize;
            let first = component.ids.partition_point(|id| (*id as usize) < before);
            RecordedSession {
                source: session.source.clone(),
                first_keyframe: first as u32,
            }
        }));
    }
    sessions
}

/// The frames of all parts that are known relative to keyframes of the component.
fn frames(component: &Component, parts: &[Part]) -> Vec<RecordedFrame> {
    let mut frames = Vec::new();
    for (part, sessions) in with_sessions(parts) {
        frames.extend(part.earlier.frames.iter().filter_map(|frame| {
            Some(RecordedFrame {
                session: sessions.start + frame.session,
                keyframe: component.renamed(part, frame.keyframe)?,
                ..*frame
            })
        }));
    }
    frames
}

/// Every part with the numbers that its sessions have among those of all parts.
fn with_sessions(parts: &[Part]) -> impl Iterator<Item = (&Part, Range<u32>)> {
    parts.iter().scan(0, |next, part| {
        let first = *next;
        *next += part.earlier.sessions.len() as u32;
        Some((part, first..*next))
    })
}

fn write_recording(
    folder: &OutputFolder,
    component: &Component,
    reference: Option<&Part>,
    parts: &[Part],
    frames: &[RecordedFrame],
) -> Result<(), Failure> {
    let doing = "the recording cannot be written";
    let name = &format!("{}{RECORDING}", component.place);
    let session = &session(component, reference, parts);
    let mut writer = RecordingWriter::create(&folder.begin(name)?, session).while_running(doing)?;
    let keyframes = &component.map.keyframes;
    for (stored, before) in keyframes.iter().zip(&component.ids) {
        let camera = Some(camera_of(stored)).filter(|camera| *camera != session.camera());
        let record = keyframe_record(&stored.keyframe, camera);
        writer.append_keyframe(record).while_running(doing)?;
        if let Some(jpeg) = colour(parts, *before) {
            let keyframe_id = stored.keyframe.id;
            let record = Record::Colour(ColourRecord { keyframe_id, jpeg });
            writer.append(&record).while_running(doing)?;
        }
    }
    let pose = |stored: &StoredKeyframe| (stored.keyframe.id, stored.world_from_keyframe);
    let poses = PoseSnapshot {
        revision: component.map.pose_revision,
        poses: keyframes.iter().map(pose).collect(),
    };
    writer.append_poses(poses).while_running(doing)?;
    let sessions = sessions(component, parts);
    let continuation = continuation_of(&component.map, sessions, frames.to_vec());
    let continuation = Record::Continuation(continuation);
    writer.append(&continuation).while_running(doing)?;
    let end = EndRecord {
        num_frames: frames.len() as u64,
        num_tracked: frames.len() as u64,
        summary: String::new(),
    };
    writer.finish(end).while_running(doing)?;
    folder.list(name, Content::Whole)
}

/// The colour of a keyframe by the identity that it had side by side with all others.
fn colour(parts: &[Part], id: KeyframeId) -> Option<Vec<u8>> {
    let index = id as usize;
    let part = parts.iter().find(|part| part.keyframes.contains(&index))?;
    let own = index - part.keyframes.start;
    let jpeg = part.earlier.colours.jpeg(own as KeyframeId);
    jpeg.map(<[u8]>::to_vec)
}

/// Writes `trajectory.txt` and, of each recording, `trajectory_N.txt`, in the frame of the results;
/// the positions of all frames, or of the keyframes of recordings that know no frames.
fn write_paths(
    folder: &OutputFolder,
    component: &Component,
    frames: &[RecordedFrame],
    frame: &MapFrame,
    parts: &[Part],
) -> Result<Vec<[f64; 3]>, Failure> {
    let place = &component.place;
    let posed = |recorded: &RecordedFrame| {
        let keyframe = &component.map.keyframes[recorded.keyframe as usize];
        let pose = tracked_frame(recorded).world_from_camera(&keyframe.world_from_keyframe);
        TimedPose {
            timestamp_ns: recorded.timestamp_ns,
            world_from_camera: in_map(&frame.map_from_world, &pose),
        }
    };
    let mut all: Vec<TimedPose> = Vec::with_capacity(frames.len());
    for (part, sessions) in with_sessions(parts) {
        let of_part = frames.iter().filter(|f| sessions.contains(&f.session));
        let poses: Vec<TimedPose> = of_part.map(posed).collect();
        if !poses.is_empty() {
            let name = format!("{place}trajectory_{}.txt", part.number);
            folder.write(&name, format_tum(&poses))?;
        }
        all.extend(poses);
    }
    // stable: frames of the same time stay in the order of the recordings
    all.sort_by_key(|pose| pose.timestamp_ns);
    if all.is_empty() {
        let keyframes = component.map.keyframes.iter();
        let centre = |k: &StoredKeyframe| frame.map_from_world * k.world_from_keyframe;
        return Ok(keyframes.map(|k| centre(k).translation.into()).collect());
    }
    folder.write(&format!("{place}trajectory.txt"), format_tum(&all))?;
    Ok(path_of(&all))
}
