//! Bundle adjustment with shared intrinsics: poses, points and one camera refined together.
//!
//! Levenberg-Marquardt on a robust reprojection error; points are eliminated (Schur complement),
//! the reduced system of poses and camera is dense. The first view is held; the scale is left to
//! the damping.

use crate::intrinsics::{Intrinsics, NUM_PARAMETERS, ParameterMatrix, Parameters, Prior, READOUT};
use monogrid_geometry::{Se3, Vec2, Vec3, Vec6, hat};
use monogrid_graph::RobustKernel;
use nalgebra::{DMatrix, DVector, Matrix3, SMatrix};

/// A point seen in a view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// Index of the view.
    pub view: usize,
    /// Index of the point.
    pub point: usize,
    /// Pixel as the camera has it, with distortion.
    pub pixel: Vec2,
    /// How far a rolling shutter that takes the whole time from frame to frame moves it, px: the
    /// motion from frame to frame times the [phase](monogrid_geometry::ReadoutDirection::phase) of
    /// the pixel.
    pub bend: Vec2,
}

impl Sighting {
    /// Where the middle row would have seen it.
    fn unbent(&self, readout: f64) -> Vec2 {
        self.pixel - self.bend * readout
    }
}

/// What is adjusted.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// The camera that all views share.
    pub intrinsics: Intrinsics,
    /// Poses of the views, `camera_from_world`.
    pub poses: Vec<Se3>,
    /// Points in the world.
    pub points: Vec<Vec3>,
    /// Who sees what, grouped by point.
    pub sightings: Vec<Sighting>,
}

/// Settings of [`adjust`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdjustConfig {
    /// Standard deviation of a followed corner, px. Default 0.5: corners drift from view to view.
    pub sigma_px: f64,
    /// Kernel on the error in standard deviations. Default: Cauchy at 2, which forgets what moved.
    pub kernel: RobustKernel,
    /// Accepted steps at most. Default 30.
    pub max_iterations: usize,
    /// Stop when a step lowers the cost by less than this share. Default 1e-4.
    pub min_relative_decrease: f64,
}

impl Default for AdjustConfig {
    fn default() -> Self {
        Self {
            sigma_px: 0.5,
            kernel: RobustKernel::Cauchy { scale: 2.0 },
            max_iterations: 30,
            min_relative_decrease: 1e-4,
        }
    }
}

/// A scene after adjustment.
#[derive(Clone, Debug, PartialEq)]
pub struct Adjusted {
    /// The scene.
    pub scene: Scene,
    /// Half the sum of robust squared errors, in standard deviations, with the prior.
    pub cost: f64,
    /// Information of the sightings about the parameters of the camera, with poses and points
    /// unknown; without the prior.
    pub information: SMatrix<f64, NUM_PARAMETERS, NUM_PARAMETERS>,
    /// Squared error of each sighting in standard deviations; infinite behind the camera.
    pub chi2: Vec<f64>,
}

/// Squared error charged for a point that is not in front of the camera, standard deviations.
const BEHIND_CHI2: f64 = 1e4;

/// Damping at the start, the least and the most, as a share of the diagonal.
const DAMPING: (f64, f64, f64) = (1e-3, 1e-9, 1e8);

/// Share of the diagonal that keeps the free scale from making the system singular.
const GAUGE_DAMPING: f64 = 1e-9;

/// Largest change of a parameter in one step.
const MAX_STEP: [f64; NUM_PARAMETERS] = [0.2, 0.1, 0.1, 20.0, 20.0, 0.5];

