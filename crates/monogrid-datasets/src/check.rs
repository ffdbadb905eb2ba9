//! What would hurt tracking, seen in the images alone: blur, exposure jumps, repeated frames, lack
//! of texture.

use monogrid_geometry::median::median;
use monogrid_image::{GradientImage, GrayImage};

/// Gradient from which a pixel counts as textured, grey levels per px.
const MIN_GRADIENT: f32 = 5.0;
/// Share of textured pixels below which a frame is called plain.
const MIN_TEXTURED_SHARE: f32 = 0.05;
/// Brightness ratio of successive frames, or its inverse, that is called a jump.
const EXPOSURE_JUMP: f32 = 1.1;
/// Mean absolute difference to the predecessor below which a frame repeats it, grey levels.
/// Sensor noise alone is above 0.5; compressing the same picture twice is below.
const REPEAT_DIFFERENCE: f32 = 0.2;
/// Blur above the sequence's median from which a frame is called blurred.
const BLUR_ABOVE_MEDIAN: f32 = 0.1;
/// Share of pixels at the upper end of the range from which a frame is called overexposed.
const MAX_SATURATED_SHARE: f32 = 0.2;
/// What one frame looks like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameCheck {
    /// Blur in the worse of both directions: 0 sharp, 1 without any detail; see [`blur`].
    pub blur: f32,
    /// Mean brightness, [0, 255].
    pub brightness: f32,
    /// Share of pixels with enough gradient for tracking.
    pub textured_share: f32,
    /// Share of pixels at or above 253.
    pub saturated_share: f32,
    /// Brightness over that of the frame before; `None` for the first or after a change of size.
    pub gain: Option<f32>,
    /// Whether it is the frame before, pixel by pixel: such frames are left out when a source is
    /// tracked.
    pub is_repeated: bool,
    /// Whether it shows the picture of the frame before, encoded once more.
    pub is_nearly_repeated: bool,
}

/// Checks frames one after the other.
#[derive(Clone, Debug, Default)]
pub struct FrameChecker {
    previous: Option<GrayImage>,
}

impl FrameChecker {
    /// Checks the next frame.
    pub fn check(&mut self, image: &GrayImage) -> FrameCheck {
        let before = self.previous.as_ref().filter(|p| p.same_size(image));
        let difference = before.map(|before| mean_difference(before, image));
        let magnitude = GradientImage::new(image).magnitude();
        let check = FrameCheck {
            blur: blur(image),
            brightness: mean(image.as_slice().iter().copied()),
            textured_share: share(&magnitude, |m| m >= MIN_GRADIENT),
            saturated_share: share(image, |v| v >= 253.0),
            gain: before.and_then(|p| brightness_gain(p, image)),
            is_repeated: difference == Some(0.0),
            is_nearly_repeated: difference.is_some_and(|d| d > 0.0 && d < REPEAT_DIFFERENCE),
        };
        self.previous = Some(image.clone());
        check
    }
}

/// Blur after `[CRETE07]`: how little of the variation between neighbours is lost when the image is
/// blurred once more. The larger of both directions, because motion blurs in one.
#[must_use]
pub fn blur(image: &GrayImage) -> f32 {
    let (w, h) = (image.width(), image.height());
    let rows = (0..h).map(|y| image.row(y).to_vec());
    let columns = (0..w).map(|x| (0..h).map(|y| image.at(x, y)).collect());
    line_blur(rows).max(line_blur(columns))
}

/// Width of the second blur, px.
const REBLUR_WIDTH: usize = 9;

fn line_blur(lines: impl Iterator<Item = Vec<f32>>) -> f32 {
    let (mut variation, mut lost) = (0.0f64, 0.0f64);
    for line in lines {
        // difference of two neighbouring box averages = ends of the box, over its width
        for i in REBLUR_WIDTH / 2 + 1..line.len().saturating_sub(REBLUR_WIDTH / 2) {
            let sharp = (line[i] - line[i - 1]).abs();
            let entering = line[i + REBLUR_WIDTH / 2];
            let leaving = line[i - 1 - REBLUR_WIDTH / 2];
            let blurred = (entering - leaving).abs() / REBLUR_WIDTH as f32;
            variation += f64::from(sharp);
            lost += f64::from((sharp - blurred).max(0.0));
        }
    }
    let varies = variation > 0.0;
    if varies {
        (1.0 - lost / variation) as f32
    } else {
        1.0
    }
}

