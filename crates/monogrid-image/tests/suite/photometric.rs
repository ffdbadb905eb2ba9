//! Photometric correction undoes a known camera.

use monogrid_image::{GrayImage, Photometric, PhotometricError};

/// Inverse of the response `255 (b / 255)^(1 / 2.2)`.
fn gamma() -> Vec<f64> {
    (0..256).map(|i| (f64::from(i) / 255.0).powf(2.2)).collect()
}

#[test]
fn a_gamma_and_a_vignette_are_undone() {
    let (width, height) = (40, 30);
    let irradiance =
        GrayImage::from_fn(width, height, |x, y| 20.0 + 4.0 * x as f32 + 2.0 * y as f32);
    let vignette = GrayImage::from_fn(width, height, |x, y| {
        let r2 = (x as f32 - 19.5).powi(2) + (y as f32 - 14.5).powi(2);
        // the brightest pixel of the file need not be 255
        200.0 * (1.0 - r2 / 2000.0)
    });
    let brightest = vignette.as_slice().iter().copied().fold(0.0, f32::max);
    let mut seen = GrayImage::from_fn(width, height, |x, y| {
        let light = irradiance.at(x, y) * vignette.at(x, y) / brightest;
        255.0 * (light / 255.0).powf(1.0 / 2.2)
    });
    let correction = Photometric::try_new(Some(&gamma()), Some(&vignette)).expect("valid");
    assert!(!correction.is_identity());
    correction.apply(&mut seen).expect("same size");
    for (value, expected) in seen.as_slice().iter().zip(irradiance.as_slice()) {
        assert!(
            (value - expected).abs() < 0.05,
            "{value} instead of {expected}"
        );
    }
}

#[test]
fn an_identity_changes_nothing() {
    let image = GrayImage::from_fn(16, 16, |x, y| (x * 16 + y) as f32);
    let none = Photometric::try_new(None, None).expect("valid");
    assert!(none.is_identity());
    let linear: Vec<f64> = (0..256).map(f64::from).collect();
    let flat = GrayImage::filled(16, 16, 90.0);
    let linear = Photometric::try_new(Some(&linear), Some(&flat)).expect("valid");
    for correction in [none, linear] {
        let mut corrected = image.clone();
        correction.apply(&mut corrected).expect("same size");
        for (a, b) in corrected.as_slice().iter().zip(image.as_slice()) {
            assert!((a - b).abs() < 1e-3);
        }
    }
}

#[test]
fn impossible_calibrations_are_refused() {
    let short = Photometric::try_new(Some(&[0.0; 255]), None).err();
    assert_eq!(short, Some(PhotometricError::ResponseLength { found: 255 }));
    for (level, value) in [
        (0, f64::NAN),
        (100, f64::NAN),
        (255, f64::INFINITY),
        (7, 0.5),
    ] {
        let mut response = gamma();
        response[level] = value;
        let error = Photometric::try_new(Some(&response), None).err();
        assert!(
            matches!(error, Some(PhotometricError::NotMonotonic { .. })),
            "{level} {value}: {error:?}"
        );
    }
    // a camera that answers everything with one value
    assert!(Photometric::try_new(Some(&[3.0; 256]), None).is_err());
    let vignette = GrayImage::filled(4, 4, 255.0);
    let correction = Photometric::try_new(None, Some(&vignette)).expect("valid");
    let error = correction.apply(&mut GrayImage::filled(5, 4, 1.0));
    assert_eq!(
        error,
        Err(PhotometricError::VignetteSize {
            found: (4, 4),
            expected: (5, 4)
        })
    );
}

#[test]
fn a_dark_corner_is_not_amplified_without_bound() {
    let mut vignette = GrayImage::filled(4, 4, 255.0);
    vignette.set(0, 0, 0.0);
    vignette.set(1, 0, f32::NAN);
    let correction = Photometric::try_new(None, Some(&vignette)).expect("valid");
    let mut image = GrayImage::filled(4, 4, 10.0);
    correction.apply(&mut image).expect("same size");
    assert!(
        image
            .as_slice()
            .iter()
            .all(|v| v.is_finite() && *v <= 200.1)
    );
    assert!((image.at(2, 2) - 10.0).abs() < 1e-4);
}
