//! The frame in which results are written.
//!
//! It is one similarity, `map_from_world`: of the scene, an inertial sensor, `--up`, `--align`, or
//! the earlier session. Poses are brought to it before the map is built: a finished map is never
//! resampled.

use crate::process::failure::{Classify, Failure};
use crate::run::sensed::SensedFrame;
use monogrid_datasets::{Dataset, SourceOptions, TimedPose, read_path, read_sim3};
use monogrid_evaluation::{StampedPose, TrajectoryConfig, TrajectoryReport, evaluate_trajectory};
use monogrid_geometry::{Se3, Sim3, Vec3};
use monogrid_mapping::{
    Floor, MIN_UP_CONFIDENCE, UprightView, floor_below, level_from_world, upright,
    z_up_from_camera_world,
};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// What `--up` asks for.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Up {
    /// Gravity as an inertial sensor has it, else what the scene says, where either is sure enough,
    /// else as the first camera was held.
    #[default]
    Scene,
    /// As the first camera was held, whatever the scene says.
    FirstCamera,
    /// A direction in the frame of the first camera (x right, y down, z ahead).
    Given(Vec3),
}

/// What `--align` asks for.
#[derive(Clone, Debug)]
pub enum Align {
    /// Nothing: z up.
    Level(Up),
    /// A transform from the frame of unaligned results to the frame of a reference.
    Sim3 {
        /// The frame of unaligned results.
        base: Box<Align>,
        /// The file it came from.
        path: PathBuf,
        /// The transform.
        target_from_results: Sim3,
    },
    /// The frame of the map of an earlier run.
    Map {
        /// From the world of that run.
        map_from_world: Sim3,
        /// What that run says about it.
        description: String,
        /// Whether its lengths are metres.
        is_metric: bool,
        /// What that run found out about up and the ground.
        ground: KnownGround,
        /// Whether the map has grown since, so that more may be found out about them.
        has_grown: bool,
    },
    /// The frame of a trajectory, to which the estimated one is fitted.
    Trajectory {
        /// The file it came from.
        path: PathBuf,
        /// The trajectory.
        poses: Vec<TimedPose>,
    },
}

/// The frame that was found.
#[derive(Clone, Debug)]
pub struct MapFrame {
    /// From the world of the run.
    pub map_from_world: Sim3,
    /// For people and for `summary.json`.
    pub description: String,
    /// Whether the frame fixes the scale.
    pub is_aligned: bool,
    /// How well a trajectory fitted.
    pub fit: Option<TrajectoryReport>,
    /// What z is.
    pub up: UpSummary,
    /// The floor at z = 0, where one was found.
    pub floor: Option<FloorSummary>,
    /// The level surface at z = 0 that is no floor: things lie below it.
    pub level_surface: Option<FloorSummary>,
}

/// What an earlier run found out about up and the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnownGround {
    /// What z is.
    pub up: UpSummary,
    /// The floor at z = 0.
    pub floor: Option<FloorSummary>,
    /// Or a level surface that is none.
    pub level_surface: Option<FloorSummary>,
}

/// What was found out about up, as `summary.json` says it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct UpSummary {
    /// `imu`, `scene`, `first-camera`, `given` (`--up x,y,z`), `reference` (`--align`) or `earlier`
    /// (`--continue`).
    pub from: &'static str,
    /// How sure the scene is, from 0 to 1; `null` where it was not asked.
    pub confidence: Option<f64>,
    /// Whether that is sure enough to rely on: a guess from the scene, and how the first camera was
    /// held, are not.
    pub is_certain: bool,
}

impl UpSummary {
    fn new(from: &'static str, confidence: Option<f64>) -> Self {
        let is_certain = match (from, confidence) {
            ("first-camera", _) => false,
            (_, Some(confidence)) => confidence >= CERTAIN,
            (_, None) => true,
        };
        Self {
            from,
            confidence,
            is_certain,
        }
    }

