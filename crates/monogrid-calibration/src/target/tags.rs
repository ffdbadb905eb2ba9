//! A grid of AprilTags in an image (Kalibr's AprilGrid): tags of the family 36h11 with small black
//! squares between their corners.
//!
//! The squares make every corner of a tag a place where black and white cross, as on a chessboard,
//! which is found to a fraction of a pixel. Four such places that edges join are a tag when what is
//! between them reads as one. Tags have numbers, so that any part of the grid will do.

use super::board::{BoardSize, BoardView, Crossing, Direction, crossings, next_crossings};
use super::family::TagFamily;
use super::fit::homography;
use monogrid_geometry::Vec2;
use monogrid_image::GrayImage;
use std::collections::BTreeMap;

/// A grid of tags.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TagGrid {
    /// Tags along each side; the numbers run along the first.
    pub size: BoardSize,
    /// Gap between two tags over the side of a tag. Range above 0 to 1; Kalibr's grids have 0.3.
    pub spacing: f64,
}

/// Widths of the black border of a tag, in bits: Kalibr's tags have 2, others 1.
const BORDERS: [usize; 2] = [2, 1];

/// Fewest tags of a view: what one tag shows of its place is in doubt.
const MIN_TAGS: usize = 4;

/// Shortest side of a tag, px: fewer than two for a bit cannot be read.
const MIN_SIDE_PX: f64 = 14.0;

/// Crossings that are tried along an edge: those of the pattern of a tag lie before its next
/// corner.
const MAX_TRIED: usize = 4;

/// A tag in an image: its number, and its corners as its pattern has them (clockwise, but nobody
/// knows from which).
struct Tag {
    number: usize,
    corners: [Vec2; 4],
}

/// The tags of a grid that an image shows (grey, 0 to 255); `None` for too few of them.
#[must_use]
pub fn find_tags(image: &GrayImage, grid: &TagGrid) -> Option<BoardView> {
    let bytes: Vec<u8> = image.as_slice().iter().map(|v| *v as u8).collect();
    let family = TagFamily::tag36h11();
    let crossings = crossings(&bytes, (image.width(), image.height()))?;
    let quads = quads(&crossings);
    let found = (crossings.as_slice(), quads.as_slice());
    let seen = BORDERS.map(|border| tags_of(image, found, border, &family, grid));
    let tags = seen.into_iter().max_by_key(BTreeMap::len)?;
    let tags: Vec<Tag> = tags.into_values().collect();
    if tags.len() < MIN_TAGS {
        return None;
    }
    // from below, as Kalibr has them, or from above; and which corner of a tag is its first
    let layouts = [true, false]
        .into_iter()
        .flat_map(|from_below| (0..4).map(move |turn| (from_below, turn)));
    let views = layouts.map(|(from_below, turn)| laid_out(&tags, grid, from_below, turn));
    let fitting = views.filter_map(|view| Some((misfit(&view)?, view)));
    fitting
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, view)| view)
}

/// Four crossings that edges join, clockwise in the image from the one that was found first.
fn quads(crossings: &[Crossing]) -> Vec<[usize; 4]> {
    let next: Vec<[Vec<usize>; 4]> = (0..crossings.len())
        .map(|k| Direction::ALL.map(|d| next_crossings(crossings, k, d, MAX_TRIED)))
        .collect();
    let mut quads = Vec::new();
    for first in 0..crossings.len() {
        for (right, down) in Direction::corners(&crossings[first]) {
            for &second in &next[first][right.index()] {
                let on = down.continued(&crossings[first], &crossings[second]);
                for &fourth in &next[first][down.index()] {
                    let across = right.continued(&crossings[first], &crossings[fourth]);
                    let closing = next[second][on.index()]
                        .iter()
                        .find(|third| next[fourth][across.index()].contains(third));
                    if let Some(&third) = closing
                        && first < second.min(third).min(fourth)
                    {
                        quads.push([first, second, third, fourth]);
                    }
                }
            }
        }
    }
    let pixels = |quad: &[usize; 4]| quad.map(|k| crossings[k].pixel);
    quads.retain(|quad| is_large(&pixels(quad)));
    quads
}

fn is_large(corners: &[Vec2; 4]) -> bool {
    (0..4).all(|k| (corners[(k + 1) % 4] - corners[k]).norm() >= MIN_SIDE_PX)
}

/// The tags among the quads by number; of several with one number, none can be trusted but the best
/// read.
fn tags_of(
    image: &GrayImage,
    (crossings, quads): (&[Crossing], &[[usize; 4]]),
    border: usize,
    family: &TagFamily,
    grid: &TagGrid,
) -> BTreeMap<usize, Tag> {
    let mut tags: BTreeMap<usize, (u32, Tag)> = BTreeMap::new();
    for quad in quads {
        let mut corners = quad.map(|k| crossings[k].pixel);
        let Some(read) = family.read(image, &corners, border) else {
            continue;
        };
        let number = read.number;
        if number >= grid.size.columns * grid.size.rows {
            continue;
        }
        corners.rotate_left(read.first_corner);
        let is_better = tags
            .get(&number)
            .is_none_or(|(wrong, _)| read.wrong_bits < *wrong);
        if is_better {
            tags.insert(number, (read.wrong_bits, Tag { number, corners }));
        }
    }
    tags.into_iter()
        .map(|(number, (_, tag))| (number, tag))
        .collect()
}

/// The corners of tags with their places on the grid, in sides of a tag, x right and y down.
fn laid_out(tags: &[Tag], grid: &TagGrid, from_below: bool, turn: usize) -> BoardView {
    const CORNERS: [[f64; 2]; 4] = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
    let BoardSize { columns, rows } = grid.size;
    let mut view = BoardView {
        size: grid.size,
        corners: Vec::new(),
        places: Vec::new(),
    };
    for tag in tags {
        let (column, row) = (tag.number % columns, tag.number / columns);
        let row = if from_below { rows - 1 - row } else { row };
        let origin = Vec2::new(column as f64, row as f64) * (1.0 + grid.spacing);
        for (k, pixel) in tag.corners.iter().enumerate() {
            view.corners.push(*pixel);
            view.places
                .push(origin + Vec2::from(CORNERS[(k + turn) % 4]));
        }
    }
    view
}

/// How badly a plane board fits a view, squared px; a lens bends all layouts alike.
fn misfit(view: &BoardView) -> Option<f64> {
    let pairs = || view.places.iter().zip(&view.corners);
    let to_pixel = homography(pairs().map(|(place, pixel)| (*place, *pixel)))?;
    let error = |(place, pixel): (&Vec2, &Vec2)| {
        let seen = to_pixel * place.push(1.0);
        (seen.xy() / seen.z - pixel).norm_squared()
    };
    Some(pairs().map(error).sum()).filter(|sum: &f64| sum.is_finite())
}
