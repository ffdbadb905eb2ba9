//! The motion of a picture as a smooth field, from some hundred corners followed from image to
//! image.
//!
//! Eight numbers are what a plane does that is seen by a moving camera (`[LONGUET84]`): a rotation,
//! and the mean motion by parallax. What single corners move otherwise is spread over their
//! surroundings.

use monogrid_geometry::Vec2;
use monogrid_geometry::median::median;
use nalgebra::{SMatrix, SVector};

/// Where something is, and how it moves there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlowSample {
    /// Its place, px.
    pub pixel: Vec2,
    /// Its velocity, px per unit of time.
    pub velocity: Vec2,
}

/// Settings of [`FlowField::fit`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlowConfig {
    /// Fewest samples. Range 8..; default 20.
    pub min_samples: usize,
    /// Distance between the nodes of the field, as a share of the longer side. Range 0.01..0.5;
    /// default 0.06.
    pub spacing: f64,
    /// How many samples right at a node weigh as much as the assumption that there is no motion
    /// beside that of the plane. Range above 0; default 0.5.
    pub stiffness: f64,
}

impl Default for FlowConfig {
    fn default() -> Self {
        Self {
            min_samples: 20,
            spacing: 0.06,
            stiffness: 0.5,
        }
    }
}

/// Velocity everywhere in an image: bilinear between the nodes of a grid.
#[derive(Clone, Debug, PartialEq)]
pub struct FlowField {
    spacing_px: f32,
    /// Number of columns of nodes.
    columns: usize,
    /// Row by row, px per unit of time.
    nodes: Vec<[f32; 2]>,
    /// Pixels of a row between two columns of nodes: the first between each two, and the end of the
    /// row.
    starts: Vec<usize>,
    /// How far each pixel of a row is from the column before it to the one behind it, [0, 1).
    fractions: Vec<f32>,
}

impl FlowField {
    /// The field through samples of an image of this size; `None` where they are too few, or lie on
    /// a line.
    #[must_use]
    pub fn fit(
        samples: &[FlowSample],
        (width, height): (usize, usize),
        config: &FlowConfig,
    ) -> Option<Self> {
        if samples.len() < config.min_samples.max(8) {
            return None;
        }
        let longer = width.max(height) as f64;
        let frame = Frame {
            centre: Vec2::new(width as f64, height as f64) / 2.0,
            unit_px: longer / 2.0,
        };
        let plane = Plane::fit(samples, frame)?;
        let rest: Vec<FlowSample> = samples
            .iter()
            .map(|sample| FlowSample {
                velocity: sample.velocity - plane.velocity(&sample.pixel),
                ..*sample
            })
            .collect();
        let spacing_px = (config.spacing * longer).max(1.0);
        let columns = (width as f64 / spacing_px) as usize + 2;
        let rows = (height as f64 / spacing_px) as usize + 2;
        let node = |k: usize| {
            let pixel = Vec2::new((k % columns) as f64, (k / columns) as f64) * spacing_px;
            let beside = local_mean(&rest, &pixel, spacing_px, config.stiffness);
            let velocity = plane.velocity(&pixel) + beside;
            [velocity.x as f32, velocity.y as f32]
        };
        let nodes = (0..columns * rows).map(node).collect();
        Some(Self::of_nodes(nodes, columns, spacing_px as f32, width))
    }

    /// For images of this width.
    fn of_nodes(nodes: Vec<[f32; 2]>, columns: usize, spacing_px: f32, width: usize) -> Self {
        let places: Vec<f32> = (0..width).map(|x| x as f32 / spacing_px).collect();
        let before = |place: &f32| (*place as usize).min(columns - 2);
        Self {
            spacing_px,
            columns,
            nodes,
            starts: (0..columns)
                .map(|column| places.partition_point(|place| before(place) < column))
                .collect(),
            fractions: places.iter().map(|p| p - before(p) as f32).collect(),
        }
    }

    /// Memory that it takes.
    #[must_use]
    pub fn num_bytes(&self) -> usize {
        size_of::<Self>()
            + size_of_val(self.nodes.as_slice())
            + size_of_val(self.starts.as_slice())
            + size_of_val(self.fractions.as_slice())
    }

