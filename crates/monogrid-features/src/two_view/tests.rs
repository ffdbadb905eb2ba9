use super::*;
use monogrid_geometry::rotation_exp;

const PINHOLE: Pinhole = Pinhole {
    fx: 520.0,
    fy: 515.0,
    cx: 319.5,
    cy: 239.5,
};

#[derive(Clone, Copy, PartialEq)]
enum Scene {
    General,
    Plane,
    /// Like a room: two planes and things in front of them.
    Room,
}

struct Synthetic {
    matches: Vec<Match>,
    is_outlier: Vec<bool>,
    idepths: Vec<f64>,
    truth: Se3,
}

fn random_vector(rng: &mut Rng) -> Vec3 {
    Vec3::new(rng.normal(), rng.normal(), rng.normal())
}

fn depth_at(scene: Scene, ray: &Vec3, normal: &Vec3, rng: &mut Rng) -> f64 {
    match scene {
        Scene::General => 1.5 + 3.0 * rng.uniform(),
        Scene::Plane => 3.0 / normal.dot(ray),
        Scene::Room => {
            let wall = 4.0 / Vec3::new(0.3, 0.0, 0.95).dot(ray);
            let floor = if ray.y > 0.05 { 1.2 / ray.y } else { f64::MAX };
            let far = wall.min(floor);
            if rng.uniform() < 0.3 {
                far * (0.5 + 0.4 * rng.uniform())
            } else {
                far
            }
        }
    }
}

fn synthesise(scene: Scene, truth: Se3, noise_px: f64, outlier_ratio: f64, seed: u64) -> Synthetic {
    let mut rng = Rng::new(seed);
    let normal = Vec3::new(0.5 * rng.normal().clamp(-1.0, 1.0), 0.3, 1.0).normalize();
    let mut out = Synthetic {
        matches: Vec::new(),
        is_outlier: Vec::new(),
        idepths: Vec::new(),
        truth,
    };
    let random_pixel = |rng: &mut Rng| Vec2::new(rng.uniform() * 639.0, rng.uniform() * 479.0);
    while out.matches.len() < 300 {
        let a = random_pixel(&mut rng);
        let ray = PINHOLE.unproject(&a);
        let depth = depth_at(scene, &ray, &normal, &mut rng);
        let in_b = truth * (ray * depth);
        if !(0.3..50.0).contains(&depth) || in_b.z < 0.2 {
            continue;
        }
        let is_outlier = rng.uniform() < outlier_ratio;
        let b = if is_outlier {
            // half of them slipped a little, as tracked points do
            if rng.uniform() < 0.5 {
                random_pixel(&mut rng)
            } else {
                PINHOLE.project(&in_b) + Vec2::new(rng.normal(), rng.normal()) * 15.0
            }
        } else {
            PINHOLE.project(&in_b) + Vec2::new(rng.normal(), rng.normal()) * noise_px
        };
        out.matches.push(Match { a, b });
        out.is_outlier.push(is_outlier);
        out.idepths.push(1.0 / depth);
    }
    out
}

fn random_motion(seed: u64, baseline: f64) -> Se3 {
    let mut rng = Rng::new(seed ^ 0xABCD);
    let rotation = rotation_exp(&(random_vector(&mut rng) * 0.06));
    Se3::new(rotation, random_vector(&mut rng).normalize() * baseline)
}

/// Angles of rotation and of direction between a solution and the truth, degrees.
fn errors_deg(found: &Se3, truth: &Se3) -> (f64, f64) {
    (
        found.rotation.angle_to(&truth.rotation).to_degrees(),
        found.translation.angle(&truth.translation).to_degrees(),
    )
}

fn candidates(outcome: &TwoViewOutcome) -> Vec<&TwoView> {
    match outcome {
        TwoViewOutcome::Accepted(best) => vec![best],
        TwoViewOutcome::Ambiguous { candidates } => candidates.iter().collect(),
        _ => Vec::new(),
    }
}

#[test]
fn general_scenes_give_the_true_motion_and_depths_despite_outliers() {
    for scene in [Scene::General, Scene::Room] {
        let (mut accepted, mut within, mut good) = (0, 0, 0);
        for seed in 0..15 {
            let world = synthesise(scene, random_motion(seed, 0.3), 0.5, 0.3, seed);
            let config = TwoViewConfig {
                seed,
                ..TwoViewConfig::default()
            };
            let outcome = two_view(&world.matches, &PINHOLE, &config);
            let TwoViewOutcome::Accepted(found) = &outcome else {
                continue;
            };
            accepted += 1;
            let (rotation, direction) = errors_deg(&found.b_from_a, &world.truth);
            assert!(rotation < 0.6, "seed {seed}: rotation {rotation} deg");
            assert!(
                direction < 4.0 * found.direction_sigma_deg + 0.5,
                "seed {seed}: direction {direction} deg, claimed {}",
                found.direction_sigma_deg
            );
            assert!((found.b_from_a.translation.norm() - 1.0).abs() < 1e-9);
            let depths = check_depths(found, &world);
            (within, good) = (within + depths.0, good + depths.1);
        }
        assert!(
            within * 100 > good * 95,
            "{within} of {good} within 3 sigma"
        );
        assert!(accepted >= 13, "only {accepted} of 15 accepted");
    }
}

