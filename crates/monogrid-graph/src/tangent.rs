//! Inverse left Jacobian of the logarithm on Sim(3).
//!
//! `log(exp(d) T) = log(T) + J_l^-1(log T) d` to first order, with
//! `J_l(x) = sum ad(x)^n / (n + 1)!` for any Lie group. LSD-SLAM puts the identity in its place,
//! which is wrong by half the residual and stalls loops with a large error.

use monogrid_geometry::{Mat7, Vec3, Vec7, hat};

/// Matrix of the Lie bracket on Sim(3) for the tangent order `[v, w, s]`.
pub(crate) fn sim3_bracket(x: &Vec7) -> Mat7 {
    let (v, w) = (Vec3::new(x[0], x[1], x[2]), Vec3::new(x[3], x[4], x[5]));
    let mut ad = Mat7::zeros();
    let turn_and_grow = hat(&w) + monogrid_geometry::Mat3::identity() * x[6];
    ad.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn_and_grow);
    ad.fixed_view_mut::<3, 3>(0, 3).copy_from(&hat(&v));
    ad.fixed_view_mut::<3, 1>(0, 6).copy_from(&-v);
    ad.fixed_view_mut::<3, 3>(3, 3).copy_from(&hat(&w));
    ad
}

/// `d log(exp(d) T) / d d` at zero for `log T = x` on Sim(3).
pub(crate) fn sim3_left_jacobian_inverse(x: &Vec7) -> Mat7 {
    inverse_of_series(&sim3_bracket(x))
}

/// Inverse of `phi(A) = sum A^n / (n + 1)! = (e^A - 1) / A`.
fn inverse_of_series(a: &Mat7) -> Mat7 {
    let size = a.norm();
    if size < 0.1 {
        // x / (e^x - 1) = 1 - x/2 + x^2/12 - x^4/720 + x^6/30240 - …, Bernoulli's numbers.
        let a2 = a * a;
        let inner = Mat7::identity() / 720.0 - a2 / 30240.0;
        return Mat7::identity() - a * 0.5 + a2 * (Mat7::identity() / 12.0 - a2 * inner);
    }
    // Far out the series above diverges (at 2 pi). phi halves well:
    // phi(A) = phi(A/2) (e^(A/2) + 1) / 2, and e^(A/2) = 1 + phi(A/2) A/2.
    let halvings = (size / 0.25).log2().ceil().max(0.0) as i32;
    let mut b = a * 0.5_f64.powi(halvings);
    let mut phi = Mat7::identity();
    for n in (1..=12).rev() {
        phi = Mat7::identity() + b * phi / f64::from(n + 1);
    }
    for _ in 0..halvings {
        let exp = Mat7::identity() + phi * b;
        phi = phi * (exp + Mat7::identity()) * 0.5;
        b *= 2.0;
    }
    // Singular only for a rotation by a multiple of 2 pi, which no logarithm returns.
    phi.try_inverse()
        .unwrap_or_else(|| Mat7::identity() - a * 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::Sim3;

    #[test]
    fn the_inverse_jacobian_is_the_derivative_of_the_logarithm() {
        let directions = [
            [0.3, -0.7, 0.2, 0.5, 0.1, -0.4, 0.3],
            [1.0, 2.0, -3.0, 0.0, 0.0, 1.0, -0.5],
            [0.0, 0.0, 0.0, -0.6, 0.8, 0.0, 0.0],
        ];
        let sizes = [0.0, 1e-9, 1e-3, 0.05, 0.11, 0.9, 2.9];
        assert_eq!(directions.len() * sizes.len(), 21);
        let h = 1e-6;
        for direction in directions {
            for size in sizes {
                let x7 = Vec7::from(direction) * size;
                let t7 = Sim3::exp(&x7);
                let j7 = sim3_left_jacobian_inverse(&x7);
                for i in 0..7 {
                    let mut d = Vec7::zeros();
                    d[i] = h;
                    let plus = (Sim3::exp(&d) * t7).log();
                    let minus = (Sim3::exp(&-d) * t7).log();
                    let error = ((plus - minus) / (2.0 * h) - j7.column(i)).norm();
                    assert!(error < 1e-8 * (1.0 + j7.norm()), "{error:e} at {x7}");
                }
            }
        }
    }
}
