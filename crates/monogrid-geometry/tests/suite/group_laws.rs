//! Laws that SE(3) and Sim(3) must obey, over lists of examples that include every branch of the
//! formulas: identity, series next to closed form, near pi, tiny and huge scales.

use crate::common::{Random, matrix4, rotation_vectors, se3_examples, se3_tangents};
use crate::common::{sim3_examples, sim3_tangents};
use monogrid_geometry::{
    Mat3, Mat6, Mat7, Se3, Sim3, Vec3, Vec6, Vec7, hat, left_jacobian, left_jacobian_inverse,
    rotation_exp, rotation_log,
};
use nalgebra::Matrix4;

/// Group elements as plain numbers, with the sign of the quaternion made unique by the matrix.
fn numbers(t: &Sim3) -> Matrix4<f64> {
    matrix4(t)
}

fn numbers_rigid(t: &Se3) -> Matrix4<f64> {
    matrix4(&Sim3::from(*t))
}

#[test]
fn example_lists_have_the_length_the_suites_rely_on() {
    assert_eq!(rotation_vectors().len(), 50);
    assert_eq!(se3_tangents().len(), 200);
    assert_eq!(sim3_tangents().len(), 650);
    assert_eq!(se3_examples().len(), 51);
    assert_eq!(sim3_examples().len(), 51);
}

#[test]
fn rotation_exp_log_round_trips() {
    for w in rotation_vectors() {
        assert_close!(rotation_log(&rotation_exp(&w)), w, 1e-12);
    }
}

#[test]
fn rotation_log_takes_the_short_way_for_both_quaternions() {
    for w in rotation_vectors() {
        let q = rotation_exp(&w);
        let opposite = monogrid_geometry::Rotation::new_unchecked(-q.into_inner());
        assert_close!(rotation_log(&opposite), w, 1e-12);
    }
}

#[test]
fn rotation_of_exactly_pi_round_trips_as_a_rotation() {
    for axis in [Vec3::x(), Vec3::y(), Vec3::z()] {
        let q = rotation_exp(&(axis * std::f64::consts::PI));
        let w = rotation_log(&q);
        assert_close!(
            rotation_exp(&w).to_rotation_matrix().into_inner(),
            q.to_rotation_matrix().into_inner(),
            1e-12
        );
        assert!(w.norm() <= std::f64::consts::PI + 1e-12);
    }
}

#[test]
fn se3_exp_log_round_trips() {
    for d in se3_tangents() {
        assert_close!(Se3::exp(&d).log(), d, 1e-12);
    }
}

#[test]
fn sim3_exp_log_round_trips() {
    for d in sim3_tangents() {
        assert_close!(Sim3::exp(&d).log(), d, 1e-12, "tangent {d}");
    }
}

#[test]
fn sim3_round_trips_over_log_uniform_arguments() {
    let mut random = Random(77);
    for _ in 0..20_000 {
        let magnitude = |random: &mut Random| 10_f64.powf(random.signed() * 7.5 - 7.0);
        let angle = magnitude(&mut random).min(3.1);
        let s = magnitude(&mut random).min(2.0) * random.signed().signum();
        let v = random.direction() * magnitude(&mut random);
        let w = random.direction() * angle;
        let d = Vec7::from_column_slice(&[v.x, v.y, v.z, w.x, w.y, w.z, s]);
        assert_close!(Sim3::exp(&d).log(), d, 1e-12, "tangent {d}");
    }
}

