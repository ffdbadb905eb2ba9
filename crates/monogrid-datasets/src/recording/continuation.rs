//! What a later session needs to go on where a run ended, beside keyframes and poses.

use super::format::{Bytes, numbers_of_pose, pose_of_numbers};
use crate::bytes::Input;
use crate::pose_from_numbers;
use monogrid_geometry::{Se3, Sim3};

/// Everything of a finished run that keyframes, depth and poses do not say.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Continuation {
    /// The runs that made the map, the first one first.
    pub sessions: Vec<RecordedSession>,
    /// One per keyframe.
    pub keyframes: Vec<KeyframeLink>,
    /// Constraints between keyframes.
    pub edges: Vec<RecordedEdge>,
    /// Points that several keyframes see.
    pub points: Vec<RecordedPoint>,
    /// Frames with a believed pose, session by session.
    pub frames: Vec<RecordedFrame>,
    /// Keyframes that are not in the main map, and therefore have no recorded pose.
    pub fragments: Vec<FragmentKeyframe>,
}

/// A keyframe of a fragment that was not joined to the main map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FragmentKeyframe {
    /// The keyframe.
    pub keyframe: u32,
    /// The fragment, from 1.
    pub fragment: u32,
    /// Pose and unit in the world of the fragment.
    pub fragment_from_keyframe: Sim3,
}

/// One run.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct RecordedSession {
    /// Name of its source.
    pub source: String,
    /// First keyframe that it made; later ones up to the next session's are its too.
    pub first_keyframe: u32,
}

/// How a keyframe came about.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KeyframeLink {
    /// The keyframe.
    pub id: u32,
    /// Keyframe that it was tracked on; none for the first.
    pub parent: Option<u32>,
    /// `I_keyframe = gain * I_first + bias`.
    pub gain: f64,
    /// See [`Self::gain`].
    pub bias: f64,
}

/// An edge of the keyframe graph.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecordedEdge {
    /// Older keyframe.
    pub i: u32,
    /// Newer keyframe.
    pub j: u32,
    /// 0 tracked motion, 1 common points, 2 direct alignment.
    pub kind: u8,
    /// Robust kernel: 0 none, 1 Huber, 2 Cauchy, 3 dynamic covariance scaling.
    pub kernel: u8,
    /// Parameter of the kernel.
    pub kernel_parameter: f64,
    /// Measured relative pose.
    pub i_from_j: Sim3,
    /// Upper triangle of the information of a left update `[v, w, s]`, row by row.
    pub information: [f64; 28],
}

/// A point of the sparse layer.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedPoint {
    /// Keyframe in which it is anchored.
    pub host: u32,
    /// Its pixel there.
    pub pixel: [f64; 2],
    /// Inverse depth there, the one it was created with and the standard deviation of that, 1 /
    /// world units.
    pub idepth: [f64; 3],
    /// Other keyframes that see it, and where.
    pub observations: Vec<(u32, [f64; 2])>,
}

/// A frame with a believed pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecordedFrame {
    /// Session, from 0.
    pub session: u32,
    /// Index in the source of its session.
    pub frame_index: u64,
    /// Time, nanoseconds.
    pub timestamp_ns: i64,
    /// Keyframe that it is known relative to.
    pub keyframe: u32,
    /// Pose, translation in the units of the keyframe.
    pub keyframe_from_frame: Se3,
}

impl Continuation {
    /// Drops what names a keyframe that does not exist, a pixel outside its image, or a measurement
    /// without content; returns how much. `size_of` says the width and height of the image of a
    /// keyframe that exists.
    pub(super) fn drop_invalid(
        &mut self,
        size_of: impl Fn(u32) -> Option<(usize, usize)>,
    ) -> usize {
        let exists = |id: u32| size_of(id).is_some();
        let is_inside = |id: u32, [x, y]: [f64; 2]| {
            size_of(id).is_some_and(|(width, height)| {
                (0.0..width as f64).contains(&x) && (0.0..height as f64).contains(&y)
            })
        };
        let count = |c: &Self| {
            c.keyframes.len() + c.edges.len() + c.points.len() + c.frames.len() + c.fragments.len()
        };
        let before = count(self);
        let num_sessions = self.sessions.len();
        self.keyframes
            .retain(|k| exists(k.id) && k.parent.is_none_or(|parent| parent < k.id));
        self.edges.retain(|edge| {
            exists(edge.i)
                && exists(edge.j)
                && edge.i != edge.j
                && edge.i_from_j.is_finite()
                && edge.kernel_parameter >= 0.0
        });
        self.points.retain(|point| {
            let [idepth, _, sigma] = point.idepth;
            let mut observations = point.observations.iter();
            is_inside(point.host, point.pixel)
                && idepth > 0.0
                && sigma > 0.0
                && observations.all(|(id, pixel)| is_inside(*id, *pixel))
        });
        self.frames
            .retain(|f| exists(f.keyframe) && (f.session as usize) < num_sessions);
        self.fragments.retain(|member| exists(member.keyframe));
        before - count(self)
    }
}

