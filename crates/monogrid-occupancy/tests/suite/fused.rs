//! The rule `fused` against its definition, evaluated cell by cell on a dense grid in `f64` with
//! the exact sensor model: no image pyramids, no tables, no search for bricks, no vectors.
//!
//! The definition, for a depth image: a cell's footprint is the square of its width projected at
//! the depth of its centre. It is sampled at its centre (up to 1.5 pixels), at four places (up to
//! 3.2) or at eight. A sample is the log-odds of the model for the measurement of the pixel that
//! holds it, at the range of the cell's centre; pixels without measurement and measurements that
//! say nothing there are no samples. Obstacles among several samples count three times. The update
//! is the mean of the samples times the root of the number of measurements, one to four, that the
//! footprint holds where the middle of the cell's brick lies.
#![allow(clippy::too_many_lines, reason = "a test tells its story in one place")]
#![allow(clippy::unwrap_used, reason = "a test fails where it unwraps")]

use std::collections::BTreeMap;

use crate::common::Random;
use monogrid_occupancy::*;

const WIDTH: i32 = 80;
const HEIGHT: i32 = 60;
const FOCAL: f64 = 60.0;
const CENTER: [f64; 2] = [39.5, 29.5];
/// Error of the tables for one sample: of the table itself, and of sigma being one of 32 per
/// octave.
const TABLE_ERROR: f64 = 0.1;
/// Samples so near the border of a pixel (in pixels) may fall on either side in `f32`.
const BORDER: f64 = 2e-4;
/// Samples that say so little (in log-odds) may say nothing in the table: behind the cut, or
/// exactly 0.
const LITTLE: f64 = 0.03;

struct View {
    pose: Similarity,
    pixels: Vec<DepthPixel>,
}

impl View {
    fn scan(&self, id: u32) -> Scan<'_> {
        Scan {
            id,
            world_from_sensor: self.pose,
            pose_sigma: PoseSigma {
                translation: 0.005,
                rotation_rad: 0.001,
            },
            data: ScanData::Depth(DepthScan {
                width: WIDTH as u32,
                height: HEIGHT as u32,
                fx: FOCAL,
                fy: FOCAL,
                cx: CENTER[0],
                cy: CENTER[1],
                pixels: &self.pixels,
            }),
        }
    }

    /// Depths and standard deviations of the ranges of all pixels; 0 and 1 where nothing was
    /// measured.
    fn complete(&self) -> (Vec<f32>, Vec<f32>) {
        let count = (WIDTH * HEIGHT) as usize;
        let (mut depths, mut sigmas) = (vec![0.0; count], vec![1.0; count]);
        for pixel in &self.pixels {
            let index = usize::from(pixel.y) * WIDTH as usize + usize::from(pixel.x);
            let d = f64::from(pixel.idepth);
            let kappa = length(ray_of([f64::from(pixel.x), f64::from(pixel.y)]));
            depths[index] = (1.0 / d) as f32;
            sigmas[index] = (kappa * f64::from(pixel.sigma_idepth) / (d * d)) as f32;
        }
        (depths, sigmas)
    }

    /// The same scan as a complete image.
    fn image_scan<'a>(&self, id: u32, (depths, sigmas): &'a (Vec<f32>, Vec<f32>)) -> Scan<'a> {
        let data = ScanData::Image(DepthImage {
            width: WIDTH as u32,
            height: HEIGHT as u32,
            fx: FOCAL,
            fy: FOCAL,
            cx: CENTER[0],
            cy: CENTER[1],
            depths,
            sigmas,
        });
        let Scan {
            world_from_sensor,
            pose_sigma,
            ..
        } = self.scan(id);
        Scan {
            id,
            world_from_sensor,
            pose_sigma,
            data,
        }
    }

    /// A room with a box in it, with noise, holes and false depths.
    fn random(random: &mut Random) -> Self {
        let pose = random.pose(0.3);
        let half = random.between(1.7, 2.0);
        let near = random.between(0.7, 1.1);
        let mut pixels = Vec::new();
        for y in 0..HEIGHT {
            for x in 0..WIDTH {
                let ray = ray_of([f64::from(x), f64::from(y)]);
                let in_world = pose.rotate(ray);
                let to_wall = (0..3)
                    .map(|a| (half.copysign(in_world[a]) - pose.translation[a]) / in_world[a])
                    .fold(f64::MAX, f64::min);
                let is_box = (20..40).contains(&x) && (15..45).contains(&y);
                let mut depth = if is_box { near.min(to_wall) } else { to_wall };
                depth *= 1.0 + 0.01 * random.between(-1.0, 1.0);
                if random.unit() < 0.02 {
                    depth *= random.between(0.4, 1.3);
                }
                if random.unit() < 0.25 {
                    continue;
                }
                pixels.push(DepthPixel {
                    x: x as u16,
                    y: y as u16,
                    idepth: (1.0 / depth) as f32,
                    sigma_idepth: ((0.005 + 0.015 * random.unit()) / depth) as f32,
                });
            }
        }
        Self { pose, pixels }
    }
}

