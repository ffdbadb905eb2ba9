//! Similarity alignment: exact on exact data, no better neighbour on noisy data, honest on bad
//! data.

use crate::common::{Random, matrix4, sim3_examples};
use monogrid_geometry::{AlignmentError, Sim3, Vec3, Vec7, align_similarity};

fn cloud(random: &mut Random, n: usize) -> Vec<Vec3> {
    (0..n)
        .map(|_| random.vec3().component_mul(&Vec3::new(3.0, 1.0, 0.2)))
        .collect()
}

fn cost(t: &Sim3, source: &[Vec3], target: &[Vec3]) -> f64 {
    let pairs = source.iter().zip(target);
    pairs.map(|(s, t2)| (*t * *s - t2).norm_squared()).sum()
}

#[test]
fn exact_pairs_give_the_exact_similarity() {
    let mut random = Random(21);
    for truth in sim3_examples() {
        for n in [3, 4, 50] {
            let source = cloud(&mut random, n);
            let target: Vec<_> = source.iter().map(|p| truth * *p).collect();
            let fit = align_similarity(&source, &target, true).unwrap();
            assert_close!(matrix4(&fit.target_from_source), matrix4(&truth), 1e-11);
            assert!(fit.rmse < 1e-12 * (1.0 + truth.scale));
        }
    }
}

#[test]
fn points_in_a_plane_suffice() {
    let mut random = Random(22);
    for truth in sim3_examples() {
        let source: Vec<_> = (0..10)
            .map(|_| Vec3::new(random.signed(), random.signed(), 0.0))
            .collect();
        let target: Vec<_> = source.iter().map(|p| truth * *p).collect();
        let fit = align_similarity(&source, &target, true).unwrap();
        assert_close!(matrix4(&fit.target_from_source), matrix4(&truth), 1e-11);
    }
}

#[test]
fn no_neighbouring_similarity_fits_noisy_pairs_better() {
    let mut random = Random(23);
    for truth in sim3_examples() {
        let source = cloud(&mut random, 40);
        let target: Vec<_> = source
            .iter()
            .map(|p| truth * *p + random.vec3() * (0.1 * truth.scale))
            .collect();
        for with_scale in [true, false] {
            let fit = align_similarity(&source, &target, with_scale).unwrap();
            let best = fit.target_from_source;
            let least = cost(&best, &source, &target);
            assert!((fit.rmse - (least / 40.0).sqrt()).abs() < 1e-9 * (1.0 + fit.rmse));
            assert!(with_scale || best.scale == 1.0);
            for _ in 0..30 {
                for size in [1e-4, 1e-2, 1.0] {
                    let mut step = Vec7::from_fn(|_, _| random.signed() * size);
                    if !with_scale {
                        step[6] = 0.0;
                    }
                    let other = Sim3::exp(&step) * best;
                    assert!(cost(&other, &source, &target) >= least * (1.0 - 1e-12));
                }
            }
        }
    }
}

#[test]
fn mirrored_points_get_the_best_proper_rotation() {
    // The best orthogonal matrix is a reflection; the answer must be the best rotation instead,
    // found here by brute force over rotation vectors.
    let mut random = Random(24);
    let source: Vec<_> = (0..30)
        .map(|_| random.vec3().component_mul(&Vec3::new(1.0, 0.8, 0.6)))
        .collect();
    let target: Vec<_> = source.iter().map(|p| Vec3::new(p.x, p.y, -p.z)).collect();
    let fit = align_similarity(&source, &target, false).unwrap();
    let found = cost(&fit.target_from_source, &source, &target);
    let r = fit.target_from_source.rotation.to_rotation_matrix();
    assert!((r.matrix().determinant() - 1.0).abs() < 1e-12);
    let mean_source = source.iter().sum::<Vec3>() / 30.0;
    let mean_target = target.iter().sum::<Vec3>() / 30.0;
    let mut least = f64::INFINITY;
    let n = 14_i32;
    let at = |i: i32| f64::from(i) / f64::from(n) * std::f64::consts::PI;
    for i in -n..=n {
        for j in -n..=n {
            for k in -n..=n {
                let rotation = monogrid_geometry::rotation_exp(&Vec3::new(at(i), at(j), at(k)));
                let t = Sim3::new(1.0, rotation, mean_target - rotation * mean_source);
                least = least.min(cost(&t, &source, &target));
            }
        }
    }
    assert!(found <= least + 1e-12, "found {found}, brute force {least}");
    assert!(found > 0.5 * least, "a rotation cannot mirror");
}

#[test]
fn far_from_the_origin_accuracy_is_kept() {
    let mut random = Random(25);
    let offset = Vec3::new(4.5e5, 5.2e6, 300.0); // as in UTM coordinates
    let truth = sim3_examples()[20];
    let source = cloud(&mut random, 100);
    let target: Vec<_> = source.iter().map(|p| truth * *p + offset).collect();
    let fit = align_similarity(&source, &target, true).unwrap();
    assert!(fit.rmse < 1e-7);
    assert!((fit.target_from_source.scale / truth.scale - 1.0).abs() < 1e-7);
}

#[test]
fn undetermined_input_is_refused() {
    let p = |x: f64| Vec3::new(x, 2.0 * x, -x);
    let line: Vec<_> = (0..10).map(|i| p(f64::from(i))).collect();
    assert_eq!(
        align_similarity(&line, &line, true),
        Err(AlignmentError::Degenerate)
    );
    let spot = vec![p(1.0); 5];
    assert_eq!(
        align_similarity(&spot, &spot, true),
        Err(AlignmentError::Degenerate)
    );
    assert_eq!(
        align_similarity(&line[..2], &line[..2], true),
        Err(AlignmentError::TooFew { found: 2 })
    );
    assert!(matches!(
        align_similarity(&line, &line[..4], true),
        Err(AlignmentError::Length { .. })
    ));
    let mut bad = vec![Vec3::x(), Vec3::y(), Vec3::z(), Vec3::zeros()];
    bad[1].y = f64::NAN;
    assert_eq!(
        align_similarity(&bad, &bad, true),
        Err(AlignmentError::Degenerate)
    );
}
