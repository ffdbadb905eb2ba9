//! A view of a map: occupied cells as shaded cubes, seen from above at an angle, with the camera's
//! path.

use super::{Picture, box_around, colour, over_triangle, shrink};
use monogrid_occupancy::{MapError, Occupancy, OccupancyMap, SurfaceMesh};
use std::collections::BTreeMap;

/// One occupied cell, z up.
#[derive(Debug, Clone, Copy)]
pub struct Cube {
    /// Centre.
    pub center: [f64; 3],
    /// Edge length.
    pub size: f64,
}

/// Occupied leaves as cubes.
pub fn occupied_cubes(map: &OccupancyMap) -> Result<Vec<Cube>, MapError> {
    let resolution = map.resolution();
    let mut cubes = Vec::new();
    map.for_each_leaf(|leaf| {
        if map.state_of(leaf.first) == Occupancy::Occupied {
            cubes.push(Cube {
                center: leaf.center(resolution),
                size: f64::from(leaf.edge_cells) * resolution,
            });
        }
    })?;
    Ok(cubes)
}

/// How the map is looked at.
#[derive(Debug, Clone, Copy)]
pub struct View {
    /// Width of the picture, px.
    pub width: usize,
    /// Height of the picture, px.
    pub height: usize,
    /// Direction from which it is seen, radians from the x axis towards y.
    pub azimuth: f64,
    /// Angle above the horizon, radians.
    pub elevation: f64,
    /// Lower and upper corner of the box that fills the picture; `None`: what there is to see.
    pub frame: Option<[[f64; 3]; 2]>,
}

impl Default for View {
    fn default() -> Self {
        Self {
            width: 960,
            height: 640,
            azimuth: (-125.0f64).to_radians(),
            elevation: 48.0f64.to_radians(),
            frame: None,
        }
    }
}

/// Pixels rendered per pixel of the picture and axis.
const OVERSAMPLING: usize = 2;
/// How often a pixel is looked at for triangles, on average: surfaces of rooms need a few dozen,
/// a small file of triangles in one another would take minutes.
const LOOKS_PER_PIXEL: usize = 200;
const BACKGROUND: [u8; 3] = [250, 250, 248];
const PATH_COLOUR: [u8; 3] = [20, 20, 20];
/// Share of cells on each side that does not decide the extent of the picture (stray cells far
/// away).
const EXTENT_QUANTILE: f64 = 0.005;

/// Renders the cubes and the path (both z up). `cut_height`: cells whose centre lies above are left
/// out, so that ceilings do not hide rooms.
pub fn render(cubes: &[Cube], path: &[[f64; 3]], cut_height: Option<f64>, view: &View) -> Picture {
    let visible: Vec<Cube> = cubes
        .iter()
        .filter(|cube| cut_height.is_none_or(|cut| cube.center[2] <= cut))
        .copied()
        .collect();
    let mut canvas = Canvas::new(view, &visible, path);
    let heights = height_range(&visible);
    for cube in &visible {
        let fraction = (cube.center[2] - heights.0) / (heights.1 - heights.0);
        canvas.draw_cube(cube, colour::rainbow(fraction));
    }
    canvas.shade_depth_steps();
    for pair in path.windows(2) {
        canvas.draw_line(pair[0], pair[1]);
    }
    shrink(&canvas.picture, OVERSAMPLING, |pixel| pixel)
}

/// Renders cubes in given colours, one per cube.
pub fn render_coloured(cubes: &[Cube], colours: &[[u8; 3]], view: &View) -> Picture {
    let mut canvas = Canvas::new(view, cubes, &[]);
    for (cube, colour) in cubes.iter().zip(colours) {
        canvas.draw_cube(cube, *colour);
    }
    canvas.shade_depth_steps();
    shrink(&canvas.picture, OVERSAMPLING, |pixel| pixel)
}