    /// Velocities at the pixels of a row of the image, px per unit of time: their horizontal and
    /// their vertical parts.
    pub fn row(&self, y: usize, parts: &mut [&mut [f32]; 2]) {
        let place = y as f32 / self.spacing_px;
        let row = (place as usize).min(self.nodes.len() / self.columns - 2);
        let fy = place - row as f32;
        let (upper, lower) = self.nodes[row * self.columns..].split_at(self.columns);
        for (part, velocities) in parts.iter_mut().enumerate() {
            for (column, pixels) in self.starts.windows(2).enumerate() {
                let pixels = pixels[0]..pixels[1];
                let [a, b] = [upper[column][part], upper[column + 1][part]];
                let [c, d] = [lower[column][part], lower[column + 1][part]];
                let fractions = &self.fractions[pixels.clone()];
                for (velocity, fx) in velocities[pixels].iter_mut().zip(fractions) {
                    let top = a + fx * (b - a);
                    let bottom = c + fx * (d - c);
                    *velocity = top + fy * (bottom - top);
                }
            }
        }
    }
}

/// Mean of the velocities around a pixel, drawn towards none where there are few.
fn local_mean(samples: &[FlowSample], pixel: &Vec2, width_px: f64, stiffness: f64) -> Vec2 {
    let (mut sum, mut total) = (Vec2::zeros(), stiffness);
    for sample in samples {
        let distance_sq = (sample.pixel - pixel).norm_squared() / (width_px * width_px);
        // beyond three widths the weight is below one percent
        if distance_sq < 9.0 {
            let weight = (-0.5 * distance_sq).exp();
            sum += sample.velocity * weight;
            total += weight;
        }
    }
    sum / total
}

/// Coordinates of order one.
#[derive(Clone, Copy, Debug)]
struct Frame {
    centre: Vec2,
    unit_px: f64,
}

/// Number of parameters of the motion of a plane.
const NUM_PLANE: usize = 8;

/// Rounds of weighting by the size of the residuals.
const ROUNDS: usize = 6;

/// The picture of a plane in front of a moving camera.
#[derive(Clone, Copy, Debug)]
struct Plane {
    frame: Frame,
    parameters: SVector<f64, NUM_PLANE>,
}

impl Plane {
    /// Least absolute deviations by weighted least squares: other things than the plane do not bend
    /// it.
    fn fit(samples: &[FlowSample], frame: Frame) -> Option<Self> {
        let mut plane = Self {
            frame,
            parameters: SVector::zeros(),
        };
        for round in 0..ROUNDS {
            let typical = plane.median_residual(samples).max(1e-12);
            let mut matrix = SMatrix::<f64, NUM_PLANE, NUM_PLANE>::zeros();
            let mut right = SVector::<f64, NUM_PLANE>::zeros();
            for sample in samples {
                let basis = plane.basis(&sample.pixel);
                let residual = (sample.velocity - basis * plane.parameters).norm();
                let weight = match round {
                    0 => 1.0,
                    _ => 1.0 / residual.max(typical),
                };
                matrix += basis.tr_mul(&basis) * weight;
                right += basis.tr_mul(&sample.velocity) * weight;
            }
            plane.parameters = matrix.cholesky()?.solve(&right);
        }
        let is_finite = plane.parameters.iter().all(|p| p.is_finite());
        is_finite.then_some(plane)
    }

    fn median_residual(&self, samples: &[FlowSample]) -> f64 {
        let residual =
            |sample: &FlowSample| (sample.velocity - self.velocity(&sample.pixel)).norm();
        let mut residuals: Vec<f64> = samples.iter().map(residual).collect();
        median(&mut residuals).unwrap_or(f64::NAN)
    }

    fn basis(&self, pixel: &Vec2) -> SMatrix<f64, 2, NUM_PLANE> {
        let [x, y] = ((pixel - self.frame.centre) / self.frame.unit_px).into();
        SMatrix::<f64, 2, NUM_PLANE>::from_row_slice(&[
            1.0,
            x,
            y,
            0.0,
            0.0,
            0.0,
            x * x,
            x * y, //
            0.0,
            0.0,
            0.0,
            1.0,
            x,
            y,
            x * y,
            y * y,
        ])
    }