#[test]
fn exponentials_equal_the_matrix_exponential_of_the_generator() {
    // The oracle is nalgebra's Padé approximation with scaling and squaring (Higham 2005).
    for d in sim3_tangents() {
        let mut generator = Matrix4::zeros();
        let w = Vec3::new(d[3], d[4], d[5]);
        let block = hat(&w) + Mat3::identity() * d[6];
        generator.fixed_view_mut::<3, 3>(0, 0).copy_from(&block);
        for i in 0..3 {
            generator[(i, 3)] = d[i];
        }
        // Its error grows with the norm of the result.
        assert_close!(
            numbers(&Sim3::exp(&d)),
            generator.exp(),
            1e-13,
            "tangent {d}"
        );
    }
    for d in se3_tangents() {
        let mut generator = Matrix4::zeros();
        let w = Vec3::new(d[3], d[4], d[5]);
        generator.fixed_view_mut::<3, 3>(0, 0).copy_from(&hat(&w));
        for i in 0..3 {
            generator[(i, 3)] = d[i];
        }
        assert_close!(numbers_rigid(&Se3::exp(&d)), generator.exp(), 1e-13);
    }
}

#[test]
fn translations_of_small_scales_are_accurate_relative_to_themselves() {
    // V(w, s) by composite Simpson integration of exp(t (s I + hat w)), relative to its own size.
    for d in sim3_tangents() {
        let (w, s) = (Vec3::new(d[3], d[4], d[5]), d[6]);
        let v = Vec3::new(0.3, -0.8, 0.5);
        let n = 4000;
        let mut integral = Vec3::zeros();
        for i in 0..=n {
            let x = f64::from(i) / f64::from(n);
            let weight = match i {
                0 => 1.0,
                i if i == n => 1.0,
                i if i % 2 == 1 => 4.0,
                _ => 2.0,
            };
            integral += rotation_exp(&(w * x)) * v * ((s * x).exp() * weight);
        }
        integral /= 3.0 * f64::from(n);
        let tangent = Vec7::from_column_slice(&[v.x, v.y, v.z, w.x, w.y, w.z, s]);
        let translation = Sim3::exp(&tangent).translation;
        let error = (translation - integral).norm() / integral.norm();
        assert!(error < 1e-11, "relative error {error:e} at {d}");
    }
}

#[test]
fn composition_is_that_of_matrices_and_associative() {
    let examples = sim3_examples();
    for (i, a) in examples.iter().enumerate() {
        let b = &examples[(i * 7 + 3) % examples.len()];
        let c = &examples[(i * 11 + 5) % examples.len()];
        assert_close!(numbers(&(*a * *b)), matrix4(a) * matrix4(b), 1e-14);
        assert_close!(
            numbers(&((*a * *b) * *c)),
            numbers(&(*a * (*b * *c))),
            1e-13
        );
        let p = Vec3::new(0.4, -2.0, 1.5);
        assert_close!((*a * *b) * p, *a * (*b * p), 1e-13);
    }
    let examples = se3_examples();
    for (i, a) in examples.iter().enumerate() {
        let b = &examples[(i * 7 + 3) % examples.len()];
        let c = &examples[(i * 11 + 5) % examples.len()];
        let product = Sim3::from(*a * *b);
        assert_close!(
            numbers(&product),
            numbers(&(Sim3::from(*a) * Sim3::from(*b))),
            1e-14
        );
        assert_close!(
            numbers_rigid(&((*a * *b) * *c)),
            numbers_rigid(&(*a * (*b * *c))),
            1e-13
        );
    }
}

#[test]
fn inverse_undoes_on_both_sides_and_reverses_products() {
    let examples = sim3_examples();
    for (i, a) in examples.iter().enumerate() {
        let b = &examples[(i * 5 + 1) % examples.len()];
        assert_close!(numbers(&(*a * a.inverse())), Matrix4::identity(), 1e-14);
        assert_close!(numbers(&(a.inverse() * *a)), Matrix4::identity(), 1e-13);
        let reversed = b.inverse() * a.inverse();
        assert_close!(numbers(&(*a * *b).inverse()), numbers(&reversed), 1e-13);
        assert_close!((a.inverse()).log(), -a.log(), 1e-12);
    }
    for a in se3_examples() {
        assert_close!(
            numbers_rigid(&(a * a.inverse())),
            Matrix4::identity(),
            1e-14
        );
        assert_close!(
            numbers_rigid(&(a.inverse() * a)),
            Matrix4::identity(),
            1e-14
        );
    }
}