    /// As the summary of an earlier run says it: how the first camera was held stays what it was,
    /// and so does a reference.
    pub fn read(up: &Value) -> Self {
        let from = match up["from"].as_str() {
            Some("first-camera") => "first-camera",
            Some("reference") => "reference",
            _ => "earlier",
        };
        let read = Self::new(from, up["confidence"].as_f64());
        Self {
            is_certain: up["is_certain"].as_bool().unwrap_or(read.is_certain),
            ..read
        }
    }

    /// Whether nobody asked for this up, and the scene was not sure of it.
    fn is_guess(&self) -> bool {
        !self.is_certain && self.confidence.is_some()
    }
}

/// Confidence of the scene, a probability, from which up is called certain.
const CERTAIN: f64 = 0.6;

/// Heights within this share of that of the cameras are one level surface.
const SAME_HEIGHT: f64 = 0.05;

/// What was found out about the floor, as `summary.json` says it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FloorSummary {
    /// Median height of the keyframes' cameras over it, in units of the results.
    pub camera_height: f64,
    /// Its share of all level planes that were seen from above.
    pub share: f64,
    /// Share of what was seen near the cameras that lies clearly below it.
    #[serde(default)]
    pub below: f64,
}

impl FloorSummary {
    fn of(floor: &Floor) -> Self {
        Self {
            camera_height: floor.camera_height,
            share: floor.share,
            below: floor.below,
        }
    }
}

/// The keyframes and what is needed to look at the scene that they show.
#[derive(Debug)]
pub struct Scene<'a> {
    /// Keyframes of the map.
    pub views: Vec<UprightView<'a>>,
    /// Poses of the camera in the world, in all frames that are in the map.
    pub path: Vec<Se3>,
}

impl Up {
    /// Reads the argument of `--up`.
    pub fn parse(argument: &str) -> Result<Self, String> {
        match argument {
            "scene" => return Ok(Self::Scene),
            "first-camera" => return Ok(Self::FirstCamera),
            _ => {}
        }
        let numbers = argument.split(',').map(|number| number.trim().parse().ok());
        let numbers: Vec<f64> = numbers.collect::<Option<_>>().unwrap_or_default();
        let direction = <[f64; 3]>::try_from(numbers).ok().map(Vec3::from);
        let direction = direction.filter(|d| d.norm().is_normal() && d.norm() < 1e6);
        direction.map(|direction| Self::Given(direction.normalize())).ok_or_else(|| {
            "expected `scene`, `first-camera`, or a direction x,y,z in the first camera (x right, \
             y down, z ahead)"
                .to_owned()
        })
    }

    /// The frame with z up, in metres where they are known.
    fn frame<'a>(self, sensed: &SensedFrame, scene: &mut dyn FnMut() -> Scene<'a>) -> MapFrame {
        let frame = self.level_frame(sensed, scene);
        match sensed.metres_per_unit {
            Some(metres) => frame.in_metres(metres),
            None => frame,
        }
    }

    fn level_frame<'a>(
        self,
        sensed: &SensedFrame,
        scene: &mut dyn FnMut() -> Scene<'a>,
    ) -> MapFrame {
        let mut known = |up: &Vec3, said, from| {
            let scene = scene();
            let floor = floor_below(&scene.views, &scene.path, up);
            level(up, floor.as_ref(), said, (from, None))
        };
        match (self, sensed.up_in_world) {
            (Self::FirstCamera, _) => first_camera(),
            (Self::Given(up), _) => known(&up, "as given", "given"),
            (Self::Scene, Some(up)) => known(&up, "as gravity says", "imu"),
            (Self::Scene, None) => {
                let scene = scene();
                let found = upright(&scene.views, &scene.path);
                let confidence = found.as_ref().map_or(0.0, |found| found.confidence);
                match found {
                    Some(found) if confidence >= MIN_UP_CONFIDENCE => {
                        let said = match confidence >= CERTAIN {
                            true => "as the scene says",
                            false => "as the scene seems to say (uncertain)",
                        };
                        let from = ("scene", Some(confidence));
                        level(&found.up_in_world, found.floor.as_ref(), said, from)
                    }
                    _ => uncertain(confidence),
                }
            }
        }
    }
}

