//! A chessboard in an image: its inner corners in the order of rows and columns.

use chess_corners::{CornerDescriptor, Detector, DetectorConfig, ImageRefiner};
use monogrid_geometry::Vec2;
use monogrid_image::GrayImage;
use std::collections::{BTreeMap, VecDeque};
use std::f64::consts::{FRAC_PI_4, PI};

/// Number of inner corners of a chessboard: where four squares meet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct BoardSize {
    /// Along its longer side.
    pub columns: usize,
    /// Along its shorter side.
    pub rows: usize,
}

impl BoardSize {
    /// The size with the longer side first; `None` for fewer than 3 by 3 corners, which cannot be
    /// told from clutter.
    #[must_use]
    pub fn new(a: usize, b: usize) -> Option<Self> {
        let (rows, columns) = (a.min(b), a.max(b));
        (rows >= 3).then_some(Self { columns, rows })
    }
}

impl std::fmt::Display for BoardSize {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}x{}", self.columns, self.rows)
    }
}

/// What an image shows of a target: a whole chessboard, or some tags of a grid.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardView {
    /// How many corners (of a chessboard) or tags it has.
    pub size: BoardSize,
    /// Those of a chessboard row by row, px; the centre of the top-left pixel of the image is (0,
    /// 0).
    pub corners: Vec<Vec2>,
    /// Where each lies on the target, in squares or sides of a tag: x right, y down.
    pub places: Vec<Vec2>,
}

impl BoardView {
    /// A whole chessboard with its corners row by row, px.
    #[must_use]
    pub fn chessboard(size: BoardSize, corners: Vec<Vec2>) -> Self {
        let place = |k: usize| Vec2::new((k % size.columns) as f64, (k / size.columns) as f64);
        Self {
            size,
            places: (0..corners.len()).map(place).collect(),
            corners,
        }
    }
}

/// The whole chessboard with the most corners in an image (grey, 0 to 255), of any size.
#[must_use]
pub fn find_board(image: &GrayImage) -> Option<BoardView> {
    let bytes: Vec<u8> = image.as_slice().iter().map(|v| *v as u8).collect();
    let corners = crossings(&bytes, (image.width(), image.height()))?;
    let next = |k, direction| next_crossings(&corners, k, direction, 1).first().copied();
    let links: Vec<[Option<usize>; 4]> = (0..corners.len())
        .map(|k| Direction::ALL.map(|direction| next(k, direction)))
        .collect();
    let mut is_used = vec![false; corners.len()];
    let mut best: Option<BoardView> = None;
    for seed in 0..corners.len() {
        if !is_used[seed] {
            let lattice = grow(&corners, &links, seed, &mut is_used);
            if let Some(board) = whole_board(&corners, &lattice)
                && best
                    .as_ref()
                    .is_none_or(|b| b.corners.len() < board.corners.len())
            {
                best = Some(board);
            }
        }
    }
    best
}

/// Places in an image of this size where black and white cross; `None` where the detector refuses
/// it.
pub(super) fn crossings(bytes: &[u8], (width, height): (usize, usize)) -> Option<Vec<Crossing>> {
    let (width, height) = (u32::try_from(width).ok()?, u32::try_from(height).ok()?);
    let config = DetectorConfig::chess_multiscale().with_refiner(ImageRefiner::saddle_point());
    let mut detector = Detector::new(config).ok()?;
    let found = detector.detect_u8(bytes, width, height).ok()?;
    Some(found.iter().filter_map(Crossing::new).collect())
}

/// A place where four squares meet.
#[derive(Clone, Copy, Debug)]
pub(super) struct Crossing {
    pub pixel: Vec2,
    /// Directions of its two edges, rad, known up to half a turn.
    edges: [f64; 2],
}

impl Crossing {
    fn new(found: &CornerDescriptor) -> Option<Self> {
        Some(Self {
            pixel: Vec2::new(found.x.into(), found.y.into()),
            edges: found.axes?.map(|axis| f64::from(axis.angle)),
        })
    }
}

/// One of the four ways along the edges of a crossing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Direction {
    edge: usize,
    is_back: bool,
}

impl Direction {
    pub const ALL: [Self; 4] = [
        Self {
            edge: 0,
            is_back: false,
        },
        Self {
            edge: 0,
            is_back: true,
        },
        Self {
            edge: 1,
            is_back: false,
        },
        Self {
            edge: 1,
            is_back: true,
        },
    ];

    pub fn index(self) -> usize {
        2 * self.edge + usize::from(self.is_back)
    }

    fn vector(self, from: &Crossing) -> Vec2 {
        let (sin, cos) = from.edges[self.edge].sin_cos();
        Vec2::new(cos, sin) * if self.is_back { -1.0 } else { 1.0 }
    }