#[test]
fn adjoint_moves_a_tangent_to_the_other_side() {
    let mut random = Random(8);
    for a in sim3_examples() {
        let mut d = Vec7::from_fn(|_, _| random.signed());
        d[6] *= 0.5;
        let left = Sim3::exp(&(a.adjoint() * d)) * a;
        assert_close!(numbers(&(a * Sim3::exp(&d))), numbers(&left), 1e-12);
    }
    for a in se3_examples() {
        let d = Vec6::from_fn(|_, _| random.signed());
        let left = Se3::exp(&(a.adjoint() * d)) * a;
        assert_close!(
            numbers_rigid(&(a * Se3::exp(&d))),
            numbers_rigid(&left),
            1e-12
        );
    }
}

#[test]
fn adjoint_is_a_homomorphism() {
    let examples = sim3_examples();
    for (i, a) in examples.iter().enumerate() {
        let b = &examples[(i * 3 + 2) % examples.len()];
        assert_close!((*a * *b).adjoint(), a.adjoint() * b.adjoint(), 1e-13);
        let product: Mat7 = a.adjoint() * a.inverse().adjoint();
        assert_close!(product, Mat7::identity(), 1e-12);
    }
    for a in se3_examples() {
        let product: Mat6 = a.adjoint() * a.inverse().adjoint();
        assert_close!(product, Mat6::identity(), 1e-12);
    }
}

#[test]
fn left_jacobian_is_the_derivative_of_the_exponential() {
    for w in rotation_vectors() {
        let mut numeric = Mat3::zeros();
        let h = 1e-5;
        for i in 0..3 {
            let mut d = Vec3::zeros();
            d[i] = h;
            let back = rotation_exp(&w).inverse();
            let plus = rotation_log(&(rotation_exp(&(w + d)) * back));
            let minus = rotation_log(&(rotation_exp(&(w - d)) * back));
            numeric.set_column(i, &((plus - minus) / (2.0 * h)));
        }
        assert_close!(left_jacobian(&w), numeric, 1e-9, "rotation vector {w}");
        let product = left_jacobian(&w) * left_jacobian_inverse(&w);
        assert_close!(product, Mat3::identity(), 1e-12);
    }
}

#[test]
fn interpolation_keeps_the_ends_and_the_middle_is_half_way() {
    let examples = se3_examples();
    for (i, a) in examples.iter().enumerate() {
        let b = &examples[(i * 3 + 7) % examples.len()];
        assert_close!(
            numbers_rigid(&a.interpolate(b, 0.0)),
            numbers_rigid(a),
            1e-13
        );
        assert_close!(
            numbers_rigid(&a.interpolate(b, 1.0)),
            numbers_rigid(b),
            1e-12
        );
        let middle = a.interpolate(b, 0.5);
        let (first, second) = (middle * a.inverse(), *b * middle.inverse());
        assert_close!(first.log(), second.log(), 1e-9);
    }
}

#[test]
fn long_products_stay_on_the_group() {
    let step = Se3::exp(&Vec6::new(0.01, -0.02, 0.03, 0.3, -0.2, 0.5));
    let mut product = Se3::identity();
    for _ in 0..1_000_000 {
        product = product * step;
    }
    let r = product.rotation_matrix();
    assert_close!(r * r.transpose(), Mat3::identity(), 1e-14);
    assert!((product.rotation.coords.norm() - 1.0).abs() < 1e-15);
}

#[test]
fn bad_numbers_are_noticed() {
    assert!(Sim3::identity().is_finite());
    for scale in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(!Sim3::new(scale, Sim3::identity().rotation, Vec3::zeros()).is_finite());
    }
    let bad = Vec3::new(f64::NAN, 0.0, 0.0);
    assert!(!Se3::new(Se3::identity().rotation, bad).is_finite());
}