/// Median ratio of brightness over a grid of blocks, which the motion of single objects does not
/// disturb; `None` where everything is black.
fn brightness_gain(before: &GrayImage, after: &GrayImage) -> Option<f32> {
    const BLOCKS: usize = 16;
    let block = |image: &GrayImage, bx: usize, by: usize| {
        let columns = bx * image.width() / BLOCKS..(bx + 1) * image.width() / BLOCKS;
        let rows = by * image.height() / BLOCKS..(by + 1) * image.height() / BLOCKS;
        mean(rows.flat_map(|y| image.row(y)[columns.clone()].iter().copied()))
    };
    let ratios = (0..BLOCKS * BLOCKS)
        .map(|i| (i % BLOCKS, i / BLOCKS))
        .map(|(bx, by)| (block(before, bx, by), block(after, bx, by)))
        // black and saturated blocks do not follow the exposure
        .filter(|(a, b)| a.min(*b) > 8.0 && a.max(*b) < 250.0)
        .map(|(a, b)| b / a);
    median(&mut ratios.collect::<Vec<f32>>())
}

fn mean(values: impl Iterator<Item = f32>) -> f32 {
    let (sum, count) = values.fold((0.0f64, 0u64), |(s, n), v| (s + f64::from(v), n + 1));
    (sum / count.max(1) as f64) as f32
}

fn mean_difference(a: &GrayImage, b: &GrayImage) -> f32 {
    let pairs = a.as_slice().iter().zip(b.as_slice());
    mean(pairs.map(|(a, b)| (a - b).abs()))
}

fn share(image: &GrayImage, condition: impl Fn(f32) -> bool) -> f32 {
    let hits = image.as_slice().iter().filter(|&&v| condition(v)).count();
    hits as f32 / image.as_slice().len().max(1) as f32
}

/// What a whole sequence looks like.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct SequenceCheck {
    /// Frames that were checked.
    pub num_frames: usize,
    /// Positions of frames that repeat their predecessor pixel by pixel.
    pub repeated: Vec<usize>,
    /// Positions of frames that show the picture of their predecessor, encoded once more.
    pub nearly_repeated: Vec<usize>,
    /// Positions and gains of exposure jumps.
    pub exposure_jumps: Vec<(usize, f32)>,
    /// Positions of frames that are more blurred than the others.
    pub blurred: Vec<usize>,
    /// Positions of frames with little texture.
    pub plain: Vec<usize>,
    /// Positions of overexposed frames.
    pub overexposed: Vec<usize>,
    /// Median blur.
    pub median_blur: f32,
    /// Median share of textured pixels.
    pub median_textured_share: f32,
}

impl SequenceCheck {
    /// Gathers the checks of the frames of a sequence in their order.
    #[must_use]
    pub fn new(frames: &[FrameCheck]) -> Self {
        let positions = |condition: &dyn Fn(&FrameCheck) -> bool| {
            let hits = frames.iter().enumerate().filter(|(_, f)| condition(f));
            hits.map(|(i, _)| i).collect::<Vec<_>>()
        };
        let median_blur = median_of(frames.iter().map(|f| f.blur));
        let is_jump = |gain: &f32| gain.max(1.0 / gain) >= EXPOSURE_JUMP;
        let jumps = frames.iter().enumerate();
        let jumps = jumps.filter_map(|(i, f)| Some((i, f.gain.filter(is_jump)?)));
        Self {
            num_frames: frames.len(),
            repeated: positions(&|f| f.is_repeated),
            nearly_repeated: positions(&|f| f.is_nearly_repeated),
            exposure_jumps: jumps.collect(),
            blurred: positions(&|f| f.blur > median_blur + BLUR_ABOVE_MEDIAN),
            plain: positions(&|f| f.textured_share < MIN_TEXTURED_SHARE),
            overexposed: positions(&|f| f.saturated_share > MAX_SATURATED_SHARE),
            median_blur,
            median_textured_share: median_of(frames.iter().map(|f| f.textured_share)),
        }
    }

    /// Sentences for people about what would hurt tracking; none when nothing would.
    #[must_use]
    pub fn findings(&self) -> Vec<String> {
        let repeated = "repeat the one before and are left out (motion looks jerky)";
        let nearly = "show the picture before them once more, encoded anew (motion looks jerky)";
        let jumping = "change in brightness abruptly (lock the exposure if you can)";
        let blurred = "are clearly more blurred than the others (move slower, or more light)";
        let plain = "have hardly any texture (tracking needs edges)";
        let jumps: Vec<usize> = self.exposure_jumps.iter().map(|(i, _)| *i).collect();
        let all = self.num_frames;
        let finding = |(positions, what): (&[usize], &str)| {
            let (count, first) = (positions.len(), positions.first()?);
            Some(format!(
                "{count} of {all} frames {what}, first frame {first}"
            ))
        };
        let lists: [(&[usize], &str); 6] = [
            (&self.repeated, repeated),
            (&self.nearly_repeated, nearly),
            (&jumps, jumping),
            (&self.blurred, blurred),
            (&self.plain, plain),
            (&self.overexposed, "are overexposed"),
        ];
        lists.into_iter().filter_map(finding).collect()
    }
}

fn median_of(values: impl Iterator<Item = f32>) -> f32 {
    median(&mut values.collect::<Vec<f32>>()).unwrap_or(0.0)
}