fn ray_of(pixel: [f64; 2]) -> [f64; 3] {
    [
        (pixel[0] - CENTER[0]) / FOCAL,
        (pixel[1] - CENTER[1]) / FOCAL,
        1.0,
    ]
}

fn length(v: [f64; 3]) -> f64 {
    v.iter().map(|c| c * c).sum::<f64>().sqrt()
}

/// Range and its standard deviation.
#[derive(Clone, Copy)]
struct Measured {
    range: f64,
    sigma: f64,
}

/// The measurements by pixel, gaps of one pixel between opposite measurements closed.
fn measurements(image: &View) -> BTreeMap<(i32, i32), Measured> {
    let pose_sigma = image.scan(0).pose_sigma;
    let own: BTreeMap<_, _> = image
        .pixels
        .iter()
        .map(|pixel| {
            let kappa = length(ray_of([f64::from(pixel.x), f64::from(pixel.y)]));
            let d = f64::from(pixel.idepth);
            let range = kappa / d;
            let own = kappa * f64::from(pixel.sigma_idepth) / (d * d);
            let rotation = range * pose_sigma.rotation_rad;
            let sigma = (own.powi(2) + pose_sigma.translation.powi(2) + rotation.powi(2)).sqrt();
            let at = (i32::from(pixel.x), i32::from(pixel.y));
            (at, Measured { range, sigma })
        })
        .collect();
    let mut closed = own.clone();
    for x in 1..WIDTH - 1 {
        for y in 1..HEIGHT - 1 {
            let pairs = [(1, 0), (0, 1), (1, 1), (-1, 1)]
                .map(|(dx, dy)| (own.get(&(x - dx, y - dy)), own.get(&(x + dx, y + dy))));
            let agreeing = pairs.into_iter().find_map(|pair| match pair {
                (Some(a), Some(b)) if (a.range - b.range).abs() <= 0.05 * a.range.min(b.range) => {
                    Some((a, b))
                }
                _ => None,
            });
            if let Some((a, b)) = agreeing {
                closed.entry((x, y)).or_insert(Measured {
                    range: 2.0 / (1.0 / a.range + 1.0 / b.range),
                    sigma: a.sigma,
                });
            }
        }
    }
    closed
}

const EIGHT: [(i32, i32); 8] = [
    (-7, -3),
    (-5, 5),
    (-3, -7),
    (-1, 1),
    (1, 7),
    (3, -1),
    (5, -5),
    (7, 3),
];

/// What the definition says of one cell.
struct Expected {
    update: f64,
    /// How far the implementation may be off.
    bound: f64,
    /// Whether a rounding could decide otherwise.
    is_edge_case: bool,
}

/// How many updates bring a cell to what is stated of it.
fn updates(config: &IntegrationConfig) -> [f64; 2] {
    config
        .updates_to_belief
        .map(|updates| f64::from(updates.max(1)))
}

struct Definition {
    camera_from_world: Similarity,
    measured: BTreeMap<(i32, i32), Measured>,
    config: IntegrationConfig,
    cell: f64,
}

