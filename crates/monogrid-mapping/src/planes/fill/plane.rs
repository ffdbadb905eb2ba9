//! Planes through the outline of a region.

use monogrid_geometry::Rng;
use monogrid_geometry::{Pinhole, Sim3, Vec2, Vec3};
use monogrid_occupancy::DepthPixel as Measurement;
use nalgebra::{Matrix3, Vector3};

/// Weight of a point of the outline in front of the plane, where one behind it has 1: frames,
/// skirtings and switches stand a centimetre or two in front of the wall that they outline.
const FRONT_WEIGHT: f64 = 0.25;

/// Random triples per plane (sample consensus). Measured: planes of the cupboards in red-kitchen
/// are better than with 60.
const SAMPLES: usize = 240;
/// Measurements of the outline that must lie on a plane.
pub(crate) const MIN_INLIERS: usize = 20;
/// Share of the outline that must lie on the plane of a region; what lies in front of it is no
/// objection. Measured: dense depth beside a plain surface is often that of what stands in front
/// of it; against 0.5, red-kitchen has 6 % more of its surfaces.
const MIN_INLIER_SHARE: f64 = 0.3;
/// Largest share of the outline that may lie behind the plane.
pub(crate) const MAX_BEHIND_SHARE: f64 = 0.05;
/// How flat surfaces are: standard deviation of the inverse depth around the plane over the
/// inverse depth.
pub(crate) const FLATNESS: f64 = 0.01;
/// Neighbouring depths whose errors count as one in the uncertainty of the fit.
const CORRELATED_POINTS: f64 = 100.0;

/// Points that a candidate is judged by, at most.
const MAX_JUDGES: usize = 300;
/// Fits in which sides differ, each to the points on the one before.
const ASYMMETRIC_FITS: usize = 4;
/// Fits after these to the points near the surface.
const NARROW_FITS: usize = 3;
/// How near: so many times the spread of what lies behind it.
const NARROW_REACH: f64 = 2.0;
/// Least spread of points around a surface, in standard deviations.
const LEAST_SPREAD: f64 = 0.1;

/// A measurement on an outline.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BorderPoint {
    x: f64,
    y: f64,
    idepth: f64,
    sigma: f64,
    /// Standard deviation of its distance from a plane.
    deviation: f64,
}

/// The measurements along the outline of a region.
#[derive(Clone, Debug, Default)]
pub(crate) struct Border {
    points: Vec<BorderPoint>,
}

/// How an outline judges a plane.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Count {
    on_plane: usize,
    behind: usize,
    total: usize,
}

impl Count {
    /// Agreement less contradiction.
    pub fn score(self) -> i64 {
        self.on_plane as i64 - 4 * self.behind as i64
    }

    /// Whether enough lies on the plane, and little behind it.
    pub fn is_believable(self, min_inliers: usize, min_share: f64) -> bool {
        let total = self.total as f64;
        self.on_plane >= min_inliers
            && self.on_plane as f64 >= min_share * total
            && self.behind as f64 <= MAX_BEHIND_SHARE * total
    }
}

/// The inverse depth of a plane over the image, with the uncertainty of the fit.
#[derive(Clone, Debug)]
pub(crate) struct Plane {
    /// Of (x, y, 1), x and y relative to `center`.
    coefficients: Vector3<f64>,
    center: [f64; 2],
    covariance: Matrix3<f64>,
    /// Relative standard deviation that all its points share: that of a typical one.
    shared_sigma: f64,
    /// Points that it was fitted to.
    pub inliers: usize,
}

impl Plane {
    /// Inverse depth at a pixel and the standard deviation of the fit there.
    pub fn at(&self, x: f64, y: f64) -> (f64, f64) {
        let row = self.row(x, y);
        let variance = row.dot(&(self.covariance * row));
        let idepth = self.coefficients.dot(&row);
        (
            idepth,
            (variance.max(0.0) + (self.shared_sigma * idepth).powi(2)).sqrt(),
        )
    }

    /// Its normal, towards the keyframe, and the point at the mean of the pixels that it was fitted
    /// to, both in the world. With the inverse depth `a x + b y + c` of the pixel, `N X = 1` holds
    /// on the plane for `N = (a fx, b fy, a cx + b cy + c)`. Not finite for a plane through the
    /// camera.
    pub fn in_world(&self, pinhole: &Pinhole, world_from_keyframe: &Sim3) -> (Vec3, Vec3) {
        let ([a, b, c], [x, y]) = (self.coefficients.into(), self.center);
        let c = c - a * x - b * y;
        let normal = Vec3::new(
            a * pinhole.fx,
            b * pinhole.fy,
            a * pinhole.cx + b * pinhole.cy + c,
        );
        let ray = pinhole.unproject(&Vec2::new(x, y));
        (
            world_from_keyframe.rotation * -normal.normalize(),
            *world_from_keyframe * (ray / ray.dot(&normal)),
        )
    }

