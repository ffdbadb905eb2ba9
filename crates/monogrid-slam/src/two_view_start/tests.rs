use super::*;
use crate::test_world::small_demo;
use crate::{FrameInput, SlamConfig};
use monogrid_image::GrayImage;

/// The buffered frames, by their number, and the places of the references among them.
type State = (Vec<i64>, Vec<usize>);

/// A camera with images of this width and height.
fn setup(config: SlamConfig, (width, height): (usize, usize)) -> Setup {
    let pinhole = Pinhole::new(200.0, 200.0, 80.0, 60.0);
    Setup::new(config, pinhole, Mask::filled(width, height, 255), 0)
}

/// Shows images to a start that buffers so many frames and is never satisfied; its state after
/// each.
fn states(images: &[GrayImage], max_buffered_frames: usize) -> Vec<State> {
    let mut config = SlamConfig::default();
    config.initialization.max_buffered_frames = max_buffered_frames;
    config.initialization.sigma_px = 20.0;
    config.initialization.max_relative_sigma = 0.001;
    let mut start = TwoViewStart::new(&config.initialization, 0);
    let setup = setup(config, (images[0].width(), images[0].height()));
    let mut states = Vec::new();
    for (index, image) in images.iter().enumerate() {
        let input = FrameInput {
            index,
            timestamp_ns: index as i64,
            image: image.clone(),
            depth: None,
        };
        let outcome = start.add_frame(setup.frame(input), &setup);
        assert!(outcome.is_err());
        let times = start.buffered.iter().map(|frame| frame.timestamp_ns);
        let references = start.references.iter().map(|r| r.buffer_index);
        states.push((times.collect(), references.collect()));
    }
    states
}

fn room() -> GrayImage {
    small_demo().frame(0).unwrap().image
}

#[test]
fn the_newest_frames_are_kept_while_there_is_nothing_to_follow() {
    let plain = vec![GrayImage::filled(160, 120, 90.0); 6];
    let states = states(&plain, 4);
    assert_eq!(states[3], (vec![0, 1, 2, 3], vec![]));
    assert_eq!(states[5], (vec![2, 3, 4, 5], vec![]));
}

#[test]
fn a_camera_that_stands_still_gets_a_new_reference_when_the_first_leaves_the_buffer() {
    let states = states(&vec![room(); 6], 4);
    assert_eq!(states[3], (vec![0, 1, 2, 3], vec![0]));
    assert_eq!(states[4], (vec![1, 2, 3, 4], vec![3]));
    assert_eq!(states[5], (vec![2, 3, 4, 5], vec![2]));
}

#[test]
fn a_camera_that_moves_on_without_a_start_gets_references_beside_the_first() {
    const STEP_PX: usize = 5;
    let room = room();
    let (width, height) = (room.width(), room.height());
    let images: Vec<GrayImage> = (0..25)
        .map(|k| GrayImage::from_fn(width, height, |x, y| room.at((x + STEP_PX * k) % width, y)))
        .collect();
    let share = InitializationConfig::default().reference_displacement;
    let frames_between = (share * width as f64 / STEP_PX as f64).ceil() as usize;
    let states = states(&images, 100);
    assert_eq!(states[frames_between - 1].1, [0]);
    assert_eq!(states[frames_between + 1].1.len(), 2);
    assert!(
        states
            .iter()
            .all(|(_, references)| references.len() <= MAX_REFERENCES)
    );
    // the oldest has given way
    assert!(states[24].1[0] > 0);
}

fn frame(image: GrayImage) -> Frame {
    let setup = setup(SlamConfig::default(), (image.width(), image.height()));
    setup.frame(FrameInput {
        index: 0,
        timestamp_ns: 0,
        image,
        depth: None,
    })
}

#[test]
fn what_has_changed_its_looks_is_followed_from_where_it_was_last_seen() {
    let room = room();
    let (width, height) = (room.width(), room.height());
    // of other looks than in the reference, then moved
    let negative = room.map(|grey| 255.0 - grey);
    let moved = GrayImage::from_fn(width, height, |x, y| {
        negative.at(x.saturating_sub(4), y.saturating_sub(3))
    });
    let mut start = TwoViewStart::new(&InitializationConfig::default(), 0);
    start.buffer(&frame(room.clone()));
    let mask = Mask::filled(width, height, 255);
    start.refer_to(frame(room), &mask, &CornerConfig::default());
    let mut reference = start.references.remove(0);
    let points = reference.points.clone();
    let seen = |pixels: Vec<Option<Vec2>>, offset| View { offset, pixels };
    // the last one was not found in the view before either
    let mut before: Vec<Option<Vec2>> = points.iter().copied().map(Some).collect();
    before[points.len() - 1] = None;
    reference.views = vec![seen(before, 1), seen(vec![None; points.len()], 2)];
    reference.tracks = vec![None; points.len()];
    reference.follow_from(&frame(negative).pyramid, &frame(moved));
    let shift = Vec2::new(4.0, 3.0);
    let found: Vec<(usize, Vec2, Vec2)> = (0..points.len())
        .filter_map(|i| reference.tracks[i].map(|(pixel, step)| (i, pixel, step)))
        .collect();
    assert!(found.len() > points.len() / 2, "{}", found.len());
    assert!(reference.tracks[points.len() - 1].is_none());
    let is_right = |(i, pixel, _): &&(usize, Vec2, Vec2)| (pixel - points[*i] - shift).norm() < 0.3;
    let num_right = found.iter().filter(is_right).count();
    assert!(
        20 * num_right > 19 * found.len(),
        "{num_right} of {}",
        found.len()
    );
    for (i, pixel, step) in found {
        assert_eq!(step, pixel - points[i]);
        assert_eq!(reference.views[1].pixels[i], Some(pixel));
    }
}

#[test]
fn only_references_with_few_features_need_that() {
    let mut start = TwoViewStart::new(&InitializationConfig::default(), 0);
    let room = room();
    let mask = Mask::filled(room.width(), room.height(), 255);
    start.buffer(&frame(room.clone()));
    start.refer_to(frame(room), &mask, &CornerConfig::default());
    let reference = &start.references[0];
    let num = reference.points.len();
    assert!(!reference.is_poor(num / FEW_TIMES));
    assert!(reference.is_poor(num / FEW_TIMES + 1));
}

#[test]
fn features_lie_closer_together_when_nothing_starts_for_long() {
    let settings = InitializationConfig {
        patient_frames: 2,
        ..InitializationConfig::default()
    };
    let pinhole = Pinhole::new(200.0, 200.0, 80.0, 60.0);
    let mut start = TwoViewStart::new(&settings, 0);
    let mut spacing = || {
        start.buffer(&frame(room()));
        start
            .corners(&pinhole, &SparseConfig::default())
            .min_distance_px
    };
    let usual = CornerConfig::default().min_distance_px;
    assert_eq!([spacing(), spacing()], [usual; 2]);
    assert!(spacing() < usual);
}