/// Points within three claimed deviations of the truth, and points.
fn check_depths(found: &TwoView, world: &Synthetic) -> (usize, usize) {
    let scale = world.truth.translation.norm();
    let (mut good, mut within, mut outliers_kept) = (0usize, 0usize, 0usize);
    for (i, point) in found.points.iter().enumerate() {
        let Some(point) = point else { continue };
        if world.is_outlier[i] {
            outliers_kept += 1;
            continue;
        }
        good += 1;
        let error = point.idepth - world.idepths[i] * scale;
        within += usize::from(error.abs() < 3.0 * point.idepth_sigma);
    }
    let inliers = world.is_outlier.iter().filter(|o| !**o).count();
    assert!(good * 100 > inliers * 90, "{good} of {inliers} kept");
    // a slip along the epipolar line cannot be seen
    assert!(outliers_kept < 40, "{outliers_kept} outliers kept");
    (within, good)
}

#[test]
fn planes_are_never_inverted() {
    let mut with_truth = 0;
    for seed in 0..30 {
        let world = synthesise(Scene::Plane, random_motion(seed, 0.4), 0.5, 0.2, seed);
        let outcome = two_view(&world.matches, &PINHOLE, &TwoViewConfig::default());
        let found = candidates(&outcome);
        if found.is_empty() {
            continue;
        }
        let is_true = found.iter().any(|candidate| {
            let (rotation, direction) = errors_deg(&candidate.b_from_a, &world.truth);
            rotation < 1.5 && direction < 10.0
        });
        assert!(
            is_true,
            "seed {seed}: the true motion is not among {}",
            found.len()
        );
        with_truth += 1;
    }
    assert!(
        with_truth >= 20,
        "only {with_truth} of 30 planes gave motions"
    );
}

#[test]
fn rotation_is_refused() {
    for seed in 0..20 {
        let mut rng = Rng::new(seed);
        let truth = Se3::new(
            rotation_exp(&(random_vector(&mut rng) * 0.1)),
            Vec3::zeros(),
        );
        for outliers in [0.0, 0.3] {
            let world = synthesise(Scene::General, truth, 0.5, outliers, seed);
            let outcome = two_view(&world.matches, &PINHOLE, &TwoViewConfig::default());
            assert!(
                matches!(outcome, TwoViewOutcome::NotEnoughParallax { .. }),
                "seed {seed}: {outcome:?}"
            );
        }
    }
}

#[test]
fn little_parallax_is_refused_or_right() {
    for seed in 0..20 {
        let world = synthesise(Scene::General, random_motion(seed, 0.02), 0.5, 0.1, seed);
        let outcome = two_view(&world.matches, &PINHOLE, &TwoViewConfig::default());
        assert!(
            matches!(
                outcome,
                TwoViewOutcome::NotEnoughParallax { .. } | TwoViewOutcome::Uncertain { .. }
            ),
            "seed {seed}: {outcome:?}"
        );
    }
}

#[test]
fn random_matches_have_no_motion() {
    for seed in 0..5 {
        let world = synthesise(Scene::General, random_motion(seed, 0.3), 0.5, 0.95, seed);
        let outcome = two_view(&world.matches, &PINHOLE, &TwoViewConfig::default());
        assert!(candidates(&outcome).is_empty(), "seed {seed}");
    }
}

#[test]
fn bad_input_is_not_a_motion() {
    let config = TwoViewConfig::default();
    let outcome = two_view(&[], &PINHOLE, &config);
    assert!(matches!(
        outcome,
        TwoViewOutcome::TooFewMatches { found: 0, .. }
    ));
    let nan = vec![
        Match {
            a: Vec2::new(f64::NAN, 1.0),
            b: Vec2::new(1.0, 1.0)
        };
        100
    ];
    let outcome = two_view(&nan, &PINHOLE, &config);
    assert!(matches!(
        outcome,
        TwoViewOutcome::TooFewMatches { found: 0, .. }
    ));
    let same = vec![
        Match {
            a: Vec2::new(10.0, 10.0),
            b: Vec2::new(90.0, 10.0)
        };
        100
    ];
    assert!(candidates(&two_view(&same, &PINHOLE, &config)).is_empty());
}

#[test]
fn the_same_seed_gives_the_same_bits() {
    let world = synthesise(Scene::Room, random_motion(1, 0.3), 0.5, 0.3, 1);
    let run = || {
        format!(
            "{:?}",
            two_view(&world.matches, &PINHOLE, &TwoViewConfig::default())
        )
    };
    assert_eq!(run(), run());
}
