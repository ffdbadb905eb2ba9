//! Random damage to every decoder of images and text: errors, never panics.

use super::images::{colour, gray};
use monogrid_datasets::{
    decode_depth, decode_gray, encode_jpeg_rgb, encode_png, encode_png_16, parse_trajectory,
};
use monogrid_image::Image;
use proptest::prelude::*;
use std::path::Path;

fn samples() -> Vec<Vec<u8>> {
    let mut pgm = b"P5\n20 10\n255\n".to_vec();
    pgm.extend_from_slice(gray(20, 10).as_slice());
    vec![
        encode_jpeg_rgb(&colour(48, 40), 80),
        encode_png(&gray(24, 20)),
        encode_png_16(&Image::from_fn(9, 7, |x, y| (x * 1000 + y) as u16)),
        pgm,
        b"P2 3 2 255 1 2 3 4 5 6".to_vec(),
        b"P7\nWIDTH 2\nHEIGHT 1\nDEPTH 1\nMAXVAL 255\nTUPLTYPE GRAYSCALE\nENDHDR\nab".to_vec(),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 600,
        failure_persistence: None,
        ..Default::default()
    })]

    #[test]
    fn damaged_images_never_panic(
        which in 0usize..6,
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
        cut in any::<prop::sample::Index>(),
        truncate in any::<bool>(),
    ) {
        let mut bytes = samples().swap_remove(which);
        for (index, value) in damage {
            let i = index.index(bytes.len());
            bytes[i] = value;
        }
        if truncate {
            let length = cut.index(bytes.len());
            bytes.truncate(length);
        }
        if let Ok(image) = decode_gray(&bytes, Path::new("x")) {
            prop_assert!(image.as_slice().iter().all(|v| (0.0..=255.001).contains(v)));
        }
        let _ = decode_depth(&bytes, 1000.0, Path::new("x"));
    }

    #[test]
    fn damaged_trajectories_never_panic(text in "[0-9 .,eE+\\-#\n]{0,120}") {
        if let Ok(poses) = parse_trajectory(&text, Path::new("x")) {
            prop_assert!(poses.iter().all(|p| p.world_from_camera.is_finite()));
        }
    }
}
