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
    /// The size with the longer side first; `None` for fewer than 3 by 3 corners, which cannot be told from clutter.
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

/// A chessboard that an image shows whole.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardView {
    /// How many corners it has.
    pub size: BoardSize,
    /// Row by row, px; the centre of the top-left pixel of the image is (0, 0).
    pub corners: Vec<Vec2>,
}

/// The whole chessboard with the most corners in an image (grey, 0 to 255), of any size.
#[must_use]
pub fn find_board(image: &GrayImage) -> Option<BoardView> {
    let bytes: Vec<u8> = image.as_slice().iter().map(|v| *v as u8).collect();
    let (width, height) = (u32::try_from(image.width()), u32::try_from(image.height()));
    let config = DetectorConfig::chess_multiscale().with_refiner(ImageRefiner::saddle_point());
    let found = Detector::new(config)
        .ok()?
        .detect_u8(&bytes, width.ok()?, height.ok()?)
        .ok()?;
    let corners: Vec<Crossing> = found.iter().filter_map(Crossing::new).collect();
    let links: Vec<[Option<usize>; 4]> = (0..corners.len())
        .map(|k| Direction::ALL.map(|direction| neighbour(&corners, k, direction)))
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

/// A place where four squares meet.
#[derive(Clone, Copy, Debug)]
struct Crossing {
    pixel: Vec2,
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
struct Direction {
    edge: usize,
    is_back: bool,
}

impl Direction {
    const ALL: [Self; 4] = [
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

    fn index(self) -> usize {
        2 * self.edge + usize::from(self.is_back)
    }

    fn vector(self, from: &Crossing) -> Vec2 {
        let (sin, cos) = from.edges[self.edge].sin_cos();
        Vec2::new(cos, sin) * if self.is_back { -1.0 } else { 1.0 }
    }

    /// Which way of another crossing leads on in this direction of `from`.
    fn continued(self, from: &Crossing, to: &Crossing) -> Self {
        let ahead = self.vector(from);
        let along = |direction: &Self| direction.vector(to).dot(&ahead);
        let most = Self::ALL
            .into_iter()
            .max_by(|a, b| along(a).total_cmp(&along(b)));
        most.unwrap_or(self)
    }
}

/// Largest angle between an edge and the way to the next crossing: perspective and distortion bend little over one square.
const MAX_ANGLE: f64 = 0.3;

/// The next crossing in a direction.
fn neighbour(corners: &[Crossing], k: usize, direction: Direction) -> Option<usize> {
    let from = &corners[k];
    let ahead = direction.vector(from);
    let mut nearest: Option<(f64, usize)> = None;
    for (other, to) in corners.iter().enumerate() {
        let way = to.pixel - from.pixel;
        let distance = way.norm();
        let is_ahead = distance > 1.0 && way.dot(&ahead) > distance * MAX_ANGLE.cos();
        let is_nearer = nearest.is_none_or(|(least, _)| distance < least);
        if is_ahead && is_nearer && has_edge_along(to, &way) {
            nearest = Some((distance, other));
        }
    }
    nearest.map(|(_, other)| other)
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
    Some(BoardView {
        size,
        corners: ordered.map(pixel).collect::<Option<Vec<Vec2>>>()?,
    })
}