/// Refines the scene. Linear in the sightings, cubic in the views.
#[must_use]
pub fn adjust(scene: Scene, prior: &Prior, config: &AdjustConfig) -> Adjusted {
    let mut problem = Problem {
        prior,
        config,
        scene,
    };
    let (initial, least, most) = DAMPING;
    let mut damping = initial;
    let mut cost = problem.cost(&problem.scene);
    let mut accepted = 0;
    while accepted < config.max_iterations && damping < most {
        let candidate = problem.step(damping);
        let candidate_cost = candidate
            .as_ref()
            .map_or(f64::INFINITY, |c| problem.cost(c));
        match candidate {
            Some(candidate) if candidate_cost < cost => {
                let decrease = (cost - candidate_cost) / cost;
                problem.scene = candidate;
                cost = candidate_cost;
                damping = (damping / 10.0).max(least);
                accepted += 1;
                if decrease < config.min_relative_decrease {
                    break;
                }
            }
            _ => damping *= 10.0,
        }
    }
    Adjusted {
        cost,
        information: problem.information(),
        chi2: problem.errors(),
        scene: problem.scene,
    }
}

struct Problem<'a> {
    prior: &'a Prior,
    config: &'a AdjustConfig,
    scene: Scene,
}

/// A sighting, linearised and weighted.
struct Row {
    /// First column of the view in the reduced system; `None` for the view that is held.
    column: Option<usize>,
    residual: Vec2,
    by_pose: SMatrix<f64, 2, 6>,
    by_parameters: SMatrix<f64, 2, NUM_PARAMETERS>,
    by_point: SMatrix<f64, 2, 3>,
}

/// A point after elimination: what its step is once the others are known.
struct Eliminated {
    inverse: Matrix3<f64>,
    gradient: Vec3,
    /// Coupling to each view that sees it: first column and block.
    to_views: Vec<(usize, SMatrix<f64, 6, 3>)>,
    to_parameters: SMatrix<f64, NUM_PARAMETERS, 3>,
}

/// The system of poses and camera.
struct Reduced {
    matrix: DMatrix<f64>,
    right: DVector<f64>,
    points: Vec<Eliminated>,
}

