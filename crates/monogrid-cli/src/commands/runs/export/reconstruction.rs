//! The keyframes of a recording as images with poses, and the points that they see.

use monogrid_app::process::failure::Failure;
use monogrid_app::run::align::Align;
use monogrid_app::run::sessions::frame_beside;
use monogrid_datasets::{RecordedCamera, RecordedKeyframe, RecordedPoint, Recording};
use monogrid_geometry::median::median;
use monogrid_geometry::{Se3, Sim3, Vec2, Vec3};
use monogrid_mapping::ImageOf;
use monogrid_report::colours::Colours;
use monogrid_report::explorer::Look;
use std::collections::BTreeMap;
use std::path::Path;

/// Distances from where a point projects to that are no chance, in medians of all: with errors that
/// are normal, one in a hundred thousand is larger.
const FAR: f64 = 4.0;
/// Never far, px.
const NEAR_PX: f64 = 1.0;

/// Images with poses and points, in the frame of maps.
#[derive(Debug, Default)]
pub struct Reconstruction {
    /// Pinhole cameras without distortion; the centre of the top-left pixel is (0, 0).
    pub cameras: Vec<RecordedCamera>,
    pub views: Vec<View>,
    pub points: Vec<Point>,
    /// How often an image shows something else where a point should be.
    pub left_out: usize,
    /// How far that is from where it projects to, px.
    pub limit: f64,
}

/// An image with its pose.
#[derive(Debug)]
pub struct View {
    /// Name of the image file in the folder of images.
    pub name: String,
    /// Index of the keyframe in the recording.
    pub keyframe: usize,
    /// Index of its camera.
    pub camera: usize,
    pub camera_from_map: Se3,
    /// Where it shows points, px, and their indices.
    pub features: Vec<(Vec2, usize)>,
}

/// A point that images may show.
#[derive(Debug)]
pub struct Candidate {
    /// Place in the frame of maps.
    pub place: Vec3,
    pub colour: [u8; 3],
    pub seen: Vec<Seen>,
}

/// Where an image shows a point.
#[derive(Debug)]
pub struct Seen {
    /// Index of the view.
    pub view: usize,
    pub at: Vec2,
    /// Distance from where it projects to, px.
    pub error: f64,
}

/// A point that at least two images show.
#[derive(Debug)]
pub struct Point {
    /// Place in the frame of maps.
    pub place: Vec3,
    pub colour: [u8; 3],
    /// Mean distance between where images show it and where it projects to, px.
    pub error: f64,
    /// Index of each view that shows it, and of the feature in it.
    pub track: Vec<(usize, usize)>,
}

impl Reconstruction {
    /// Of the keyframes with a pose and an image, and the points of the sparse layer.
    pub fn new(recording: &Recording, file: &Path) -> Result<Self, Failure> {
        let map_from_world = match frame_beside(file)? {
            Some(Align::Map { map_from_world, .. }) => map_from_world,
            _ => Sim3::identity(),
        };
        let mut scene = Self::default();
        let mut view_of = BTreeMap::new();
        for (index, keyframe) in recording.keyframes.iter().enumerate() {
            if let Some(world_from_keyframe) = keyframe.world_from_keyframe
                && keyframe.image.is_some()
            {
                let map_from_camera = map_from_world * world_from_keyframe;
                view_of.insert(keyframe.id, scene.views.len());
                scene.add_view(index, keyframe, &map_from_camera.to_se3());
            }
        }
        if scene.views.is_empty() {
            return Err(Failure::input(format!(
                "{} holds no keyframe with an image and a pose: tracking never started, or its \
                 images were not recorded",
                file.display()
            )));
        }
        let points = recording.continuation.iter().flat_map(|c| &c.points);
        let mut points: Vec<&RecordedPoint> = points.collect();
        // so that each image is decoded once
        points.sort_by_key(|point| point.host);
        let colours = Colours::of(&recording.keyframes);
        let mut candidates = Vec::new();
        for of_host in points.chunk_by(|a, b| a.host == b.host) {
            let Some(host) = view_of.get(&of_host[0].host) else {
                continue;
            };
            let keyframe = &recording.keyframes[scene.views[*host].keyframe];
            let image = keyframe.image.as_ref().map(ImageOf::Held);
            let look = Look::of(keyframe.id, image, &colours);
            for point in of_host {
                if let Some(place) = place_of(point, keyframe, &map_from_world) {
                    candidates.push(Candidate {
                        place,
                        colour: colour_at(&look, point.pixel, &keyframe.camera),
                        seen: scene.seen(point, &view_of, place),
                    });
                }
            }
        }
        scene.add_points(candidates);
        Ok(scene)
    }

