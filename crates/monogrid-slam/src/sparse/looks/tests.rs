use super::*;
use monogrid_image::{GrayImage, Pyramid};
use nalgebra::Matrix2;

const SIZE: usize = 60;

/// Waves that repeat nowhere near.
fn image(phase: f64) -> GrayImage {
    GrayImage::from_fn(SIZE, SIZE, |x, y| {
        let (x, y) = (x as f64, y as f64);
        let waves = (0.61 * x + 0.2 * y + phase).sin() + (0.53 * y - 0.31 * x + 2.0 * phase).cos();
        (128.0 + 40.0 * waves).round() as f32
    })
}

fn photometric_cost(at: Vec2) -> PhotometricCost {
    let reference = Pyramid::new(image(0.0), 1);
    PhotometricCost::new(&reference, &at, &Matrix2::identity()).unwrap()
}

#[test]
fn a_point_is_compared_where_it_is_projected_to() {
    let seen = Vec2::new(31.3, 27.8);
    let config = ImageAdjustmentConfig::default();
    let whole = image(0.0).map(|v| v as u8);
    let look = Look::new(photometric_cost(seen), &whole, seen, &config).unwrap();
    let looks = Looks {
        looks: vec![Some(look), None],
        config: config.photometric_cost(),
    };
    for offset in [[0.0, 0.0], [0.7, -0.4], [-2.3, 2.4]] {
        let offset = Vec2::from(offset);
        let expected = photometric_cost(seen);
        let cost = expected.cost(&whole, &(seen + offset), &looks.config);
        let found = looks.cost(0, &(seen + offset));
        assert!((found - cost.unwrap()).abs() < 1e-4, "{found} {cost:?}");
        let slope = expected
            .slope(&whole, &(seen + offset), &looks.config)
            .unwrap();
        let found = looks.slope(0, &(seen + offset)).unwrap();
        let difference = (found.gradient - slope.gradient).norm();
        // places in single precision: some 1e-6 px where the piece ends
        assert!(difference < 0.02 * (1.0 + slope.gradient.norm()));
        assert_eq!(looks.cost(1, &(seen + offset)), 0.0);
        assert_eq!(looks.slope(1, &(seen + offset)), None);
    }
    // further than the piece reaches: as bad as can be, and no direction is better
    let away = seen + Vec2::new(5.0, 0.0);
    assert_eq!(looks.cost(0, &away), looks.config.largest_cost());
    assert_eq!(looks.slope(0, &away), None);
    assert!(looks.cost(0, &(seen + Vec2::new(2.4, 0.0))) < looks.config.largest_cost());
}

#[test]
fn what_looks_different_or_lies_at_the_border_is_not_compared() {
    let seen = Vec2::new(31.3, 27.8);
    let config = ImageAdjustmentConfig::default();
    let same = image(0.0).map(|v| v as u8);
    let other = image(1.4).map(|v| v as u8);
    let is_compared = |image: &Image<u8>, seen: Vec2| {
        Look::new(
            photometric_cost(Vec2::new(31.3, 27.8)),
            image,
            seen,
            &config,
        )
        .is_some()
    };
    assert!(is_compared(&same, seen));
    assert!(!is_compared(&other, seen));
    assert!(!is_compared(&same, seen + Vec2::new(2.0, 2.0)));
    for border in [[6.9, 30.0], [30.0, 6.9], [52.6, 30.0], [f64::NAN, 30.0]] {
        assert!(!is_compared(&same, Vec2::from(border)));
    }
    let anything = ImageAdjustmentConfig {
        min_correlation: -1.0,
        ..config
    };
    let look = Look::new(photometric_cost(seen), &other, seen, &anything);
    assert!(look.is_some());
}

#[test]
fn observations_come_together_by_keyframe() {
    let seen = |keyframe: usize| Observation {
        keyframe,
        point: 0,
        pixel: Vec2::zeros(),
        inv_sigma_px: 1.0,
    };
    let observations = [2, 0, 2, 5, 0].map(seen);
    let together = by_keyframe(&observations, |o| o.keyframe);
    assert_eq!(
        together,
        vec![(0, vec![1, 4]), (2, vec![0, 2]), (5, vec![3])]
    );
}
