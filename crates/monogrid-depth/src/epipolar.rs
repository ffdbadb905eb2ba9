//! Geometry of one stereo frame: where a keyframe pixel lies in it as a function of inverse depth.
//!
//! With `a = K R K⁻¹ p` and `b = K t` the pixel of inverse depth `d` projects to `h = a + d b`, and
//! `h_z = z_frame / z_keyframe`. Hence it moves on a line of constant direction
//! `q = (b_x a_z - a_x b_z, b_y a_z - a_y b_z)`, at the distance `s(d) = d |q| / (a_z h_z)` from
//! the projection of the point at infinity.

use crate::observe::StereoFrame;
use monogrid_geometry::{Mat3, Pinhole};

/// Smallest `a_z`: beyond it the point at infinity leaves the field of view of any pinhole camera.
const MIN_INFINITY_Z: f32 = 0.2;

/// Precomputed single-precision geometry of a frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FrameGeometry {
    /// `K R K⁻¹`, row-major.
    homography: [f32; 9],
    /// `K t`.
    translation: [f32; 3],
    /// Centre of the frame in the keyframe as `(fx x, fy y, z)`.
    centre: [f32; 3],
    /// Principal point of the keyframe.
    principal: [f32; 2],
    /// Focal length, px (mean of both axes).
    pub(crate) focal: f32,
}

/// The epipolar line of one pixel in a frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EpipolarLine {
    /// Pixel of the point at infinity.
    pub(crate) infinity: [f32; 2],
    /// Unit direction of growing inverse depth.
    pub(crate) direction: [f32; 2],
    a_z: f32,
    b_z: f32,
    q_norm: f32,
}

impl FrameGeometry {
    pub(crate) fn new(frame: &StereoFrame<'_>, pinhole: &Pinhole) -> Self {
        let k = Mat3::new(
            pinhole.fx, 0.0, pinhole.cx, 0.0, pinhole.fy, pinhole.cy, 0.0, 0.0, 1.0,
        );
        let [x, y] = [-pinhole.cx / pinhole.fx, -pinhole.cy / pinhole.fy];
        let [inv_fx, inv_fy] = [1.0 / pinhole.fx, 1.0 / pinhole.fy];
        let k_inv = Mat3::new(inv_fx, 0.0, x, 0.0, inv_fy, y, 0.0, 0.0, 1.0);
        let pose = &frame.frame_from_keyframe;
        let h = k * pose.rotation_matrix() * k_inv;
        let t = k * pose.translation;
        let centre = pose.inverse().translation;
        Self {
            homography: std::array::from_fn(|i| h[(i / 3, i % 3)] as f32),
            translation: [t.x as f32, t.y as f32, t.z as f32],
            centre: [
                (pinhole.fx * centre.x) as f32,
                (pinhole.fy * centre.y) as f32,
                centre.z as f32,
            ],
            principal: [pinhole.cx as f32, pinhole.cy as f32],
            focal: (0.5 * (pinhole.fx + pinhole.fy)) as f32,
        }
    }

    /// Direction (not normalised) of the epipolar line in the keyframe: towards the frame's centre.
    #[inline]
    pub(crate) fn keyframe_direction(&self, x: f32, y: f32) -> [f32; 2] {
        [
            self.centre[0] - self.centre[2] * (x - self.principal[0]),
            self.centre[1] - self.centre[2] * (y - self.principal[1]),
        ]
    }

    /// `K R K⁻¹ p`.
    #[inline]
    fn at_infinity(&self, x: f32, y: f32) -> [f32; 3] {
        let m = &self.homography;
        [0, 3, 6].map(|row| m[row] * x + m[row + 1] * y + m[row + 2])
    }

