//! What of a recording is worth delivering.

use super::AgentError;
use crate::packet::{PackedKeyframe, PackedRevision, Packet, parts_of};
use crate::packet_log::PacketLog;
use monogrid_datasets::{DepthPixel, DepthRevision, PoseSnapshot, Record};
use monogrid_geometry::{Sim3, rotation_log};
use std::collections::BTreeMap;

/// New depth of a keyframe is delivered when at least this share of its pixels is new or more than
/// a sigma from what was delivered.
const MIN_CHANGED_PIXELS: f64 = 0.25;
/// A new pose is delivered when it differs from the one that was by at least this: rad, units of
/// the keyframe, or share of its unit. At the end of a run all poses are delivered exactly.
const MIN_MOVED: f64 = 1e-3;

/// A pose that is new.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NewestPose {
    /// The newest keyframe that has a pose.
    pub keyframe: u32,
    /// Time of its frame, nanoseconds.
    pub timestamp_ns: i64,
    /// Its pose in the world of the run.
    pub world_from_keyframe: Sim3,
}

/// Makes packets of the records of one run, in their order. The same records give the same packets.
#[derive(Debug)]
pub struct Packer {
    jpeg_quality: u8,
    keyframes: BTreeMap<u32, Known>,
    /// The newest poses, which the end of the run makes exact.
    newest: Option<PoseSnapshot>,
}

/// What was delivered of a keyframe.
#[derive(Debug)]
struct Known {
    timestamp_ns: i64,
    /// Width and height of its image, px.
    size: (u16, u16),
    /// Number of the packet with its depth.
    depth: u64,
    pose: Option<Sim3>,
}

impl Packer {
    /// Before the first record; images of keyframes become JPEG of this quality, 1 to 100.
    #[must_use]
    pub fn new(jpeg_quality: u8) -> Self {
        Self {
            jpeg_quality,
            keyframes: BTreeMap::new(),
            newest: None,
        }
    }

    /// Appends to the log what of a record is worth delivering.
    ///
    /// # Errors
    /// When the record cannot be packed, or the log not be written.
    pub fn pack(&mut self, record: &Record, log: &mut PacketLog) -> Result<(), AgentError> {
        match record {
            Record::Keyframe(keyframe) => {
                let packed = PackedKeyframe::pack(keyframe, self.jpeg_quality)?;
                let known = Known {
                    timestamp_ns: keyframe.timestamp_ns,
                    size: packed.size,
                    depth: append(Packet::Keyframe(packed), log)?,
                    pose: None,
                };
                self.keyframes.insert(keyframe.id, known);
            }
            Record::Depth(revision) => self.pack_revision(revision, log)?,
            Record::Poses(poses) => {
                self.newest = Some(poses.clone());
                self.pack_poses(poses, MIN_MOVED, log)?;
            }
            Record::Continuation(_) => {
                if let Some(newest) = self.newest.take() {
                    self.pack_poses(&newest, 0.0, log)?;
                    self.newest = Some(newest);
                }
                append_parts(record, log)?;
            }
            Record::Session(_) | Record::End(_) => append_parts(record, log)?,
            // for people only, and as large as all the rest
            Record::Colour(_) => {}
        }
        Ok(())
    }

    /// Where the newest keyframe with a pose is.
    #[must_use]
    pub fn newest_pose(&self) -> Option<NewestPose> {
        let poses = &self.newest.as_ref()?.poses;
        let (keyframe, world_from_keyframe) = *poses.iter().max_by_key(|(id, _)| *id)?;
        Some(NewestPose {
            keyframe,
            timestamp_ns: self.keyframes.get(&keyframe)?.timestamp_ns,
            world_from_keyframe,
        })
    }

    fn pack_revision(
        &mut self,
        revision: &DepthRevision,
        log: &mut PacketLog,
    ) -> Result<(), AgentError> {
        let Some(known) = self.keyframes.get_mut(&revision.keyframe_id) else {
            return Ok(());
        };
        let before = log.read(known.depth)?.unwrap_or_default();
        let before = match Packet::decode(&before)? {
            Packet::Keyframe(keyframe) => keyframe.depth.unpack(keyframe.size)?,
            Packet::Depth(depth) => depth.unpack()?.pixels,
            Packet::Record(_) => Vec::new(),
        };
        if changed_share(&before, &revision.pixels) >= MIN_CHANGED_PIXELS {
            let packed = PackedRevision::pack(revision, known.size);
            known.depth = append(Packet::Depth(packed), log)?;
        }
        Ok(())
    }

