//! Comparisons and example lists that several test files share.

use monogrid_geometry::{Se3, Sim3, Vec3, Vec6, Vec7, rotation_exp};
use std::f64::consts::PI;

/// Absolute and relative comparison that no NaN passes.
#[macro_export]
macro_rules! assert_close {
    ($a:expr, $b:expr, $tolerance:expr) => {
        $crate::assert_close!($a, $b, $tolerance, "")
    };
    ($a:expr, $b:expr, $tolerance:expr, $($context:tt)*) => {{
        let (a, b) = (&$a, &$b);
        assert_eq!(a.len(), b.len());
        let size = a.iter().chain(b.iter()).fold(1.0_f64, |m, x| m.max(x.abs()));
        let worst = a.iter().zip(b.iter()).fold(0.0_f64, |m, (x, y)| {
            let error = (x - y).abs() / size;
            if error.is_nan() { f64::INFINITY } else { m.max(error) }
        });
        assert!(
            worst <= $tolerance,
            "differ by {worst:e} (relative to {size:e}), allowed {:e}\n{a}\n{b}\n{}",
            $tolerance,
            format!($($context)*)
        );
    }};
}

/// Deterministic pseudo-random numbers (Steele's splitmix64), enough for tests.
pub struct Random(pub u64);

impl Random {
    /// Uniform in [-1, 1).
    pub fn signed(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^= z >> 31;
        (z >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    /// Vector with entries in [-1, 1).
    pub fn vec3(&mut self) -> Vec3 {
        Vec3::new(self.signed(), self.signed(), self.signed())
    }

    /// Unit vector.
    pub fn direction(&mut self) -> Vec3 {
        loop {
            let v = self.vec3();
            if v.norm() > 0.1 && v.norm() < 1.0 {
                return v / v.norm();
            }
        }
    }
}

/// Rotation angles at which closed forms and series meet or a branch is near.
pub const ANGLES: [f64; 14] = [
    0.0, 1e-300, 1e-12, 1e-7, 0.99e-6, 1.01e-6, 0.99e-4, 1.01e-4, 1e-3, 0.049, 0.051, 1.0, 2.5, 3.1,
];

/// Logarithms of scales, from a factor of a millionth to a million.
pub const LOG_SCALES: [f64; 13] = [
    0.0, 1e-300, -1e-12, 1e-8, -1e-5, 1e-3, 0.049, -0.051, 0.7, -2.0, 5.0, -13.8, 13.8,
];

/// Rotation vectors: every angle of [`ANGLES`] along a few directions, and right up to pi.
pub fn rotation_vectors() -> Vec<Vec3> {
    let mut random = Random(1);
    let mut out = vec![];
    for angle in ANGLES {
        out.push(Vec3::x() * angle);
        out.push(-Vec3::z() * angle);
        out.push(random.direction() * angle);
    }
    for gap in [1e-2, 1e-4, 1e-6, 1e-9] {
        out.push(random.direction() * (PI - gap));
        out.push(Vec3::y() * (PI - gap));
    }
    out
}

/// Tangents of SE(3).
pub fn se3_tangents() -> Vec<Vec6> {
    let mut random = Random(2);
    let mut out = vec![];
    for w in rotation_vectors() {
        for length in [0.0, 1e-9, 1.0, 50.0] {
            let v = random.direction() * length;
            out.push(Vec6::new(v.x, v.y, v.z, w.x, w.y, w.z));
        }
    }
    out
}

/// Tangents of Sim(3): every rotation with every scale.
pub fn sim3_tangents() -> Vec<Vec7> {
    let mut random = Random(3);
    let mut out = vec![];
    for (i, w) in rotation_vectors().iter().enumerate() {
        for s in LOG_SCALES {
            let v = random.direction() * [0.0, 1e-6, 1.0, 10.0][i % 4];
            out.push(Vec7::from_column_slice(&[v.x, v.y, v.z, w.x, w.y, w.z, s]));
        }
    }
    out
}

/// A few general rigid transforms.
pub fn se3_examples() -> Vec<Se3> {
    let mut random = Random(4);
    let mut out = vec![Se3::identity()];
    for w in rotation_vectors() {
        out.push(Se3::new(rotation_exp(&w), random.vec3() * 3.0));
    }
    out
}

/// A few general similarities.
pub fn sim3_examples() -> Vec<Sim3> {
    let mut random = Random(5);
    let mut out = vec![Sim3::identity()];
    for w in rotation_vectors() {
        let scale = (random.signed() * 2.0).exp();
        out.push(Sim3::new(scale, rotation_exp(&w), random.vec3() * 3.0));
    }
    out
}

/// Homogeneous 4x4 matrix of a similarity.
pub fn matrix4(t: &Sim3) -> nalgebra::Matrix4<f64> {
    let mut m = nalgebra::Matrix4::identity();
    let r = t.rotation.to_rotation_matrix().into_inner();
    m.fixed_view_mut::<3, 3>(0, 0).copy_from(&(r * t.scale));
    m.fixed_view_mut::<3, 1>(0, 3).copy_from(&t.translation);
    m
}
