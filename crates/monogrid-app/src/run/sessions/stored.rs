//! Maps as a recording holds them and as the library takes them.

use crate::process::failure::Failure;
use monogrid_datasets::{
    Continuation, KeyframeLink, RecordedEdge, RecordedFrame, RecordedKeyframe, RecordedPoint,
    Recording,
};
use monogrid_geometry::Mat7;
use monogrid_graph::RobustKernel;
use monogrid_graph::pose_graph::GraphEdge;
use monogrid_slam::{
    EdgeKind, Keyframe, KeyframeId, MAIN_MAP, Scale, StoredEdge, StoredKeyframe, StoredMap,
    StoredPoint, TrackedFrame,
};
use std::path::Path;

/// The map of a recording. Keyframes at its end without a pose (the run was killed) are left out,
/// and so are all after one of a fragment whose run was killed.
pub(super) fn stored_map(
    recording: &Recording,
    continuation: &Continuation,
    file: &Path,
) -> Result<StoredMap, Failure> {
    let links = |id: u32| continuation.keyframes.iter().find(|link| link.id == id);
    let mut keyframes = Vec::with_capacity(recording.keyframes.len());
    for recorded in &recording.keyframes {
        let mut members = continuation.fragments.iter();
        let member = members.find(|m| m.keyframe == recorded.id);
        let in_fragment = member.map(|m| (m.fragment, m.fragment_from_keyframe));
        let in_main_map = recorded.world_from_keyframe.map(|pose| (MAIN_MAP, pose));
        let Some((fragment, world_from_keyframe)) = in_fragment.or(in_main_map) else {
            break;
        };
        let Some(keyframe) = keyframe(recorded) else {
            return Err(Failure::input(format!(
                "{}: keyframe {} has no image, without which the camera cannot be recognised",
                file.display(),
                recorded.id
            )));
        };
        let link = links(recorded.id).copied().unwrap_or(KeyframeLink {
            id: recorded.id,
            parent: recorded.id.checked_sub(1),
            gain: 1.0,
            bias: 0.0,
        });
        keyframes.push(StoredKeyframe {
            keyframe,
            pinhole: recorded.camera.pinhole,
            fragment,
            world_from_keyframe,
            parent: link.parent,
            gain: link.gain,
            bias: link.bias,
        });
    }
    let map = StoredMap {
        scale: match recording.session.scale {
            monogrid_datasets::Scale::Metric => Scale::Metric,
            monogrid_datasets::Scale::Arbitrary => Scale::Arbitrary,
        },
        pose_revision: recording.pose_revision.unwrap_or(0),
        keyframes,
        edges: continuation.edges.iter().filter_map(stored_edge).collect(),
        points: continuation.points.iter().map(stored_point).collect(),
    };
    map.check_keyframes()
        .map_err(|error| Failure::input(format!("{}: {error}", file.display())))?;
    Ok(map)
}

fn keyframe(recorded: &RecordedKeyframe) -> Option<Keyframe> {
    Some(Keyframe {
        id: recorded.id,
        frame_index: recorded.frame_index as usize,
        timestamp_ns: recorded.timestamp_ns,
        revision: recorded.depth_revision,
        image: recorded.image.clone()?,
        pixels: recorded.pixels.clone(),
    })
}

/// An edge; `None` for kinds of a later version.
fn stored_edge(recorded: &RecordedEdge) -> Option<StoredEdge> {
    let kind = match recorded.kind {
        0 => EdgeKind::Odometry,
        1 => EdgeKind::Sparse,
        2 => EdgeKind::Direct,
        _ => return None,
    };
    let parameter = recorded.kernel_parameter;
    let kernel = match recorded.kernel {
        0 => RobustKernel::None,
        1 => RobustKernel::Huber { delta: parameter },
        2 => RobustKernel::Cauchy { scale: parameter },
        3 => RobustKernel::DynamicCovariance { phi: parameter },
        _ => return None,
    };
    let mut information = Mat7::zeros();
    for (value, (row, column)) in recorded.information.into_iter().zip(upper_half()) {
        information[(row, column)] = value;
        information[(column, row)] = value;
    }
    Some(StoredEdge {
        kind,
        edge: GraphEdge {
            i: recorded.i.into(),
            j: recorded.j.into(),
            i_from_j: recorded.i_from_j,
            information,
            kernel,
        },
    })
}

/// Rows and columns of an information matrix in the order in which recordings hold them.
fn upper_half() -> impl Iterator<Item = (usize, usize)> {
    (0..7).flat_map(|row| (row..7).map(move |column| (row, column)))
}

pub(super) fn recorded_edge(stored: &StoredEdge) -> RecordedEdge {
    let edge = &stored.edge;
    let (kernel, kernel_parameter) = match edge.kernel {
        RobustKernel::None => (0, 0.0),
        RobustKernel::Huber { delta } => (1, delta),
        RobustKernel::Cauchy { scale } => (2, scale),
        RobustKernel::DynamicCovariance { phi } => (3, phi),
        // one that the format does not know
        _ => (0, 0.0),
    };
    let mut information = [0.0; 28];
    for (value, at) in information.iter_mut().zip(upper_half()) {
        *value = edge.information[at];
    }
    RecordedEdge {
        i: edge.i as u32,
        j: edge.j as u32,
        kind: match stored.kind {
            EdgeKind::Odometry => 0,
            EdgeKind::Sparse => 1,
            EdgeKind::Direct => 2,
        },
        kernel,
        kernel_parameter,
        i_from_j: edge.i_from_j,
        information,
    }
}

fn stored_point(recorded: &RecordedPoint) -> StoredPoint {
    let [idepth, prior, sigma] = recorded.idepth;
    StoredPoint {
        host: recorded.host,
        pixel: recorded.pixel,
        idepth,
        prior: [prior, sigma],
        observations: recorded.observations.clone(),
    }
}

pub(super) fn recorded_point(stored: &StoredPoint) -> RecordedPoint {
    RecordedPoint {
        host: stored.host,
        pixel: stored.pixel,
        idepth: [stored.idepth, stored.prior[0], stored.prior[1]],
        observations: stored.observations.clone(),
    }
}

/// A frame of an earlier session as the library has it.
pub fn tracked_frame(recorded: &RecordedFrame) -> TrackedFrame {
    TrackedFrame {
        frame_index: recorded.frame_index as usize,
        timestamp_ns: recorded.timestamp_ns,
        keyframe: recorded.keyframe as KeyframeId,
        keyframe_from_frame: recorded.keyframe_from_frame,
    }
}
