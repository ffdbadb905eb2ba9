//! Propagation of a depth map into the next keyframe.
//!
//! With `m = K⁻¹ p`, `h_z = r3·m + d t_z` the ratio of the depths: `d' = d / h_z`, and
//! `V' = (r3·m)² / h_z⁴ V` (exact with rotation; `(d'/d)⁴ V` without).

use crate::HostFrame;
use crate::config::DepthConfig;
use crate::map::MAX_VAR;
use crate::map::{BORDER, DepthMap, FoundDepth, Hypothesis};
use monogrid_geometry::{Se3, Vec2, Vec3};
use std::ops::Range;
use std::sync::Arc;

/// One hypothesis warped into the new keyframe.
#[derive(Clone, Copy, Debug)]
struct Warped {
    x: f32,
    y: f32,
    idepth: f32,
    var: f32,
    validity: u8,
    /// Next in the same pixel, or `NONE`.
    next: u32,
}

const NONE: u32 = u32::MAX;
/// Hypotheses considered per target pixel.
const MAX_CANDIDATES: usize = 16;
/// Hypotheses of one surface differ by at most this many standard deviations.
const SAME_SURFACE_SIGMA: f32 = 2.5;
/// Relative difference of inverse depth per px that one surface may have besides.
const SAME_SURFACE_SLOPE: f32 = 0.02;

/// What is known of a keyframe, as the next one sees it, on its way there.
#[derive(Debug)]
pub struct WarpedDepth {
    /// Per pixel of the next keyframe the first of those whose nearest pixel it is, or `NONE`.
    heads: Vec<u32>,
    warped: Vec<Warped>,
    width: usize,
    noise_var: f32,
    noise_measured: bool,
}

impl DepthMap {
    /// The depth of this keyframe as seen from `target`, an image of the same camera.
    /// `target_from_source` has its translation in this keyframe's unit, which is also the unit of
    /// the result ([`DepthMap::rescale`] changes it).
    #[must_use]
    pub fn propagate(
        &self,
        target: Arc<HostFrame>,
        target_from_source: &Se3,
        config: &DepthConfig,
    ) -> Self {
        let mut target = Self::empty(target, config);
        let warped = self.warped(target_from_source);
        let all = warped.merged(&target, 0..target.host.height(), config);
        target.take_over(&warped, &[all], config);
        target
    }

    /// Takes over what another keyframe knew, from all rows.
    pub fn take_over(
        &mut self,
        warped: &WarpedDepth,
        rows: &[Vec<FoundDepth>],
        config: &DepthConfig,
    ) {
        self.noise_var = warped.noise_var;
        self.noise_measured = warped.noise_measured;
        for found in rows.iter().flatten() {
            self.set(found.index, found.hypothesis);
        }
        self.limit_search(config);
    }

    /// Warps every known pixel into an image of the same camera and sorts it into lists per nearest
    /// pixel there.
    #[must_use]
    pub fn warped(&self, target_from_source: &Se3) -> WarpedDepth {
        let (w, h) = (self.host.width(), self.host.height());
        let mut heads = vec![NONE; w * h];
        let mut warped: Vec<Warped> = Vec::with_capacity(self.num_candidates());
        let rotation = target_from_source.rotation_matrix();
        let translation = target_from_source.translation;
        for (x, y, i) in self.all_candidates() {
            if self.arrays.var[i] <= 0.0 || self.arrays.idepth[i] <= 0.0 {
                continue;
            }
            let ray = rotation * self.host.pinhole.unproject(&Vec2::new(x as f64, y as f64));
            let idepth = f64::from(self.arrays.idepth[i]);
            if let Some(mut moved) = warp(&ray, &translation, idepth, &self.host) {
                let (tx, ty) = ((moved.x + 0.5) as usize, (moved.y + 0.5) as usize);
                moved.var *= self.arrays.var[i];
                moved.validity = self.arrays.validity[i];
                moved.next = heads[ty * w + tx];
                heads[ty * w + tx] = warped.len() as u32;
                warped.push(moved);
            }
        }
        WarpedDepth {
            heads,
            warped,
            width: w,
            noise_var: self.noise_var,
            noise_measured: self.noise_measured,
        }
    }
}