impl Problem<'_> {
    /// Columns of the poses in the reduced system; those of the camera follow.
    fn pose_columns(&self) -> usize {
        6 * self.scene.poses.len().saturating_sub(1)
    }

    fn chi2(&self, scene: &Scene, sighting: &Sighting) -> Option<f64> {
        let pose = scene.poses.get(sighting.view)?;
        let point = scene.points.get(sighting.point)?;
        let pixel = scene.intrinsics.project(&(*pose * *point))?;
        let sigma = self.config.sigma_px;
        let seen = sighting.unbent(scene.intrinsics.readout);
        Some((pixel - seen).norm_squared() / (sigma * sigma))
    }

    fn cost(&self, scene: &Scene) -> f64 {
        let sightings: f64 = scene
            .sightings
            .iter()
            .map(|s| (self.config.kernel).cost(self.chi2(scene, s).unwrap_or(BEHIND_CHI2)))
            .sum();
        let offset = scene.intrinsics.parameters() - self.prior.mean;
        0.5 * (sightings + offset.component_div(&self.prior.sigma).norm_squared())
    }

    fn errors(&self) -> Vec<f64> {
        let chi2 = |s| self.chi2(&self.scene, s).unwrap_or(f64::INFINITY);
        self.scene.sightings.iter().map(chi2).collect()
    }

    fn linearise(&self, sighting: &Sighting) -> Option<Row> {
        let pose = self.scene.poses.get(sighting.view)?;
        let in_camera = *pose * *self.scene.points.get(sighting.point)?;
        let mut projection = self.scene.intrinsics.linearise(&in_camera)?;
        projection.by_parameters.set_column(READOUT, &sighting.bend);
        let error = projection.pixel - sighting.unbent(self.scene.intrinsics.readout);
        let sigma = self.config.sigma_px;
        let weight = self
            .config
            .kernel
            .weight(error.norm_squared() / (sigma * sigma));
        let scale = weight.sqrt() / sigma;
        // d(exp([v, w]) x) = v + w x point
        let mut by_pose = SMatrix::<f64, 2, 6>::zeros();
        by_pose
            .fixed_columns_mut::<3>(0)
            .copy_from(&projection.by_point);
        by_pose
            .fixed_columns_mut::<3>(3)
            .copy_from(&(-projection.by_point * hat(&in_camera)));
        Some(Row {
            column: sighting.view.checked_sub(1).map(|view| 6 * view),
            residual: error * scale,
            by_pose: by_pose * scale,
            by_parameters: projection.by_parameters * scale,
            by_point: projection.by_point * pose.rotation_matrix() * scale,
        })
    }

    /// The sightings of each point, linearised.
    fn rows_by_point(&self) -> Vec<Vec<Row>> {
        let mut rows: Vec<Vec<Row>> = self.scene.points.iter().map(|_| Vec::new()).collect();
        for sighting in &self.scene.sightings {
            if let Some(rows) = rows.get_mut(sighting.point) {
                rows.extend(self.linearise(sighting));
            }
        }
        rows
    }

    /// The reduced system at this damping (`[TRIGGS00]` section 6).
    fn reduce(&self, damping: f64) -> Reduced {
        let columns = self.pose_columns();
        let mut reduced = Reduced {
            matrix: DMatrix::zeros(columns + NUM_PARAMETERS, columns + NUM_PARAMETERS),
            right: DVector::zeros(columns + NUM_PARAMETERS),
            points: Vec::new(),
        };
        let rows_by_point = self.rows_by_point();
        for row in rows_by_point.iter().flatten() {
            reduced.add(row, columns);
        }
        let information = self.prior.information();
        let offset = self.scene.intrinsics.parameters() - self.prior.mean;
        let mut block = reduced
            .matrix
            .fixed_view_mut::<NUM_PARAMETERS, NUM_PARAMETERS>(columns, columns);
        block += information;
        let mut right = reduced.right.fixed_rows_mut::<NUM_PARAMETERS>(columns);
        right -= information * offset;
        for k in 0..columns + NUM_PARAMETERS {
            reduced.matrix[(k, k)] *= 1.0 + damping;
        }
        for rows in &rows_by_point {
            reduced.eliminate(rows, damping, columns);
        }
        reduced
    }

    /// The scene after one damped step; `None` where the system is singular.
    fn step(&self, damping: f64) -> Option<Scene> {
        let columns = self.pose_columns();
        let reduced = self.reduce(damping);
        let step = reduced.matrix.cholesky()?.solve(&reduced.right);
        let mut scene = self.scene.clone();
        let parameters: Parameters = step.fixed_rows::<NUM_PARAMETERS>(columns).into_owned();
        let bounded =
            parameters.zip_map(&Parameters::from(MAX_STEP), |p, most| p.clamp(-most, most));
        scene.intrinsics = Intrinsics::from_parameters(&(scene.intrinsics.parameters() + bounded));
        for (view, pose) in scene.poses.iter_mut().enumerate().skip(1) {
            let twist: Vec6 = step.fixed_rows::<6>(6 * (view - 1)).into_owned();
            *pose = Se3::exp(&twist) * *pose;
        }
        for (point, eliminated) in scene.points.iter_mut().zip(&reduced.points) {
            let mut gradient = eliminated.gradient - eliminated.to_parameters.tr_mul(&parameters);
            for (column, block) in &eliminated.to_views {
                gradient -= block.tr_mul(&step.fixed_rows::<6>(*column));
            }
            *point += eliminated.inverse * gradient;
        }
        Some(scene)
    }

    /// What the sightings say about the camera when poses and points are unknown.
    fn information(&self) -> ParameterMatrix {
        let columns = self.pose_columns();
        let reduced = self.reduce(GAUGE_DAMPING);
        let camera = reduced
            .matrix
            .fixed_view::<NUM_PARAMETERS, NUM_PARAMETERS>(columns, columns)
            .into_owned();
        let poses = reduced.matrix.view((0, 0), (columns, columns)).into_owned();
        let coupling = reduced
            .matrix
            .view((0, columns), (columns, NUM_PARAMETERS))
            .into_owned();
        let Some(cholesky) = poses.cholesky() else {
            return ParameterMatrix::zeros();
        };
        let known: DMatrix<f64> = coupling.transpose() * cholesky.solve(&coupling);
        let marginal = camera - known.fixed_view::<NUM_PARAMETERS, NUM_PARAMETERS>(0, 0);
        marginal - self.prior.information()
    }
}