    fn velocity(&self, pixel: &Vec2) -> Vec2 {
        self.basis(pixel) * self.parameters
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Rng;
    use monogrid_geometry::{Pinhole, Vec3};

    const SIZE: (usize, usize) = (640, 480);

    /// What a turning and moving camera sees of points at the given depths.
    fn seen(depth: impl Fn(&Vec2) -> f64) -> Vec<FlowSample> {
        let pinhole = Pinhole::new(500.0, 500.0, 319.5, 239.5);
        let (turn, shift) = (Vec3::new(0.02, -0.03, 0.01), Vec3::new(0.02, 0.01, 0.005));
        let mut rng = Rng::new(3);
        (0..300)
            .map(|_| {
                let pixel = Vec2::new(640.0 * rng.uniform(), 480.0 * rng.uniform()).map(f64::floor);
                let point = pinhole.unproject(&pixel) * depth(&pixel);
                let half = (turn.cross(&point) + shift) / 2.0;
                FlowSample {
                    pixel,
                    velocity: pinhole.project(&(point + half)) - pinhole.project(&(point - half)),
                }
            })
            .collect()
    }

    fn largest_error(field: &FlowField, samples: &[FlowSample]) -> f64 {
        let error = |sample: &FlowSample| {
            let mut row = [[0.0; SIZE.0]; 2];
            field.row(
                sample.pixel.y as usize,
                &mut row.each_mut().map(|part| &mut part[..]),
            );
            let [u, v] = row.map(|part| f64::from(part[sample.pixel.x as usize]));
            (sample.velocity - Vec2::new(u, v)).norm()
        };
        samples.iter().map(error).fold(0.0, f64::max)
    }

    #[test]
    fn rotation_and_a_plane_are_followed_everywhere() {
        let samples = seen(|_| 2.0);
        let field = FlowField::fit(&samples, SIZE, &FlowConfig::default()).unwrap();
        assert!(largest_error(&field, &samples) < 0.1);
    }

    #[test]
    fn what_is_near_moves_as_it_does() {
        let depth = |pixel: &Vec2| if pixel.x < 320.0 { 1.0 } else { 3.0 };
        let samples = seen(depth);
        let away: Vec<FlowSample> = samples
            .iter()
            .filter(|sample| (sample.pixel.x - 320.0).abs() > 100.0)
            .copied()
            .collect();
        let stiff = FlowConfig {
            stiffness: 1e9,
            ..FlowConfig::default()
        };
        let error = |config: FlowConfig| {
            let field = FlowField::fit(&samples, SIZE, &config).unwrap();
            largest_error(&field, &away)
        };
        let (followed, only_a_plane) = (error(FlowConfig::default()), error(stiff));
        assert!(
            followed < 1.2 && followed < 0.5 * only_a_plane,
            "{followed} {only_a_plane}"
        );
    }

    #[test]
    fn a_few_wrong_corners_change_little() {
        let mut samples = seen(|_| 2.0);
        let right = samples.clone();
        for sample in samples.iter_mut().step_by(40) {
            sample.velocity = Vec2::new(60.0, -80.0);
        }
        let field = FlowField::fit(&samples, SIZE, &FlowConfig::default()).unwrap();
        let far: Vec<FlowSample> = right
            .iter()
            .filter(|sample| {
                let mut wrong = samples.iter().step_by(40);
                wrong.all(|w| (w.pixel - sample.pixel).norm() > 120.0)
            })
            .copied()
            .collect();
        assert!(far.len() > 50 && largest_error(&field, &far) < 0.3);
    }

    #[test]
    fn too_little_is_no_field() {
        let samples = seen(|_| 2.0);
        let config = FlowConfig::default();
        assert_eq!(FlowField::fit(&samples[..19], SIZE, &config), None);
        let line: Vec<FlowSample> = (0..50)
            .map(|k| FlowSample {
                pixel: Vec2::new(f64::from(k), 2.0 * f64::from(k)),
                velocity: Vec2::zeros(),
            })
            .collect();
        assert_eq!(FlowField::fit(&line, SIZE, &config), None);
    }
}