/// Renders a surface from the side that it faces: what is seen from behind is not there, so that
/// one looks into a room. Colours are those of triangles at shares of their corners. `None` where
/// very many triangles lie in one another.
pub fn render_surface(
    surface: &SurfaceMesh,
    colour_at: impl Fn(usize, [f64; 3]) -> [u8; 3],
    path: &[[f64; 3]],
) -> Option<Picture> {
    let places = surface.vertices.iter().map(|vertex| Cube {
        center: vertex.map(f64::from),
        size: 0.0,
    });
    let places: Vec<Cube> = places.collect();
    let view = View {
        azimuth: faced_azimuth(surface).unwrap_or(View::default().azimuth),
        ..View::default()
    };
    let mut canvas = Canvas::new(&view, &places, path);
    let pixels = canvas.picture.width() * canvas.picture.height();
    let corners = |triangle: &[u32; 3]| triangle.map(|i| places[i as usize].center);
    let mut looks_left = LOOKS_PER_PIXEL * pixels;
    for triangle in &surface.triangles {
        looks_left = looks_left.checked_sub(canvas.looks_for(corners(triangle)))?;
    }
    for (number, triangle) in surface.triangles.iter().enumerate() {
        canvas.fill_triangle(corners(triangle), |shares| colour_at(number, shares));
    }
    canvas.shade_depth_steps();
    for pair in path.windows(2) {
        canvas.draw_line(pair[0], pair[1]);
    }
    Some(shrink(&canvas.picture, OVERSAMPLING, |pixel| pixel))
}

/// Share of a surface that must face one side more than the other, for it to be seen from there.
const FACED_SHARE: f64 = 0.05;

/// The side that most of a surface faces: that from which it was filmed.
fn faced_azimuth(surface: &SurfaceMesh) -> Option<f64> {
    let (mut sum, mut area) = ([0.0; 2], 0.0);
    for triangle in &surface.triangles {
        let corners = triangle.map(|i| surface.vertices[i as usize].map(f64::from));
        let normal = normal_of(corners);
        sum = [sum[0] + normal[0], sum[1] + normal[1]];
        area += dot(normal, normal).sqrt();
    }
    let is_clear = sum[0].hypot(sum[1]) > FACED_SHARE * area;
    is_clear.then(|| sum[1].atan2(sum[0]))
}

/// Normal of a triangle, twice as long as its area.
fn normal_of([a, b, c]: [[f64; 3]; 3]) -> [f64; 3] {
    let [u, v] = [b, c].map(|end| [0, 1, 2].map(|k| end[k] - a[k]));
    [
        u[1] * v[2] - u[2] * v[1],
        u[2] * v[0] - u[0] * v[2],
        u[0] * v[1] - u[1] * v[0],
    ]
}

/// Where to cut so that one looks into the room in which the camera moved: somewhat above its path,
/// or below the ceiling where that leaves more to be seen.
pub fn dollhouse_cut(cubes: &[Cube], path: &[[f64; 3]]) -> Option<f64> {
    let highest = path.iter().map(|p| p[2]).max_by(f64::total_cmp)?;
    let mut heights: Vec<f64> = cubes.iter().map(|cube| cube.center[2]).collect();
    let floor = colour::quantile(&mut heights, 0.02);
    let cut = highest + 0.15 * (highest - floor).max(0.0);
    // a camera that looks up from the floor must not lose everything that it saw
    let kept = cubes.iter().filter(|cube| cube.center[2] <= cut).count();
    if 2 * kept >= cubes.len() {
        Some(cut)
    } else {
        below_ceiling(cubes, highest)
    }
}

/// A ceiling is at most so many cells thick below its densest layer,
const CEILING_CELLS: i64 = 12;
/// and holds at least this share of the cells.
const CEILING_SHARE: f64 = 0.25;

/// Below the layer above `height` that holds most cells, where that is a ceiling: thin, and much of
/// the map.
fn below_ceiling(cubes: &[Cube], height: f64) -> Option<f64> {
    let sizes = cubes.iter().map(|cube| cube.size);
    let cell = sizes.min_by(f64::total_cmp)?;
    let area = |cube: &Cube| (cube.size / cell).powi(2);
    let mut layers: BTreeMap<i64, f64> = BTreeMap::new();
    for cube in cubes {
        let layer = ((cube.center[2] - height) / cell).floor() as i64;
        *layers.entry(layer).or_default() += area(cube);
    }
    let above = layers.range(1..);
    let (&densest, &most) = above.max_by(|a, b| a.1.total_cmp(b.1))?;
    let is_ceiling = |layer: i64| layers.get(&layer).is_some_and(|area| *area >= 0.1 * most);
    let mut lowest = densest;
    while lowest > 0 && is_ceiling(lowest - 1) {
        lowest -= 1;
    }
    let highest = densest + CEILING_CELLS;
    let ceiling: f64 = layers.range(lowest..=highest).map(|(_, area)| area).sum();
    let all: f64 = cubes.iter().map(area).sum();
    let is_thin = lowest > 0 && densest - lowest <= CEILING_CELLS;
    // a centre may lie on the border of its layer
    let cut = height + (lowest as f64 - 0.25) * cell;
    (is_thin && ceiling >= CEILING_SHARE * all).then_some(cut)
}