    /// Where keyframe pixel `(x, y)` at inverse depth `idepth` lies in the frame, px; `None` where
    /// it is not in front of it.
    #[inline]
    pub(crate) fn project(&self, x: f32, y: f32, idepth: f32) -> Option<[f32; 2]> {
        let a = self.at_infinity(x, y);
        let h: [f32; 3] = std::array::from_fn(|i| a[i] + idepth * self.translation[i]);
        (h[2] > MIN_INFINITY_Z).then(|| [h[0] / h[2], h[1] / h[2]])
    }

    /// `alpha²` of keyframe pixel `(x, y)` at inverse depth `idepth`: the square of
    /// [`EpipolarLine::alpha`] without setting up the line.
    #[inline]
    pub(crate) fn alpha_sq(&self, x: f32, y: f32, idepth: f32) -> f32 {
        let a = self.at_infinity(x, y);
        let b = &self.translation;
        let q = [b[0] * a[2] - a[0] * b[2], b[1] * a[2] - a[1] * b[2]];
        let hz_sq = (a[2] + idepth * b[2]).powi(2);
        hz_sq * hz_sq / (q[0] * q[0] + q[1] * q[1])
    }

    /// The epipolar line of keyframe pixel `(x, y)`; `None` without baseline or when the pixel at
    /// infinity is not in front of the frame.
    #[inline]
    pub(crate) fn line(&self, x: f32, y: f32) -> Option<EpipolarLine> {
        let a = self.at_infinity(x, y);
        let b = &self.translation;
        if a[2] < MIN_INFINITY_Z {
            return None;
        }
        let q = [b[0] * a[2] - a[0] * b[2], b[1] * a[2] - a[1] * b[2]];
        let q_norm = (q[0] * q[0] + q[1] * q[1]).sqrt();
        if q_norm < 1e-6 {
            return None;
        }
        let (inv_z, inv_q) = (1.0 / a[2], 1.0 / q_norm);
        Some(EpipolarLine {
            infinity: [a[0] * inv_z, a[1] * inv_z],
            direction: [q[0] * inv_q, q[1] * inv_q],
            a_z: a[2],
            b_z: b[2],
            q_norm,
        })
    }

    /// How far the match moves along `line`, per px that the keyframe pixel moves along the unit
    /// vector `direction` at constant inverse depth; negative when against the line.
    #[inline]
    pub(crate) fn stretch(&self, line: &EpipolarLine, idepth: f32, direction: [f32; 2]) -> f32 {
        let m = &self.homography;
        let [dx, dy] = direction;
        let v = [0, 3, 6].map(|row| m[row] * dx + m[row + 1] * dy);
        let inv_hz = 1.0 / line.depth_ratio(idepth);
        let [u, w] = line.pixel(line.position(idepth));
        // derivative of h_x / h_z
        let du = (v[0] - u * v[2]) * inv_hz;
        let dw = (v[1] - w * v[2]) * inv_hz;
        du * line.direction[0] + dw * line.direction[1]
    }
}

impl EpipolarLine {
    /// `h_z = z_frame / z_keyframe` at inverse depth `idepth`.
    #[inline]
    pub(crate) fn depth_ratio(&self, idepth: f32) -> f32 {
        self.a_z + idepth * self.b_z
    }

    /// Distance along the line from the point at infinity, px.
    #[inline]
    pub(crate) fn position(&self, idepth: f32) -> f32 {
        idepth * self.q_norm / (self.a_z * self.depth_ratio(idepth))
    }

    /// Inverse of [`Self::position`]; `None` beyond the vanishing point of the line.
    #[inline]
    pub(crate) fn idepth(&self, position: f32) -> Option<f32> {
        let denominator = self.q_norm - position * self.a_z * self.b_z;
        (denominator > 1e-3 * self.q_norm).then(|| position * self.a_z * self.a_z / denominator)
    }

    /// Change of inverse depth per px along the line at inverse depth `idepth`.
    #[inline]
    pub(crate) fn alpha(&self, idepth: f32) -> f32 {
        let hz = self.depth_ratio(idepth);
        hz * hz / self.q_norm
    }

