//! Where the camera itself was: space that is free without being seen.

use monogrid_geometry::Sim3;
use monogrid_slam::{KeyframeId, TrackedFrame};

/// The paths of the camera in the frame of a map, one for each stretch of consecutive frames.
/// `world_from_keyframe` says where keyframes are; frames of those that it does not know (fragments
/// that are apart) are left out.
#[must_use]
pub fn camera_paths<'a>(
    frames: &[TrackedFrame],
    world_from_keyframe: impl Fn(KeyframeId) -> Option<&'a Sim3>,
    map_from_world: &Sim3,
) -> Vec<Vec<[f64; 3]>> {
    // frames may be taken several apart
    let steps = frames
        .windows(2)
        .map(|pair| pair[1].frame_index.wrapping_sub(pair[0].frame_index));
    let stride = steps.filter(|step| *step > 0).min().unwrap_or(1);
    let mut paths: Vec<Vec<[f64; 3]>> = Vec::new();
    let mut next_index = None;
    for frame in frames {
        let Some(keyframe) = world_from_keyframe(frame.keyframe) else {
            next_index = None;
            continue;
        };
        let centre = *map_from_world * frame.world_from_camera(keyframe).translation;
        match paths.last_mut() {
            Some(path) if next_index == Some(frame.frame_index) => path.push(centre.into()),
            _ => paths.push(vec![centre.into()]),
        }
        next_index = Some(frame.frame_index + stride);
    }
    paths
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::{Rotation, Se3, Vec3};

    #[test]
    fn paths_end_where_frames_are_missing_or_their_place_is_unknown() {
        let frame = |frame_index: usize, keyframe: u32, x: f64| TrackedFrame {
            frame_index,
            timestamp_ns: 0,
            keyframe,
            keyframe_from_frame: Se3::new(Rotation::identity(), Vec3::new(x, 0.0, 0.0)),
        };
        // every second frame; one was lost, keyframe 2 is in a fragment; a second session begins at
        // 0 again
        let frames = [
            frame(0, 0, 0.0),
            frame(2, 0, 1.0),
            frame(6, 1, 0.0),
            frame(8, 1, 0.5),
            frame(10, 2, 0.5),
            frame(12, 1, 1.0),
            frame(0, 0, 3.0),
        ];
        let keyframes = [
            Sim3::identity(),
            Sim3::new(2.0, Rotation::identity(), Vec3::new(10.0, 0.0, 0.0)),
        ];
        let map_from_world = Sim3::new(10.0, Rotation::identity(), Vec3::new(0.0, 1.0, 0.0));
        let paths = camera_paths(&frames, |id| keyframes.get(id as usize), &map_from_world);
        let expected: [&[[f64; 3]]; 4] = [
            &[[0.0, 1.0, 0.0], [10.0, 1.0, 0.0]],
            &[[100.0, 1.0, 0.0], [110.0, 1.0, 0.0]],
            &[[120.0, 1.0, 0.0]],
            &[[30.0, 1.0, 0.0]],
        ];
        assert_eq!(paths, expected);
    }
}
