//! The camera that sees a board as it is: Levenberg-Marquardt over camera and poses.
//!
//! Zhang, *A Flexible New Technique for Camera Calibration*, 2000. Instead of his closed form,
//! which knows no distortion, several fields of view are tried: with one of them the board's pose
//! follows from its homography.

use super::board::BoardView;
use monogrid_geometry::{Camera, Distortion, Pinhole, Rotation, Se3, Vec2, Vec3, Vec6};
use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, Vector3};

/// How the lens is described.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LensModel {
    /// OpenCV's `k1 k2 p1 p2`: ordinary lenses.
    RadialTangential,
    /// Kannala and Brandt's `k1 k2 k3 k4`: wide lenses and fisheyes.
    Equidistant,
}

/// Parameters of a camera: `fx fy cx cy` and four of its distortion.
const NUM_CAMERA: usize = 8;
type CameraVector = SVector<f64, NUM_CAMERA>;

impl LensModel {
    fn camera(self, parameters: &CameraVector, (width, height): (usize, usize)) -> Option<Camera> {
        let [fx, fy, cx, cy, a, b, c, d] = (*parameters).into();
        let distortion = match self {
            Self::RadialTangential => Distortion::RadialTangential {
                k1: a,
                k2: b,
                p1: c,
                p2: d,
                k3: 0.0,
            },
            Self::Equidistant => Distortion::Equidistant { k: [a, b, c, d] },
        };
        Camera::try_new(width, height, Pinhole::new(fx, fy, cx, cy), distortion).ok()
    }
}

/// A camera and where the board was in each view.
#[derive(Clone, Debug)]
pub(super) struct Fit {
    pub camera: Camera,
    /// Poses of the views, `camera_from_board`, in squares of the board.
    pub poses: Vec<Se3>,
    /// Standard deviations of `fx fy cx cy`, px, as the corners' errors have them.
    pub sigma_px: [f64; 4],
    pub model: LensModel,
    /// Half the sum of the squared errors, px.
    pub cost: f64,
}

/// Fields of view along the longer side that are tried, degrees.
const GUESSES_DEG: [f64; 5] = [40.0, 60.0, 80.0, 105.0, 140.0];

/// Error of a corner that is claimed at least, px: its place in a sharp image.
const MIN_CORNER_SIGMA_PX: f64 = 0.03;

/// Most steps of the optimiser that are accepted.
const MAX_STEPS: usize = 60;

/// Stop when a step lowers the cost by less than this share.
const MIN_DECREASE: f64 = 1e-9;

/// Standard deviations of what is believed before anything is seen, which keep what no view shows
/// from running away: the principal point as a share of the longer side, and each term of the
/// distortion.
const PRIOR_CENTRE: f64 = 0.2;
const PRIOR_DISTORTION: f64 = 1.0;

/// The camera with the least error; `None` where no guess leads to one.
pub(super) fn fit(views: &[BoardView], size: (usize, usize), model: LensModel) -> Option<Fit> {
    GUESSES_DEG
        .iter()
        .filter_map(|fov_deg| fit_from(views, size, model, *fov_deg))
        .min_by(|a, b| a.cost.total_cmp(&b.cost))
}

fn fit_from(
    views: &[BoardView],
    size: (usize, usize),
    model: LensModel,
    fov_deg: f64,
) -> Option<Fit> {
    let longer = size.0.max(size.1) as f64;
    let half = (fov_deg / 2.0).to_radians();
    let focal = longer
        / 2.0
        / match model {
            LensModel::RadialTangential => half.tan(),
            LensModel::Equidistant => half,
        };
    let (cx, cy) = ((size.0 as f64 - 1.0) / 2.0, (size.1 as f64 - 1.0) / 2.0);
    let parameters = CameraVector::from([focal, focal, cx, cy, 0.0, 0.0, 0.0, 0.0]);
    let camera = model.camera(&parameters, size)?;
    let poses = views.iter().map(|view| board_pose(view, &camera));
    let mut problem = Problem {
        views,
        size,
        model,
        expected: parameters,
        parameters,
        poses: poses.collect::<Option<Vec<Se3>>>()?,
    };
    let cost = problem.optimise()?;
    Some(Fit {
        camera: problem.model.camera(&problem.parameters, size)?,
        sigma_px: problem.sigma_px(cost),
        poses: problem.poses,
        model,
        cost,
    })
}

/// Place of a corner on the board, in squares.
pub(super) fn on_board(view: &BoardView, corner: usize) -> Vec3 {
    view.places[corner].push(0.0)
}

/// What maps places on a plane to points in an image plane with the least algebraic error.
pub(super) fn homography(pairs: impl Iterator<Item = (Vec2, Vec2)>) -> Option<Matrix3<f64>> {
    let mut matrix = SMatrix::<f64, 9, 9>::zeros();
    for (place, seen) in pairs {
        let (x, y) = (place.x, place.y);
        let rows = [
            [x, y, 1.0, 0.0, 0.0, 0.0, -seen.x * x, -seen.x * y, -seen.x],
            [0.0, 0.0, 0.0, x, y, 1.0, -seen.y * x, -seen.y * y, -seen.y],
        ];
        for row in rows.map(SVector::<f64, 9>::from) {
            matrix += row * row.transpose();
        }
    }
    let eigen = matrix.symmetric_eigen();
    let (least, _) = (eigen.eigenvalues.iter().enumerate()).min_by(|a, b| a.1.total_cmp(b.1))?;
    let h = eigen.eigenvectors.column(least);
    Some(Matrix3::from_row_slice(h.as_slice()))
}