const NO_PARENT: u32 = u32::MAX;

pub(super) fn encode(record: &Continuation, out: &mut Bytes) -> Option<()> {
    out.count(record.sessions.len())?;
    for session in &record.sessions {
        out.blob(session.source.as_bytes())?;
        out.u32(session.first_keyframe);
    }
    out.count(record.keyframes.len())?;
    for keyframe in &record.keyframes {
        out.u32(keyframe.id);
        out.u32(keyframe.parent.unwrap_or(NO_PARENT));
        out.f64(keyframe.gain);
        out.f64(keyframe.bias);
    }
    out.count(record.edges.len())?;
    for edge in &record.edges {
        out.u32(edge.i);
        out.u32(edge.j);
        out.0.extend([edge.kind, edge.kernel]);
        out.f64(edge.kernel_parameter);
        out.numbers(numbers_of_pose(&edge.i_from_j));
        out.numbers(edge.information);
    }
    out.count(record.points.len())?;
    for point in &record.points {
        out.u32(point.host);
        out.numbers(point.pixel);
        out.numbers(point.idepth);
        out.count(point.observations.len())?;
        for (keyframe, pixel) in &point.observations {
            out.u32(*keyframe);
            out.numbers(*pixel);
        }
    }
    out.count(record.frames.len())?;
    for frame in &record.frames {
        out.u32(frame.session);
        out.u64(frame.frame_index);
        out.u64(frame.timestamp_ns as u64);
        out.u32(frame.keyframe);
        let [_, rigid @ ..] = numbers_of_pose(&frame.keyframe_from_frame.with_scale(1.0));
        out.numbers(rigid);
    }
    out.count(record.fragments.len())?;
    for member in &record.fragments {
        out.u32(member.keyframe);
        out.u32(member.fragment);
        out.numbers(numbers_of_pose(&member.fragment_from_keyframe));
    }
    Some(())
}

pub(super) fn decode(input: &mut Input) -> Option<Continuation> {
    Some(Continuation {
        sessions: input.list(|input| {
            Some(RecordedSession {
                source: input.text()?,
                first_keyframe: input.u32()?,
            })
        })?,
        keyframes: input.list(|input| {
            Some(KeyframeLink {
                id: input.u32()?,
                parent: Some(input.u32()?).filter(|id| *id != NO_PARENT),
                gain: input.finite()?,
                bias: input.finite()?,
            })
        })?,
        edges: input.list(decode_edge)?,
        points: input.list(|input| {
            Some(RecordedPoint {
                host: input.u32()?,
                pixel: input.finites()?,
                idepth: input.finites()?,
                observations: input.list(|input| Some((input.u32()?, input.finites()?)))?,
            })
        })?,
        frames: input.list(|input| {
            Some(RecordedFrame {
                session: input.u32()?,
                frame_index: input.u64()?,
                timestamp_ns: input.u64()? as i64,
                keyframe: input.u32()?,
                keyframe_from_frame: pose_from_numbers(&input.finites::<7>()?)?,
            })
        })?,
        // earlier versions end here
        fragments: match input.is_empty() {
            true => Vec::new(),
            false => input.list(|input| {
                Some(FragmentKeyframe {
                    keyframe: input.u32()?,
                    fragment: input.u32()?,
                    fragment_from_keyframe: pose_of_numbers(&input.finites()?)?,
                })
            })?,
        },
    })
}

fn decode_edge(input: &mut Input) -> Option<RecordedEdge> {
    Some(RecordedEdge {
        i: input.u32()?,
        j: input.u32()?,
        kind: input.u8()?,
        kernel: input.u8()?,
        kernel_parameter: input.finite()?,
        i_from_j: {
            // one whose scale is none is dropped alone, not with all of the others
            let [scale, rigid @ ..] = input.finites::<8>()?;
            pose_from_numbers(&rigid)?.with_scale(scale)
        },
        information: input.finites()?,
    })
}
