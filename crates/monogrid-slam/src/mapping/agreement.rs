//! Filled depth that other keyframes contradict.
//!
//! A plane through the outline of a plain region may be the wrong one: the wall beside it, which then passes behind
//! the true surface as a wing of the map. Whether a filled pixel is right, other keyframes know. Each of them either
//!
//! * **agrees**: it has that depth where it sees the point;
//! * **sees through it**: it has a larger depth there, so its line of sight passes the point;
//! * **is seen through**: the line of sight of the pixel passes a surface that the other keyframe has in front of the point;
//! * or does not see it, or sees it covered by something else, and has no say.
//!
//! Depth that was measured has a full vote, depth that was filled a smaller one. Pixels with too many votes against them
//! are taken out. Images are compared in blocks of a few pixels.

use super::KeyframeCamera;
use super::posed::Scene;
use super::scan::{Depths, KeptDepths};
use super::transfer::Transfer;
use monogrid_geometry::{Pinhole, Sim3, Vec2, Vec3};
use monogrid_occupancy::DepthPixel as Measurement;
use std::sync::Arc;

/// Edge of a block, px.
const BLOCK_PX: usize = 4;
/// The vote of filled depth; that of measured depth is 1.
const FILLED_VOTE: f32 = 0.5;
/// Blocks by which is found whether two keyframes see the same: every so many in both directions.
const PROBE_STRIDE: usize = 8;
/// Share of these that must be seen by the other keyframe.
const MIN_OVERLAP: f64 = 0.1;

/// A block of an image that has depth.
#[derive(Clone, Copy, Debug, Default)]
struct Block {
    /// Mean inverse depth in units of the keyframe; 0 where there is none.
    idepth: f32,
    /// 1 for measured depth, [`FILLED_VOTE`] for filled.
    vote: f32,
    /// Whether it was filled.
    is_filled: bool,
}

/// The blocks of a keyframe.
#[derive(Debug)]
pub(super) struct Blocks {
    columns: usize,
    rows: usize,
    blocks: Vec<Block>,
}

/// A keyframe with its pose.
#[derive(Clone, Debug)]
pub(super) struct View {
    pub depths: KeptDepths,
    pub blocks: Arc<Blocks>,
    pub world_from_keyframe: Sim3,
    /// How far across epipolar lines other images show its patches, px ([`monogrid_depth::epipolar_misfits`]).
    pub misfits: Arc<[f32]>,
}

impl Blocks {
    /// Means over blocks: of measured depth where there is some, else of filled.
    pub fn new(depths: &Depths, camera: &KeyframeCamera) -> Self {
        let columns = camera.width.div_ceil(BLOCK_PX);
        let rows = camera.height.div_ceil(BLOCK_PX);
        let mut this = Self {
            columns,
            rows,
            blocks: vec![Block::default(); columns * rows],
        };
        for (pixels, is_filled) in [(&depths.measured, false), (&depths.filled, true)] {
            let mut sums = vec![(0.0_f32, 0.0_f32); columns * rows];
            for pixel in pixels {
                let sum = &mut sums[this.index_of_pixel(pixel)];
                *sum = (sum.0 + pixel.idepth, sum.1 + 1.0);
            }
            for (block, (sum, count)) in this.blocks.iter_mut().zip(sums) {
                if block.vote <= 0.0 && count > 0.0 {
                    *block = Block {
                        idepth: sum / count,
                        vote: if is_filled { FILLED_VOTE } else { 1.0 },
                        is_filled,
                    };
                }
            }
        }
        this
    }

    fn index_of_pixel(&self, pixel: &Measurement) -> usize {
        let column = (usize::from(pixel.x) / BLOCK_PX).min(self.columns - 1);
        let row = (usize::from(pixel.y) / BLOCK_PX).min(self.rows - 1);
        row * self.columns + column
    }

    /// The block at a place in the image.
    fn index_at(&self, pixel: &Vec2) -> Option<usize> {
        let (x, y) = (
            (pixel.x + 0.5) / BLOCK_PX as f64,
            (pixel.y + 0.5) / BLOCK_PX as f64,
        );
        let inside = x >= 0.0 && y >= 0.0 && x < self.columns as f64 && y < self.rows as f64;
        inside.then(|| y as usize * self.columns + x as usize)
    }

    /// Smallest and largest inverse depth and the best vote of a block and its neighbours.
    fn around(&self, index: usize) -> Option<(f32, f32, f32)> {
        let (column, row) = (index % self.columns, index / self.columns);
        let columns = column.saturating_sub(1)..(column + 2).min(self.columns);
        let rows = row.saturating_sub(1)..(row + 2).min(self.rows);
        let blocks = rows.flat_map(|y| &self.blocks[y * self.columns..][columns.clone()]);
        let known = blocks.filter(|block| block.vote > 0.0);
        known.fold(None, |found, block| {
            let (low, high, vote) = found.unwrap_or((f32::INFINITY, 0.0_f32, 0.0_f32));
            let (low, high) = (low.min(block.idepth), high.max(block.idepth));
            Some((low, high, vote.max(block.vote)))
        })
    }