    fn row(&self, x: f64, y: f64) -> Vector3<f64> {
        Vector3::new(x - self.center[0], y - self.center[1], 1.0)
    }

    /// Whether a point lies on the plane.
    pub fn explains(&self, point: &BorderPoint) -> bool {
        self.gap(point).abs() <= 2.0
    }

    /// Inverse depth of the point less that of the plane there, in standard deviations.
    fn gap(&self, point: &BorderPoint) -> f64 {
        let expected = self.coefficients.dot(&self.row(point.x, point.y));
        (point.idepth - expected) / point.deviation
    }
}

impl Border {
    /// Adds a measurement.
    pub fn push(&mut self, point: &Measurement) {
        let (idepth, sigma) = (point.idepth.into(), point.sigma_idepth.into());
        let flatness = FLATNESS * idepth;
        let own = f64::min(sigma, flatness);
        self.points.push(BorderPoint {
            x: point.x.into(),
            y: point.y.into(),
            idepth,
            sigma,
            deviation: (own * own + flatness * flatness).sqrt(),
        });
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Finds the plane that most points lie on, and takes these points away.
    pub fn take_best_plane(&mut self, seed: u64, samples: usize) -> Option<Plane> {
        if self.points.len() < MIN_INLIERS {
            return None;
        }
        // here nothing is seen through anything: points behind a plane do not contradict it
        let score = |border: &Self, plane: &Plane| border.count(plane).on_plane as i64;
        let plane = self.best_plane(seed, samples, score)?;
        self.points.retain(|point| !plane.explains(point));
        Some(plane)
    }

    /// The surface that one of its planes stands for, as certain as that plane.
    pub fn surface(&self, plane: &Plane) -> Plane {
        converged(&self.points, plane).unwrap_or_else(|| plane.clone())
    }

    /// Where the points of the outline on a plane are, px.
    pub fn points_on(&self, plane: &Plane) -> Vec<[f64; 2]> {
        let on_plane = self.points.iter().filter(|p| plane.explains(p));
        on_plane.map(|p| [p.x, p.y]).collect()
    }

    /// How the outline judges a plane.
    pub fn count(&self, plane: &Plane) -> Count {
        let mut count = Count {
            total: self.points.len(),
            ..Count::default()
        };
        for gap in self.points.iter().map(|point| plane.gap(point)) {
            count.on_plane += usize::from(gap.abs() <= 2.0);
            count.behind += usize::from(gap < -2.5);
        }
        count
    }

    /// The plane that the outline agrees with best; none if it contradicts it.
    ///
    /// The sampling is a function of `seed` alone.
    pub fn fit_plane(&self, seed: u64) -> Option<Plane> {
        if self.points.len() < MIN_INLIERS {
            return None;
        }
        let score = |border: &Self, plane: &Plane| border.count(plane).score();
        let plane = self.best_plane(seed, SAMPLES, score)?;
        self.count(&plane)
            .is_believable(MIN_INLIERS, MIN_INLIER_SHARE)
            .then_some(plane)
    }

    /// The candidate of the best score (`[FISCHLER81]`), fitted to them.
    fn best_plane(
        &self,
        seed: u64,
        samples: usize,
        score: impl Fn(&Self, &Plane) -> i64,
    ) -> Option<Plane> {
        let points = &self.points;
        let stride = points.len().div_ceil(MAX_JUDGES);
        let judges = Self {
            points: points.iter().step_by(stride).copied().collect(),
        };
        let mut rng = Rng::new(seed.wrapping_add(0x9e37_79b9_7f4a_7c15));
        let mut best: Option<(i64, Plane)> = None;
        for _ in 0..samples {
            let triple = [(); 3].map(|()| points[(rng.next_u64() % points.len() as u64) as usize]);
            let Some(plane) = through(&triple) else {
                continue;
            };
            let score = score(&judges, &plane);
            if best.as_ref().is_none_or(|(other, _)| score > *other) {
                best = Some((score, plane));
            }
        }
        let (_, mut plane) = best?;
        for _ in 0..2 {
            plane = fitted(&within(points, &plane, 2.0), None)?;
        }
        Some(plane)
    }
}

/// The surface that a plane through its outline stands for. What stands before it, frames and
/// skirtings, is left out by fits that weigh what is before them less; what then lies behind is
/// noise, which is as large on either side.
fn converged(points: &[BorderPoint], plane: &Plane) -> Option<Plane> {
    let mut surface = plane.clone();
    for _ in 0..ASYMMETRIC_FITS {
        surface = fitted(&within(points, &surface, 2.0), Some(&surface))?;
    }
    let reach = NARROW_REACH * spread_behind(points, &surface);
    for _ in 0..NARROW_FITS {
        let near = within(points, &surface, reach);
        if near.len() < MIN_INLIERS {
            break;
        }
        surface = fitted(&near, None)?;
    }
    let [x, y] = plane.center;
    let [a, b, _] = surface.coefficients.into();
    let c = surface.coefficients.dot(&surface.row(x, y));
    Some(Plane {
        coefficients: Vector3::new(a, b, c),
        ..plane.clone()
    })
}

/// Points at most so many standard deviations off a plane.
fn within<'a>(points: &'a [BorderPoint], plane: &Plane, sigmas: f64) -> Vec<&'a BorderPoint> {
    let is_near = |point: &&BorderPoint| plane.gap(point).abs() <= sigmas;
    points.iter().filter(is_near).collect()
}

