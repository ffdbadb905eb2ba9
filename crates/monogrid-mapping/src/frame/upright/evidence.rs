//! What keyframes say about directions: planes of their depth, straight edges of their images, how
//! they were held.

use super::segments::segments;
use crate::planes::planes_of_image;
use crate::{ImageOf, KeyframeScan};
use monogrid_geometry::{Se3, Sim3, Vec2, Vec3};
use rayon::prelude::*;

/// A keyframe as the search for up needs it.
#[derive(Clone, Copy, Debug)]
pub struct UprightView<'a> {
    /// Its depth as it is mapped.
    pub scan: &'a KeyframeScan,
    /// Its image; without one there are no edges.
    pub image: Option<ImageOf<'a>>,
    /// Its pose.
    pub world_from_keyframe: Sim3,
}

/// A plane that a keyframe sees.
#[derive(Clone, Copy, Debug)]
pub(super) struct Patch {
    /// Towards the camera.
    pub normal_in_world: Vec3,
    /// The middle of what was seen of it.
    pub middle_in_world: Vec3,
    /// Its share of all depth of the keyframe that lies on planes.
    pub weight: f64,
}

/// A straight edge of an image: the plane through it and the camera.
#[derive(Clone, Copy, Debug)]
pub(super) struct Edge {
    pub normal_in_world: Vec3,
    /// Its share of the length of all edges in its image.
    pub weight: f64,
}

/// Shortest straight edge that votes, as a share of the image's width.
const MIN_EDGE: f64 = 0.06;

/// How many poses say how the camera was held and moved: a long path says it as well.
const MAX_POSES: usize = 500;

/// Everything that votes.
#[derive(Clone, Debug, Default)]
pub(super) struct Evidence {
    pub patches: Vec<Patch>,
    pub edges: Vec<Edge>,
    /// Of the keyframes.
    pub poses: Vec<Sim3>,
    /// Poses of the camera in the world, evenly over all frames.
    pub path: Vec<Se3>,
}

impl Evidence {
    /// Collects it from all keyframes, and the poses of the camera in all frames.
    pub fn of(views: &[UprightView], path: &[Se3]) -> Self {
        let seen = |view: &UprightView| {
            let planes = planes_of_image(&view.scan.pixels());
            let min_length_px = MIN_EDGE * view.scan.camera.width as f64;
            let image = view.image.and_then(ImageOf::get);
            let segments = image.map(|image| segments(&image, min_length_px));
            (planes, segments)
        };
        let seen: Vec<_> = views.par_iter().map(seen).collect();
        let mut this = Self {
            path: path
                .iter()
                .step_by(1 + path.len() / MAX_POSES)
                .copied()
                .collect(),
            ..Self::default()
        };
        for (view, (planes, segments)) in views.iter().zip(seen) {
            let (pose, camera) = (&view.world_from_keyframe, &view.scan.camera);
            this.poses.push(*pose);
            let points: usize = planes.iter().map(|plane| plane.inliers).sum();
            let patches = planes.iter().map(|plane| {
                let (normal_in_world, middle_in_world) = plane.in_world(&camera.pinhole, pose);
                Patch {
                    normal_in_world,
                    middle_in_world,
                    weight: plane.inliers as f64 / points as f64,
                }
            });
            // a plane through the camera has no place
            let is_finite = |p: &Patch| (p.normal_in_world + p.middle_in_world).norm().is_finite();
            this.patches.extend(patches.filter(is_finite));
            let found = segments.unwrap_or_default();
            let length: f64 = found.iter().map(|segment| segment.length_px).sum();
            this.edges.extend(found.iter().map(|segment| {
                let ray = |side: f64| {
                    let half = 0.5 * side * segment.length_px;
                    camera.pinhole.unproject(&Vec2::new(
                        segment.middle[0] + half * segment.direction[0],
                        segment.middle[1] + half * segment.direction[1],
                    ))
                };
                let normal = ray(-1.0).cross(&ray(1.0)).normalize();
                Edge {
                    normal_in_world: pose.rotation * normal,
                    weight: segment.length_px / length,
                }
            }));
        }
        this
    }
}