/// The frame of unaligned results where the scene has no say, or is not sure.
fn first_camera() -> MapFrame {
    let description = "z up as the first camera was held, x ahead, origin at the first keyframe";
    MapFrame::new(z_up_from_camera_world(), description, "first-camera")
}

/// That frame, because the scene is only so sure.
fn uncertain(confidence: f64) -> MapFrame {
    let first = first_camera();
    MapFrame {
        up: UpSummary::new(first.up.from, Some(confidence)),
        description:
            "z up uncertain, as the first camera was held, x ahead, origin at the first keyframe"
                .to_owned(),
        ..first
    }
}

/// The frame with the floor, where there is one, at z = 0.
fn level(
    up_in_world: &Vec3,
    floor: Option<&Floor>,
    said: &str,
    (from, confidence): (&'static str, Option<f64>),
) -> MapFrame {
    let up = UpSummary::new(from, confidence);
    let origin = origin(floor, up.is_certain);
    let description = format!("z up {said}, x ahead of the first camera, {origin}");
    let frame = MapFrame {
        up,
        ..MapFrame::new(level_from_world(up_in_world, floor), description, from)
    };
    frame.over_found(floor)
}

/// Where z = 0 is, for people.
fn origin(floor: Option<&Floor>, is_up_certain: bool) -> &'static str {
    match floor {
        Some(_) if !is_up_certain => {
            "z = 0 at the largest surface that is level if up is right (a guess), below the first \
             keyframe (where up is uncertain, no floor is claimed)"
        }
        Some(floor) if floor.is_floor() => "z = 0 at the floor, below the first keyframe",
        Some(_) => {
            "z = 0 at the largest level surface (a table?), below the first keyframe (no floor was \
             seen)"
        }
        None => "origin at the first keyframe (no floor was seen)",
    }
}

/// The poses that a result is compared with: of a trajectory file, or those that lie in the folder
/// of a data set.
pub fn read_reference(path: &Path) -> Result<Vec<TimedPose>, Failure> {
    if !path.is_dir() {
        return read_path(path).bad_input();
    }
    let dataset = Dataset::open(path, SourceOptions::default()).bad_input()?;
    let poses = dataset.reference_trajectory().bad_input()?;
    poses.ok_or_else(|| {
        Failure::input(format!(
            "{} holds no poses: expected groundtruth.txt or those of its layout, or a trajectory \
             file",
            path.display()
        ))
    })
}

impl Align {
    /// Says of a known frame that its map has grown since it was found.
    #[must_use]
    pub fn of_grown_map(mut self) -> Self {
        if let Self::Map { has_grown, .. } = &mut self {
            *has_grown = true;
        }
        self
    }

    /// Reads what `gt:FILE` or `sim3:FILE` names, else what is up.
    pub fn parse(argument: Option<&str>, up: Up) -> Result<Self, Failure> {
        let Some(argument) = argument else {
            return Ok(Self::Level(up));
        };
        match argument.split_once(':') {
            Some(("gt", file)) => Ok(Self::Trajectory {
                path: file.into(),
                poses: read_reference(Path::new(file))?,
            }),
            Some(("sim3", file)) => Ok(Self::Sim3 {
                base: Box::new(Self::Level(up)),
                path: file.into(),
                target_from_results: read_sim3(Path::new(file)).bad_input()?,
            }),
            _ => Err(Failure::input(format!(
                "--align {argument}: expected gt:FILE (a trajectory) or sim3:FILE"
            ))),
        }
    }