impl WarpedDepth {
    /// The depth of some rows of `target`.
    #[must_use]
    pub fn merged(
        &self,
        target: &DepthMap,
        rows: Range<usize>,
        config: &DepthConfig,
    ) -> Vec<FoundDepth> {
        let mut found = Vec::new();
        let mut nearby = Vec::with_capacity(MAX_CANDIDATES);
        let rows = rows.start..rows.end.min(target.host.height());
        for (x, y, index) in target.candidates.in_rows(rows, self.width) {
            self.collect_nearby((x, y), config, &mut nearby);
            if let Some(hypothesis) = merge((x, y), &nearby, config) {
                found.push(FoundDepth { index, hypothesis });
            }
        }
        found
    }

    /// The warped hypotheses less than a pixel from `(x, y)` (or of the pixel itself).
    fn collect_nearby(
        &self,
        (x, y): (usize, usize),
        config: &DepthConfig,
        nearby: &mut Vec<Warped>,
    ) {
        nearby.clear();
        let radius = usize::from(config.propagate_subpixel);
        for yy in y - radius..=y + radius {
            for xx in x - radius..=x + radius {
                let mut index = self.heads[yy * self.width + xx];
                while index != NONE && nearby.len() < MAX_CANDIDATES {
                    let candidate = self.warped[index as usize];
                    index = candidate.next;
                    let gaps = [candidate.x - x as f32, candidate.y - y as f32];
                    if gaps.iter().all(|gap| gap.abs() < 1.0) {
                        nearby.push(candidate);
                    }
                }
            }
        }
    }
}

/// Where `ray` (rotated, z = 1 before) at inverse depth `idepth` is seen; `var` is the factor on
/// the variance.
fn warp(ray: &Vec3, translation: &Vec3, idepth: f64, camera: &HostFrame) -> Option<Warped> {
    let point = ray + translation * idepth;
    let ratio = point.z;
    if ratio < 0.1 || ray.z <= 0.0 {
        return None;
    }
    let pixel = camera.pinhole.project(&point);
    let border = BORDER as f64 - 1.0;
    let inside = pixel.x >= border
        && pixel.y >= border
        && pixel.x <= camera.width() as f64 - 1.0 - border
        && pixel.y <= camera.height() as f64 - 1.0 - border;
    let jacobian = ray.z / (ratio * ratio);
    inside.then_some(Warped {
        x: pixel.x as f32,
        y: pixel.y as f32,
        idepth: (idepth / ratio) as f32,
        var: (jacobian * jacobian) as f32,
        validity: 0,
        next: NONE,
    })
}

/// Bilinear weight of a hypothesis for the pixel.
fn tent(candidate: &Warped, x: f32, y: f32) -> f32 {
    (1.0 - (candidate.x - x).abs()) * (1.0 - (candidate.y - y).abs())
}

fn same_surface(a: &Warped, b: &Warped) -> bool {
    let gap = a.idepth - b.idepth;
    let distance = (a.x - b.x).abs() + (a.y - b.y).abs();
    let slope = SAME_SURFACE_SLOPE * distance * a.idepth.max(b.idepth);
    gap * gap <= SAME_SURFACE_SIGMA * SAME_SURFACE_SIGMA * (a.var + b.var) + slope * slope
}

/// The surface seen at the pixel, interpolated to its centre.
fn merge((x, y): (usize, usize), nearby: &[Warped], config: &DepthConfig) -> Option<Hypothesis> {
    let (x, y) = (x as f32, y as f32);
    let seed = visible_seed(nearby, (x, y), config)?;
    let (mut sum_w, mut sum_d, mut sum_v, mut sum_ww) = (0.0f32, 0.0f32, 0.0f32, 0.0f32);
    let (mut offset_x, mut offset_y, mut tents) = (0.0f32, 0.0f32, 0.0f32);
    let mut validity = 0.0f32;
    for candidate in nearby.iter().filter(|c| same_surface(seed, c)) {
        let share = tent(candidate, x, y) + 0.01;
        let weight = share / candidate.var;
        sum_w += weight;
        sum_d += weight * candidate.idepth;
        sum_v += weight * candidate.var;
        sum_ww += weight * weight;
        offset_x += weight * (candidate.x - x);
        offset_y += weight * (candidate.y - y);
        tents += share;
        validity += share * f32::from(candidate.validity);
    }
    let idepth = sum_d / sum_w;
    let offset = (offset_x * offset_x + offset_y * offset_y) / (sum_w * sum_w);
    let slope = config.slope_per_px * idepth;
    let prediction = config.propagation_relative_sigma * idepth;
    // neighbouring matches share most of their samples: only some of their errors averages out, and
    // what was averaged once is alike afterwards
    let mean_var = sum_v / sum_w * (0.6 + 0.4 * sum_ww / (sum_w * sum_w));
    let var =
        config.propagation_inflation * mean_var + slope * slope * offset + prediction * prediction;
    (var <= MAX_VAR).then_some(Hypothesis {
        idepth,
        var,
        prior_var: var,
        validity: (validity / tents) as u8,
    })
}

