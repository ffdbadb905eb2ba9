//! Depth of keyframes against the truth.

use crate::failure::Failure;
use crate::keyframe_pixels::to_estimates;
use monogrid_evaluation::{DepthConfig, DepthEvaluator, DepthReport, KeyframeDepth};
use monogrid_image::{GradientImage, GrayImage, Image};
use monogrid_slam::DepthPixel;

/// A keyframe to compare.
#[derive(Debug)]
pub struct Candidate<'a> {
    /// Its identity.
    pub id: u32,
    /// Its grey image.
    pub image: &'a Image<u8>,
    /// Its depth.
    pub pixels: &'a [DepthPixel],
    /// Length of its unit.
    pub world_scale: f64,
}

/// Collects keyframes whose true depth is known.
#[derive(Debug)]
pub struct DepthComparison {
    evaluator: DepthEvaluator,
    num_compared: usize,
}

impl DepthComparison {
    /// Nothing compared yet.
    pub fn new() -> Self {
        Self {
            evaluator: DepthEvaluator::new(DepthConfig::default()),
            num_compared: 0,
        }
    }

    /// Adds a keyframe and its true depth (z, NaN where unknown, in the keyframe's camera).
    pub fn add(&mut self, candidate: &Candidate, true_depth: &GrayImage) -> Result<(), Failure> {
        let gradient = GradientImage::new(&candidate.image.map(f32::from)).magnitude();
        self.evaluator
            .add_keyframe(&KeyframeDepth {
                id: u64::from(candidate.id),
                width: candidate.image.width(),
                height: candidate.image.height(),
                estimates: &to_estimates(candidate.pixels),
                world_scale: candidate.world_scale,
                true_depth: true_depth.as_slice(),
                gradient: gradient.as_slice(),
            })
            .map_err(Failure::input)?;
        self.num_compared += 1;
        Ok(())
    }

    /// Keyframes compared.
    pub fn num_compared(&self) -> usize {
        self.num_compared
    }

    /// The result.
    pub fn finish(self) -> Result<DepthReport, Failure> {
        self.evaluator.finish().map_err(Failure::input)
    }
}