    /// The point that the middle of a block with depth sees, in the frame of the keyframe.
    fn point(&self, index: usize, pinhole: &Pinhole) -> Vec3 {
        let middle = |cell: usize| (cell * BLOCK_PX) as f64 + 0.5 * (BLOCK_PX as f64 - 1.0);
        let ray = pinhole.unproject(&Vec2::new(
            middle(index % self.columns),
            middle(index / self.columns),
        ));
        ray / f64::from(self.blocks[index].idepth)
    }
}

/// Votes on the filled depth of the blocks of a keyframe.
#[derive(Clone, Copy, Debug, Default)]
struct Votes {
    agree: f32,
    against: f32,
}

/// Which of the filled depth of a keyframe the others leave; `None` for one without a pose.
pub(super) fn kept(scene: &Scene, index: usize) -> Option<Vec<bool>> {
    let (this, config) = (scene.views[index].as_ref()?, &scene.config.fill);
    let mut votes = vec![Votes::default(); this.blocks.blocks.len()];
    for (_, other) in scene.witnesses(index, config.max_witnesses) {
        hear_where_it_sees(&mut votes, this, other, scene);
        hear_where_it_is_seen(&mut votes, this, other, scene);
    }
    let is_kept = |pixel: &Measurement| {
        let votes = votes[this.blocks.index_of_pixel(pixel)];
        votes.against <= config.max_against * votes.agree.max(FILLED_VOTE)
    };
    Some(this.depths.filled().iter().map(is_kept).collect())
}