    /// The same, where the unaligned frame is known unless something else was asked for.
    #[must_use]
    pub fn in_known_frame(mut self, known: Self) -> Self {
        match &mut self {
            Self::Level(Up::Scene) => return known,
            // a run's own frame, which its maps have already: it is not meant twice
            Self::Sim3 {
                target_from_results: named,
                ..
            } if matches!(&known, Self::Map { map_from_world, .. } if map_from_world == named) => {
                return known;
            }
            Self::Sim3 { base, .. } => **base = base.as_ref().clone().in_known_frame(known),
            _ => {}
        }
        self
    }

    /// The frame of the results, given the estimated trajectory in the world of the run. The scene
    /// is only looked at where it has a say, and so is what an inertial sensor found.
    ///
    /// An alignment that cannot be found is not fatal: the results are written unaligned and the
    /// reason is returned beside them.
    pub fn frame<'a>(
        &self,
        trajectory: &[(i64, Se3)],
        sensed: &SensedFrame,
        scene: &mut dyn FnMut() -> Scene<'a>,
    ) -> (MapFrame, Option<String>) {
        let by_reference = |map_from_world, description| MapFrame {
            is_aligned: true,
            ..MapFrame::new(map_from_world, description, "reference")
        };
        match self {
            Self::Level(up) => (up.frame(sensed, scene), None),
            Self::Map {
                map_from_world,
                description,
                is_metric,
                ground,
                has_grown,
            } => {
                let frame = MapFrame {
                    is_aligned: *is_metric,
                    up: ground.up,
                    ..MapFrame::new(*map_from_world, description, ground.up.from)
                };
                let frame = frame.over(ground.floor, ground.level_surface);
                match has_grown {
                    true => frame.grown(scene),
                    false => (frame, None),
                }
            }
            Self::Sim3 {
                base,
                path,
                target_from_results,
            } => {
                let (base, _) = base.frame(trajectory, sensed, scene);
                let map_from_world = *target_from_results * base.map_from_world;
                let description = format!("aligned by {}", path.display());
                (by_reference(map_from_world, description), None)
            }
            Self::Trajectory { path, poses } => match fit(trajectory, poses) {
                Ok(report) => {
                    let description = format!("frame of {}", path.display());
                    let mut frame = by_reference(report.gt_from_est, description);
                    frame.fit = Some(report);
                    (frame, None)
                }
                Err(reason) => {
                    let path = path.display();
                    let reason = format!("results are not aligned to {path}: {reason}");
                    (Up::default().frame(sensed, scene), Some(reason))
                }
            },
        }
    }
}

impl MapFrame {
    /// A frame that does not fix the scale, with what `summary.json` says of where its up is from.
    fn new(map_from_world: Sim3, description: impl Into<String>, from: &'static str) -> Self {
        Self {
            map_from_world,
            description: description.into(),
            is_aligned: false,
            fit: None,
            up: UpSummary::new(from, None),
            floor: None,
            level_surface: None,
        }
    }

    /// Says that z = 0 is at a surface that was found, or at none.
    fn over_found(self, found: Option<&Floor>) -> Self {
        let is_floor = found.is_some_and(Floor::is_floor);
        let ground = found.map(FloorSummary::of);
        self.over(ground.filter(|_| is_floor), ground.filter(|_| !is_floor))
    }

    /// Says that z = 0 is at a floor or at another level surface. Where up is uncertain a wall may
    /// be taken for the floor: there no floor is claimed.
    fn over(mut self, floor: Option<FloorSummary>, surface: Option<FloorSummary>) -> Self {
        self.floor = floor.filter(|_| self.up.is_certain);
        self.level_surface = surface.or(floor.filter(|_| !self.up.is_certain));
        self
    }