impl Definition {
    fn in_camera(&self, point: [f64; 3]) -> [f64; 3] {
        self.camera_from_world.transform(point)
    }

    fn sample(&self, pixel: [f64; 2], range: f64) -> (f64, bool) {
        let at = pixel.map(|c| (c + 0.5).floor());
        let mut is_edge_case = (0..2).any(|i| {
            let inside = pixel[i] + 0.5 - at[i];
            inside.min(1.0 - inside) < BORDER
        });
        let Some(measured) = self.measured.get(&(at[0] as i32, at[1] as i32)) else {
            return (0.0, is_edge_case);
        };
        let (low, high) = (self.config.update_min, self.config.update_max);
        let [free, occupied] = updates(&self.config);
        let limits = (free * f64::from(low), occupied * f64::from(high));
        let model = self.config.model.at_resolution(self.cell);
        let Measured { range: z, sigma } = *measured;
        let value = model.log_odds(range, z, sigma, limits);
        let share = 1.0 / if value < 0.0 { free } else { occupied };
        let cutoff = f64::from(self.config.cutoff_log_odds);
        let is_behind = range > z;
        is_edge_case |= value != 0.0
            && (share * value).abs() < LITTLE
            && (!is_behind || value.abs() > 0.5 * cutoff);
        if is_behind && value.abs() < cutoff {
            (0.0, is_edge_case)
        } else {
            (share * value, is_edge_case)
        }
    }

    /// A cell after one more update.
    fn after(&self, value: f64, update: f64) -> f64 {
        let [free, occupied] = self.config.updates_to_belief.map(|updates| match updates {
            0 => f64::INFINITY,
            updates => f64::from(updates),
        });
        let after = match update {
            u if u < 0.0 => value.min((value + u).max(free * u)),
            u if u > 0.0 => value.max((value + u).min(occupied * u)),
            _ => value,
        };
        after.clamp(-2.0, 3.5)
    }

    fn cell(&self, key: VoxelKey) -> Expected {
        let nothing = Expected {
            update: 0.0,
            bound: 0.0,
            is_edge_case: false,
        };
        let center = self.in_camera(key.center(self.cell));
        if center[2] <= 0.25 * self.cell {
            return nothing;
        }
        let range = length(center);
        let middle = [0, 1].map(|i| center[i] / center[2] * FOCAL + CENTER[i]);
        let width = self.cell * FOCAL / center[2];
        let offsets: Vec<[f64; 2]> = if width <= 1.5 {
            vec![[0.0; 2]]
        } else if width <= 3.2 {
            let four = [[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]];
            four.map(|o| o.map(|c| 0.25 * c * width)).to_vec()
        } else {
            let offset = |c: i32| f64::from(c) / 16.0 * width;
            EIGHT.map(|(u, v)| [offset(u), offset(v)]).to_vec()
        };
        let samples: Vec<_> = offsets
            .iter()
            .map(|o| self.sample([middle[0] + o[0], middle[1] + o[1]], range))
            .collect();
        let hits = samples.iter().filter(|s| s.0 != 0.0).count() as f64;
        if hits == 0.0 {
            return Expected {
                is_edge_case: samples.iter().any(|s| s.1),
                ..nothing
            };
        }
        let gain = |value: f64| {
            if value > 0.0 && offsets.len() > 1 {
                1.0 + f64::from(self.config.obstacle_weight)
            } else {
                1.0
            }
        };
        let brick = key.brick().first_cell().to_array();
        let brick_middle = brick.map(|c| (f64::from(c) + 4.0) * self.cell);
        let depth = self.in_camera(brick_middle)[2].max(0.25 * self.cell);
        let footprint = (self.cell * FOCAL / depth).powi(2).max(1.0);
        let share = hits / offsets.len() as f64;
        let factor = (footprint * share).clamp(1.0, 4.0).sqrt() / hits;
        let near_border = [1.5, 3.2].iter().any(|limit| (width - limit).abs() < 1e-4);
        Expected {
            update: factor * samples.iter().map(|s| gain(s.0) * s.0).sum::<f64>(),
            bound: factor * samples.iter().map(|s| gain(s.0) * TABLE_ERROR).sum::<f64>(),
            is_edge_case: near_border || samples.iter().any(|s| s.1),
        }
    }
}