impl Reduced {
    /// Adds what a sighting says about its pose and the camera.
    fn add(&mut self, row: &Row, columns: usize) {
        let parameters = &row.by_parameters;
        let mut camera = self
            .matrix
            .fixed_view_mut::<NUM_PARAMETERS, NUM_PARAMETERS>(columns, columns);
        camera += parameters.tr_mul(parameters);
        let mut right = self.right.fixed_rows_mut::<NUM_PARAMETERS>(columns);
        right -= parameters.tr_mul(&row.residual);
        let Some(column) = row.column else {
            return;
        };
        let mut pose = self.matrix.fixed_view_mut::<6, 6>(column, column);
        pose += row.by_pose.tr_mul(&row.by_pose);
        let coupling = row.by_pose.tr_mul(parameters);
        let mut upper = self
            .matrix
            .fixed_view_mut::<6, NUM_PARAMETERS>(column, columns);
        upper += coupling;
        let mut lower = self
            .matrix
            .fixed_view_mut::<NUM_PARAMETERS, 6>(columns, column);
        lower += coupling.transpose();
        let mut right = self.right.fixed_rows_mut::<6>(column);
        right -= row.by_pose.tr_mul(&row.residual);
    }

    /// Eliminates a point; one that the sightings do not hold stays where it is.
    fn eliminate(&mut self, rows: &[Row], damping: f64, columns: usize) {
        let mut hessian = Matrix3::zeros();
        let mut point = Eliminated {
            inverse: Matrix3::zeros(),
            gradient: Vec3::zeros(),
            to_views: Vec::with_capacity(rows.len()),
            to_parameters: SMatrix::zeros(),
        };
        for row in rows {
            hessian += row.by_point.tr_mul(&row.by_point);
            point.gradient -= row.by_point.tr_mul(&row.residual);
            point.to_parameters += row.by_parameters.tr_mul(&row.by_point);
            if let Some(column) = row.column {
                point
                    .to_views
                    .push((column, row.by_pose.tr_mul(&row.by_point)));
            }
        }
        hessian += Matrix3::from_diagonal(&(hessian.diagonal() * damping));
        if let Some(inverse) = hessian.try_inverse() {
            point.inverse = inverse;
            self.subtract(&point, columns);
        }
        self.points.push(point);
    }

    /// Subtracts what a point's unknown position takes away.
    fn subtract(&mut self, point: &Eliminated, columns: usize) {
        let to_parameters = point.to_parameters * point.inverse;
        let mut camera = self
            .matrix
            .fixed_view_mut::<NUM_PARAMETERS, NUM_PARAMETERS>(columns, columns);
        camera -= to_parameters * point.to_parameters.transpose();
        let mut right = self.right.fixed_rows_mut::<NUM_PARAMETERS>(columns);
        right -= to_parameters * point.gradient;
        for (column, block) in &point.to_views {
            let weighted = block * point.inverse;
            let mut right = self.right.fixed_rows_mut::<6>(*column);
            right -= weighted * point.gradient;
            let coupling = weighted * point.to_parameters.transpose();
            let mut upper = self
                .matrix
                .fixed_view_mut::<6, NUM_PARAMETERS>(*column, columns);
            upper -= coupling;
            let mut lower = self
                .matrix
                .fixed_view_mut::<NUM_PARAMETERS, 6>(columns, *column);
            lower -= coupling.transpose();
            for (other, other_block) in &point.to_views {
                let mut pair = self.matrix.fixed_view_mut::<6, 6>(*column, *other);
                pair -= weighted * other_block.transpose();
            }
        }
    }
}
