//! Rolling shutter: images as a camera would have taken them that reads all rows at once.
//!
//! Rows are read one after the other, so each shows the scene a little later than the one before
//! it. A pixel has moved on by its velocity times the time between its row and the middle one; it
//! is put back there. The velocity is that of the picture around it, measured by corners that are
//! followed to the image before and the image after: whatever the depth, and without a pose, so
//! that everything that comes after sees an ordinary camera whose pose is that of the middle row:
//! the start too, when no pose is known that a model of the shutter could use.

use crate::read_frame::ReadFrame;
use crate::unusable::{Unusable, each_channel};
use monogrid_features::{
    CornerConfig, FlowConfig, FlowField, FlowSample, TrackConfig, detect_corners, track_points,
};
use monogrid_geometry::{Camera, Pinhole, ReadoutDirection, Vec2};
use monogrid_image::lanes::{LANES, Lanes};
use monogrid_image::{GrayImage, Image, Pyramid, bicubic, for_lanes};
use std::collections::VecDeque;
use std::sync::Arc;

/// Corners that are followed from image to image.
const MAX_CORNERS: usize = 300;

/// Levels of the pyramids: moves of some 40 px between two images.
const NUM_LEVELS: usize = 4;

/// Images further apart say nothing about the velocity in between, ns.
const MAX_GAP_NS: i64 = 150_000_000;

/// Frames without an image (unreadable, or repeating the one before) that are waited for at most.
pub(crate) const MAX_WAITING: usize = 8;

/// When each pixel of the working image is read.
#[derive(Clone, Debug)]
pub(crate) struct Shutter {
    /// Time between the first and the last row, ns.
    readout_ns: f64,
    direction: ReadoutDirection,
    /// Time of each pixel in shares of it, 0 in the middle.
    phases: Arc<GrayImage>,
}

impl Shutter {
    /// For working images with these intrinsics and of this size, taken from images of `camera`.
    pub(crate) fn new(
        (readout_ns, direction): (f64, ReadoutDirection),
        camera: &Camera,
        working: &Pinhole,
        (width, height): (usize, usize),
    ) -> Self {
        let size = (camera.width, camera.height);
        let phase = |x: usize, y: usize| {
            let ray = working.unproject(&Vec2::new(x as f64, y as f64));
            let phase = |pixel| direction.phase(&pixel, size);
            camera.project(&ray).map_or(0.0, phase) as f32
        };
        Self {
            readout_ns,
            direction,
            phases: Arc::new(GrayImage::from_fn(width, height, phase)),
        }
    }

    /// When the row at a pixel is read, ns after the middle one.
    fn time_ns(&self, pixel: &Vec2) -> f64 {
        let column = (pixel.x.max(0.0) as usize).min(self.phases.width() - 1);
        let row = (pixel.y.max(0.0) as usize).min(self.phases.height() - 1);
        self.readout_ns * f64::from(self.phases.at(column, row))
    }

    /// The image with every pixel where it is when the middle row is read; velocities in px per ns.
    fn rectify(&self, image: &GrayImage, flow: &FlowField) -> GrayImage {
        let (width, height) = (image.width(), image.height());
        let mut rectified = GrayImage::filled(width, height, 0.0);
        let [mut xs, mut ys] = [(); 2].map(|()| vec![0.0; width.next_multiple_of(LANES)]);
        for row in 0..height {
            let mut places = [&mut xs[..width], &mut ys[..width]];
            flow.row(row, &mut places);
            self.seen_at(row, (width, height), places);
            look_up(image, [&xs, &ys], rectified.row_mut(row));
        }
        rectified
    }

