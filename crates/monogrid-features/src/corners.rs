//! Well-distributed corners: smaller eigenvalue of the structure tensor (`[SHI94]`), one maximum
//! per small cell, then the best of every larger cell first.

use crate::{finest_pixel, noise_share};
use monogrid_geometry::Vec2;
use monogrid_image::lanes::Lanes;
use monogrid_image::{GrayImage, Image, Mask, Pyramid, for_lanes, noise_sigma};

/// Settings of the corner detector.
#[derive(Clone, Debug, PartialEq)]
pub struct CornerConfig {
    /// Most corners that are returned. Range 1..; default 600.
    pub max_corners: usize,
    /// Pyramid level on which corners are searched first. Default 0.
    pub level: usize,
    /// Coarser levels on which they are searched where finer ones show too few: faint blotches
    /// stand out of the noise there, but are found less exactly. Default 0.
    pub num_coarser: usize,
    /// Smallest distance between two corners, level-0 px. Default 10.
    pub min_distance_px: f64,
    /// Smallest score on `level`: mean squared gradient in the weakest direction,
    /// (grey levels / px)². Default 5, which suits noise of up to two grey levels; where an image
    /// has more, as much more as its variance. On each coarser level a quarter of it, as the
    /// variance of the noise.
    pub min_score: f32,
    /// No corner closer to the border than this, level-0 px. Default 12: room for a patch.
    pub border_px: usize,
}

impl Default for CornerConfig {
    fn default() -> Self {
        Self {
            max_corners: 600,
            level: 0,
            num_coarser: 0,
            min_distance_px: 10.0,
            min_score: 5.0,
            border_px: 12,
        }
    }
}

/// A corner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corner {
    /// Position with sub-pixel precision, level-0 px.
    pub pixel: Vec2,
    /// Smaller eigenvalue of the mean structure tensor, (grey levels / px)².
    pub score: f32,
}

/// Variance of the noise up to which the smallest score is as set, grey levels².
const USUAL_NOISE_VARIANCE: f64 = 4.0;

/// Half width of the window of the structure tensor, px.
const WINDOW: usize = 2;

/// No corner closer to the border than this, px of its level: room for a patch there.
const MIN_BORDER: usize = 6;

/// Finds at most `config.max_corners` corners, spread over the image, best cells first, finer
/// levels before coarser ones.
///
/// `mask` (level-0 size, 0 = ignore) excludes pixels; corners keep `min_distance_px` from the
/// pixels in `occupied` too. Returns an empty list for an image too small to hold one.
#[must_use]
pub fn detect_corners(
    pyramid: &Pyramid,
    mask: Option<&Mask>,
    occupied: &[Vec2],
    config: &CornerConfig,
) -> Vec<Corner> {
    let Some(finest) = pyramid.levels.first() else {
        return Vec::new();
    };
    let mut taken = Spacing::new(finest.width(), finest.height(), config.min_distance_px);
    for pixel in occupied {
        taken.insert(*pixel);
    }
    let coarsest = pyramid.num_levels() - 1;
    let first = config.level.min(coarsest);
    let config = &in_noise(finest, config);
    let last = (first + config.num_coarser).min(coarsest);
    let mut corners = Vec::with_capacity(config.max_corners);
    for level in first..=last {
        detect_on_level(pyramid, level, mask, config, &mut taken, &mut corners);
    }
    corners
}

/// The settings for an image as noisy as this one.
fn in_noise(image: &GrayImage, config: &CornerConfig) -> CornerConfig {
    let variance = noise_sigma(image).map_or(0.0, |sigma| sigma * sigma);
    let factor = (variance / USUAL_NOISE_VARIANCE).max(1.0);
    CornerConfig {
        min_score: config.min_score * factor as f32,
        ..config.clone()
    }
}