fn height_range(cubes: &[Cube]) -> (f64, f64) {
    let mut heights: Vec<f64> = cubes.iter().map(|cube| cube.center[2]).collect();
    let low = colour::quantile(&mut heights, 0.02);
    let high = colour::quantile(&mut heights, 0.98);
    (low, high.max(low + 1e-9))
}

struct Canvas {
    picture: Picture,
    /// Distance from the viewer, smaller is nearer.
    depth: Vec<f32>,
    /// Rows: right, up, away from the viewer.
    axes: [[f64; 3]; 3],
    pixels_per_unit: f64,
    /// Centre of the picture along right and up.
    centre: [f64; 2],
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

impl Canvas {
    fn new(view: &View, cubes: &[Cube], path: &[[f64; 3]]) -> Self {
        let (width, height) = (view.width * OVERSAMPLING, view.height * OVERSAMPLING);
        let (sin_a, cos_a) = view.azimuth.sin_cos();
        let (sin_e, cos_e) = view.elevation.sin_cos();
        let axes = [
            [-sin_a, cos_a, 0.0],
            [-cos_a * sin_e, -sin_a * sin_e, cos_e],
            [-cos_a * cos_e, -sin_a * cos_e, -sin_e],
        ];
        let extent = |axis: [f64; 3]| {
            if let Some([low, high]) = view.frame {
                return (0..3).fold((0.0, 0.0), |(least, most), a| {
                    let (p, q) = (axis[a] * low[a], axis[a] * high[a]);
                    (least + f64::min(p, q), most + f64::max(p, q))
                });
            }
            let mut positions: Vec<f64> = cubes.iter().map(|c| dot(axis, c.center)).collect();
            let mut low = colour::quantile(&mut positions, EXTENT_QUANTILE);
            let mut high = colour::quantile(&mut positions, 1.0 - EXTENT_QUANTILE);
            if positions.is_empty() {
                (low, high) = (f64::INFINITY, f64::NEG_INFINITY);
            }
            for point in path {
                low = low.min(dot(axis, *point));
                high = high.max(dot(axis, *point));
            }
            if low <= high {
                (low, high)
            } else {
                (-1.0, 1.0)
            }
        };
        let (right, up) = (extent(axes[0]), extent(axes[1]));
        let margin = 1.08;
        let pixels_per_unit = (width as f64 / (margin * (right.1 - right.0)).max(1e-9))
            .min(height as f64 / (margin * (up.1 - up.0)).max(1e-9));
        Self {
            picture: Picture::filled(width, height, BACKGROUND),
            depth: vec![f32::INFINITY; width * height],
            axes,
            pixels_per_unit,
            centre: [0.5 * (right.0 + right.1), 0.5 * (up.0 + up.1)],
        }
    }

    /// Column, row (px) and distance of a point.
    fn project(&self, point: [f64; 3]) -> [f64; 3] {
        let x = dot(self.axes[0], point) - self.centre[0];
        let y = dot(self.axes[1], point) - self.centre[1];
        [
            0.5 * self.picture.width() as f64 + x * self.pixels_per_unit,
            0.5 * self.picture.height() as f64 - y * self.pixels_per_unit,
            dot(self.axes[2], point),
        ]
    }

    /// The three faces of a cube that the viewer sees.
    fn draw_cube(&mut self, cube: &Cube, base: [u8; 3]) {
        const BRIGHTNESS: [f64; 3] = [0.80, 0.64, 1.0];
        let half = 0.5 * cube.size;
        for (axis, brightness) in BRIGHTNESS.into_iter().enumerate() {
            // the face towards the viewer: against the viewing direction
            let side = -half * self.axes[2][axis].signum();
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            let around = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
            let corners = around.map(|[du, dv]| {
                let mut point = cube.center;
                point[axis] += side;
                point[u] += du * half;
                point[v] += dv * half;
                self.project(point)
            });
            self.fill_parallelogram(&corners, colour::shade(base, brightness));
        }
    }