/// Root mean square of how far points on a plane lie behind it, in standard deviations.
fn spread_behind(points: &[BorderPoint], plane: &Plane) -> f64 {
    let gaps = points.iter().map(|point| plane.gap(point));
    let behind = gaps.filter(|gap| (-2.0..0.0).contains(gap));
    let (sum, count) = behind.fold((0.0, 0.0), |(sum, count), gap| {
        (sum + gap * gap, count + 1.0)
    });
    (sum / f64::max(count, 1.0)).sqrt().max(LEAST_SPREAD)
}

/// The plane through three points that are not almost on one line.
fn through(points: &[BorderPoint; 3]) -> Option<Plane> {
    let [a, b, c] = points;
    let (ux, uy) = (b.x - a.x, b.y - a.y);
    let (vx, vy) = (c.x - a.x, c.y - a.y);
    let area = ux * vy - uy * vx;
    let longest_sq = (ux * ux + uy * uy).max(vx * vx + vy * vy);
    if area.abs() < 0.1 * longest_sq || longest_sq < 25.0 {
        return None;
    }
    let (du, dv) = (b.idepth - a.idepth, c.idepth - a.idepth);
    Some(Plane {
        coefficients: Vector3::new(
            (du * vy - dv * uy) / area,
            (dv * ux - du * vx) / area,
            a.idepth,
        ),
        center: [a.x, a.y],
        covariance: Matrix3::zeros(),
        shared_sigma: 0.0,
        inliers: 3,
    })
}

/// Weighted least squares. Points before the plane `side_of` weigh less than those behind it
/// (`front_weight`; `[NEWEY87]`), but say as much about how certain it is. Neighbouring depths
/// share their errors: `correlated_points` of them count as one in the covariance.
fn fitted(points: &[&BorderPoint], side_of: Option<&Plane>) -> Option<Plane> {
    let count = points.len() as f64;
    if points.len() < 3 {
        return None;
    }
    let center = [
        points.iter().map(|p| p.x).sum::<f64>() / count,
        points.iter().map(|p| p.y).sum::<f64>() / count,
    ];
    let (mut information, mut normal) = (Matrix3::zeros(), Matrix3::zeros());
    let mut right = Vector3::zeros();
    for point in points {
        let row = Vector3::new(point.x - center[0], point.y - center[1], 1.0);
        let variance = point.sigma.powi(2) + (FLATNESS * point.idepth).powi(2);
        let is_before = side_of.is_some_and(|plane| plane.gap(point) > 0.0);
        let weight = if is_before { FRONT_WEIGHT } else { 1.0 };
        let outer = row * row.transpose() / variance;
        information += outer;
        normal += outer * weight;
        right += row * (weight * point.idepth / variance);
    }
    Some(Plane {
        coefficients: normal.try_inverse()? * right,
        center,
        covariance: information.try_inverse()? * CORRELATED_POINTS,
        shared_sigma: points.iter().map(|p| p.sigma / p.idepth).sum::<f64>() / count,
        inliers: points.len(),
    })
}