/// Adds the corners of one level that keep their distance from those taken.
fn detect_on_level(
    pyramid: &Pyramid,
    level: usize,
    mask: Option<&Mask>,
    config: &CornerConfig,
    taken: &mut Spacing,
    corners: &mut Vec<Corner>,
) {
    let missing = config.max_corners.saturating_sub(corners.len());
    if missing == 0 {
        return;
    }
    let image = pyramid.level(level);
    let scores = score_image(image);
    let min_score = config.min_score * noise_share(level.saturating_sub(config.level));
    let candidates = cell_maxima(&scores, mask, level, min_score, config);
    let mut ordered = spread(candidates, image, missing).into_iter();
    while corners.len() < config.max_corners
        && let Some((x, y, score)) = ordered.next()
    {
        let pixel = finest_pixel(&subpixel_peak(&scores, x, y), level);
        if taken.try_insert(pixel) {
            corners.push(Corner { pixel, score });
        }
    }
}

for_lanes! {
    /// Smaller eigenvalue of the mean structure tensor over 5x5 pixels; zero on a border of three.
    fn score_image = score_image_with, (image: &GrayImage) -> GrayImage;
}

#[inline(always)]
fn score_image_with<L: Lanes>(_: L, image: &GrayImage) -> GrayImage {
    const N: usize = 2 * WINDOW + 1;
    let (w, h) = (image.width(), image.height());
    let mut scores = Image::filled(w, h, 0.0f32);
    if w < N + 2 || h < N + 2 {
        return scores;
    }
    // ring of the last five rows of gx², gx gy, gy²
    let mut products: [[Vec<f32>; 3]; N] =
        std::array::from_fn(|_| std::array::from_fn(|_| vec![0.0; w]));
    let mut columns: [Vec<f32>; 3] = std::array::from_fn(|_| vec![0.0; w]);
    for y in 1..h - 1 {
        gradient_products(image, y, &mut products[y % N]);
        if y < N {
            continue;
        }
        for (c, sum) in columns.iter_mut().enumerate() {
            let [p0, p1, p2, p3, p4] = std::array::from_fn(|k| &products[k][c][..w]);
            for (x, sum) in sum.iter_mut().enumerate().take(w) {
                *sum = (p0[x] + p1[x]) + (p2[x] + p3[x]) + p4[x];
            }
        }
        let out = &mut scores.row_mut(y - WINDOW)[WINDOW + 1..w - WINDOW - 1];
        min_eigenvalues(&columns, out);
    }
    scores
}

/// Products of the central differences of one row.
#[inline(always)]
fn gradient_products(image: &GrayImage, y: usize, out: &mut [Vec<f32>; 3]) {
    let w = image.width();
    let (above, below) = (&image.row(y - 1)[1..w - 1], &image.row(y + 1)[1..w - 1]);
    let (left, right) = (&image.row(y)[..w - 2], &image.row(y)[2..]);
    let [xx, xy, yy] = out;
    let (xx, xy, yy) = (&mut xx[1..w - 1], &mut xy[1..w - 1], &mut yy[1..w - 1]);
    for i in 0..w - 2 {
        let gx = right[i] - left[i];
        let gy = below[i] - above[i];
        xx[i] = gx * gx;
        xy[i] = gx * gy;
        yy[i] = gy * gy;
    }
}

/// Smaller eigenvalue from the column sums; `out[i]` belongs to the window that starts at `i + 1`.
#[inline(always)]
fn min_eigenvalues(columns: &[Vec<f32>; 3], out: &mut [f32]) {
    // 25 pixels, and differences over two pixels squared
    let scale = 1.0 / (25.0 * 4.0);
    let n = out.len();
    let [xx, xy, yy] = columns;
    let (xx, xy, yy) = (&xx[1..n + 5], &xy[1..n + 5], &yy[1..n + 5]);
    for i in 0..n {
        let a = (xx[i] + xx[i + 1]) + (xx[i + 2] + xx[i + 3]) + xx[i + 4];
        let b = (xy[i] + xy[i + 1]) + (xy[i + 2] + xy[i + 3]) + xy[i + 4];
        let c = (yy[i] + yy[i + 1]) + (yy[i + 2] + yy[i + 3]) + yy[i + 4];
        let half_difference = 0.5 * (a - c);
        let root = (half_difference * half_difference + b * b).sqrt();
        out[i] = (0.5 * (a + c) - root) * scale;
    }
}

