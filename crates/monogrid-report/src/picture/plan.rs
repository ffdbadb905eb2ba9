//! A map from above as people read it: obstacles, free space and what nobody saw in three tones,
//! with the path of the camera and a bar of a round length.

use super::{Picture, data_url};
use crate::surface::{DXF_END, dxf_head};
use crate::svg::escape;
use monogrid_datasets::encode_png_rgb;
use monogrid_occupancy::{Occupancy, Projection};
use std::fmt::Write;

/// Obstacles, free space, unknown.
const TONES: [([u8; 3], &str); 3] = [
    ([38, 38, 44], "obstacle"),
    ([255, 255, 255], "free"),
    ([205, 205, 200], "unknown"),
];
const INK: [u8; 3] = [20, 20, 20];
const PATH: [u8; 3] = [42, 127, 200];
/// Colours of the first and the last place of the path.
const ENDS: [[u8; 3]; 2] = [[31, 158, 119], [199, 55, 47]];

/// Pixels along the longer side at most; cells of larger maps share one.
const MAX_SIDE: usize = 1600;
/// Pixels of the strip below with the bar and what the colours mean.
const STRIP: usize = 112;
/// Width of the narrowest picture: so much the strip needs.
const MIN_WIDTH: usize = 400;
/// Where the colours stand on it, px.
const KEY: [usize; 3] = [16, 170, 270];
/// Pixels per dot of a letter.
const DOT: usize = 2;

/// What is drawn.
#[derive(Clone, Copy, Debug)]
pub struct Plan<'a> {
    /// The map from above.
    pub grid: &'a Projection,
    /// Centres of the camera.
    pub path: &'a [[f64; 3]],
    /// Whether lengths are metres.
    pub is_metric: bool,
}

/// One pixel per cell, or per square of cells of a large map.
#[derive(Clone, Debug)]
pub struct Cells {
    /// The tones.
    pub picture: Picture,
    /// Edge of a pixel.
    pub edge: f64,
    /// Lower left corner.
    pub low: [f64; 2],
}