    /// From the velocities of the pixels of a row, px per ns, to where the image shows them.
    fn seen_at(&self, row: usize, size: (usize, usize), [xs, ys]: [&mut [f32]; 2]) {
        let readout_ns = self.readout_ns as f32;
        let per_pixel = self.direction.gradient(size);
        let [per_x, per_y] = [per_pixel.x, per_pixel.y].map(|p| (self.readout_ns * p) as f32);
        let pixels = xs.iter_mut().zip(ys).zip(self.phases.row(row));
        for (column, ((x, y), phase)) in (0u16..).zip(pixels) {
            let (u, v) = (*x, *y);
            // the row that shows it is read at another time: t = readout (phase + t (u, v) .
            // gradient of the phase)
            let passed = per_x * u + per_y * v;
            let time = readout_ns * phase / (1.0 - passed).max(0.5);
            (*x, *y) = (f32::from(column) + time * u, row as f32 + time * v);
        }
    }
}

for_lanes! {
    /// The image at `places` x and y, whose number is a multiple of [`LANES`]; those beyond
    /// `values` do not count.
    fn look_up = look_up_with, (image: &GrayImage, places: [&[f32]; 2], values: &mut [f32]);
}

#[inline(always)]
fn look_up_with<L: Lanes>(lanes: L, image: &GrayImage, [xs, ys]: [&[f32]; 2], values: &mut [f32]) {
    let mut eights = xs.as_chunks().0.iter().zip(ys.as_chunks().0);
    let (whole, rest) = values.as_chunks_mut();
    for (values, (xs, ys)) in whole.iter_mut().zip(&mut eights) {
        *values = bicubic(lanes, image, xs, ys);
    }
    if let Some((xs, ys)) = eights.next() {
        rest.copy_from_slice(&bicubic(lanes, image, xs, ys)[..rest.len()]);
    }
}

/// How a rolling shutter was taken out of a working image; what it shows in colour moves with it.
#[derive(Clone, Debug)]
pub struct Rectification {
    shutter: Shutter,
    flow: Arc<FlowField>,
}

impl Rectification {
    /// The image in colour (red, green, blue), [as it covers the working
    /// image](crate::Preparation::apply_rgb), with every pixel where it is when the middle row is
    /// read.
    ///
    /// # Errors
    /// An image of another size than the working image's.
    pub fn apply_rgb(&self, image: &Image<[u8; 3]>) -> Result<Image<[u8; 3]>, Unusable> {
        let phases = &self.shutter.phases;
        let found = (image.width(), image.height());
        let expected = (phases.width(), phases.height());
        if found != expected {
            return Err(Unusable::Size { found, expected });
        }
        each_channel(image, |channel| {
            Ok(self.shutter.rectify(channel, &self.flow))
        })
    }

    /// Memory that it takes beside what all images of a camera share.
    #[must_use]
    pub fn num_bytes(&self) -> usize {
        size_of::<Self>() + self.flow.num_bytes()
    }
}

/// Takes images of a rolling shutter and gives each back rectified when the next one is known.
#[derive(Debug)]
pub(crate) struct Rectifier {
    shutter: Shutter,
    /// In the order in which they came; the newest with an image is not rectified yet.
    frames: VecDeque<ReadFrame>,
    newest: Option<Newest>,
}

/// The newest frame with an image.
#[derive(Debug)]
struct Newest {
    pyramid: Pyramid,
    timestamp_ns: i64,
    /// Its place among the waiting frames, once it waits no longer `None`.
    place: Option<usize>,
    /// What moved towards it.
    towards: Vec<FlowSample>,
}

impl Rectifier {
    pub(crate) fn new(shutter: Shutter) -> Self {
        Self {
            shutter,
            frames: VecDeque::new(),
            newest: None,
        }
    }

    /// From the next frame on, the camera takes another time from its first row to the last.
    pub(crate) fn take_readout_ms(&mut self, readout_ms: f64) {
        self.rectify_newest(&[]);
        self.shutter.readout_ns = readout_ms * 1e6;
    }

    /// Takes the next frame of the source.
    pub(crate) fn add(&mut self, frame: ReadFrame) {
        let Some(Ok(image)) = &frame.image else {
            self.frames.push_back(frame);
            return;
        };
        let pyramid = Pyramid::new(image.clone(), NUM_LEVELS);
        let timestamp_ns = frame.timestamp_ns;
        let newest = self.newest.as_ref();
        let moved = newest.map(|newest| self.moved(newest, &pyramid, timestamp_ns));
        let (away, towards) = moved.unwrap_or_default();
        self.rectify_newest(&away);
        self.newest = Some(Newest {
            pyramid,
            timestamp_ns,
            place: Some(self.frames.len()),
            towards,
        });
        self.frames.push_back(frame);
    }