/// The best pixel of every small cell that is a maximum of its 3x3 neighbourhood and allowed.
fn cell_maxima(
    scores: &GrayImage,
    mask: Option<&Mask>,
    level: usize,
    min_score: f32,
    config: &CornerConfig,
) -> Vec<(usize, usize, f32)> {
    let (w, h) = (scores.width(), scores.height());
    let scale = (1usize << level) as f64;
    let border = ((config.border_px as f64 / scale).ceil() as usize).max(MIN_BORDER);
    let cell = ((config.min_distance_px / scale).floor() as usize).clamp(4, 64);
    let mut found = Vec::new();
    let (mut y0, x_end, y_end) = (border, w.saturating_sub(border), h.saturating_sub(border));
    while y0 < y_end {
        let mut x0 = border;
        while x0 < x_end {
            let mut best = (0, 0, min_score);
            for y in y0..(y0 + cell).min(y_end) {
                let row = &scores.row(y)[x0..(x0 + cell).min(x_end)];
                for (i, &score) in row.iter().enumerate() {
                    if score > best.2 {
                        best = (x0 + i, y, score);
                    }
                }
            }
            let (x, y, score) = best;
            if score > min_score && is_peak(scores, x, y) && allowed(mask, x, y, level) {
                found.push(best);
            }
            x0 += cell;
        }
        y0 += cell;
    }
    found
}

fn is_peak(scores: &GrayImage, x: usize, y: usize) -> bool {
    let value = scores.at(x, y);
    (y - 1..=y + 1).all(|yy| scores.row(yy)[x - 1..=x + 1].iter().all(|s| *s <= value))
}

fn allowed(mask: Option<&Mask>, x: usize, y: usize, level: usize) -> bool {
    mask.is_none_or(|mask| {
        let pixel = finest_pixel(&Vec2::new(x as f64, y as f64), level);
        let (mx, my) = (pixel.x.round() as usize, pixel.y.round() as usize);
        mx < mask.width() && my < mask.height() && mask.at(mx, my) > 0
    })
}

/// Orders candidates so that every prefix is spread: first the best of each large cell, then the
/// second of each, and so on; within a rank by score, then by position.
fn spread(
    mut candidates: Vec<(usize, usize, f32)>,
    image: &GrayImage,
    max_corners: usize,
) -> Vec<(usize, usize, f32)> {
    let area = (image.width() * image.height()) as f64;
    // about four corners per large cell: room to prefer good ones without leaving holes
    let cell = (4.0 * area / max_corners.max(1) as f64).sqrt().max(8.0) as usize;
    let columns = image.width() / cell + 1;
    candidates.sort_by(|a, b| b.2.total_cmp(&a.2).then((a.1, a.0).cmp(&(b.1, b.0))));
    let mut counts = vec![0usize; columns * (image.height() / cell + 1)];
    let mut ranked: Vec<(usize, (usize, usize, f32))> = candidates
        .into_iter()
        .map(|c| {
            let count = &mut counts[(c.1 / cell) * columns + c.0 / cell];
            *count += 1;
            (*count, c)
        })
        .collect();
    ranked.sort_by_key(|(rank, _)| *rank); // stable: keeps the order by score
    ranked.into_iter().map(|(_, c)| c).collect()
}

/// Vertex of the parabolas through the score and its neighbours in x and in y.
fn subpixel_peak(scores: &GrayImage, x: usize, y: usize) -> Vec2 {
    let offset = |before: f32, at: f32, after: f32| {
        let curvature = before - 2.0 * at + after;
        if curvature >= -1e-6 {
            return 0.0;
        }
        f64::from((0.5 * (before - after) / curvature).clamp(-0.5, 0.5))
    };
    let at = scores.at(x, y);
    Vec2::new(
        x as f64 + offset(scores.at(x - 1, y), at, scores.at(x + 1, y)),
        y as f64 + offset(scores.at(x, y - 1), at, scores.at(x, y + 1)),
    )
}

