//! Large planes that keyframes around one share, and which of them bound its view.

use super::extent::Extent;
use super::fill::{Plane, planes_of_image};
use crate::scene::{Scene, View};
use crate::{KeyframeCamera, MappingConfig};
use monogrid_geometry::{Pinhole, Sim3, Vec2, Vec3};
use monogrid_occupancy::DepthPixel as Measurement;
use nalgebra::{Matrix3, SymmetricEigen};

/// Keyframes around each that tell the planes around it.
const MAX_COVISIBLE: usize = 16;
/// Points of a keyframe, at most.
const MAX_POINTS: usize = 1000;
/// Depths of a keyframe in which planes are looked for, at most.
const MAX_DEPTHS: usize = 4000;
/// Share of the depth of all keyframes on a large plane, at least.
const MIN_SHARE: f64 = 0.02;
/// Depth is on a plane that is off by at most this share of the range.
const REACH: f64 = 0.015;
/// Share of the depth around a keyframe that may be behind a plane that bounds its view.
const MAX_BEHIND_SHARE: f64 = 0.02;
/// A point is behind a plane that is so far behind it, as a share of its range.
const BEHIND: f64 = 0.05;
/// Relative standard deviation of the depth of a point.
const RELATIVE_SIGMA: f64 = 0.01;
/// Points that lie within this share of the reach are close to a plane.
const CLOSE: f64 = 1.0 / 3.0;
/// Fewest points of a plane.
const MIN_POINTS: usize = 20;
/// Fits, each to the points on the plane before.
const NUM_FITS: usize = 4;

/// Some of what a keyframe sees.
#[derive(Clone, Debug, Default)]
pub(crate) struct Cloud {
    points: Vec<Point>,
    /// Planes that much of it lies on.
    planes: Vec<Hypothesis>,
}

#[derive(Clone, Copy, Debug)]
struct Point {
    in_world: Vec3,
    /// Distance from who sees it.
    range: f64,
}

/// A plane that a keyframe sees: `normal . x = offset`.
#[derive(Clone, Copy, Debug)]
struct Hypothesis {
    normal: Vec3,
    offset: f64,
}

impl Hypothesis {
    fn height(&self, in_world: &Vec3) -> f64 {
        self.normal.dot(in_world) - self.offset
    }

    fn has(&self, point: &Point) -> bool {
        self.is_near(point, REACH)
    }

    /// Whether a point is off by at most this share of its range.
    fn is_near(&self, point: &Point, reach: f64) -> bool {
        self.height(&point.in_world).abs() <= reach * point.range
    }
}

impl Cloud {
    /// Of a keyframe; nothing without a pose, or where nobody looks for planes.
    pub fn new(view: Option<&View>, camera: &KeyframeCamera, config: &MappingConfig) -> Self {
        let Some(view) = view.filter(|_| config.planes.max_count > 0) else {
            return Self::default();
        };
        let kinds = view.depths.kinds();
        let total: usize = kinds.iter().map(|kind| kind.len()).sum();
        let some = |most: usize| {
            let stride = total.div_ceil(most).max(1);
            let all = kinds.iter().flat_map(|kind| kind.iter());
            all.step_by(stride).copied()
        };
        let depths: Vec<Measurement> = some(MAX_DEPTHS).collect();
        let center = view.world_from_keyframe.translation;
        let point = |p: Measurement| {
            let ray = camera.pinhole.unproject(&Vec2::new(p.x.into(), p.y.into()));
            let in_world = view.world_from_keyframe * (ray / f64::from(p.idepth));
            let range = (in_world - center).norm();
            Point { in_world, range }
        };
        let hypothesis = |plane: &Plane| {
            let (normal, middle) = plane.in_world(&camera.pinhole, &view.world_from_keyframe);
            let offset = normal.dot(&middle);
            offset.is_finite().then_some(Hypothesis { normal, offset })
        };
        let planes = planes_of_image(&depths);
        Self {
            points: some(MAX_POINTS).map(point).collect(),
            planes: planes.iter().filter_map(hypothesis).collect(),
        }
    }
}

/// A plane of several keyframes.
#[derive(Clone, Debug)]
pub(crate) struct SharedPlane {
    /// Its normal is towards the keyframe whose view it bounds.
    equation: Hypothesis,
    middle: Vec3,
    /// Directions in the plane.
    axes: [Vec3; 2],
    /// Of its height at (u, v, 1) from the middle along the axes.
    covariance: Matrix3<f64>,
    extent: Extent,
    /// How flat what lies on it is: share of the points within reach of it that lie within a third
    /// of that. A wall has 0.7 to 0.95 in rendered rooms, a plane that passes through what stands
    /// around, or a curtain, 0.35 to 0.65.
    pub concentration: f64,
}