impl Plan<'_> {
    /// The tones alone.
    pub fn cells(&self) -> Cells {
        let grid = self.grid;
        let side = grid.width.max(grid.height).div_ceil(MAX_SIDE).max(1);
        let [width, height] = [grid.width, grid.height].map(|cells| cells.div_ceil(side));
        let mut tones = vec![2; width * height];
        let rows = grid.columns.chunks(grid.width.max(1)).enumerate();
        for (y, row) in rows {
            for (x, state) in row.iter().enumerate() {
                // obstacles hide free space, and that hides what is unknown
                let tone = &mut tones[(y / side) * width + x / side];
                *tone = (*tone).min(match state {
                    Occupancy::Occupied => 0,
                    Occupancy::Free => 1,
                    Occupancy::Unknown => 2,
                });
            }
        }
        Cells {
            picture: Picture::from_fn(width, height, |x, y| {
                TONES[tones[(height - 1 - y) * width + x]].0
            }),
            edge: grid.resolution * side as f64,
            low: grid.origin,
        }
    }

    /// The picture as PNG.
    pub fn png(&self) -> Vec<u8> {
        let cells = self.cells();
        let (small, scale) = (&cells.picture, cells.scale());
        let [drawn, below] = [small.width(), small.height()].map(|side| side * scale);
        let width = drawn.max(MIN_WIDTH);
        let mut picture = Picture::from_fn(width, below + STRIP, |x, y| match (x, y) {
            (x, y) if x < drawn && y < below => small.at(x / scale, y / scale),
            (_, y) if y < below => TONES[2].0,
            _ => TONES[1].0,
        });
        let at = |place: &[f64; 3]| cells.pixel(*place);
        for pair in self.path.windows(2) {
            draw_line(&mut picture, below, at(&pair[0]), at(&pair[1]));
        }
        let ends = [self.path.first(), self.path.last()];
        for (end, colour) in ends.into_iter().zip(ENDS) {
            if let Some([x, y]) = end.map(at) {
                dot(&mut picture, below, [x, y], 5, colour);
            }
        }
        let (length, text) = self.bar(&cells);
        let y = below + 14;
        fill(&mut picture, [16, y], [16 + length, y + 4], INK);
        write_text(&mut picture, [16, y + 14], &text);
        for (tone, name, [x, y]) in self.key(y + 42) {
            fill(&mut picture, [x, y], [x + 18, y + 18], INK);
            fill(&mut picture, [x + 1, y + 1], [x + 17, y + 17], tone);
            write_text(&mut picture, [x + 24, y + 2], name);
        }
        encode_png_rgb(&picture)
    }

    /// The picture as SVG, whose lines and text stay sharp.
    pub fn svg(&self) -> String {
        let cells = self.cells();
        let scale = cells.scale();
        let [drawn, below] = [cells.picture.width(), cells.picture.height()].map(|n| n * scale);
        let (width, height) = (drawn.max(MIN_WIDTH), below + STRIP);
        let css = |[r, g, b]: [u8; 3]| format!("rgb({r},{g},{b})");
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" \
             width=\"{width}\" height=\"{height}\" font-family=\"sans-serif\" font-size=\"14\">\n\
             <rect width=\"{width}\" height=\"{height}\" fill=\"white\"/>\n<image \
             width=\"{drawn}\" height=\"{below}\" style=\"image-rendering:pixelated\" \
             href=\"{}\"/>\n<polyline fill=\"none\" stroke=\"{}\" stroke-width=\"2\" points=\"",
            data_url(&encode_png_rgb(&cells.picture)),
            css(PATH)
        );
        // writing into a string cannot fail
        for place in self.path {
            let [x, y] = cells.pixel(*place);
            let _ = write!(svg, "{x:.1},{y:.1} ");
        }
        svg += "\"/>\n";
        let ends = [self.path.first(), self.path.last()];
        for (end, colour) in ends.into_iter().zip(ENDS) {
            if let Some([x, y]) = end.map(|place| cells.pixel(*place)) {
                let fill = css(colour);
                let _ = writeln!(
                    svg,
                    "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"5\" fill=\"{fill}\"/>"
                );
            }
        }
        let (length, text) = self.bar(&cells);
        let y = below + 14;
        let _ = writeln!(
            svg,
            "<rect x=\"16\" y=\"{y}\" width=\"{length}\" height=\"4\"/>\n<text x=\"16\" \
             y=\"{}\">{}</text>",
            y + 28,
            escape(&text)
        );
        for (tone, name, [x, square]) in self.key(y + 40) {
            let (tone, text) = (css(tone), square + 14);
            let _ = writeln!(
                svg,
                "<rect x=\"{x}\" y=\"{square}\" width=\"18\" height=\"18\" fill=\"{tone}\" \
                 stroke=\"black\"/>\n<text x=\"{}\" y=\"{text}\">{name}</text>",
                x + 24
            );
        }
        svg + "</svg>\n"
    }

    /// What the colours mean, and where each stands, from a height on.
    fn key(&self, top: usize) -> impl Iterator<Item = ([u8; 3], &'static str, [usize; 2])> {
        let of_path = [(PATH, "path"), (ENDS[0], "start"), (ENDS[1], "end")];
        let count = if self.path.is_empty() { 0 } else { 3 };
        let known = TONES.into_iter().chain(of_path.into_iter().take(count));
        let place = move |k: usize| [KEY[k % 3], top + 28 * (k / 3)];
        known
            .enumerate()
            .map(move |(k, (tone, name))| (tone, name, place(k)))
    }

    /// Outlines of obstacles and of what is known, and the path, as DXF: lines on a layer each.
    pub fn dxf(&self) -> String {
        let grid = self.grid;
        let at = |cell: [usize; 2]| {
            [0, 1].map(|axis| grid.origin[axis] + cell[axis] as f64 * grid.resolution)
        };
        let mut dxf = dxf_head(if self.is_metric { "m" } else { "map units" });
        for axis in 0..2 {
            let sides = [grid.width, grid.height];
            for across in 0..=sides[1 - axis] {
                // along a line between cells, from where one begins to where it ends
                let mut begun: Option<(&str, usize)> = None;
                for along in 0..=sides[axis] {
                    let layer = self.outline(axis, along, across);
                    if layer == begun.map(|(layer, _)| layer) {
                        continue;
                    }
                    if let Some((layer, from)) = begun {
                        let ends = [from, along].map(|along| match axis {
                            0 => at([along, across]),
                            _ => at([across, along]),
                        });
                        dxf += &format!("0\nLINE\n8\n{layer}\n{}", dxf_points(&ends));
                    }
                    begun = layer.map(|layer| (layer, along));
                }
            }
        }
        for pair in self.path.windows(2) {
            let ends = [0, 1].map(|k| [pair[k][0], pair[k][1]]);
            dxf += &format!("0\nLINE\n8\npath\n{}", dxf_points(&ends));
        }
        dxf + DXF_END
    }

    /// The layer of the edge between two cells, if they differ: beside each other across an axis.
    fn outline(&self, axis: usize, along: usize, across: usize) -> Option<&'static str> {
        let grid = self.grid;
        let state = |across: Option<usize>| {
            let [x, y] = match axis {
                0 => [along, across?],
                _ => [across?, along],
            };
            let is_inside = x < grid.width && y < grid.height;
            is_inside.then(|| grid.columns[y * grid.width + x])
        };
        let [before, after] = [across.checked_sub(1), Some(across)]
            .map(|across| state(across).unwrap_or(Occupancy::Unknown));
        match [before, after].contains(&Occupancy::Occupied) {
            _ if before == after => None,
            true => Some("obstacle"),
            false => Some("known"),
        }
    }

    /// Length of the bar, px, and what stands below it.
    fn bar(&self, cells: &Cells) -> (usize, String) {
        let pixels = cells.scale() as f64 / cells.edge;
        let most = 240.0 / pixels;
        let power = 10f64.powf(most.log10().floor());
        let times = [5.0, 2.0, 1.0].into_iter().find(|n| n * power <= most);
        let length = times.unwrap_or(1.0) * power;
        let text = match self.is_metric {
            true => format!("{length} m"),
            false => format!("{length} map units, scale unknown"),
        };
        ((length * pixels).round() as usize, text)
    }
}