    fn add_view(&mut self, index: usize, keyframe: &RecordedKeyframe, map_from_camera: &Se3) {
        let known = self.cameras.iter().position(|c| *c == keyframe.camera);
        let camera = known.unwrap_or_else(|| {
            self.cameras.push(keyframe.camera);
            self.cameras.len() - 1
        });
        let ending = match keyframe.colour {
            Some(_) => "jpg",
            None => "png",
        };
        self.views.push(View {
            name: format!("{:05}.{ending}", keyframe.id),
            keyframe: index,
            camera,
            camera_from_map: map_from_camera.inverse(),
            features: Vec::new(),
        });
    }

    /// Where images in which it lies before the camera show a point.
    fn seen(&self, point: &RecordedPoint, views: &BTreeMap<u32, usize>, place: Vec3) -> Vec<Seen> {
        let own = [(point.host, point.pixel)];
        let observations = own.iter().chain(&point.observations);
        let seen = observations.filter_map(|(keyframe, [x, y])| {
            let view = *views.get(keyframe)?;
            let at = Vec2::new(*x, *y);
            let error = self.error_at(view, &place, &at)?;
            Some(Seen { view, at, error })
        });
        seen.collect()
    }

    /// Adds points that two or more images show. Where one is shown far from where it projects to,
    /// the image shows something else: robust adjustment took no notice of it, and readers that
    /// adjust once more would.
    pub fn add_points(&mut self, candidates: Vec<Candidate>) {
        let errors = candidates.iter().flat_map(|candidate| &candidate.seen);
        let mut errors: Vec<f64> = errors.map(|seen| seen.error).collect();
        let limit = median(&mut errors).map_or(NEAR_PX, |median| NEAR_PX.max(FAR * median));
        for mut candidate in candidates {
            let before = candidate.seen.len();
            candidate.seen.retain(|seen| seen.error <= limit);
            self.left_out += before - candidate.seen.len();
            self.add_point(candidate);
        }
        self.limit = limit;
    }

    fn add_point(&mut self, candidate: Candidate) {
        let seen = candidate.seen;
        if seen.len() < 2 {
            return;
        }
        let index = self.points.len();
        let errors: f64 = seen.iter().map(|seen| seen.error).sum();
        let track = seen.iter().map(|seen| {
            let features = &mut self.views[seen.view].features;
            features.push((seen.at, index));
            (seen.view, features.len() - 1)
        });
        let track = track.collect();
        self.points.push(Point {
            place: candidate.place,
            colour: candidate.colour,
            error: errors / seen.len() as f64,
            track,
        });
    }

    /// Distance between where a view shows a point and where that projects to, px; `None` behind
    /// the camera.
    fn error_at(&self, view: usize, place: &Vec3, at: &Vec2) -> Option<f64> {
        let view = &self.views[view];
        let seen = view.camera_from_map * *place;
        let projected = || self.cameras[view.camera].pinhole.project(&seen);
        (seen.z > 0.0).then(|| (projected() - at).norm())
    }

    /// How often images show points.
    pub fn num_observations(&self) -> usize {
        self.points.iter().map(|point| point.track.len()).sum()
    }

    /// Mean over points, px; none without points.
    pub fn mean_error(&self) -> Option<f64> {
        let sum: f64 = self.points.iter().map(|point| point.error).sum();
        (!self.points.is_empty()).then(|| sum / self.points.len() as f64)
    }
}

/// Where a point is in the frame of maps; `None` where its depth says nothing.
fn place_of(point: &RecordedPoint, host: &RecordedKeyframe, map_from_world: &Sim3) -> Option<Vec3> {
    let [idepth, ..] = point.idepth;
    let [x, y] = point.pixel;
    let in_host = host.camera.pinhole.unproject(&Vec2::new(x, y)) / idepth;
    // depth is in units of the world
    let place = *map_from_world * (host.world_from_keyframe?.to_se3() * in_host);
    (idepth > 0.0 && place.iter().all(|c| c.is_finite())).then_some(place)
}

/// The colour of the nearest pixel.
fn colour_at(look: &Look, [x, y]: [f64; 2], camera: &RecordedCamera) -> [u8; 3] {
    let nearest = |at: f64, size: usize| (at.round().max(0.0) as usize).min(size - 1);
    look.at(nearest(x, camera.width), nearest(y, camera.height))
}