    /// Fills a parallelogram given by its corners in order, nearest distance wins.
    fn fill_parallelogram(&mut self, corners: &[[f64; 3]; 4], colour: [u8; 3]) {
        let [origin, first, _, second] = *corners;
        let [a, b] = [first, second].map(|end| [0, 1, 2].map(|axis| end[axis] - origin[axis]));
        let determinant = a[0] * b[1] - a[1] * b[0];
        if determinant.abs() < 1e-12 {
            return;
        }
        let (width, height) = (self.picture.width(), self.picture.height());
        let bound = |axis: usize, limit: usize| {
            let values = corners.map(|corner| corner[axis]);
            let low = values.into_iter().fold(f64::INFINITY, f64::min);
            let high = values.into_iter().fold(f64::NEG_INFINITY, f64::max);
            let low = low.ceil().max(0.0) as usize;
            low..((high.floor() + 1.0).clamp(0.0, limit as f64) as usize).max(low)
        };
        for y in bound(1, height) {
            for x in bound(0, width) {
                let (dx, dy) = (x as f64 - origin[0], y as f64 - origin[1]);
                let s = (dx * b[1] - dy * b[0]) / determinant;
                let t = (a[0] * dy - a[1] * dx) / determinant;
                if !((0.0..=1.0).contains(&s) && (0.0..=1.0).contains(&t)) {
                    continue;
                }
                let depth = (origin[2] + s * a[2] + t * b[2]) as f32;
                let index = y * width + x;
                if depth < self.depth[index] {
                    self.depth[index] = depth;
                    self.picture.set(x, y, colour);
                }
            }
        }
    }

    /// How many pixels are looked at to fill a triangle.
    fn looks_for(&self, corners: [[f64; 3]; 3]) -> usize {
        if dot(normal_of(corners), self.axes[2]) >= 0.0 {
            return 0;
        }
        let corners = corners.map(|corner| self.project(corner));
        let size = [self.picture.width(), self.picture.height()];
        let [columns, rows] = box_around(corners.map(|[x, y, _]| [x, y]), size);
        columns.len() * rows.len()
    }

    /// Fills a triangle that faces the viewer, nearest distance wins; lit from above a little, so
    /// that its shape is seen.
    fn fill_triangle(&mut self, corners: [[f64; 3]; 3], colour_at: impl Fn([f64; 3]) -> [u8; 3]) {
        const LIGHT: [f64; 3] = [0.303, 0.505, 0.808];
        let normal = normal_of(corners);
        if dot(normal, self.axes[2]) >= 0.0 {
            return;
        }
        let lit = dot(normal, LIGHT).abs() / dot(normal, normal).sqrt();
        let brightness = 0.8 + 0.2 * lit;
        let [a, b, c] = corners.map(|corner| self.project(corner));
        let size = [self.picture.width(), self.picture.height()];
        let pixels = [a, b, c].map(|[x, y, _]| [x, y]);
        over_triangle(pixels, size, |x, y, shares| {
            let depth = (shares[0] * a[2] + shares[1] * b[2] + shares[2] * c[2]) as f32;
            let nearest = &mut self.depth[y * size[0] + x];
            if depth < *nearest {
                *nearest = depth;
                let own = colour::shade(colour_at(shares), brightness);
                self.picture.set(x, y, own);
            }
        });
    }

    /// Darkens pixels that lie behind their neighbours, which makes edges readable.
    fn shade_depth_steps(&mut self) {
        let (width, height) = (self.picture.width(), self.picture.height());
        // a step of a twentieth of the picture counts as deep
        let strength = (20.0 * self.pixels_per_unit / width as f64) as f32;
        for y in 2..height.saturating_sub(2) {
            for x in 2..width.saturating_sub(2) {
                let own = self.depth[y * width + x];
                if own.is_infinite() {
                    continue;
                }
                let neighbours = [(x - 2, y), (x + 2, y), (x, y - 2), (x, y + 2)];
                let step: f32 = neighbours
                    .iter()
                    .map(|&(nx, ny)| (own - self.depth[ny * width + nx]).max(0.0))
                    .filter(|step| step.is_finite())
                    .map(|step| (step * strength).min(1.0))
                    .sum();
                let pixel = self.picture.at(x, y);
                self.picture
                    .set(x, y, colour::shade(pixel, 1.0 - 0.16 * f64::from(step)));
            }
        }
    }