impl Cells {
    /// Pixels of the large picture per pixel of this one.
    fn scale(&self) -> usize {
        let side = self.picture.width().max(self.picture.height());
        (MAX_SIDE / side.max(1)).clamp(1, 8)
    }

    /// Where a place is on the large picture.
    fn pixel(&self, [x, y, _]: [f64; 3]) -> [f64; 2] {
        let pixels = self.scale() as f64 / self.edge;
        let height = (self.picture.height() * self.scale()) as f64;
        [
            (x - self.low[0]) * pixels,
            height - (y - self.low[1]) * pixels,
        ]
    }
}

/// Two places as groups of DXF.
fn dxf_points(ends: &[[f64; 2]; 2]) -> String {
    let [[x, y], [u, v]] = ends;
    format!("10\n{x:.4}\n20\n{y:.4}\n30\n0\n11\n{u:.4}\n21\n{v:.4}\n31\n0\n")
}

fn fill(picture: &mut Picture, from: [usize; 2], to: [usize; 2], colour: [u8; 3]) {
    for y in from[1]..to[1].min(picture.height()) {
        for x in from[0]..to[0].min(picture.width()) {
            picture.set(x, y, colour);
        }
    }
}

/// A disc above the strip.
fn dot(picture: &mut Picture, below: usize, [x, y]: [f64; 2], radius: i64, colour: [u8; 3]) {
    for (dx, dy) in (-radius..=radius).flat_map(|dx| (-radius..=radius).map(move |dy| (dx, dy))) {
        let (x, y) = (x as i64 + dx, y as i64 + dy);
        let inside = 0 <= x && x < picture.width() as i64 && 0 <= y && y < below as i64;
        if inside && dx * dx + dy * dy <= radius * radius {
            picture.set(x as usize, y as usize, colour);
        }
    }
}

fn draw_line(picture: &mut Picture, below: usize, from: [f64; 2], to: [f64; 2]) {
    let steps = (to[0] - from[0]).abs().max((to[1] - from[1]).abs());
    // a camera that jumps farther than the picture is wide is drawn at its ends only
    let steps = steps.ceil().clamp(1.0, MAX_SIDE as f64);
    for i in 0..=steps as usize {
        let t = i as f64 / steps;
        let at = [0, 1].map(|axis| from[axis] + t * (to[axis] - from[axis]));
        dot(picture, below, at, 1, PATH);
    }
}

/// Writes a text whose upper left corner is here, in letters of 5 x 7 dots.
fn write_text(picture: &mut Picture, [left, top]: [usize; 2], text: &str) {
    for (k, letter) in text.chars().enumerate() {
        for (row, dots) in glyph(letter).into_iter().enumerate() {
            for column in (0..5).filter(|column| dots >> (4 - column) & 1 == 1) {
                let (x, y) = (left + (6 * k + column) * DOT, top + row * DOT);
                fill(picture, [x, y], [x + DOT, y + DOT], INK);
            }
        }
    }
}