    /// The next frame that is ready.
    pub(crate) fn take(&mut self) -> Option<ReadFrame> {
        if self.frames.len() > MAX_WAITING {
            self.rectify_newest(&[]);
        }
        let newest = self.newest.as_mut();
        match newest.and_then(|newest| newest.place.as_mut()) {
            Some(0) => return None,
            Some(place) => *place -= usize::from(!self.frames.is_empty()),
            None => {}
        }
        self.frames.pop_front()
    }

    /// Frames that were not given back yet.
    pub(crate) fn num_waiting(&self) -> usize {
        self.frames.len()
    }

    /// No more frames come: all are ready.
    pub(crate) fn finish(&mut self) {
        self.rectify_newest(&[]);
    }

    /// How corners moved between the newest image and the next: where they were, and where they
    /// are.
    fn moved(
        &self,
        newest: &Newest,
        next: &Pyramid,
        next_ns: i64,
    ) -> (Vec<FlowSample>, Vec<FlowSample>) {
        let interval_ns = next_ns - newest.timestamp_ns;
        if !(1..=MAX_GAP_NS).contains(&interval_ns) {
            return Default::default();
        }
        let config = CornerConfig {
            max_corners: MAX_CORNERS,
            ..CornerConfig::default()
        };
        let corners = detect_corners(&newest.pyramid, None, &[], &config);
        let from: Vec<Vec2> = corners.iter().map(|corner| corner.pixel).collect();
        let found = track_points(&newest.pyramid, next, &from, &from, &TrackConfig::default());
        from.iter()
            .zip(&found)
            .filter_map(|(from, outcome)| {
                let to = outcome.pixel()?;
                // rows are read at their own times in both
                let rows_ns = self.shutter.time_ns(&to) - self.shutter.time_ns(from);
                let velocity = (to - from) / (interval_ns as f64 + rows_ns).max(1.0);
                let sample = |pixel| FlowSample { pixel, velocity };
                Some((sample(*from), sample(to)))
            })
            .unzip()
    }