    /// Largest inverse depth, at most `idepth`, whose depth ratio stays above `min_ratio`.
    #[inline]
    pub(crate) fn limit_in_front(&self, idepth: f32, min_ratio: f32) -> f32 {
        if self.b_z < 0.0 {
            idepth.min((self.a_z - min_ratio) / -self.b_z)
        } else {
            idepth
        }
    }

    /// Pixel in the frame at a position on the line.
    #[inline]
    pub(crate) fn pixel(&self, position: f32) -> [f32; 2] {
        [0, 1].map(|axis| self.infinity[axis] + position * self.direction[axis])
    }

    /// The part of `[from, to]` whose pixels lie inside the image shrunk by `border` px.
    pub(crate) fn clip(
        &self,
        interval: (f32, f32),
        size: (usize, usize),
        border: f32,
    ) -> Option<(f32, f32)> {
        let (mut from, mut to) = interval;
        for (axis, length) in [size.0, size.1].into_iter().enumerate() {
            let (low, high) = (border, length as f32 - 1.0 - border);
            let (p, v) = (self.infinity[axis], self.direction[axis]);
            if v.abs() < 1e-6 {
                if p < low || p > high {
                    return None;
                }
                continue;
            }
            let (s0, s1) = ((low - p) / v, (high - p) / v);
            from = from.max(s0.min(s1));
            to = to.min(s0.max(s1));
        }
        (from <= to).then_some((from, to))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::{Rotation, Se3, Vec2, Vec3};
    use monogrid_image::GrayImage;

    fn cases() -> Vec<(FrameGeometry, Pinhole, Se3)> {
        let pinhole = Pinhole::new(481.2, 480.0, 319.5, 239.5);
        let motions = [
            ([0.1, 0.0, 0.0], [0.0, 0.0, 0.0]),
            ([-0.02, 0.08, 0.01], [0.02, -0.05, 0.1]),
            ([0.0, 0.01, 0.2], [0.0, 0.03, 0.0]),
            ([0.03, 0.02, -0.2], [-0.1, 0.2, 0.3]),
        ];
        let image = GrayImage::filled(640, 480, 0.0);
        motions
            .into_iter()
            .map(|(t, r)| {
                let rotation = Rotation::from_euler_angles(r[0], r[1], r[2]);
                let frame_from_keyframe = Se3::new(rotation, Vec3::from(t));
                let frame = StereoFrame {
                    image: &image,
                    frame_from_keyframe,
                    gain: 1.0,
                    bias: 0.0,
                    residual_rms: 0.0,
                    pose_sigma_trans: 0.0,
                    pose_sigma_rot: 0.0,
                    id: 0,
                };
                (
                    FrameGeometry::new(&frame, &pinhole),
                    pinhole,
                    frame_from_keyframe,
                )
            })
            .collect()
    }

    /// The same in double precision, point by point.
    fn project(pinhole: &Pinhole, pose: &Se3, x: f64, y: f64, idepth: f64) -> (Vec2, f64) {
        let point = *pose * (pinhole.unproject(&Vec2::new(x, y)) / idepth);
        (pinhole.project(&point), point.z * idepth)
    }

    const PIXELS: [(f32, f32); 4] = [(20.0, 30.0), (319.0, 240.0), (600.0, 100.0), (77.0, 455.0)];

    #[test]
    fn positions_on_the_line_are_projections() {
        for (geometry, pinhole, pose) in cases() {
            for (x, y) in PIXELS {
                let line = geometry.line(x, y).expect("baseline");
                for idepth in [0.05f32, 0.4, 1.0, 2.5] {
                    let (truth, ratio) =
                        project(&pinhole, &pose, x.into(), y.into(), idepth.into());
                    let [u, v] = line.pixel(line.position(idepth));
                    assert!((f64::from(u) - truth.x).abs() < 2e-3, "{u} {truth}");
                    assert!((f64::from(v) - truth.y).abs() < 2e-3, "{v} {truth}");
                    assert!((f64::from(line.depth_ratio(idepth)) - ratio).abs() < 1e-5);
                    let back = line.idepth(line.position(idepth)).expect("in front");
                    assert!(
                        (back - idepth).abs() < 1e-4 * idepth.max(0.5),
                        "{back} {idepth}"
                    );
                }
            }
        }
    }

    #[test]
    fn alpha_and_stretch_are_the_numeric_derivatives() {
        for (geometry, pinhole, pose) in cases() {
            for (x, y) in PIXELS {
                let line = geometry.line(x, y).expect("baseline");
                for idepth in [0.2f64, 1.0, 2.0] {
                    let (step, d) = (1e-5, idepth as f32);
                    let (px, py) = (f64::from(x), f64::from(y));
                    let at = |dx: f64, dy: f64, dd: f64| {
                        project(&pinhole, &pose, px + dx, py + dy, idepth + dd).0
                    };
                    let speed = (at(0.0, 0.0, step) - at(0.0, 0.0, -step)).norm() / (2.0 * step);
                    let alpha = f64::from(line.alpha(d));
                    assert!((alpha * speed - 1.0).abs() < 1e-3, "{alpha} {speed}");
                    let quick = f64::from(geometry.alpha_sq(x, y, d)).sqrt();
                    assert!((quick / alpha - 1.0).abs() < 1e-3);
                    let [ex, ey] = geometry.keyframe_direction(x, y);
                    let norm = ex.hypot(ey);
                    let (ex, ey) = (ex / norm, ey / norm);
                    let h = 1e-3;
                    let moved = (at(h * f64::from(ex), h * f64::from(ey), 0.0)
                        - at(-h * f64::from(ex), -h * f64::from(ey), 0.0))
                        / (2.0 * h);
                    let [lx, ly] = line.direction;
                    let along = moved.x * f64::from(lx) + moved.y * f64::from(ly);
                    let across = moved.x * f64::from(ly) - moved.y * f64::from(lx);
                    let stretch = f64::from(geometry.stretch(&line, d, [ex, ey]));
                    assert!((stretch - along).abs() < 2e-3, "{stretch} {along}");
                    // epipolar lines map onto epipolar lines
                    assert!(across.abs() < 2e-3, "{across}");
                }
            }
        }
    }

    #[test]
    fn clipping_keeps_exactly_the_visible_part() {
        for (geometry, ..) in cases() {
            for (x, y) in PIXELS {
                let line = geometry.line(x, y).expect("baseline");
                let inside = |s: f32| {
                    let [u, v] = line.pixel(s);
                    (5.0..=634.0).contains(&u) && (5.0..=474.0).contains(&v)
                };
                let clipped = line.clip((-50.0, 400.0), (640, 480), 5.0);
                for k in 0..=900 {
                    let s = -50.0 + 0.5 * k as f32;
                    let kept = clipped.is_some_and(|(from, to)| s >= from && s <= to);
                    let near_end = clipped
                        .is_some_and(|(from, to)| (s - from).abs() < 0.01 || (s - to).abs() < 0.01);
                    assert!(kept == inside(s) || near_end, "{s} {clipped:?}");
                }
            }
        }
    }

    #[test]
    fn without_baseline_there_is_no_line() {
        let (_, pinhole, _) = cases()[0];
        let image = GrayImage::filled(640, 480, 0.0);
        let frame = StereoFrame {
            image: &image,
            frame_from_keyframe: Se3::identity(),
            gain: 1.0,
            bias: 0.0,
            residual_rms: 0.0,
            pose_sigma_trans: 0.0,
            pose_sigma_rot: 0.0,
            id: 0,
        };
        assert!(
            FrameGeometry::new(&frame, &pinhole)
                .line(100.0, 100.0)
                .is_none()
        );
    }
}
