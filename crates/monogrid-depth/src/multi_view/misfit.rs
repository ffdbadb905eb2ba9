//! How far the images of keyframes are from fitting each other where no depth can make them fit.
//!
//! Along an epipolar line whatever is wrong with a match (noise, blur, compression, another pose, rows that were exposed one after the other) becomes
//! depth. Across it a patch is seen beside its line, whatever its depth. Errors have no reason to prefer one direction: what is found across tells what
//! the depth has taken up along, which includes what keyframes share since the same images made their depths.

use super::search::{NOISE_CONTRAST, Patch, Search, center, dot, norm};
use super::sight::{Projected, SAMPLES, Sight};
use super::{MultiViewConfig, SourceView};
use crate::DepthPixel;
use monogrid_geometry::Pinhole;
use monogrid_image::lanes::Lanes;
use monogrid_image::{Image, for_lanes};

/// One pixel in so many is looked at, in a pattern that favours no row or column.
const STRIDE: u32 = 29;
/// Patches that correlate less are not of the same surface.
const MIN_CORRELATION: f32 = 0.85;
/// Least sum of squares of the derivatives of a patch in each direction, grey levels per px: edges have no place along themselves, ...
const MIN_DERIVATIVE_SQ: f64 = 100.0;
/// ... nor do patches whose derivatives are alike but for this share.
const MIN_INDEPENDENCE: f64 = 0.2;
/// Matches that are farther away are others, px.
const MAX_OFFSET_PX: f64 = 1.5;
const ITERATIONS: usize = 4;

/// How far across their epipolar lines `sources` show the patches around pixels of a keyframe, px with a sign: for each patch with texture, and
/// each source that sees it.
///
/// `pixels` in any order, in units of the keyframe, with depths as good as they are known.
#[must_use]
pub fn epipolar_misfits(
    image: &Image<u8>,
    camera: &Pinhole,
    pixels: &[DepthPixel],
    sources: &[SourceView],
    config: &MultiViewConfig,
) -> Vec<f32> {
    let projections = Projected::of_sources(image, camera, sources);
    let mut search = Search::new(image, &projections, config);
    let chosen =
        |p: &&DepthPixel| (u32::from(p.x) * 7 + u32::from(p.y) * 13).is_multiple_of(STRIDE);
    let mut found = Vec::new();
    for pixel in pixels.iter().filter(chosen) {
        // also tells pixels at the border from those that have neighbours
        let Some(patch) = Patch::around(image, pixel) else {
            continue;
        };
        if search.find_sights(pixel).is_some() {
            let across = |sight| Some(across(sight, pixel.idepth.into(), &patch)? as f32);
            found.extend(search.sights.iter().filter_map(across));
        }
    }
    found
}

for_lanes! {
    /// How far across the epipolar line a source shows a patch, px: by Gauss-Newton along and across it, with gain and bias free.
    fn across = across_with, (sight: &Sight<'_>, idepth: f64, patch: &Patch) -> Option<f64>;
}

#[inline(always)]
fn across_with<L: Lanes>(lanes: L, sight: &Sight<'_>, idepth: f64, patch: &Patch) -> Option<f64> {
    let start = sight.center(idepth)?;
    let motion = sight.motion(idepth);
    let length = motion[0].hypot(motion[1]);
    let along = motion.map(|m| m / length);
    let across = [-along[1], along[0]];
    let at = |[a, c]: [f64; 2]| [0, 1].map(|i| start[i] + a * along[i] + c * across[i]);
    let values = |offset| sight.values(lanes, at(offset));
    let mut offset = [0.0; 2];
    for _ in 0..ITERATIONS {
        let [a, c] = offset;
        let value = values(offset);
        let by_along = difference(values([a - 0.5, c]), values([a + 0.5, c]));
        let by_across = difference(values([a, c - 0.5]), values([a, c + 0.5]));
        let [residual, by_along, by_across] = [value, by_along, by_across].map(centered);
        let gain = patch.dot(&residual);
        if gain < MIN_CORRELATION * norm(&residual).max(NOISE_CONTRAST) {
            return None;
        }
        let r = patch.without(gain, residual);
        let [j, k] = [by_along, by_across].map(|slope| patch.without(patch.dot(&slope), slope));
        let (jj, kk, jk) = (dot64(&j, &j), dot64(&k, &k), dot64(&j, &k));
        let determinant = jj * kk - jk * jk;
        if jj.min(kk) < MIN_DERIVATIVE_SQ || determinant < MIN_INDEPENDENCE * jj * kk {
            return None;
        }
        let (jr, kr) = (dot64(&j, &r), dot64(&k, &r));
        offset = [
            a - (kk * jr - jk * kr) / determinant,
            c - (jj * kr - jk * jr) / determinant,
        ];
        // written so that NaN gives nothing
        if !(offset[0].hypot(offset[1]) <= MAX_OFFSET_PX && sight.shows(at(offset))) {
            return None;
        }
    }
    Some(offset[1])
}

fn difference(before: [f32; SAMPLES], after: [f32; SAMPLES]) -> [f32; SAMPLES] {
    std::array::from_fn(|i| after[i] - before[i])
}

fn centered(mut values: [f32; SAMPLES]) -> [f32; SAMPLES] {
    center(&mut values);
    values
}

fn dot64(a: &[f32; SAMPLES], b: &[f32; SAMPLES]) -> f64 {
    f64::from(dot(a, b))
}
