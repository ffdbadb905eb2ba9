//! Straight edges of an image.
//!
//! Pixels of strong gradient whose gradient is largest across the edge are joined to their
//! neighbours of the same direction; a group that is long and thin is a segment (Burns, Hanson and
//! Riseman, "Extracting straight lines", PAMI 1986, line support regions).

use monogrid_image::{GradientImage, Image};

/// Weakest gradient of an edge, grey levels per pixel.
const MIN_GRADIENT: f32 = 6.0;
/// Cosine of the largest angle between the gradient of a pixel and that of its group.
const MIN_COSINE: f32 = 0.92;
/// Largest standard deviation of the pixels from their line.
const MAX_WIDTH_PX: f64 = 0.8;

/// A straight edge: its middle, its direction and its length, pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Segment {
    pub middle: [f64; 2],
    /// Of length 1.
    pub direction: [f64; 2],
    pub length_px: f64,
}

/// The segments of at least `min_length_px`, in the order of their first pixel.
pub(super) fn segments(image: &Image<u8>, min_length_px: f64) -> Vec<Segment> {
    let grey = image.map(f32::from);
    let gradient = GradientImage::new(&grey);
    let (width, height) = (image.width(), image.height());
    let mut is_free = ridge(&gradient);
    let mut found = Vec::new();
    let mut group = Vec::new();
    for start in 0..width * height {
        if !is_free[start] {
            continue;
        }
        grow(start, &gradient, (width, height), &mut is_free, &mut group);
        found.extend(line_of(&group, width).filter(|s| s.length_px >= min_length_px));
    }
    found
}

/// Pixels where the gradient is strong and not weaker than that of both neighbours across the edge.
fn ridge(gradient: &GradientImage) -> Vec<bool> {
    let (gx, gy) = (gradient.gx.as_slice(), gradient.gy.as_slice());
    let (width, height) = (gradient.gx.width(), gradient.gx.height());
    let square = |i: usize| gx[i] * gx[i] + gy[i] * gy[i];
    let mut is_ridge = vec![false; gx.len()];
    for y in 1..height.saturating_sub(1) {
        for x in 1..width - 1 {
            let i = y * width + x;
            let here = square(i);
            if here < MIN_GRADIENT * MIN_GRADIENT {
                continue;
            }
            let step = if gx[i].abs() >= gy[i].abs() { 1 } else { width };
            is_ridge[i] = here >= square(i - step) && here > square(i + step);
        }
    }
    is_ridge
}

/// Takes the connected pixels of one direction, from `start` on.
fn grow(
    start: usize,
    gradient: &GradientImage,
    (width, height): (usize, usize),
    is_free: &mut [bool],
    group: &mut Vec<usize>,
) {
    let (gx, gy) = (gradient.gx.as_slice(), gradient.gy.as_slice());
    group.clear();
    group.push(start);
    is_free[start] = false;
    let mut sum = [gx[start], gy[start]];
    let mut next = 0;
    while let Some(&index) = group.get(next) {
        next += 1;
        let (x, y) = (index % width, index / width);
        for ny in y.saturating_sub(1)..(y + 2).min(height) {
            for nx in x.saturating_sub(1)..(x + 2).min(width) {
                let i = ny * width + nx;
                let along = gx[i] * sum[0] + gy[i] * sum[1];
                if is_free[i] && along >= MIN_COSINE * gx[i].hypot(gy[i]) * sum[0].hypot(sum[1]) {
                    is_free[i] = false;
                    sum = [sum[0] + gx[i], sum[1] + gy[i]];
                    group.push(i);
                }
            }
        }
    }
}

/// The line through a group, if the group is thin.
fn line_of(group: &[usize], width: usize) -> Option<Segment> {
    let count = group.len() as f64;
    let at = |index: &usize| [(index % width) as f64, (index / width) as f64];
    let mean = |axis: usize| group.iter().map(|i| at(i)[axis]).sum::<f64>() / count;
    let middle = [mean(0), mean(1)];
    let [mut xx, mut xy, mut yy] = [0.0; 3];
    for point in group.iter().map(at) {
        let (dx, dy) = (point[0] - middle[0], point[1] - middle[1]);
        xx += dx * dx / count;
        xy += dx * dy / count;
        yy += dy * dy / count;
    }
    // principal axes of the 2x2 covariance
    let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
    let (sin, cos) = angle.sin_cos();
    let along = xx * cos * cos + 2.0 * xy * sin * cos + yy * sin * sin;
    let across = (xx + yy - along).max(0.0);
    let segment = Segment {
        middle,
        direction: [cos, sin],
        length_px: (12.0 * along).sqrt(),
    };
    (across.sqrt() <= MAX_WIDTH_PX).then_some(segment)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sides_of_a_turned_square_are_found_to_a_fifth_of_a_degree() {
        let turn = 20_f64.to_radians();
        let image = Image::from_fn(160, 120, |x, y| {
            let (dx, dy) = (x as f64 - 80.0, y as f64 - 60.0);
            let u = dx * turn.cos() + dy * turn.sin();
            let v = dy * turn.cos() - dx * turn.sin();
            let inside = (30.5 - u.abs()).min(30.5 - v.abs()).clamp(-1.0, 1.0);
            (100.0 + 50.0 * inside) as u8
        });
        let found = segments(&image, 40.0);
        assert_eq!(found.len(), 4, "{found:?}");
        for segment in found {
            let angle = segment.direction[1].atan2(segment.direction[0]);
            let off = (angle - turn).rem_euclid(std::f64::consts::FRAC_PI_2);
            let off = off.min(std::f64::consts::FRAC_PI_2 - off).to_degrees();
            assert!(off < 0.2, "{off} degrees");
            assert!((50.0..64.0).contains(&segment.length_px));
        }
    }

    #[test]
    fn noise_and_plain_pictures_have_no_segments() {
        let noise = Image::from_fn(160, 120, |x, y| ((x * 7919 + y * 104_729) % 251) as u8);
        assert_eq!(segments(&noise, 20.0), Vec::new());
        assert_eq!(segments(&Image::filled(40, 30, 9), 5.0), Vec::new());
    }
}