    /// Rectifies the newest frame, if it waits, by what moved towards it and away from it; where
    /// that is too little, it stays as it is.
    fn rectify_newest(&mut self, away: &[FlowSample]) {
        let Some(newest) = &mut self.newest else {
            return;
        };
        let Some(frame) = newest.place.take().and_then(|k| self.frames.get_mut(k)) else {
            return;
        };
        let Some(Ok(image)) = &mut frame.image else {
            return;
        };
        let samples: Vec<FlowSample> = newest.towards.iter().chain(away).copied().collect();
        let size = (image.width(), image.height());
        if let Some(flow) = FlowField::fit(&samples, size, &FlowConfig::default()) {
            *image = self.shutter.rectify(image, &flow);
            frame.rectification = Some(Rectification {
                shutter: self.shutter.clone(),
                flow: Arc::new(flow),
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Rectifier, Shutter};
    use crate::read_frame::ReadFrame;
    use crate::unusable::Unusable;
    use monogrid_geometry::ReadoutDirection::{self, Down, Left, Right, Up};
    use monogrid_geometry::{Camera, Distortion, Pinhole, Vec2};
    use monogrid_image::{GrayImage, Image};

    const SIZE: (usize, usize) = (160, 120);
    const INTERVAL_NS: i64 = 33_000_000;
    const READOUT_NS: f64 = 25e6;

    /// A picture with structure everywhere.
    fn texture(x: f64, y: f64) -> f64 {
        let wave = |fx: f64, fy: f64, phase: f64| (fx * x + fy * y + phase).sin();
        128.0 + 40.0 * (wave(0.31, 0.11, 0.0) + wave(-0.13, 0.27, 1.0) + wave(0.07, -0.19, 2.0))
    }

    /// The picture after it moved for a time, px per interval, as a sensor sees it that takes
    /// `readout_ns`.
    fn frame(index: usize, velocity: [f64; 2], readout_ns: f64) -> ReadFrame {
        frame_read(index, velocity, readout_ns, Down)
    }

    /// The same with the rows of the sensor lying that way.
    fn frame_read(
        index: usize,
        velocity: [f64; 2],
        readout_ns: f64,
        direction: ReadoutDirection,
    ) -> ReadFrame {
        let (width, height) = SIZE;
        let image = GrayImage::from_fn(width, height, |x, y| {
            let phase = direction.phase(&Vec2::new(x as f64, y as f64), SIZE);
            let time = index as f64 + phase * readout_ns / INTERVAL_NS as f64;
            let [u, v] = velocity.map(|speed| speed * time);
            texture(x as f64 - u, y as f64 - v) as f32
        });
        ReadFrame {
            index,
            timestamp_ns: index as i64 * INTERVAL_NS,
            image: Some(Ok(image)),
            depth: None,
            readout_ms: 0.0,
            rectification: None,
            due: None,
        }
    }

    fn rectifier() -> Rectifier {
        rectifier_of(Down)
    }

    fn rectifier_of(direction: ReadoutDirection) -> Rectifier {
        let (width, height) = SIZE;
        let pinhole = Pinhole::new(130.0, 130.0, 79.5, 59.5);
        let camera = Camera {
            width,
            height,
            pinhole,
            distortion: Distortion::None,
        };
        let shutter = Shutter::new((READOUT_NS, direction), &camera, &pinhole, SIZE);
        Rectifier::new(shutter)
    }

    fn all_of(frames: impl IntoIterator<Item = ReadFrame>) -> Vec<ReadFrame> {
        rectified(rectifier(), frames)
    }

    fn rectified(
        mut rectifier: Rectifier,
        frames: impl IntoIterator<Item = ReadFrame>,
    ) -> Vec<ReadFrame> {
        let mut out = Vec::new();
        for frame in frames {
            rectifier.add(frame);
            while let Some(ready) = rectifier.take() {
                out.push(ready);
            }
        }
        rectifier.finish();
        while let Some(ready) = rectifier.take() {
            out.push(ready);
        }
        out
    }

    /// Mean difference of two images away from the border, grey levels.
    fn difference(a: &ReadFrame, b: &ReadFrame) -> f32 {
        let (Some(Ok(a)), Some(Ok(b))) = (&a.image, &b.image) else {
            panic!("no image");
        };
        let inner = |x: usize, y: usize| (12..148).contains(&x) && (12..108).contains(&y);
        let (mut sum, mut count) = (0.0, 0.0);
        for y in 0..a.height() {
            for x in (0..a.width()).filter(|&x| inner(x, y)) {
                sum += (a.at(x, y) - b.at(x, y)).abs();
                count += 1.0;
            }
        }
        sum / count
    }

    #[test]
    fn a_moving_picture_is_put_back_where_the_middle_row_saw_it() {
        for (velocity, direction) in [
            ([6.0, 0.0], Down),
            ([0.0, 5.0], Down),
            ([-4.0, 3.0], Down),
            ([3.0, -5.0], Down),
            ([3.0, -5.0], Up),
            ([6.0, 0.0], Right),
            ([-4.0, 3.0], Right),
            ([5.0, 2.0], Left),
            ([0.0, 5.0], Left),
        ] {
            let rolling = || (0..4).map(|k| frame_read(k, velocity, READOUT_NS, direction));
            let rectified = rectified(rectifier_of(direction), rolling());
            assert_eq!(rectified.len(), 4);
            for (k, (before, after)) in rolling().zip(&rectified).enumerate() {
                let truth = frame(k, velocity, 0.0);
                let (bent, left) = (difference(&before, &truth), difference(after, &truth));
                assert!(
                    bent > 6.0 && left < 0.05 * bent,
                    "{velocity:?} {direction:?} {k}: {bent} {left}"
                );
            }
        }
    }

    #[test]
    fn colours_are_put_where_the_grey_image_is() {
        let rolling = (0..4).map(|k| frame(k, [6.0, -2.0], READOUT_NS));
        let tinted = |value: f32| [value as u8, (0.5 * value) as u8, 255 - value as u8];
        for (before, after) in rolling.clone().zip(all_of(rolling)) {
            let (Some(Ok(bent)), Some(Ok(grey))) = (&before.image, &after.image) else {
                panic!("no image");
            };
            let rectification = after.rectification.as_ref().expect("it moves");
            let colour = rectification.apply_rgb(&bent.map(tinted)).unwrap();
            for (pixel, value) in colour.as_slice().iter().zip(grey.as_slice()) {
                let expected = [*value, 0.5 * value, 255.0 - value];
                let apart = (0..3).map(|c| (f32::from(pixel[c]) - expected[c]).abs());
                assert!(apart.fold(0.0, f32::max) < 3.0, "{pixel:?} {expected:?}");
            }
            let small = Image::filled(20, 20, [0; 3]);
            assert!(rectification.apply_rgb(&small).is_err());
        }
    }

    #[test]
    fn a_changing_velocity_is_that_at_the_middle() {
        // the frames before and after moved by 2 and by 6 px: at the middle frame 4 px per interval
        let [before, _, after] = [2.0, 4.0, 6.0];
        let mut frames: Vec<ReadFrame> = (0..3).map(|k| frame(k, [4.0, 0.0], READOUT_NS)).collect();
        let moved = |k: usize, by: f64| {
            let mut frame = frame(k, [4.0, 0.0], READOUT_NS);
            if let Some(Ok(image)) = &mut frame.image {
                *image = GrayImage::from_fn(SIZE.0, SIZE.1, |x, y| {
                    let row = (y as f64 - 59.5) / 120.0 * READOUT_NS / INTERVAL_NS as f64;
                    let at = x as f64 - 4.0 - by - 4.0 * row;
                    texture(at, y as f64) as f32
                });
            }
            frame
        };
        frames[0] = moved(0, -before);
        frames[2] = moved(2, after);
        let truth = frame(1, [4.0, 0.0], 0.0);
        let rectified = all_of(frames);
        assert!(difference(&rectified[1], &truth) < 1.5);
    }

    #[test]
    fn order_and_frames_without_an_image_are_kept() {
        let frames = (0..20).map(|k| {
            let mut frame = frame(k, [4.0, 0.0], READOUT_NS);
            if k % 3 == 1 || (5..18).contains(&k) {
                frame.image = Some(Err(Unusable::Repeats));
            }
            frame
        });
        let out = all_of(frames);
        let indices: Vec<usize> = out.iter().map(|frame| frame.index).collect();
        assert_eq!(indices, (0..20).collect::<Vec<_>>());
        // nothing is known of the motion over a gap of 14 frames, which are not all waited for
        let mut rectifier = rectifier();
        rectifier.add(frame(0, [4.0, 0.0], READOUT_NS));
        let mut waited = 0;
        while rectifier.take().is_none() {
            waited += 1;
            rectifier.add(ReadFrame {
                image: Some(Err(Unusable::Repeats)),
                ..frame(waited, [4.0, 0.0], READOUT_NS)
            });
        }
        assert!(waited <= super::MAX_WAITING, "{waited}");
    }

    #[test]
    fn without_motion_that_can_be_measured_images_stay() {
        let alone = all_of([frame(0, [4.0, 0.0], READOUT_NS)]);
        assert_eq!(
            difference(&alone[0], &frame(0, [4.0, 0.0], READOUT_NS)),
            0.0
        );
        let far = ReadFrame {
            timestamp_ns: 10 * INTERVAL_NS,
            ..frame(1, [4.0, 0.0], READOUT_NS)
        };
        let apart = all_of([frame(0, [4.0, 0.0], READOUT_NS), far]);
        assert_eq!(
            difference(&apart[0], &frame(0, [4.0, 0.0], READOUT_NS)),
            0.0
        );
    }
}