/// A hypothesis of the surface that is visible at the pixel: of two surfaces the nearer one,
/// provided that it has its share of the support; otherwise the better supported one.
fn visible_seed<'a>(
    nearby: &'a [Warped],
    (x, y): (f32, f32),
    config: &DepthConfig,
) -> Option<&'a Warped> {
    let weight = |c: &Warped| (tent(c, x, y) + 0.01) * (1.0 + f32::from(c.validity));
    let support = |of: &Warped| -> f32 {
        let surface = nearby.iter().filter(|c| same_surface(of, c));
        surface.map(weight).sum()
    };
    let first = nearby.first()?;
    if nearby.iter().all(|c| same_surface(first, c)) {
        // one surface: its best known member decides who belongs to it
        return nearby.iter().min_by(|a, b| a.var.total_cmp(&b.var));
    }
    let total: f32 = nearby.iter().map(weight).sum();
    let candidates = nearby.iter();
    let supported = |c: &&Warped| support(c) >= config.occlusion_support * total;
    let visible = candidates.clone().filter(supported);
    visible
        .max_by(|a, b| a.idepth.total_cmp(&b.idepth))
        .or_else(|| candidates.max_by(|a, b| support(a).total_cmp(&support(b))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::{Pinhole, Rotation};
    use monogrid_image::{GrayImage, Mask};

    const SIZE: (usize, usize) = (96, 72);

    fn textured() -> Arc<HostFrame> {
        let image = GrayImage::from_fn(SIZE.0, SIZE.1, |x, y| {
            100.0 + 40.0 * ((x * 7 + y * 3) as f32).sin()
        });
        let pinhole = Pinhole::new(90.0, 90.0, 47.5, 35.5);
        let mask = Mask::filled(SIZE.0, SIZE.1, 255);
        Arc::new(HostFrame::new(image, mask, pinhole).expect("valid"))
    }

    #[test]
    fn variance_follows_the_numeric_derivative_with_rotation() {
        let map = DepthMap::empty(textured(), &DepthConfig::default());
        let pose = Se3::new(
            Rotation::from_euler_angles(0.1, -0.2, 0.3),
            Vec3::new(0.1, 0.05, 0.3),
        );
        for (x, y) in [(30.0, 30.0), (47.5, 35.5), (60.0, 50.0)] {
            let ray = pose.rotation_matrix() * map.host.pinhole.unproject(&Vec2::new(x, y));
            for idepth in [0.3, 1.0, 1.7] {
                let at =
                    |d: f64| 1.0 / (pose * (map.host.pinhole.unproject(&Vec2::new(x, y)) / d)).z;
                let numeric = (at(idepth + 1e-6) - at(idepth - 1e-6)) / 2e-6;
                let moved = warp(&ray, &pose.translation, idepth, &map.host).expect("visible");
                assert!((f64::from(moved.idepth) - at(idepth)).abs() < 1e-6);
                assert!((f64::from(moved.var) / (numeric * numeric) - 1.0).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn without_motion_nothing_but_the_prediction_noise_changes() {
        let config = DepthConfig::default();
        let mut map = DepthMap::empty(textured(), &config);
        map.initialize_constant(0.9, 1e-3);
        let next = map.propagate(textured(), &Se3::identity(), &config);
        assert_eq!(next.num_known(), map.num_known());
        for p in next.pixels(crate::PixelFilter::default()) {
            let index = usize::from(p.y) * next.host.width() + usize::from(p.x);
            assert!((p.idepth - 0.9).abs() < 1e-6 && next.arrays.validity[index] == 20);
            assert!(p.idepth_var < 1.2e-3 && p.idepth_var > 0.9e-3, "{p:?}");
        }
    }

    #[test]
    fn bands_of_rows_give_what_all_rows_give() {
        let config = DepthConfig::default();
        let mut map = DepthMap::empty(textured(), &config);
        map.initialize_constant(0.9, 1e-3);
        let pose = Se3::new(
            Rotation::from_euler_angles(0.01, -0.02, 0.03),
            Vec3::new(0.02, 0.01, 0.05),
        );
        let whole = map.propagate(textured(), &pose, &config);
        assert!(whole.num_known() > 1000);
        for band in [1, 7, SIZE.1 + 5] {
            let mut next = DepthMap::empty(textured(), &config);
            let warped = map.warped(&pose);
            let rows = (0..SIZE.1).step_by(band);
            let rows = rows.map(|y| warped.merged(&next, y..y + band, &config));
            let rows: Vec<_> = rows.collect();
            next.take_over(&warped, &rows, &config);
            for (x, y) in (0..SIZE.1).flat_map(|y| (0..SIZE.0).map(move |x| (x, y))) {
                assert_eq!(next.at(x, y), whole.at(x, y), "{x} {y}");
            }
        }
    }

    #[test]
    fn an_oblique_plane_keeps_its_place_over_twenty_keyframes() {
        let config = DepthConfig::default();
        // plane 1 = 0.9 z + 0.5 x in the first camera: idepth = 0.9 + 0.5 m_x, exactly linear
        let host = textured();
        let depth = GrayImage::from_fn(SIZE.0, SIZE.1, |x, _| {
            1.0 / (0.9 + 0.5 * (x as f32 - 47.5) / 90.0)
        });
        let mut map = DepthMap::empty(host, &config);
        map.initialize_from_depth(&depth, 0.01);
        let step = Se3::new(
            Rotation::from_euler_angles(0.0, 0.0, 0.004),
            Vec3::new(0.0011, 0.0007, 0.003),
        );
        let mut world = Se3::identity();
        for _ in 0..20 {
            map = map.propagate(textured(), &step, &config);
            world = step * world;
        }
        let back = world.inverse();
        let (mut sum, mut num) = (0.0, 0);
        for p in map.pixels(crate::PixelFilter::default()) {
            // away from the border, where new pixels see one side only
            if !(20..76).contains(&p.x) || !(20..52).contains(&p.y) {
                continue;
            }
            let ray = map
                .host
                .pinhole
                .unproject(&Vec2::new(f64::from(p.x), f64::from(p.y)));
            // truth: intersect with the plane in the first camera
            let (r, t) = (back.rotation * ray, back.translation);
            let z = (1.0 - 0.9 * t.z - 0.5 * t.x) / (0.9 * r.z + 0.5 * r.x);
            sum += f64::from(p.idepth) * z - 1.0;
            num += 1;
        }
        assert!(num > 1000, "{num} left");
        let bias = sum / f64::from(num);
        assert!(bias.abs() < 1e-3, "{bias} after 20 keyframes");
    }

    fn at(idepth: f32, validity: u8, x: f32) -> Warped {
        Warped {
            x,
            y: 10.0,
            idepth,
            var: 1e-4,
            validity,
            next: NONE,
        }
    }

    #[test]
    fn the_nearer_surface_hides_the_other_but_a_lone_outlier_does_not() {
        let config = DepthConfig::default();
        let surface = [at(1.0, 40, 9.8), at(1.01, 40, 10.3), at(0.5, 40, 10.1)];
        let front = merge((10, 10), &surface, &config).expect("visible");
        assert!((front.idepth - 1.0).abs() < 0.02, "{front:?}");
        let outlier = [at(1.0, 0, 9.8), at(0.5, 40, 10.2), at(0.505, 40, 10.1)];
        let back = merge((10, 10), &outlier, &config).expect("visible");
        assert!((back.idepth - 0.5).abs() < 0.02, "{back:?}");
        // LSD-SLAM's rule
        let thesis = merge((10, 10), &outlier, &DepthConfig::thesis());
        assert!((thesis.expect("visible").idepth - 1.0).abs() < 0.02);
    }

    #[test]
    fn depth_behind_the_camera_or_outside_is_dropped() {
        let config = DepthConfig::default();
        let mut map = DepthMap::empty(textured(), &config);
        map.initialize_constant(1.0, 1e-3);
        let through = Se3::new(Rotation::identity(), Vec3::new(0.0, 0.0, -1.5));
        assert_eq!(map.propagate(textured(), &through, &config).num_known(), 0);
        let away = Se3::new(Rotation::identity(), Vec3::new(5.0, 0.0, 0.0));
        let next = map.propagate(textured(), &away, &config);
        assert_eq!(next.num_known(), 0);
        assert_eq!(next.at(40, 40), None);
    }
}