/// Where a board is that a camera sees: from the homography between it and the directions of its
/// corners.
fn board_pose(view: &BoardView, camera: &Camera) -> Option<Se3> {
    let rays = view.corners.iter().map(|pixel| camera.unproject(pixel));
    let rays: Vec<Vec3> = rays.collect::<Option<_>>()?;
    let directions = rays.iter().map(|ray| ray.xy());
    let mut homography = homography(view.places.iter().copied().zip(directions))?;
    let scale = (homography.column(0).norm() * homography.column(1).norm()).sqrt();
    // the board lies in front of the camera
    let sign = if homography[(2, 2)] < 0.0 { -1.0 } else { 1.0 };
    homography *= sign / scale;
    let (a, b): (Vector3<f64>, Vector3<f64>) =
        (homography.column(0).into(), homography.column(1).into());
    let nearly = Matrix3::from_columns(&[a, b, a.cross(&b)]);
    let svd = nearly.svd(true, true);
    let rotation = svd.u? * svd.v_t?;
    let is_usable =
        scale > 0.0 && rotation.determinant() > 0.0 && homography.iter().all(|v| v.is_finite());
    is_usable.then(|| {
        let rotation = Rotation::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
        Se3::new(rotation, homography.column(2).into())
    })
}

struct Problem<'a> {
    views: &'a [BoardView],
    size: (usize, usize),
    model: LensModel,
    expected: CameraVector,
    parameters: CameraVector,
    poses: Vec<Se3>,
}

/// Derivatives of both coordinates of a corner by camera and pose.
struct Row {
    error: Vec2,
    by_camera: SMatrix<f64, 2, NUM_CAMERA>,
    by_pose: SMatrix<f64, 2, 6>,
}

/// What is believed beforehand, as information: nothing of the focal lengths.
fn prior_information(size: (usize, usize)) -> CameraVector {
    let centre = 1.0 / (PRIOR_CENTRE * size.0.max(size.1) as f64).powi(2);
    let terms = 1.0 / PRIOR_DISTORTION.powi(2);
    CameraVector::from([0.0, 0.0, centre, centre, terms, terms, terms, terms])
}

/// Error charged for a corner that the camera cannot see where it is, squared px.
const UNSEEN_PX_SQ: f64 = 1e6;