    fn pack_poses(
        &mut self,
        poses: &PoseSnapshot,
        min_moved: f64,
        log: &mut PacketLog,
    ) -> Result<(), AgentError> {
        let mut moved = Vec::new();
        for (id, pose) in &poses.poses {
            let Some(known) = self.keyframes.get_mut(id) else {
                continue;
            };
            let told = known.pose;
            if told.is_none_or(|told| distance(&told, pose) > min_moved) {
                known.pose = Some(*pose);
                moved.push((*id, *pose));
            }
        }
        if moved.is_empty() {
            return Ok(());
        }
        let (revision, poses) = (poses.revision, moved);
        append_parts(&Record::Poses(PoseSnapshot { revision, poses }), log)
    }
}

fn append(packet: Packet, log: &mut PacketLog) -> Result<u64, AgentError> {
    Ok(log.append(&packet.encode()?)?)
}

fn append_parts(record: &Record, log: &mut PacketLog) -> Result<(), AgentError> {
    for part in parts_of(record)? {
        append(part, log)?;
    }
    Ok(())
}

/// How far a pose is from another one: the largest of angle (rad), way (units of the keyframe) and
/// change of the unit (share).
fn distance(a: &Sim3, b: &Sim3) -> f64 {
    let a_from_b = a.inverse() * *b;
    let angle = rotation_log(&a_from_b.rotation).norm();
    let way = a_from_b.translation.norm();
    angle.max(way).max(a_from_b.scale.ln().abs())
}

/// Share of the pixels after a change, and of those that are gone, that are new, gone or differ by
/// more than a sigma. Both are row by row.
fn changed_share(before: &[DepthPixel], after: &[DepthPixel]) -> f64 {
    let at = |pixel: &DepthPixel| (pixel.y, pixel.x);
    let known: BTreeMap<(u16, u16), &DepthPixel> = before.iter().map(|p| (at(p), p)).collect();
    let is_same = |pixel: &&DepthPixel| {
        known.get(&at(pixel)).is_some_and(|known| {
            let difference = known.idepth - pixel.idepth;
            difference * difference <= pixel.idepth_var
        })
    };
    let shared = after.iter().filter(|p| known.contains_key(&at(p))).count();
    let all = after.len() + before.len() - shared;
    let same = after.iter().filter(is_same).count();
    (all - same) as f64 / all.max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::{Rotation, Vec3};

    fn pixels(idepths: &[f32]) -> Vec<DepthPixel> {
        let pixel = |(x, idepth): (u16, &f32)| DepthPixel {
            x,
            y: 3,
            idepth: *idepth,
            idepth_var: 0.01,
        };
        (0..).zip(idepths).map(pixel).collect()
    }

    #[test]
    fn a_change_is_what_is_new_gone_or_beyond_a_sigma() {
        let before = pixels(&[1.0, 1.0, 1.0, 1.0]);
        assert_eq!(changed_share(&before, &before), 0.0);
        // one within a sigma of 0.1, one beyond it
        assert_eq!(
            changed_share(&before, &pixels(&[1.09, 1.11, 1.0, 1.0])),
            0.25
        );
        assert_eq!(changed_share(&before, &pixels(&[1.0, 1.0])), 0.5);
        assert_eq!(changed_share(&pixels(&[1.0, 1.0]), &before), 0.5);
        assert_eq!(changed_share(&[], &[]), 0.0);
    }

    #[test]
    fn a_pose_moves_by_angle_way_or_unit() {
        let pose = |scale: f64, angle: f64, way: f64| {
            let rotation = Rotation::new(Vec3::new(0.0, angle, 0.0));
            Sim3::new(scale, rotation, Vec3::new(way, 0.0, 0.0))
        };
        let at = pose(2.0, 0.0, 1.0);
        assert!((distance(&at, &pose(2.0, 0.1, 1.0)) - 0.1).abs() < 1e-12);
        // half a unit of the world is a quarter of the keyframe's
        assert!((distance(&at, &pose(2.0, 0.0, 1.5)) - 0.25).abs() < 1e-12);
        assert!((distance(&at, &pose(2.2, 0.0, 1.0)) - 1.1_f64.ln()).abs() < 1e-12);
    }
}