    /// A line that is always visible.
    fn draw_line(&mut self, from: [f64; 3], to: [f64; 3]) {
        let (a, b) = (self.project(from), self.project(to));
        let [width, height] = [self.picture.width(), self.picture.height()].map(|n| n as f64);
        let steps = (b[0] - a[0]).abs().max((b[1] - a[1]).abs()).ceil().max(1.0);
        if !steps.is_finite() || steps > 1e5 {
            return;
        }
        for i in 0..=steps as usize {
            let t = i as f64 / steps;
            let (x, y) = (a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]));
            for (dx, dy) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
                let (x, y) = (x + dx, y + dy);
                if (0.0..width).contains(&x) && (0.0..height).contains(&y) {
                    self.picture.set(x as usize, y as usize, PATH_COLOUR);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cube(x: f64, y: f64, z: f64) -> Cube {
        Cube {
            center: [x, y, z],
            size: 1.0,
        }
    }

    #[test]
    fn what_is_nearer_hides_what_is_behind() {
        let view = View {
            width: 100,
            height: 100,
            azimuth: 0.0,
            elevation: 90.0f64.to_radians() - 1e-3,
            frame: None,
        };
        let hidden = cube(0.0, 0.0, 0.0);
        let top = cube(0.0, 0.0, 5.0);
        let both = render(&[hidden, top], &[], None, &view);
        let reversed = render(&[top, hidden], &[], None, &view);
        assert_eq!(both, reversed, "drawing order does not matter");
        // the highest cube has the last colour of the scale
        let seen = both.at(50, 50);
        assert_eq!(seen, colour::rainbow(1.0));
    }

    #[test]
    fn a_surface_is_seen_from_the_side_that_it_faces() {
        let square = |x: f32| [[x, 0.0, 0.0], [x, 1.0, 0.0], [x, 1.0, 1.0], [x, 0.0, 1.0]];
        // two walls that face +x, the left half of each red
        let surface = SurfaceMesh {
            vertices: [square(0.0), square(2.0)].concat(),
            triangles: [0, 4]
                .map(|k| [[k, k + 1, k + 2], [k, k + 2, k + 3]])
                .concat(),
            ..SurfaceMesh::default()
        };
        assert_eq!(faced_azimuth(&surface), Some(0.0));
        let colour = |triangle, _| [[200, 0, 0], [0, 0, 200]][triangle / 2];
        let seen = render_surface(&surface, colour, &[]).unwrap();
        let pixels = seen.as_slice().iter();
        let of = |channel: usize| {
            let is_it = |p: &&[u8; 3]| p[channel] > 100 && p[2 - channel] == 0;
            pixels.clone().filter(is_it).count()
        };
        assert!(of(0) > 1000 && of(2) > 1000, "{} {}", of(0), of(2));
        let again = |times| SurfaceMesh {
            triangles: surface.triangles.repeat(times),
            ..surface.clone()
        };
        assert!(render_surface(&again(10), |_, _| [0; 3], &[]).is_some());
        assert!(render_surface(&again(2000), |_, _| [0; 3], &[]).is_none());
        let turned = SurfaceMesh {
            triangles: surface
                .triangles
                .iter()
                .map(|[a, b, c]| [*a, *c, *b])
                .collect(),
            ..surface
        };
        let azimuth = faced_azimuth(&turned).unwrap();
        assert!(
            (azimuth.abs() - std::f64::consts::PI).abs() < 1e-9,
            "{azimuth}"
        );
    }

    #[test]
    fn empty_maps_give_an_empty_picture() {
        let picture = render(&[], &[], None, &View::default());
        assert!(picture.as_slice().iter().all(|&pixel| pixel == BACKGROUND));
    }

    #[test]
    fn the_cut_lies_above_the_path_and_keeps_most_of_the_map() {
        let cubes: Vec<Cube> = (0..10).map(|z| cube(0.0, 0.0, f64::from(z))).collect();
        let cut = dollhouse_cut(&cubes, &[[0.0, 0.0, 6.0]]).unwrap();
        assert!((6.0..8.0).contains(&cut), "{cut}");
        assert_eq!(dollhouse_cut(&cubes, &[[0.0, 0.0, 1.0]]), None);
    }

    #[test]
    fn a_ceiling_that_is_most_of_the_map_is_cut_off_below() {
        let layer = |z: usize, side: usize| {
            (0..side * side).map(move |k| cube((k % side) as f64, (k / side) as f64, z as f64))
        };
        // a wall of thirty layers and a ceiling of two
        let wall =
            (0..30).flat_map(|z| (0..20).map(move |x| cube(f64::from(x), 0.0, f64::from(z))));
        let room: Vec<Cube> = wall.chain(layer(30, 30)).chain(layer(31, 30)).collect();
        let cut = dollhouse_cut(&room, &[[0.0, 0.0, 10.0]]).unwrap();
        assert!((29.0..30.0).contains(&cut), "{cut}");
        // a street of high fronts has none
        let street: Vec<Cube> = (0..30).flat_map(|z| layer(z, 5)).collect();
        assert_eq!(dollhouse_cut(&street, &[[0.0, 0.0, 5.0]]), None);
    }
}