/// What a keyframe and those around it see, and the large planes that they share.
pub(crate) struct Surroundings<'a> {
    clouds: Vec<&'a Cloud>,
    pub(crate) planes: Vec<SharedPlane>,
}

impl<'a> Surroundings<'a> {
    /// Those of a keyframe with a pose, where planes are looked for; `cloud` is what each keyframe
    /// sees.
    pub fn of(
        scene: &Scene,
        index: usize,
        cloud: impl Fn(usize) -> Option<&'a Cloud>,
    ) -> Option<Self> {
        let max_count = scene.config.planes.max_count;
        let view = scene.views[index].as_ref();
        let view = view.filter(|_| max_count > 0)?;
        let around = scene.covisible(index, MAX_COVISIBLE).into_iter();
        let around = around.map(|(other, _)| other).chain([index]);
        let clouds: Vec<&Cloud> = around.filter_map(cloud).collect();
        let planes = large_planes(&clouds, &view.world_from_keyframe.translation, max_count);
        Some(Self { clouds, planes })
    }

    /// The planes that bound what the keyframe sees: those that nothing lies behind.
    pub(crate) fn bounding(&self) -> Vec<&SharedPlane> {
        let points = || self.clouds.iter().flat_map(|cloud| &cloud.points);
        let total = points().count() as f64;
        let bounds = |plane: &&SharedPlane| {
            let is_behind = |p: &&Point| plane.equation.height(&p.in_world) < -BEHIND * p.range;
            let behind = points().filter(is_behind).count();
            behind as f64 <= MAX_BEHIND_SHARE * total
        };
        self.planes.iter().filter(bounds).collect()
    }
}

/// Planes with much of the depth of several keyframes: that which a keyframe sees and most of it
/// lies on, fitted to all, then the next without its points.
fn large_planes(clouds: &[&Cloud], center: &Vec3, max_count: usize) -> Vec<SharedPlane> {
    let mut left: Vec<Vec<Point>> = clouds.iter().map(|cloud| cloud.points.clone()).collect();
    let total: usize = left.iter().map(Vec::len).sum();
    let min_count = f64::max(MIN_SHARE * total as f64, MIN_POINTS as f64) as usize;
    let count = |points: &[Vec<Point>], hypothesis: &Hypothesis| -> usize {
        let has = |point: &&Point| hypothesis.has(point);
        points.iter().flatten().filter(has).count()
    };
    let hypotheses = clouds.iter().flat_map(|cloud| &cloud.planes);
    let mut scored: Vec<(usize, Hypothesis)> = hypotheses.map(|h| (count(&left, h), *h)).collect();
    let mut planes = Vec::new();
    while planes.len() < max_count {
        // the first of equal ones
        let best = scored.iter().enumerate().rev().max_by_key(|(_, h)| h.0);
        let Some((best, (score, hypothesis))) = best.map(|(index, best)| (index, *best)) else {
            break;
        };
        if score < min_count {
            break;
        }
        scored.swap_remove(best);
        let Some(plane) = SharedPlane::through(&left, hypothesis, center) else {
            continue;
        };
        let is_on = |point: &mut Point| plane.equation.has(point);
        let taken = left.iter_mut().map(|p| p.extract_if(.., is_on).collect());
        let taken: Vec<Vec<Point>> = taken.collect();
        for (score, hypothesis) in &mut scored {
            *score -= count(&taken, hypothesis);
        }
        planes.push(plane);
    }
    planes
}

impl SharedPlane {
    /// The plane that the points on a hypothesis lie on.
    fn through(points: &[Vec<Point>], hypothesis: Hypothesis, center: &Vec3) -> Option<Self> {
        let on = |plane: &Hypothesis| -> Vec<Vec<Point>> {
            let on = |points: &Vec<Point>| {
                let on = points.iter().filter(|p| plane.has(p));
                on.copied().collect()
            };
            points.iter().map(on).collect()
        };
        let mut on_plane = on(&hypothesis);
        let mut plane = Self::fitted(&on_plane, center)?;
        for _ in 1..NUM_FITS {
            on_plane = on(&plane.equation);
            plane = Self::fitted(&on_plane, center)?;
        }
        let points = || on_plane.iter().flatten();
        let close = points().filter(|p| plane.equation.is_near(p, CLOSE * REACH));
        plane.concentration = close.count() as f64 / points().count() as f64;
        let in_plane = points().map(|p| plane.in_plane(&p.in_world));
        plane.extent = Extent::of(&in_plane.collect::<Vec<_>>());
        Some(plane)
    }