/// Points in cells of the minimum distance, each cell a linked list.
struct Spacing {
    distance: f64,
    columns: usize,
    rows: usize,
    heads: Vec<Option<usize>>,
    points: Vec<(Vec2, Option<usize>)>,
}

impl Spacing {
    fn new(width: usize, height: usize, distance: f64) -> Self {
        let distance = distance.max(1.0);
        let columns = (width as f64 / distance) as usize + 1;
        let rows = (height as f64 / distance) as usize + 1;
        Self {
            distance,
            columns,
            rows,
            heads: vec![None; columns * rows],
            points: Vec::new(),
        }
    }

    fn cell(&self, pixel: &Vec2) -> (usize, usize) {
        let index = |v: f64, n: usize| ((v / self.distance).max(0.0) as usize).min(n - 1);
        (index(pixel.x, self.columns), index(pixel.y, self.rows))
    }

    fn insert(&mut self, pixel: Vec2) {
        let (cx, cy) = self.cell(&pixel);
        let head = &mut self.heads[cy * self.columns + cx];
        self.points.push((pixel, *head));
        *head = Some(self.points.len() - 1);
    }

    fn try_insert(&mut self, pixel: Vec2) -> bool {
        let (cx, cy) = self.cell(&pixel);
        let limit = self.distance * self.distance;
        for y in cy.saturating_sub(1)..(cy + 2).min(self.rows) {
            for x in cx.saturating_sub(1)..(cx + 2).min(self.columns) {
                let mut next = self.heads[y * self.columns + x];
                while let Some(i) = next {
                    let (other, after) = self.points[i];
                    if (other - pixel).norm_squared() < limit {
                        return false;
                    }
                    next = after;
                }
            }
        }
        self.insert(pixel);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_images::{Texture, add_noise, blotches};
    use monogrid_image::lanes::Baseline;

    fn world() -> Pyramid {
        Pyramid::new(Texture::new(5).render(320, 240, |x, y| (x, y)), 4)
    }

    #[test]
    fn all_vectors_give_the_same_scores() {
        let world = world();
        let image = world.level(1);
        assert_eq!(score_image(image), score_image_with(Baseline, image));
    }

    #[test]
    fn score_is_the_smaller_eigenvalue_of_the_structure_tensor() {
        let image = Texture::new(1).render(40, 30, |x, y| (x, y));
        let scores = score_image(&image);
        for (x, y) in [(3, 3), (20, 14), (36, 26)] {
            let mut tensor = monogrid_geometry::nalgebra::Matrix2::<f64>::zeros();
            for yy in y - 2..=y + 2 {
                for xx in x - 2..=x + 2 {
                    let g = Vec2::new(
                        f64::from(image.at(xx + 1, yy) - image.at(xx - 1, yy)) / 2.0,
                        f64::from(image.at(xx, yy + 1) - image.at(xx, yy - 1)) / 2.0,
                    );
                    tensor += g * g.transpose() / 25.0;
                }
            }
            let expected = tensor.symmetric_eigenvalues().min();
            let found = f64::from(scores.at(x, y));
            assert!(
                (found - expected).abs() < 1e-3 * (1.0 + expected),
                "({x}, {y}): {found}, expected {expected}"
            );
        }
    }

    #[test]
    fn corners_keep_their_distance_the_mask_and_the_limit() {
        let pyramid = world();
        let mask = Mask::from_fn(320, 240, |x, _| if x < 160 { 0 } else { 255 });
        let occupied = [Vec2::new(200.0, 100.0)];
        for level in 0..2 {
            let config = CornerConfig {
                max_corners: 80,
                level,
                ..CornerConfig::default()
            };
            let corners = detect_corners(&pyramid, Some(&mask), &occupied, &config);
            assert!(corners.len() > 40 && corners.len() <= 80);
            for (i, a) in corners.iter().enumerate() {
                assert!(a.pixel.x > 158.0);
                assert!((a.pixel - occupied[0]).norm() >= 10.0);
                for b in &corners[..i] {
                    assert!((a.pixel - b.pixel).norm() >= 10.0);
                }
            }
        }
    }

    #[test]
    fn corners_cover_the_image_even_where_contrast_is_low() {
        // the left half has a third of the contrast
        let image = Texture::new(5).render(320, 240, |x, y| (x, y));
        let image = Image::from_fn(320, 240, |x, y| {
            let contrast = if x < 160 { 0.35 } else { 1.0 };
            128.0 + contrast * (image.at(x, y) - 128.0)
        });
        let config = CornerConfig {
            max_corners: 100,
            min_score: 1.0,
            ..CornerConfig::default()
        };
        let corners = detect_corners(&Pyramid::new(image, 1), None, &[], &config);
        let left = corners.iter().filter(|c| c.pixel.x < 160.0).count();
        assert!(left > 30, "{left} of {} on the left", corners.len());
    }

    /// Corners on a level and so many coarser ones of an image with noise of two grey levels.
    fn corners_in_noise(mut image: GrayImage, level: usize, num_coarser: usize) -> Vec<Corner> {
        add_noise(&mut image, 2.0, 3);
        let config = CornerConfig {
            level,
            num_coarser,
            ..CornerConfig::default()
        };
        detect_corners(&Pyramid::new(image, 4), None, &[], &config)
    }

    #[test]
    fn faint_blotches_are_corners_on_coarser_levels_and_noise_is_on_none() {
        let faint = || blotches(320, 240, |x, y| (x, y));
        let (finest, all) = (
            corners_in_noise(faint(), 0, 0),
            corners_in_noise(faint(), 0, 2),
        );
        assert!(all.len() > 60, "{}", all.len());
        assert!(
            finest.len() * 3 < all.len(),
            "{} {}",
            finest.len(),
            all.len()
        );
        assert_eq!(all[..finest.len()], finest, "the finest level is first");
        let flat = GrayImage::filled(320, 240, 128.0);
        let noise = corners_in_noise(flat, 0, 2).len();
        assert!(
            noise * 20 < all.len(),
            "{noise} in noise, {} in all",
            all.len()
        );
    }

    #[test]
    fn strong_noise_has_no_corners_either() {
        let found = |mut image: GrayImage| {
            add_noise(&mut image, 8.0, 3);
            let pyramid = Pyramid::new(image, 1);
            detect_corners(&pyramid, None, &[], &CornerConfig::default()).len()
        };
        let flat = found(GrayImage::filled(320, 240, 128.0));
        assert!(flat < 10, "{flat} of noise");
        let textured = found(Texture::new(5).render(320, 240, |x, y| (x, y)));
        assert!(textured > 100, "{textured} of a texture");
    }

    #[test]
    fn corners_move_with_the_image() {
        let texture = Texture::new(5);
        let config = CornerConfig {
            max_corners: 100,
            ..CornerConfig::default()
        };
        let find = |dx: f64| {
            let image = texture.render(320, 240, |x, y| (x + dx, y));
            detect_corners(&Pyramid::new(image, 1), None, &[], &config)
        };
        let (before, after) = (find(0.0), find(6.4));
        let repeated = before
            .iter()
            .filter(|c| {
                let expected = c.pixel - Vec2::new(6.4, 0.0);
                after.iter().any(|d| (d.pixel - expected).norm() < 1.0)
            })
            .count();
        assert!(repeated * 10 > before.len() * 6, "{repeated} repeated");
    }

    #[test]
    fn tiny_flat_and_empty_images_have_no_corners() {
        let config = CornerConfig::default();
        for image in [
            GrayImage::filled(0, 0, 0.0),
            GrayImage::filled(5, 3, 7.0),
            GrayImage::filled(100, 80, 7.0),
        ] {
            let pyramid = Pyramid::new(image, 1);
            assert!(detect_corners(&pyramid, None, &[], &config).is_empty());
        }
        assert!(detect_corners(&Pyramid::default(), None, &[], &config).is_empty());
    }
}