    /// The frame of a map that has grown, and what is new about it. Where up is certain it stays,
    /// and so does the floor; one that was not seen yet may be seen now. Where up was a guess, it
    /// is looked for again.
    fn grown<'a>(self, scene: &mut dyn FnMut() -> Scene<'a>) -> (Self, Option<String>) {
        if self.up.is_guess() {
            let again = Up::Scene.level_frame(&SensedFrame::default(), scene);
            if !again.up.is_certain {
                return (self, None);
            }
            let again = Self {
                is_aligned: self.is_aligned,
                ..again.scaled(self.map_from_world.scale)
            };
            let said = "the earlier run was not sure of up, this one is: the results have a frame \
                        of their own";
            return (again, Some(said.to_owned()));
        }
        if !self.up.is_certain || self.up.from == "reference" {
            return (self, None);
        }
        let up = self.map_from_world.rotation.inverse() * Vec3::z();
        let scene = scene();
        match floor_below(&scene.views, &scene.path, &up) {
            Some(found) => self.grown_over(&found),
            None => (self, None),
        }
    }

    /// Takes the level surface that is found now. At the height of the earlier one the frame stays;
    /// a higher one is no floor, since that one lies below it.
    fn grown_over(mut self, found: &Floor) -> (Self, Option<String>) {
        let Sim3 {
            scale, translation, ..
        } = self.map_from_world;
        let height = scale * found.height + translation.z;
        let same = SAME_HEIGHT * scale * found.camera_height;
        let is_known = self.floor.or(self.level_surface).is_some();
        if is_known && height > same {
            return (self, None);
        }
        let stays = is_known && height >= -same;
        let mut said = None;
        if !stays {
            self.map_from_world.translation.z -= height;
            self.description = format!(
                "z up as in the earlier run, x ahead of its first camera, {}",
                origin(Some(found), true)
            );
            said = Some(format!(
                "the earlier run did not see the level surface that is at z = 0 now: heights are \
                 {:.4} more than in its results",
                -height
            ));
        }
        let over_z = Floor {
            camera_height: scale * found.camera_height + if stays { height } else { 0.0 },
            ..*found
        };
        (self.over_found(Some(&over_z)), said)
    }

    /// The same frame with lengths in metres, of which a unit of the world has so many.
    fn in_metres(mut self, metres: f64) -> Self {
        self.description += ", in metres by the inertial sensor";
        self.is_aligned = true;
        self.scaled(metres)
    }

    /// Multiplies all lengths by `factor`.
    fn scaled(mut self, factor: f64) -> Self {
        let scaled = Sim3::new(factor, Se3::identity().rotation, Vec3::zeros());
        self.map_from_world = scaled * self.map_from_world;
        let levels = [&mut self.floor, &mut self.level_surface];
        for level in levels.into_iter().flatten() {
            level.camera_height *= factor;
        }
        self
    }

    /// Compares the results with a reference that has not decided their frame; returns the
    /// transform from the frame of the reference to that of the results.
    pub fn compare(
        &mut self,
        trajectory: &[(i64, Se3)],
        reference: &[TimedPose],
    ) -> Result<Sim3, String> {
        let report = fit(trajectory, reference)?;
        let results_from_reference = self.map_from_world * report.gt_from_est.inverse();
        self.fit = Some(report);
        Ok(results_from_reference)
    }
}

/// `map_from_camera` of a pose in the world: the scale of the frame applies to the position only.
pub fn in_map(map_from_world: &Sim3, world_from_camera: &Se3) -> Se3 {
    (*map_from_world * world_from_camera.with_scale(1.0)).to_se3()
}

fn fit(trajectory: &[StampedPose], poses: &[TimedPose]) -> Result<TrajectoryReport, String> {
    evaluate_trajectory(
        trajectory,
        &stamped_all(poses),
        &TrajectoryConfig::default(),
    )
    .map_err(|error| error.to_string())
}