    /// Total least squares. The points of one keyframe are off together: each keyframe counts as
    /// one point as certain as those.
    fn fitted(points: &[Vec<Point>], center: &Vec3) -> Option<Self> {
        let all = || points.iter().flatten();
        let weight = |point: &Point| 1.0 / (RELATIVE_SIGMA * point.range).powi(2);
        let count = all().count();
        let num_keyframes = points.iter().filter(|p| p.len() >= MIN_POINTS).count();
        if count < MIN_POINTS {
            return None;
        }
        let total: f64 = all().map(weight).sum();
        let middle = all().map(|p| p.in_world * weight(p)).sum::<Vec3>() / total;
        let scatter = all().map(|p| {
            let off = p.in_world - middle;
            off * off.transpose() * weight(p)
        });
        let eigen = SymmetricEigen::new(scatter.sum::<Matrix3<f64>>());
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
        let [least, u, v] = order;
        let axis = |index: usize| -> Vec3 { eigen.eigenvectors.column(index).into() };
        let side = axis(least).dot(&(center - middle)).signum();
        let normal = axis(least) * side;
        let correlated = count as f64 / num_keyframes.max(1) as f64;
        let variances = [eigen.eigenvalues[u], eigen.eigenvalues[v], total]
            .map(|information| correlated / information.max(1e-12));
        let offset = normal.dot(&middle);
        Some(Self {
            equation: Hypothesis { normal, offset },
            middle,
            axes: [axis(u), axis(v)],
            covariance: Matrix3::from_diagonal(&variances.into()),
            extent: Extent::default(),
            concentration: 0.0,
        })
    }

    fn in_plane(&self, in_world: &Vec3) -> [f64; 2] {
        let off = in_world - self.middle;
        self.axes.map(|axis| axis.dot(&off))
    }
}

/// A plane as a keyframe sees it.
pub(crate) struct SeenPlane<'a> {
    plane: &'a SharedPlane,
    /// (a, b, c) of its inverse depth `a x + b y + c` at a pixel, in the keyframe's units.
    idepth: Vec3,
    world_from_keyframe: Sim3,
    pinhole: &'a Pinhole,
}

impl<'a> SeenPlane<'a> {
    /// With the ray r of a pixel and its inverse depth d, `normal . (s R r / d + t) = offset`.
    pub fn new(
        plane: &'a SharedPlane,
        world_from_keyframe: &Sim3,
        camera: &'a KeyframeCamera,
    ) -> Self {
        let pinhole = &camera.pinhole;
        let rotation = world_from_keyframe.rotation.to_rotation_matrix();
        let Hypothesis { normal, offset } = plane.equation;
        let height = offset - normal.dot(&world_from_keyframe.translation);
        let of_ray = rotation.transpose() * normal * (world_from_keyframe.scale / height);
        let (a, b) = (of_ray.x / pinhole.fx, of_ray.y / pinhole.fy);
        Self {
            plane,
            idepth: Vec3::new(a, b, of_ray.z - a * pinhole.cx - b * pinhole.cy),
            world_from_keyframe: *world_from_keyframe,
            pinhole,
        }
    }

    /// Its inverse depth at a pixel; not positive where it lies behind the keyframe.
    pub fn idepth(&self, [x, y]: [f64; 2]) -> f64 {
        self.idepth.dot(&Vec3::new(x, y, 1.0))
    }

    /// The point of it that a pixel sees, in the world.
    pub fn point(&self, at @ [x, y]: [f64; 2]) -> Vec3 {
        let ray = self.pinhole.unproject(&Vec2::new(x, y));
        self.world_from_keyframe * (ray / self.idepth(at))
    }

    /// Whether a point of it is at most this share of the range beyond where it was measured.
    pub fn is_measured(&self, point: &Vec3, max_extent: f64) -> bool {
        let range = (point - self.world_from_keyframe.translation).norm();
        let extent = &self.plane.extent;
        extent.distance(self.plane.in_plane(point)) <= max_extent * range
    }

    /// How uncertain the distance of a point of it is.
    pub fn relative_sigma(&self, point: &Vec3) -> f64 {
        let [u, v] = self.plane.in_plane(point);
        let row = Vec3::new(u, v, 1.0);
        let height = row.dot(&(self.plane.covariance * row)).sqrt();
        let center = &self.world_from_keyframe.translation;
        let distance = self.plane.equation.height(center).abs();
        (height / distance.max(f64::MIN_POSITIVE)).hypot(RELATIVE_SIGMA)
    }
}
