//! Stereo observation of the pixels of a band of rows, and their update.
//!
//! Per pixel: choose the frame that promises most → search or refine along the epipolar line →
//! variance → create, fuse, confirm or doubt.

use crate::HostFrame;
use crate::config::DepthConfig;
use crate::epipolar::FrameGeometry;
use crate::map::{Arrays, Candidates, DepthMap};
use crate::stats::ObserveStats;
use crate::variance::LineUncertainty;
use monogrid_geometry::Se3;
use monogrid_image::GrayImage;

/// A frame that the keyframe's pixels are compared with.
#[derive(Clone, Copy, Debug)]
pub struct StereoFrame<'a> {
    /// Grey image of the keyframe's size and intrinsics.
    pub image: &'a GrayImage,
    /// Pose; translation in the keyframe's unit.
    pub frame_from_keyframe: Se3,
    /// `I_frame = gain * I_keyframe + bias`.
    pub gain: f32,
    /// See `gain`, grey levels.
    pub bias: f32,
    /// Root mean square photometric residual of tracking this frame, grey levels.
    pub residual_rms: f32,
    /// Standard deviation of the translation along each axis, u.
    pub pose_sigma_trans: f32,
    /// Standard deviation of the rotation around each axis, rad.
    pub pose_sigma_rot: f32,
    /// Number of the frame; spreads repeated work over frames.
    pub id: u32,
}

/// A frame with what is precomputed for it.
pub(crate) struct Prepared<'a> {
    pub(crate) frame: StereoFrame<'a>,
    pub(crate) geometry: FrameGeometry,
    pub(crate) uncertainty: LineUncertainty,
}

/// Mutable rows of a [`DepthMap`]; bands are disjoint and may be processed on any thread.
#[derive(Debug)]
pub struct DepthBand<'a> {
    pub(crate) host: &'a HostFrame,
    pub(crate) candidates: &'a Candidates,
    pub(crate) noise_var: f32,
    pub(crate) is_measured: bool,
    pub(crate) near_limit: f32,
    pub(crate) first_row: usize,
    pub(crate) num_rows: usize,
    pub(crate) idepth: &'a mut [f32],
    pub(crate) var: &'a mut [f32],
    pub(crate) prior_var: &'a mut [f32],
    pub(crate) floor_var: &'a mut [f32],
    pub(crate) photo_px: &'a mut [f32],
    pub(crate) validity: &'a mut [u8],
    pub(crate) failures: &'a mut [u8],
}

impl DepthMap {
    /// Splits the map into bands of `rows_per_band` rows (the last may be smaller).
    pub fn bands(&mut self, rows_per_band: usize) -> Vec<DepthBand<'_>> {
        let rows = rows_per_band.max(1);
        let len = rows * self.host.width();
        let height = self.host.height();
        let Arrays {
            idepth,
            var,
            prior_var,
            floor_var,
            photo_px,
            validity,
            failures,
        } = &mut self.arrays;
        let floats = [idepth, var, prior_var, floor_var, photo_px];
        let mut floats = floats.map(|values| values.chunks_mut(len));
        let mut bytes = [validity, failures].map(|values| values.chunks_mut(len));
        let bands = (0..height).step_by(rows).map(|first_row| {
            let floats = floats.each_mut().map(|f| f.next().unwrap_or_default());
            let [idepth, var, prior_var, floor_var, photo_px] = floats;
            let [validity, failures] = bytes.each_mut().map(|b| b.next().unwrap_or_default());
            DepthBand {
                host: &self.host,
                candidates: &self.candidates,
                noise_var: self.noise_var,
                is_measured: self.is_measured,
                near_limit: self.near_limit,
                first_row,
                num_rows: rows.min(height - first_row),
                idepth,
                var,
                prior_var,
                floor_var,
                photo_px,
                validity,
                failures,
            }
        });
        bands.collect()
    }

    /// Observes all rows on the calling thread, and learns the noise from them.
    pub fn observe(&mut self, frames: &[StereoFrame<'_>], config: &DepthConfig) -> ObserveStats {
        let mut stats = ObserveStats::default();
        // the same bands as a parallel caller would use, so that sums agree bit for bit
        for mut band in self.bands(16) {
            stats.merge(&band.observe(frames, config));
        }
        self.finish_observation(&stats);
        stats
    }
}

/// What a pixel looks like before observation.
#[derive(Clone, Copy)]
pub(crate) struct Pixel {
    /// Index inside the band.
    pub(crate) i: usize,
    pub(crate) x: f32,
    pub(crate) y: f32,
    pub(crate) gradient: [f32; 2],
}

impl DepthBand<'_> {
    /// First row of the band.
    #[must_use]
    pub fn first_row(&self) -> usize {
        self.first_row
    }

    /// Observes every candidate pixel of the band in one of `frames`, best given with the most
    /// promising first. Frames of another size than the keyframe are ignored.
    pub fn observe(&mut self, frames: &[StereoFrame<'_>], config: &DepthConfig) -> ObserveStats {
        let mut stats = ObserveStats::default();
        let prepared = prepare(frames, self.host, config);
        if prepared.is_empty() {
            return stats;
        }
        let w = self.host.width();
        let candidates = self.candidates;
        for row in 0..self.num_rows {
            let y = self.first_row + row;
            let (gx, gy) = (self.host.gradient.gx.row(y), self.host.gradient.gy.row(y));
            for &column in candidates.row(y) {
                let x = usize::from(column);
                let pixel = Pixel {
                    i: row * w + x,
                    x: f32::from(column),
                    y: y as f32,
                    gradient: [gx[x], gy[x]],
                };
                let outcome = if self.var[pixel.i] > 0.0 {
                    self.update(pixel, &prepared, config, &mut stats)
                } else {
                    self.create(pixel, &prepared, config)
                };
                stats.add(outcome);
            }
        }
        stats
    }

    pub(crate) fn size(&self) -> (usize, usize) {
        (self.host.width(), self.host.height())
    }
}

/// A number that differs between neighbours and advances with the frames.
pub(crate) fn phase(pixel: Pixel, id: u32) -> u32 {
    let [x, y] = [pixel.x, pixel.y].map(|c| c as u32);
    id.wrapping_add(x.wrapping_mul(7))
        .wrapping_add(y.wrapping_mul(13))
}

fn prepare<'a>(
    frames: &[StereoFrame<'a>],
    host: &HostFrame,
    config: &DepthConfig,
) -> Vec<Prepared<'a>> {
    let usable = |f: &&StereoFrame<'_>| {
        let gain_ok = f.gain.is_finite() && f.gain > 0.0 && f.bias.is_finite();
        f.image.same_size(&host.image) && gain_ok && f.frame_from_keyframe.is_finite()
    };
    let prepared = frames.iter().filter(usable).map(|frame| {
        let geometry = FrameGeometry::new(frame, &host.pinhole);
        let rotation_px = geometry.focal * frame.pose_sigma_rot;
        Prepared {
            frame: *frame,
            uncertainty: LineUncertainty {
                constant_sq: rotation_px * rotation_px
                    + config.line_sigma_px * config.line_sigma_px,
                per_idepth: geometry.focal * frame.pose_sigma_trans,
                residual_rms: frame.residual_rms,
            },
            geometry,
        }
    });
    prepared.collect()
}
