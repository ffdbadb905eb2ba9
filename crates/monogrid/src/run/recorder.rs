//! What is saved while a run goes on: the recording and the pictures of keyframes.

use super::change::Change;
use crate::failure::{Classify, Failure};
use crate::keyframe_pixels::to_recorded;
use crate::output::{Content, OutputFolder};
use crate::picture::keyframe::{Measured, depth_picture, uncertainty_picture};
use crate::usage::thread_cpu;
use monogrid_datasets::{
    Continuation, DepthRevision, KeyframeRecord, PoseSnapshot, Record, RecordingWriter,
    SessionInfo, encode_png, encode_png_rgb,
};
use monogrid_slam::Keyframe;
use std::sync::mpsc::Receiver;
use std::time::Duration;

/// Name of the recording.
pub const RECORDING: &str = "recording.mgk";
/// Folder with pictures of the keyframes.
pub const KEYFRAME_FOLDER: &str = "keyframes";

/// Writes every change until the channel closes; returns the CPU time used.
///
/// After an error the changes are still received, so that nobody waits for this thread.
pub fn record(
    changes: &Receiver<Change>,
    folder: &OutputFolder,
    session: &SessionInfo,
) -> Result<Duration, Failure> {
    let mut result = start(folder, session);
    for change in changes {
        if let Ok(writer) = &mut result
            && let Err(failure) = save(writer, folder, &change)
        {
            result = Err(failure);
        }
    }
    result.map(|_| thread_cpu())
}

fn start(folder: &OutputFolder, session: &SessionInfo) -> Result<Option<RecordingWriter>, Failure> {
    let writer = RecordingWriter::create(&folder.begin(RECORDING)?, session)
        .while_running("the recording cannot be written")?;
    folder.list(RECORDING, Content::Begins)?;
    Ok(Some(writer))
}

fn save(
    writer: &mut Option<RecordingWriter>,
    folder: &OutputFolder,
    change: &Change,
) -> Result<(), Failure> {
    const DOING: &str = "the recording cannot be written";
    let Some(open) = writer else {
        return Ok(());
    };
    match change {
        Change::Finished(keyframe, snapshot) => {
            open.append_keyframe(KeyframeRecord {
                id: keyframe.id,
                frame_index: keyframe.frame_index as u64,
                timestamp_ns: keyframe.timestamp_ns,
                image: Some(keyframe.image.clone()),
                pixels: to_recorded(&keyframe.pixels),
            })
            .while_running(DOING)?;
            open.append_poses(poses(snapshot)).while_running(DOING)?;
            save_pictures(folder, keyframe)
        }
        Change::Revised(keyframe) => {
            open.append_depth(DepthRevision {
                keyframe_id: keyframe.id,
                revision: keyframe.revision,
                pixels: to_recorded(&keyframe.pixels),
            })
            .while_running(DOING)?;
            save_pictures(folder, keyframe)
        }
        // poses are recorded with the next keyframe, or at the end
        Change::Moved(_) => Ok(()),
        Change::End(snapshot, continuation, end) => {
            open.append_poses(poses(snapshot)).while_running(DOING)?;
            let continuation = Record::Continuation(Continuation::clone(continuation));
            open.append(&continuation).while_running(DOING)?;
            match writer.take() {
                Some(open) => {
                    open.finish(end.clone()).while_running(DOING)?;
                    folder.list(RECORDING, Content::Whole)
                }
                None => Ok(()),
            }
        }
    }
}

/// Poses of the keyframes of the main map: nothing else has a place in a map.
fn poses(snapshot: &monogrid_slam::PoseSnapshot) -> PoseSnapshot {
    PoseSnapshot {
        revision: snapshot.revision,
        poses: (0u32..)
            .zip(snapshot.world_from_keyframe.iter().copied())
            .filter(|(id, _)| snapshot.in_main_map(*id).is_some())
            .collect(),
    }
}

/// File names of the three pictures of a keyframe.
fn picture_names(id: u32) -> [String; 3] {
    ["image", "depth", "uncertainty"].map(|kind| format!("{KEYFRAME_FOLDER}/{id:05}_{kind}.png"))
}

fn save_pictures(folder: &OutputFolder, keyframe: &Keyframe) -> Result<(), Failure> {
    let measured: Vec<Measured> = measured(keyframe).collect();
    let [image, depth, uncertainty] = picture_names(keyframe.id);
    folder.write(&image, encode_png(&keyframe.image))?;
    folder.write(
        &depth,
        encode_png_rgb(&depth_picture(&keyframe.image, &measured)),
    )?;
    folder.write(
        &uncertainty,
        encode_png_rgb(&uncertainty_picture(&keyframe.image, &measured)),
    )
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