impl Problem<'_> {
    /// Half the sum of squared errors, px, with what was believed; `None` where the camera cannot
    /// be.
    fn cost(&self, parameters: &CameraVector, poses: &[Se3]) -> Option<f64> {
        let camera = self.model.camera(parameters, self.size)?;
        let mut sum = 0.0;
        for (view, pose) in self.views.iter().zip(poses) {
            for (k, pixel) in view.corners.iter().enumerate() {
                let seen = camera.project(&(*pose * on_board(view, k)));
                sum += seen.map_or(UNSEEN_PX_SQ, |seen| (seen - pixel).norm_squared());
            }
        }
        let offset = parameters - self.expected;
        let prior = offset.component_mul(&prior_information(self.size));
        Some(0.5 * (sum + prior.dot(&offset)))
    }

    /// Steps until nothing improves; the cost.
    fn optimise(&mut self) -> Option<f64> {
        let mut cost = self.cost(&self.parameters, &self.poses)?;
        let (mut damping, mut accepted) = (1e-3, 0);
        while accepted < MAX_STEPS && damping < 1e9 {
            let candidate = self.step(damping);
            let candidate =
                candidate.and_then(|(p, poses)| Some((self.cost(&p, &poses)?, p, poses)));
            match candidate {
                Some((lower, parameters, poses)) if lower < cost => {
                    let decrease = (cost - lower) / cost;
                    (self.parameters, self.poses, cost) = (parameters, poses, lower);
                    damping = (damping / 10.0).max(1e-12);
                    accepted += 1;
                    if decrease < MIN_DECREASE {
                        break;
                    }
                }
                _ => damping *= 10.0,
            }
        }
        Some(cost)
    }

    /// Camera and poses after one damped step; the poses are eliminated.
    fn step(&self, damping: f64) -> Option<(CameraVector, Vec<Se3>)> {
        let (mut matrix, mut right) = self.prior();
        let mut eliminated = Vec::with_capacity(self.views.len());
        let damped = |diagonal: f64| diagonal * (1.0 + damping) + 1e-12;
        for (view, pose) in self.views.iter().zip(&self.poses) {
            let mut normal = Normal::of(&self.rows(view, pose)?);
            for k in 0..6 {
                normal.pose[(k, k)] = damped(normal.pose[(k, k)]);
            }
            let inverse = normal.pose.try_inverse()?;
            matrix += normal.camera - normal.mixed * inverse * normal.mixed.transpose();
            right += normal.camera_right - normal.mixed * inverse * normal.pose_right;
            eliminated.push((inverse, normal));
        }
        for k in 0..NUM_CAMERA {
            matrix[(k, k)] = damped(matrix[(k, k)]);
        }
        let change = matrix.cholesky()?.solve(&right);
        let poses = self
            .poses
            .iter()
            .zip(&eliminated)
            .map(|(pose, (inverse, normal))| {
                let twist: Vec6 = inverse * (normal.pose_right - normal.mixed.tr_mul(&change));
                Se3::exp(&twist) * *pose
            });
        Some((self.parameters + change, poses.collect()))
    }

    fn prior(&self) -> (SMatrix<f64, NUM_CAMERA, NUM_CAMERA>, CameraVector) {
        let information = prior_information(self.size);
        let offset = self.parameters - self.expected;
        (
            SMatrix::from_diagonal(&information),
            -information.component_mul(&offset),
        )
    }

    /// Errors of the corners of a view, with their derivatives by differences.
    fn rows(&self, view: &BoardView, pose: &Se3) -> Option<Vec<Row>> {
        let camera = self.model.camera(&self.parameters, self.size)?;
        let changed: Vec<[(Camera, f64); 2]> = (0..NUM_CAMERA)
            .map(|k| {
                let step = if k < 4 { 1e-3 } else { 1e-6 };
                let moved = |by: f64| {
                    let mut parameters = self.parameters;
                    parameters[k] += by;
                    Some((self.model.camera(&parameters, self.size)?, step))
                };
                Some([moved(step)?, moved(-step)?])
            })
            .collect::<Option<_>>()?;
        let row = |k: usize, pixel: &Vec2| {
            let point = *pose * on_board(view, k);
            let mut by_camera = SMatrix::<f64, 2, NUM_CAMERA>::zeros();
            for (column, [(more, step), (less, _)]) in changed.iter().enumerate() {
                let slope = (more.project(&point)? - less.project(&point)?) / (2.0 * step);
                by_camera.set_column(column, &slope);
            }
            let mut by_pose = SMatrix::<f64, 2, 6>::zeros();
            for column in 0..6 {
                let mut twist = Vec6::zeros();
                twist[column] = 1e-6;
                let (there, back) = (Se3::exp(&twist) * point, Se3::exp(&-twist) * point);
                let slope = (camera.project(&there)? - camera.project(&back)?) / 2e-6;
                by_pose.set_column(column, &slope);
            }
            Some(Row {
                error: camera.project(&point)? - pixel,
                by_camera,
                by_pose,
            })
        };
        // a corner out of sight pulls nothing
        Some(
            view.corners
                .iter()
                .enumerate()
                .filter_map(|(k, pixel)| row(k, pixel))
                .collect(),
        )
    }

    /// Standard deviations of `fx fy cx cy`, px.
    fn sigma_px(&self, cost: f64) -> [f64; 4] {
        let (mut matrix, _) = self.prior();
        let mut count = 0;
        for (view, pose) in self.views.iter().zip(&self.poses) {
            let Some(normal) = self.rows(view, pose).map(|rows| Normal::of(&rows)) else {
                continue;
            };
            count += 2 * view.corners.len();
            if let Some(inverse) = normal.pose.try_inverse() {
                matrix += normal.camera - normal.mixed * inverse * normal.mixed.transpose();
            }
        }
        let unknowns = NUM_CAMERA + 6 * self.views.len();
        let mean_square = 2.0 * cost / count.saturating_sub(unknowns).max(1) as f64;
        let variance = mean_square.max(MIN_CORNER_SIGMA_PX.powi(2));
        let covariance = matrix
            .try_inverse()
            .unwrap_or_else(|| SMatrix::from_element(f64::INFINITY));
        [0, 1, 2, 3].map(|k| (variance * covariance[(k, k)]).max(0.0).sqrt())
    }
}

/// The normal equations of one view.
struct Normal {
    camera: SMatrix<f64, NUM_CAMERA, NUM_CAMERA>,
    mixed: SMatrix<f64, NUM_CAMERA, 6>,
    pose: SMatrix<f64, 6, 6>,
    camera_right: CameraVector,
    pose_right: Vec6,
}

impl Normal {
    fn of(rows: &[Row]) -> Self {
        let mut sum = Self {
            camera: SMatrix::zeros(),
            mixed: SMatrix::zeros(),
            pose: SMatrix::zeros(),
            camera_right: CameraVector::zeros(),
            pose_right: Vec6::zeros(),
        };
        for row in rows {
            sum.camera += row.by_camera.tr_mul(&row.by_camera);
            sum.mixed += row.by_camera.tr_mul(&row.by_pose);
            sum.pose += row.by_pose.tr_mul(&row.by_pose);
            sum.camera_right -= row.by_camera.tr_mul(&row.error);
            sum.pose_right -= row.by_pose.tr_mul(&row.error);
        }
        sum
    }
}
