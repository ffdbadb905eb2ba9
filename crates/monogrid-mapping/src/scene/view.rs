//! A keyframe with its depth and its pose, and which others see some of the same.

use crate::KeyframeCamera;
use crate::scene::{Depths, KeptDepths, Scene, Transfer};
use monogrid_geometry::{Sim3, Vec2, Vec3};
use monogrid_occupancy::DepthPixel as Measurement;
use std::sync::Arc;

/// Squares of an image by which is found whether two keyframes see the same: one every so many
/// pixels in both directions, ...
const PROBE_STRIDE_PX: usize = 32;
/// ... with this edge.
const PROBE_PX: usize = 4;
/// Share of those with depth that must be seen by the other keyframe.
const MIN_OVERLAP: f64 = 0.1;

/// A keyframe with its pose.
#[derive(Clone, Debug)]
pub(crate) struct View {
    pub depths: KeptDepths,
    /// Some of the points that it sees, in its frame.
    pub probes: Arc<[Vec3]>,
    pub world_from_keyframe: Sim3,
}

impl View {
    /// From its pixels to those of another one.
    pub fn transfer_to(&self, other: &Self, camera: &KeyframeCamera) -> Transfer {
        Transfer::new(&self.other_from_this(other), camera)
    }

    fn other_from_this(&self, other: &Self) -> Sim3 {
        other.world_from_keyframe.inverse() * self.world_from_keyframe
    }

    /// Share of its depth that lies in the image of another.
    fn overlap(&self, other: &Self, camera: &KeyframeCamera) -> f64 {
        let other_from_this = self.other_from_this(other);
        let is_seen = |probe: &&Vec3| {
            let point = other_from_this * **probe;
            point.z > 1e-9 && {
                let at = camera.pinhole.project(&point);
                camera.contains(&(at + Vec2::new(0.5, 0.5)))
            }
        };
        let seen = self.probes.iter().filter(is_seen).count();
        seen as f64 / self.probes.len().max(1) as f64
    }
}

/// Some of the points that a keyframe sees: the middles of the squares that have depth, at the mean
/// of what was measured in them, else of what was filled in.
pub(crate) fn probes(depths: &Depths, camera: &KeyframeCamera) -> Arc<[Vec3]> {
    let columns = camera.width.div_ceil(PROBE_STRIDE_PX);
    let rows = camera.height.div_ceil(PROBE_STRIDE_PX);
    let mut sums = vec![[(0.0_f32, 0.0_f32); 2]; columns * rows];
    for (kind, pixels) in [&depths.measured, &depths.filled].into_iter().enumerate() {
        for Measurement { x, y, idepth, .. } in pixels {
            let [x, y] = [x, y].map(|at| usize::from(*at));
            if x % PROBE_STRIDE_PX < PROBE_PX && y % PROBE_STRIDE_PX < PROBE_PX {
                let index = y / PROBE_STRIDE_PX * columns + x / PROBE_STRIDE_PX;
                let (sum, count) = &mut sums[index][kind];
                (*sum, *count) = (*sum + idepth, *count + 1.0);
            }
        }
    }
    let middle = |at: usize| (at * PROBE_STRIDE_PX) as f64 + 0.5 * (PROBE_PX as f64 - 1.0);
    let points = sums.iter().enumerate().filter_map(|(index, kinds)| {
        let (sum, count) = kinds.iter().find(|(_, count)| *count > 0.0)?;
        let at = Vec2::new(middle(index % columns), middle(index / columns));
        Some(camera.pinhole.unproject(&at) / f64::from(sum / count))
    });
    points.collect()
}

impl<'a> Scene<'a> {
    /// Keyframes that see some of what another one sees, by their index, evenly spread over all of
    /// them; none where that has no pose.
    pub fn covisible(&self, index: usize, most: usize) -> Vec<(usize, &'a View)> {
        let Some(this) = &self.views[index] else {
            return Vec::new();
        };
        let views = self.views.iter().enumerate();
        let seen: Vec<(usize, &View)> = views
            .filter_map(|(other, view)| Some((other, view.as_ref()?)))
            .filter(|(other, _)| *other != index)
            .filter(|(_, view)| this.overlap(view, self.camera) >= MIN_OVERLAP)
            .collect();
        let count = seen.len().min(most);
        (0..count).map(|k| seen[k * seen.len() / count]).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MappingConfig;
    use monogrid_geometry::{Pinhole, Rotation};
    use monogrid_slam::store::Store;

    impl View {
        /// A keyframe whose depth lies in memory.
        pub(crate) fn in_memory(
            depths: &Depths,
            world_from_keyframe: Sim3,
            camera: &KeyframeCamera,
        ) -> Self {
            Self {
                depths: KeptDepths::new(&Store::default(), depths.clone()),
                probes: probes(depths, camera),
                world_from_keyframe,
            }
        }
    }

    fn camera() -> KeyframeCamera {
        KeyframeCamera::new(Pinhole::new(120.0, 120.0, 79.5, 59.5), (160, 120))
    }

    /// Depth of the same z at all pixels of some columns.
    fn wall(depth: f32, columns: std::ops::Range<u16>) -> Vec<Measurement> {
        let pixels = (0..120).flat_map(|y| columns.clone().map(move |x| (x, y)));
        let at = |(x, y)| Measurement {
            x,
            y,
            idepth: 1.0 / depth,
            sigma_idepth: 0.01 / depth,
        };
        pixels.map(at).collect()
    }

    #[test]
    fn measured_depth_tells_what_is_seen_and_filled_depth_where_there_is_none() {
        let depths = Depths {
            measured: wall(2.0, 0..80),
            filled: wall(4.0, 40..120),
        };
        let probes = probes(&depths, &camera());
        // squares begin every 32 px; the last column of them has no depth
        assert_eq!(probes.len(), 4 * 4);
        for (index, probe) in probes.iter().enumerate() {
            let expected = if index % 4 == 3 { 4.0 } else { 2.0 };
            assert!((probe.z - expected).abs() < 1e-6, "{index}: {probe}");
            let at = camera().pinhole.project(probe);
            assert!((at.x - (32.0 * (index % 4) as f64 + 1.5)).abs() < 1e-6);
        }
    }

    #[test]
    fn covisible_keyframes_see_a_tenth_of_the_same_and_are_spread_over_all() {
        let depths = Depths {
            measured: wall(2.0, 0..160),
            filled: Vec::new(),
        };
        let view = |x: f64| {
            let pose = Sim3::new(1.0, Rotation::identity(), Vec3::new(x, 0.0, 0.0));
            Some(View::in_memory(&depths, pose, &camera()))
        };
        // an image is 2.7 wide on the wall
        let mut views: Vec<Option<View>> = (0..12).map(|k| view(0.05 * f64::from(k))).collect();
        views[3] = None;
        views.extend([view(2.0), view(2.6), view(9.0)]);
        let (camera, config) = (camera(), MappingConfig::default());
        let scene = Scene {
            keyframes: &[],
            views: &views,
            camera: &camera,
            config: &config,
            threads: 1,
        };
        let of = |index, most| -> Vec<usize> {
            let found = scene.covisible(index, most).into_iter();
            found.map(|(other, _)| other).collect()
        };
        assert_eq!(of(0, 100), [1, 2, 4, 5, 6, 7, 8, 9, 10, 11, 12]);
        assert_eq!(of(0, 3), [1, 5, 9]);
        assert_eq!(of(0, 0), [0; 0]);
        // nobody sees what the last one does, and one without a pose sees nothing
        assert_eq!((of(14, 9), of(3, 9)), (vec![], vec![]));
    }
}