/// A trajectory in the type of the evaluation.
pub fn stamped_all(poses: &[TimedPose]) -> Vec<StampedPose> {
    let stamped = |pose: &TimedPose| (pose.timestamp_ns, pose.world_from_camera);
    poses.iter().map(stamped).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::{Pinhole, Rotation, Vec2};
    use monogrid_mapping::{KeyframeCamera, KeyframeScan};
    use monogrid_occupancy::DepthPixel;

    #[test]
    fn directions_and_words_say_what_is_up() {
        assert_eq!(Up::parse("scene"), Ok(Up::Scene));
        assert_eq!(Up::parse("first-camera"), Ok(Up::FirstCamera));
        assert_eq!(Up::parse("0,-2,0"), Ok(Up::Given(-Vec3::y())));
        for bad in [
            "", "up", "0,0,0", "1,2", "1,2,3,4", "1,x,2,3", "nan,0,1", "inf,0,0",
        ] {
            assert!(Up::parse(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn a_table_is_no_floor_and_everything_says_so() {
        let surface = |below: f64| Floor {
            height: -0.8,
            camera_height: 0.7,
            share: 0.5,
            below,
        };
        let given = ("given", None);
        let frame = |below: f64| level(&-Vec3::y(), Some(&surface(below)), "as given", given);
        let (floor, table) = (frame(0.0005), frame(0.02));
        assert_eq!(floor.floor.map(|floor| floor.camera_height), Some(0.7));
        assert_eq!(floor.level_surface, None);
        assert_eq!(table.floor, None);
        assert_eq!(table.level_surface.map(|table| table.below), Some(0.02));
        assert!(table.description.contains("a table?"), "{table:?}");
        // z = 0 is there all the same
        assert_eq!(table.map_from_world, floor.map_from_world);
        assert_eq!(
            frame(0.02)
                .in_metres(2.0)
                .level_surface
                .map(|s| s.camera_height),
            Some(1.4)
        );
    }

    #[test]
    fn no_floor_is_claimed_where_up_is_uncertain() {
        let floor = Floor {
            height: -0.8,
            camera_height: 0.7,
            share: 0.5,
            below: 0.0,
        };
        let frame = |confidence: f64| {
            let from = ("scene", Some(confidence));
            level(&-Vec3::y(), Some(&floor), "as the scene says", from)
        };
        let (certain, guess) = (frame(0.65), frame(0.55));
        assert!(certain.floor.is_some() && certain.level_surface.is_none());
        assert_eq!(guess.floor, None);
        assert_eq!(guess.level_surface.map(|s| s.camera_height), Some(0.7));
        assert!(guess.description.contains("a guess"), "{guess:?}");
        assert!(!guess.description.contains("z = 0 at the floor"));
    }

    #[test]
    fn the_frame_that_a_run_has_already_is_not_applied_twice() {
        let known = Sim3::new(2.0, Rotation::identity(), Vec3::new(1.0, 2.0, 3.0));
        let map = Align::Map {
            map_from_world: known,
            description: String::new(),
            is_metric: false,
            ground: KnownGround {
                up: UpSummary::new("scene", Some(0.9)),
                floor: None,
                level_surface: None,
            },
            has_grown: false,
        };
        let frame = |target_from_results: Sim3| {
            let align = Align::Sim3 {
                base: Box::new(Align::Level(Up::Scene)),
                path: "map_from_world.txt".into(),
                target_from_results,
            };
            let align = align.in_known_frame(map.clone());
            let mut scene = || -> Scene { unreachable!("the frame is known") };
            align.frame(&[], &SensedFrame::default(), &mut scene).0
        };
        assert_eq!(frame(known).map_from_world, known);
        let other = Sim3 {
            scale: 3.0,
            ..known
        };
        assert_eq!(frame(other).map_from_world, other * known);
    }

    /// What cameras at a height of 1.4 see of a floor and of two walls, the world as the first of
    /// them has it.
    fn room() -> (Vec<KeyframeScan>, Vec<Sim3>) {
        let camera = KeyframeCamera {
            pinhole: Pinhole {
                fx: 140.0,
                fy: 140.0,
                cx: 79.5,
                cy: 59.5,
            },
            width: 160,
            height: 120,
        };
        let level = z_up_from_camera_world().rotation;
        let pose = |k: u32| {
            let turn = Rotation::from_scaled_axis(Vec3::z() * 0.5 * f64::from(k));
            let pitch = Rotation::from_scaled_axis(-Vec3::x() * 0.4);
            Sim3::new(1.0, turn * level * pitch, Vec3::new(0.0, 0.0, 1.4))
        };
        let planes = [(Vec3::z(), 0.0), (-Vec3::x(), -3.0), (-Vec3::y(), -2.5)];
        let scan = |k: u32| {
            let pixels = (0..120_u16 * 160).step_by(2).filter_map(|at| {
                let (x, y) = (at % 160, at / 160);
                let ray = camera.pinhole.unproject(&Vec2::new(x.into(), y.into()));
                let ray = pose(k).rotation * ray;
                let hit = |(normal, offset): &(Vec3, f64)| {
                    let (along, from) = (normal.dot(&ray), normal.dot(&pose(k).translation));
                    (along < 0.0).then_some((offset - from) / along)
                };
                let depth = planes.iter().filter_map(hit).reduce(f64::min)?;
                Some(DepthPixel {
                    x,
                    y,
                    idepth: (1.0 / depth) as f32,
                    sigma_idepth: (0.01 / depth) as f32,
                })
            });
            KeyframeScan::of_measurements(k, camera, pixels.collect(), 0)
        };
        let world_from_room = pose(0).inverse();
        let poses = (0..6).map(|k| world_from_room * pose(k)).collect();
        ((0..6).map(scan).collect(), poses)
    }

    /// The frame that is found for the room.
    fn frame_of_room(align: Align) -> (MapFrame, Option<String>) {
        let (scans, poses) = room();
        let mut scene = || Scene {
            views: (scans.iter().zip(&poses))
                .map(|(scan, pose)| UprightView {
                    scan,
                    image: None,
                    world_from_keyframe: *pose,
                })
                .collect(),
            path: poses.iter().map(Sim3::to_se3).collect(),
        };
        align.frame(&[], &SensedFrame::default(), &mut scene)
    }

    /// A frame of half of the recording: that of the whole, in other units and turned about the
    /// first axis, with its origin so far below the floor.
    fn half(below: f64, turned: f64, up: UpSummary, floor: Option<FloorSummary>) -> Align {
        let whole = frame_of_room(Align::Level(Up::Scene)).0;
        let turn = Rotation::from_scaled_axis(Vec3::x() * turned);
        Align::Map {
            map_from_world: Sim3::new(2.0, turn, Vec3::z() * below) * whole.map_from_world,
            description: "of half".to_owned(),
            is_metric: true,
            ground: KnownGround {
                up,
                floor,
                level_surface: None,
            },
            has_grown: false,
        }
    }

    #[test]
    fn a_map_that_grows_keeps_its_frame_and_finds_the_floor() {
        let whole = frame_of_room(Align::Level(Up::Scene)).0;
        let height = whole.floor.expect("it is seen").camera_height;
        assert!((height - 1.4).abs() < 0.02, "{whole:?}");
        let certain = UpSummary::new("earlier", Some(0.9));
        // no floor was seen: now one is
        let (grown, said) = frame_of_room(half(-0.9, 0.0, certain, None).of_grown_map());
        assert!(said.is_some_and(|said| said.contains("0.9")), "{grown:?}");
        let at = |frame: &MapFrame| frame.map_from_world.translation.z;
        assert!((at(&grown) - 2.0 * at(&whole)).abs() < 0.01);
        assert!((grown.floor.unwrap().camera_height - 2.8).abs() < 0.02);
        assert_eq!((grown.up, grown.is_aligned), (certain, true));
        // the map as it was
        let (same, said) = frame_of_room(half(-0.9, 0.0, certain, None));
        assert_eq!((same.floor, said), (None, None));
        // the floor was seen: the frame stays, and the height of the cameras is that of all
        let floor = Some(FloorSummary {
            camera_height: 1.0,
            share: 0.5,
            below: 0.0,
        });
        let (kept, said) = frame_of_room(half(0.05, 0.0, certain, floor).of_grown_map());
        assert_eq!(said, None);
        assert_eq!(kept.description, "of half");
        assert!((kept.floor.unwrap().camera_height - 2.85).abs() < 0.02);
        // a floor far below what is seen now stays
        let (kept, _) = frame_of_room(half(0.9, 0.0, certain, floor).of_grown_map());
        assert_eq!(kept.floor, floor);
    }

    #[test]
    fn a_map_that_grows_finds_an_up_that_was_a_guess_and_no_other() {
        let guess = UpSummary::new("earlier", Some(0.3));
        let (found, said) = frame_of_room(half(0.0, 1.0, guess, None).of_grown_map());
        assert!(said.is_some() && found.up.is_certain && found.is_aligned);
        // in the units of the map
        let whole = frame_of_room(Align::Level(Up::Scene)).0;
        assert!((found.map_from_world.scale - whole.map_from_world.scale * 2.0).abs() < 1e-9);
        assert!((found.floor.unwrap().camera_height - 2.8).abs() < 0.05);
        // what was asked for stays
        for from in ["first-camera", "reference"] {
            let asked = UpSummary::new(from, None);
            let (kept, said) = frame_of_room(half(-0.9, 0.0, asked, None).of_grown_map());
            assert_eq!((kept.description.as_str(), said), ("of half", None));
            assert_eq!(kept.floor, None);
        }
    }

    #[test]
    fn up_is_certain_where_somebody_knows_it() {
        let is_certain = |from, confidence| UpSummary::new(from, confidence).is_certain;
        assert!(is_certain("imu", None) && is_certain("given", None));
        assert!(is_certain("scene", Some(0.65)) && !is_certain("scene", Some(0.55)));
        assert!(!is_certain("first-camera", Some(0.1)) && !is_certain("first-camera", None));
        assert!(is_certain("earlier", Some(0.85)) && !is_certain("earlier", Some(0.3)));
    }

    #[test]
    fn a_scene_that_is_not_sure_leaves_up_to_the_first_camera() {
        let mut nothing = || Scene {
            views: Vec::new(),
            path: Vec::new(),
        };
        let unsensed = SensedFrame::default();
        let (frame, warning) = Align::Level(Up::Scene).frame(&[], &unsensed, &mut nothing);
        assert_eq!(frame.map_from_world, z_up_from_camera_world());
        assert_eq!(frame.up.from, "first-camera");
        assert_eq!(frame.up.confidence, Some(0.0));
        assert!(frame.description.contains("uncertain"), "{frame:?}");
        assert_eq!((frame.floor, warning), (None, None));
        let (frame, _) = Align::Level(Up::Given(-Vec3::z())).frame(&[], &unsensed, &mut nothing);
        assert!((frame.map_from_world.rotation * -Vec3::z() - Vec3::z()).norm() < 1e-12);
        assert_eq!(frame.up.from, "given");

        let sensed = SensedFrame {
            up_in_world: Some(-Vec3::x()),
            metres_per_unit: Some(2.5),
        };
        let (frame, _) = Align::Level(Up::Scene).frame(&[], &sensed, &mut nothing);
        assert_eq!((frame.up.from, frame.is_aligned), ("imu", true));
        assert!((frame.map_from_world * -Vec3::x() - Vec3::z() * 2.5).norm() < 1e-12);
        let (frame, _) = Align::Level(Up::FirstCamera).frame(&[], &sensed, &mut nothing);
        assert_eq!(frame.up.from, "first-camera", "what is asked for is done");
        assert!((frame.map_from_world.scale - 2.5).abs() < 1e-12);
    }
}
