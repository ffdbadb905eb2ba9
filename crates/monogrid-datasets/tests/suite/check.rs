//! Findings on pictures whose faults are known.

use monogrid_datasets::{FrameCheck, FrameChecker, SequenceCheck, blur};
use monogrid_image::GrayImage;

/// A textured picture, shifted by `shift` pixels.
fn scene(shift: f32) -> GrayImage {
    GrayImage::from_fn(160, 120, |x, y| {
        let (x, y) = (x as f32 + shift, y as f32);
        let checks = ((x / 9.0).floor() + (y / 7.0).floor()).rem_euclid(2.0);
        60.0 + 60.0 * checks + 20.0 * (x / 31.0).sin() * (y / 17.0).cos()
    })
}

/// Average over a motion of `length` pixels to the right.
fn motion_blurred(length: usize) -> GrayImage {
    let mut sum = GrayImage::filled(160, 120, 0.0);
    for i in 0..length {
        for (s, v) in sum
            .as_mut_slice()
            .iter_mut()
            .zip(scene(i as f32).as_slice())
        {
            *s += v / length as f32;
        }
    }
    sum
}

fn check(images: &[GrayImage]) -> (Vec<FrameCheck>, SequenceCheck) {
    let mut checker = FrameChecker::default();
    let frames: Vec<FrameCheck> = images.iter().map(|i| checker.check(i)).collect();
    let sequence = SequenceCheck::new(&frames);
    (frames, sequence)
}

#[test]
fn blur_grows_with_the_length_of_the_motion_in_either_direction() {
    let values: Vec<f32> = [1, 3, 6, 12].map(|n| blur(&motion_blurred(n))).to_vec();
    assert!(values.is_sorted_by(|a, b| a < b), "{values:?}");
    let flipped = motion_blurred(6);
    let flipped = GrayImage::from_fn(120, 160, |x, y| flipped.at(y, x));
    assert!((blur(&flipped) - values[2]).abs() < 1e-4);
    assert_eq!(blur(&GrayImage::filled(50, 40, 9.0)), 1.0);
    assert_eq!(blur(&GrayImage::filled(0, 0, 0.0)), 1.0);
}

#[test]
fn repeats_jumps_blur_and_plain_frames_are_found_where_they_are() {
    let mut images: Vec<GrayImage> = (0..12).map(|i| scene(1.5 * i as f32)).collect();
    images[4] = images[3].clone();
    for image in &mut images[7..] {
        *image = image.map(|v| 1.3 * v);
    }
    images[9] = motion_blurred(12).map(|v| 1.3 * v);
    images.push(GrayImage::filled(160, 120, 130.0));
    images.push(GrayImage::filled(160, 120, 255.0));
    let (frames, sequence) = check(&images);
    assert_eq!(sequence.num_frames, 14);
    assert_eq!(sequence.repeated, [4]);
    assert_eq!(sequence.exposure_jumps[0].0, 7);
    assert!((sequence.exposure_jumps[0].1 - 1.3).abs() < 0.02);
    assert!(sequence.blurred.contains(&9) && !sequence.blurred.contains(&8));
    assert_eq!(sequence.plain, [12, 13]);
    assert_eq!(sequence.overexposed, [13]);
    // brightness of a white frame is not a gain: nothing says how bright it would be
    assert_eq!(frames[13].gain, None);
    assert_eq!(frames[0].gain, None);
    assert!(
        sequence
            .findings()
            .iter()
            .any(|f| f.starts_with("1 of 14 frames repeat"))
    );
}

#[test]
fn a_good_sequence_has_no_findings() {
    let images: Vec<GrayImage> = (0..8).map(|i| scene(2.0 * i as f32)).collect();
    let (_, sequence) = check(&images);
    assert_eq!(sequence.findings(), Vec::<String>::new());
    assert_eq!(check(&[]).1.findings(), Vec::<String>::new());
}

#[test]
fn a_change_of_size_is_no_repeat_and_no_jump() {
    let (frames, _) = check(&[scene(0.0), GrayImage::filled(10, 10, 50.0), scene(0.0)]);
    assert!(frames.iter().all(|f| f.gain.is_none() && !f.is_repeated));
}