/// Rows of a letter, five dots each; those that plans need.
fn glyph(letter: char) -> [u8; 7] {
    match letter {
        '0' => [14, 17, 19, 21, 25, 17, 14],
        '1' => [4, 12, 4, 4, 4, 4, 14],
        '2' => [14, 17, 1, 2, 4, 8, 31],
        '5' => [31, 16, 30, 1, 1, 17, 14],
        '.' => [0, 0, 0, 0, 0, 12, 12],
        ',' => [0, 0, 0, 0, 12, 4, 8],
        'a' => [0, 0, 14, 1, 15, 17, 15],
        'b' => [16, 16, 22, 25, 17, 17, 30],
        'c' => [0, 0, 14, 16, 16, 17, 14],
        'd' => [1, 1, 13, 19, 17, 17, 15],
        'e' => [0, 0, 14, 17, 31, 16, 14],
        'f' => [6, 9, 8, 28, 8, 8, 8],
        'h' => [16, 16, 22, 25, 17, 17, 17],
        'i' => [4, 0, 12, 4, 4, 4, 14],
        'k' => [16, 16, 18, 20, 24, 20, 18],
        'l' => [12, 4, 4, 4, 4, 4, 14],
        'm' => [0, 0, 26, 21, 21, 17, 17],
        'n' => [0, 0, 22, 25, 17, 17, 17],
        'o' => [0, 0, 14, 17, 17, 17, 14],
        'p' => [0, 0, 30, 17, 30, 16, 16],
        'r' => [0, 0, 22, 25, 16, 16, 16],
        's' => [0, 0, 14, 16, 14, 1, 30],
        't' => [8, 8, 28, 8, 8, 9, 6],
        'u' => [0, 0, 17, 17, 17, 19, 13],
        'w' => [0, 0, 17, 17, 21, 21, 10],
        _ => [0; 7],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> Projection {
        use Occupancy::{Free, Occupied, Unknown};
        Projection {
            width: 3,
            height: 2,
            resolution: 0.5,
            origin: [1.0, -1.0],
            // from below
            columns: vec![Free, Free, Occupied, Unknown, Free, Unknown],
        }
    }

    #[test]
    fn tones_stand_where_their_cells_are() {
        let grid = grid();
        let plan = Plan {
            grid: &grid,
            path: &[],
            is_metric: true,
        };
        let cells = plan.cells();
        let tones = |y| [0, 1, 2].map(|x| cells.picture.at(x, y));
        let [occupied, free, unknown] = TONES.map(|(tone, _)| tone);
        assert_eq!(tones(0), [unknown, free, unknown]);
        assert_eq!(tones(1), [free, free, occupied]);
        assert_eq!(
            (cells.edge, cells.low, cells.scale()),
            (0.5, [1.0, -1.0], 8)
        );
        // the upper right corner of the last cell
        assert_eq!(cells.pixel([2.5, 0.0, 9.0]), [24.0, 0.0]);
    }

    #[test]
    fn outlines_are_lines_on_layers() {
        let (grid, path) = (grid(), [[1.2, -0.8, 0.0], [2.4, -0.2, 0.0]]);
        let plan = Plan {
            grid: &grid,
            path: &path,
            is_metric: true,
        };
        let dxf = plan.dxf();
        let lines = |layer: &str| dxf.matches(&format!("LINE\n8\n{layer}\n")).count();
        // around one cell; left of, below and above two, and on three sides of the one above them
        assert_eq!(
            (lines("obstacle"), lines("known"), lines("path")),
            (4, 6, 1)
        );
        // the two cells below are one line
        assert!(dxf.contains("known\n10\n1.0000\n20\n-1.0000\n30\n0\n11\n2.0000\n21\n-1.0000"));
    }

    #[test]
    fn obstacles_of_large_maps_stay() {
        let mut grid = Projection {
            width: 4000,
            height: 1,
            columns: vec![Occupancy::Free; 4000],
            ..grid()
        };
        grid.columns[3001] = Occupancy::Occupied;
        let plan = Plan {
            grid: &grid,
            path: &[],
            is_metric: false,
        };
        let cells = plan.cells();
        assert_eq!((cells.picture.width(), cells.edge), (1334, 1.5));
        let dark = (0..1334).filter(|x| cells.picture.at(*x, 0) == TONES[0].0);
        assert_eq!(dark.collect::<Vec<_>>(), [1000]);
    }

    #[test]
    fn a_bar_has_a_round_length_and_says_whether_it_is_metres() {
        let grid = grid();
        let path = [[1.2, -0.8, 0.0], [2.4, -0.2, 0.0]];
        let plan = |is_metric| Plan {
            grid: &grid,
            path: &path,
            is_metric,
        };
        // 16 px per metre: 10 m are 160 px
        assert_eq!(plan(true).bar(&plan(true).cells()), (160, "10 m".into()));
        let svg = plan(false).svg();
        assert!(svg.contains("10 map units, scale unknown"), "{svg}");
        assert!(svg.contains("points=\"3.2,12.8 22.4,3.2 \""), "{svg}");
        let texts = ["0125. m", "map units, scale unknown"];
        let key: Vec<_> = plan(true).key(0).collect();
        assert_eq!(key.len(), 6);
        let names = key.iter().map(|(_, name, _)| *name);
        for text in texts.into_iter().chain(names) {
            let missing = text.chars().find(|c| *c != ' ' && glyph(*c) == [0; 7]);
            assert_eq!(missing, None, "{text}");
        }
        assert_ne!(plan(true).png(), plan(false).png());
    }
}