#[test]
fn fused_is_its_definition_on_a_dense_grid_to_the_accuracy_of_the_tables() {
    let models = [
        (SensorModel::default(), [0, 0]),
        (
            SensorModel::Thrun {
                buffer: Buffer::Fixed(0.15),
                form: ThrunForm::Exact,
            },
            [0, 0],
        ),
        (SensorModel::ANDERT, [0, 0]),
        (SensorModel::default(), [15, 3]),
    ];
    for (case, (model, updates_to_belief)) in models.into_iter().enumerate() {
        // Cells so small that the camera's own pixels are used.
        for cell in [0.03, 0.04].into_iter().skip(usize::from(case > 0)) {
            let config = IntegrationConfig {
                model,
                updates_to_belief,
                ..IntegrationConfig::default()
            };
            let mut random = Random(100 + case as u64);
            let mut map = OccupancyMap::new(MapConfig::with_resolution(cell)).unwrap();
            let images: Vec<_> = (0..3).map(|_| View::random(&mut random)).collect();
            for (id, image) in images.iter().enumerate() {
                // Both forms of a depth image, in turn.
                let complete = image.complete();
                let scan = match id {
                    1 => image.image_scan(1, &complete),
                    _ => image.scan(id as u32),
                };
                let report = integrate(&mut map, &scan, &config, 2).unwrap();
                assert_eq!(report.points, image.pixels.len());
            }
            let definitions: Vec<_> = images
                .iter()
                .map(|image| Definition {
                    measured: measurements(image),
                    camera_from_world: image.pose.inverse(),
                    config: config.clone(),
                    cell,
                })
                .collect();
            let reach = (2.4 / cell) as i32;
            let (mut compared, mut edge_cases, mut occupied) = (0, 0, 0);
            let (mut error_sum, mut worst) = (0.0, 0.0_f64);
            for x in -reach..reach {
                for y in -reach..reach {
                    for z in -reach..reach {
                        let key = VoxelKey::new(x, y, z);
                        let found = map.log_odds_of(key).map(f64::from);
                        let all: Vec<_> = definitions.iter().map(|d| d.cell(key)).collect();
                        if all.iter().any(|e| e.is_edge_case) {
                            edge_cases += 1;
                            continue;
                        }
                        let is_known = all.iter().any(|e| e.update != 0.0);
                        assert_eq!(found.is_some(), is_known, "{key:?}, {model:?}, {cell}");
                        let Some(found) = found else {
                            continue;
                        };
                        // Clamped when written: errors of the scans add up at most.
                        let updates = definitions.iter().zip(&all);
                        let expected = updates.fold(0.0, |value, (d, e)| d.after(value, e.update));
                        // What is stated is steeper than what is written at most.
                        let steeper = if updates_to_belief == [0, 0] {
                            1.0
                        } else {
                            3.0
                        };
                        let bound = steeper * all.iter().map(|e| e.bound).sum::<f64>();
                        let error = (found - expected).abs();
                        assert!(
                            error <= bound,
                            "{key:?} is {found}, by definition {expected} +- {bound}; {model:?}, \
                             {cell}"
                        );
                        compared += 1;
                        occupied += usize::from(expected > 0.5);
                        error_sum += error;
                        worst = worst.max(error);
                    }
                }
            }
            let mean = error_sum / f64::from(compared);
            println!(
                "{model:?} at {cell}: {compared} cells, {occupied} occupied, {edge_cases} left \
                 out, mean difference {mean:.4}, worst {worst:.3}"
            );
            assert!(compared > 20_000 && occupied > 500 && mean < 0.01);
            assert!(edge_cases * 4 < compared, "{edge_cases} edge cases");
        }
    }
}