    /// The pairs of ways of a crossing of which the second is to the right of the first (clockwise
    /// in the image).
    pub fn corners(from: &Crossing) -> impl Iterator<Item = (Self, Self)> {
        let pairs = Self::ALL
            .into_iter()
            .flat_map(|a| Self::ALL.map(|b| (a, b)));
        pairs.filter(move |(a, b)| a.edge != b.edge && a.vector(from).perp(&b.vector(from)) > 0.0)
    }

    /// Which way of another crossing leads on in this direction of `from`.
    pub fn continued(self, from: &Crossing, to: &Crossing) -> Self {
        let ahead = self.vector(from);
        let along = |direction: &Self| direction.vector(to).dot(&ahead);
        let most = Self::ALL
            .into_iter()
            .max_by(|a, b| along(a).total_cmp(&along(b)));
        most.unwrap_or(self)
    }
}

/// Largest angle between an edge and the way to the next crossing: perspective and distortion bend
/// little over one square.
const MAX_ANGLE: f64 = 0.3;

/// The next crossings in a direction, nearest first, at most so many.
pub(super) fn next_crossings(
    corners: &[Crossing],
    k: usize,
    direction: Direction,
    at_most: usize,
) -> Vec<usize> {
    let from = &corners[k];
    let ahead = direction.vector(from);
    let distance = |(other, to): (usize, &Crossing)| {
        let way = to.pixel - from.pixel;
        let distance = way.norm();
        let is_ahead = distance > 1.0 && way.dot(&ahead) > distance * MAX_ANGLE.cos();
        (is_ahead && has_edge_along(to, &way)).then_some((distance, other))
    };
    let mut next: Vec<(f64, usize)> = corners.iter().enumerate().filter_map(distance).collect();
    next.sort_by(|a, b| a.0.total_cmp(&b.0));
    next.into_iter()
        .take(at_most)
        .map(|(_, other)| other)
        .collect()
}

/// Whether one of the edges of a crossing points along a way.
fn has_edge_along(crossing: &Crossing, way: &Vec2) -> bool {
    let angle = way.y.atan2(way.x);
    crossing.edges.iter().any(|edge| {
        let turn = (angle - edge).rem_euclid(PI);
        turn.min(PI - turn) < MAX_ANGLE.min(FRAC_PI_4)
    })
}

/// Gives every crossing that edges join with the seed its place in a lattice.
fn grow(
    corners: &[Crossing],
    links: &[[Option<usize>; 4]],
    seed: usize,
    is_used: &mut [bool],
) -> BTreeMap<(i32, i32), usize> {
    /// Steps in the lattice along right, left, down and up.
    const STEPS: [(i32, i32); 4] = [(1, 0), (-1, 0), (0, 1), (0, -1)];
    let mut lattice = BTreeMap::from([((0, 0), seed)]);
    let mut open = VecDeque::from([(seed, (0, 0), Direction::ALL)]);
    is_used[seed] = true;
    while let Some((k, place, ways)) = open.pop_front() {
        for (way, step) in ways.into_iter().zip(STEPS) {
            let Some(next) = links[k][way.index()] else {
                continue;
            };
            let onward = way.continued(&corners[k], &corners[next]);
            // an edge joins two crossings only where each is the other's neighbour
            let back = Direction {
                is_back: !onward.is_back,
                ..onward
            };
            if is_used[next] || links[next][back.index()] != Some(k) {
                continue;
            }
            let there = (place.0 + step.0, place.1 + step.1);
            if lattice.contains_key(&there) {
                continue;
            }
            is_used[next] = true;
            lattice.insert(there, next);
            let on = |way: Direction| way.continued(&corners[k], &corners[next]);
            open.push_back((next, there, ways.map(on)));
        }
    }
    lattice
}

/// The lattice as a board, when it is a full rectangle.
fn whole_board(corners: &[Crossing], lattice: &BTreeMap<(i32, i32), usize>) -> Option<BoardView> {
    let range = |values: Vec<i32>| Some((*values.iter().min()?, *values.iter().max()?));
    let (left, right) = range(lattice.keys().map(|place| place.0).collect())?;
    let (top, bottom) = range(lattice.keys().map(|place| place.1).collect())?;
    let (wide, high) = ((right - left + 1) as usize, (bottom - top + 1) as usize);
    let size = BoardSize::new(wide, high)?;
    if lattice.len() != wide * high {
        return None;
    }
    let place = |column: usize, row: usize| {
        let (column, row) = (column as i32, row as i32);
        match wide >= high {
            true => (left + column, top + row),
            false => (left + row, top + column),
        }
    };
    let ordered = (0..size.rows).flat_map(|row| (0..size.columns).map(move |column| (column, row)));
    let pixel = |(column, row)| Some(corners[*lattice.get(&place(column, row))?].pixel);
    let corners = ordered.map(pixel).collect::<Option<Vec<Vec2>>>()?;
    Some(BoardView::chessboard(size, corners))
}