impl<'a> Scene<'a> {
    /// Keyframes that see some of what another one sees, by their index, evenly spread over all of them; none where that has no pose.
    pub fn witnesses(&self, index: usize, most: usize) -> Vec<(usize, &'a View)> {
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

impl View {
    fn other_from_this(&self, other: &Self) -> Sim3 {
        other.world_from_keyframe.inverse() * self.world_from_keyframe
    }

    /// From its pixels to those of another one.
    pub fn transfer_to(&self, other: &Self, camera: &KeyframeCamera) -> Transfer {
        Transfer::new(&self.other_from_this(other), camera)
    }

    /// Share of its depth that lies in the image of another.
    fn overlap(&self, other: &Self, camera: &KeyframeCamera) -> f64 {
        let other_from_this = self.other_from_this(other);
        let (mut seen, mut all) = (0, 0);
        for row in (0..self.blocks.rows).step_by(PROBE_STRIDE) {
            for column in (0..self.blocks.columns).step_by(PROBE_STRIDE) {
                let index = row * self.blocks.columns + column;
                if self.blocks.blocks[index].vote > 0.0 {
                    all += 1;
                    let place = self.place(index, other, &other_from_this, camera);
                    seen += usize::from(place.is_some());
                }
            }
        }
        f64::from(seen as u32) / f64::from(all.max(1) as u32)
    }

    /// The block of another one in which a block of this one is seen, with its inverse depth there.
    fn place(
        &self,
        index: usize,
        other: &Self,
        other_from_this: &Sim3,
        camera: &KeyframeCamera,
    ) -> Option<(usize, f32)> {
        let point = *other_from_this * self.blocks.point(index, &camera.pinhole);
        if point.z <= 1e-9 {
            return None;
        }
        let at = other.blocks.index_at(&camera.pinhole.project(&point))?;
        Some((at, (1.0 / point.z) as f32))
    }
}

/// The other keyframe agrees with a filled block, or sees through it.
fn hear_where_it_sees(votes: &mut [Votes], this: &View, other: &View, scene: &Scene) {
    let other_from_this = this.other_from_this(other);
    let tolerance = scene.config.fill.tolerance as f32;
    for (index, votes) in votes.iter_mut().enumerate() {
        if !this.blocks.blocks[index].is_filled {
            continue;
        }
        let place = this.place(index, other, &other_from_this, scene.camera);
        let seen = place.and_then(|(at, idepth)| Some((idepth, other.blocks.around(at)?)));
        let Some((idepth, (low, high, vote))) = seen else {
            continue;
        };
        if high < idepth * (1.0 - tolerance) {
            votes.against += vote;
        } else if low <= idepth * (1.0 + tolerance) {
            votes.agree += vote;
        }
    }
}

/// A filled block is behind something that the other keyframe sees.
fn hear_where_it_is_seen(votes: &mut [Votes], this: &View, other: &View, scene: &Scene) {
    let this_from_other = this.other_from_this(other).inverse();
    let tolerance = scene.config.fill.tolerance as f32;
    // the best vote of the other keyframe on each block: it has one
    let mut heard = vec![0.0_f32; votes.len()];
    let known = other.blocks.blocks.iter().enumerate();
    for (index, block) in known.filter(|(_, block)| block.vote > 0.0) {
        let place = other.place(index, this, &this_from_other, scene.camera);
        let Some((at, idepth)) = place else {
            continue;
        };
        let seen = &this.blocks.blocks[at];
        if seen.is_filled && idepth * (1.0 - tolerance) > seen.idepth {
            heard[at] = heard[at].max(block.vote);
        }
    }
    for (votes, heard) in votes.iter_mut().zip(heard) {
        votes.against += heard;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mapping::{FillConfig, MappingConfig};
    use crate::store::Store;
    use monogrid_geometry::Rotation;

    impl View {
        /// A keyframe whose depth lies in memory.
        pub(in crate::mapping) fn in_memory(
            depths: &Depths,
            world_from_keyframe: Sim3,
            camera: &KeyframeCamera,
        ) -> Self {
            Self {
                depths: KeptDepths::new(&Store::default(), depths.clone()),
                blocks: Arc::new(Blocks::new(depths, camera)),
                world_from_keyframe,
                misfits: Arc::new([]),
            }
        }
    }

    const CAMERA: KeyframeCamera = KeyframeCamera {
        pinhole: Pinhole {
            fx: 60.0,
            fy: 60.0,
            cx: 31.5,
            cy: 23.5,
        },
        width: 64,
        height: 48,
    };

    /// Depth of the same z everywhere.
    fn plane(depth: f32) -> Vec<Measurement> {
        let pixels = (0..48_u16).flat_map(|y| (0..64_u16).map(move |x| (x, y)));
        let at = |(x, y)| Measurement {
            x,
            y,
            idepth: 1.0 / depth,
            sigma_idepth: 0.01 / depth,
        };
        pixels.map(at).collect()
    }

    fn measured(depth: f32) -> Depths {
        Depths {
            measured: plane(depth),
            filled: Vec::new(),
        }
    }

    fn filled(depth: f32) -> Depths {
        Depths {
            measured: Vec::new(),
            filled: plane(depth),
        }
    }

    /// Filled pixels of the first keyframe that are kept; the others stand beside it, a tenth of a unit each.
    fn num_kept(all: &[Depths], config: &FillConfig) -> usize {
        let views: Vec<Option<View>> = all
            .iter()
            .enumerate()
            .map(|(k, depths)| {
                let centre = Vec3::new(0.1 * k as f64, 0.0, 0.0);
                let pose = Sim3::new(1.0, Rotation::identity(), centre);
                Some(View::in_memory(depths, pose, &CAMERA))
            })
            .collect();
        let config = MappingConfig {
            fill: config.clone(),
            ..MappingConfig::default()
        };
        let scene = Scene {
            keyframes: &[],
            views: &views,
            camera: &CAMERA,
            config: &config,
            threads: 1,
        };
        let kept = kept(&scene, 0).unwrap();
        kept.into_iter().filter(|kept| *kept).count()
    }

    #[test]
    fn a_plane_behind_a_measured_wall_or_before_it_is_taken_out() {
        let config = FillConfig::default();
        let all = filled(2.0).filled.len();
        for (wrong, right) in [(2.5, 2.0), (1.5, 2.0)] {
            let keyframes = [filled(wrong), measured(right), measured(right)];
            let left = num_kept(&keyframes, &config);
            assert!(10 * left < all, "{wrong}: {left} of {all}");
        }
        let keyframes = [filled(2.0), measured(2.0), measured(2.04)];
        assert_eq!(num_kept(&keyframes, &config), all);
        // nobody else saw it
        assert_eq!(num_kept(&[filled(2.5)], &config), all);
    }

    #[test]
    fn more_and_better_witnesses_win() {
        let config = FillConfig::default();
        let all = filled(2.0).filled.len();
        // one filled plane against the measured depth of two
        let keyframes = [filled(2.0), filled(1.5), measured(2.0), measured(2.0)];
        // the last does not see the rim
        assert!(10 * num_kept(&keyframes, &config) > 9 * all);
        // two filled planes of two minds
        let keyframes = [filled(2.5), filled(2.0), filled(2.0), filled(2.5)];
        assert!(10 * num_kept(&keyframes, &config) < all);
        let none = FillConfig {
            max_against: 1000.0,
            ..config
        };
        assert_eq!(num_kept(&keyframes, &none), all);
    }
}
