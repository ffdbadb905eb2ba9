//! A recording ready to be mapped: keyframes, the camera, and the frame their poses are brought to.

use crate::config::RunConfig;
use crate::process::failure::Failure;
use crate::run::align::{self, Align, MapFrame};
use crate::run::sensed::SensedFrame;
use crate::run::sessions::{Source, frame_beside, tracked_frame};
use crate::run::summary::unit_name;
use monogrid_datasets::{
    RecordedCamera, RecordedKeyframe, Recording, Scale, SessionInfo, is_submap,
};
use monogrid_evaluation::View;
use monogrid_geometry::Sim3;
use monogrid_mapping::{
    DepthOf, ImageOf, KeyframeCamera, KeyframeScan, MapStats, Mapper, MappingConfig, PosedKeyframe,
    SceneCell, UprightView, camera_paths, final_scans, scene_cell,
};
use monogrid_occupancy::{MapError, OccupancyMap};
use monogrid_report::colours::Colours;
use monogrid_report::explorer::{
    Camera, CloudPoint, Scene, SemiDense, ShownKeyframe, cloud_and_keyframes, point_groups,
};
use monogrid_report::surface::{CellColours, ColouredScan, SurfaceView};
use monogrid_slam::TrackedFrame;
use std::cell::OnceCell;
use std::path::Path;

/// A recording in memory.
#[derive(Debug)]
pub struct Recorded {
    /// What holds for all of it.
    pub session: SessionInfo,
    /// Its settings; `None` when they cannot be understood.
    pub config: Option<RunConfig>,
    /// Keyframes in the order of their ids.
    pub keyframes: Vec<RecordedKeyframe>,
    /// The frames of all sessions relative to their keyframes, where the run ended by itself.
    pub frames: Vec<TrackedFrame>,
    /// Frames of the source that were used, where the run ended by itself.
    pub num_frames: Option<u64>,
    /// The frame of maps.
    pub frame: MapFrame,
    /// What the user should know.
    pub warnings: Vec<String>,
}

impl Recorded {
    /// Reads a recording, a run or submaps, and finds the frame of their maps.
    pub fn read(path: &Path, align: &Align) -> Result<Self, Failure> {
        let source = Source::find(path)?;
        let recording = source.read()?;
        let config = RunConfig::recorded_mapping(&recording.session.config);
        let warnings = warnings(&recording, config.is_some(), is_submap(&source.file));
        let timed = |k: &RecordedKeyframe| Some((k.timestamp_ns, k.world_from_keyframe?.to_se3()));
        let trajectory: Vec<_> = recording.keyframes.iter().filter_map(timed).collect();
        if trajectory.is_empty() {
            return Err(Failure::input(format!(
                "{} holds no keyframe with a pose: tracking never started, or the file ends too \
                 early",
                path.display()
            )));
        }
        let align = match frame_beside(&source.file)? {
            Some(known) => align.clone().in_known_frame(known),
            None => align.clone(),
        };
        let mapping = config.as_ref().map(|config| config.mapping.clone());
        let mapping = mapping.unwrap_or_default();
        let scans = OnceCell::new();
        let (frame, align_failure) =
            align.frame(&trajectory, &SensedFrame::default(), &mut || align::Scene {
                views: views_of(
                    &recording.keyframes,
                    scans.get_or_init(|| scans_of(&recording.keyframes, &mapping, 1)),
                ),
                path: trajectory.iter().map(|(_, pose)| *pose).collect(),
            });
        if let Some(reason) = align_failure {
            return Err(Failure::input(reason));
        }
        let frames = recording.continuation.iter().flat_map(|c| &c.frames);
        Ok(Self {
            session: recording.session,
            config,
            frames: frames.map(tracked_frame).collect(),
            keyframes: recording.keyframes,
            num_frames: recording.end.map(|end| end.num_frames),
            frame,
            warnings,
        })
    }

    /// The map of its [scans](Self::scans) by these settings, as the run that ended with these
    /// poses makes it, and the cell where it follows from the scene.
    pub fn map(
        &self,
        scans: &[KeyframeScan],
        config: &MappingConfig,
        threads: usize,
    ) -> Result<(OccupancyMap, MapStats, Option<SceneCell>), MapError> {
        let is_free = config.auto_resolution && !self.is_metric();
        let cell = is_free.then(|| scene_cell(&views_of(&self.keyframes, scans), config));
        let cell = cell.flatten();
        let mut mapper = Mapper::new(config.clone(), threads);
        if let Some(cell) = &cell {
            mapper = mapper.with_resolution(cell.edge);
        }
        let poses = self.world_from_keyframes();
        let map_from_world = &self.frame.map_from_world;
        let (mut map, stats) = mapper.build(scans, &poses, map_from_world)?;
        mapper.free_body(&mut map, &self.paths())?;
        Ok((map, stats, cell))
    }

    /// Where the camera was in all runs that made it, in the frame of maps.
    pub fn paths(&self) -> Vec<Vec<[f64; 3]>> {
        let of_keyframe = |id: u32| {
            let found = self.keyframes.binary_search_by_key(&id, |k| k.id).ok()?;
            self.keyframes[found].world_from_keyframe.as_ref()
        };
        camera_paths(&self.frames, of_keyframe, &self.frame.map_from_world)
    }

    /// What of each keyframe is mapped.
    pub fn scans(&self, config: &MappingConfig, threads: usize) -> Vec<KeyframeScan> {
        scans_of(&self.keyframes, config, threads)
    }

    /// Colours of the cells of a map with this edge, by its [scans](Self::scans).
    pub fn cell_colours(&self, scans: &[KeyframeScan], resolution: f64) -> CellColours {
        let keyframes = self.keyframes.iter().zip(scans);
        let coloured: Vec<ColouredScan> = keyframes
            .filter_map(|(keyframe, scan)| {
                Some(ColouredScan {
                    scan,
                    image: keyframe.image.as_ref().map(ImageOf::Held),
                    map_from_keyframe: self.frame.map_from_world * keyframe.world_from_keyframe?,
                })
            })
            .collect();
        let colours = Colours::of(&self.keyframes);
        CellColours::new(&coloured, &colours, resolution)
    }

    /// What there is to explore of the keyframes, with the points that are shown.
    pub fn scene(&self) -> (Scene, Vec<CloudPoint>) {
        let colours = Colours::of(&self.keyframes);
        let posed = self.keyframes.iter().filter_map(|keyframe| {
            let RecordedKeyframe { id, camera, .. } = keyframe;
            let camera = KeyframeCamera::new(camera.pinhole, (camera.width, camera.height));
            Some(ShownKeyframe {
                frame_index: keyframe.frame_index,
                timestamp_ns: keyframe.timestamp_ns,
                map_from_keyframe: self.frame.map_from_world * keyframe.world_from_keyframe?,
                pinhole: keyframe.camera.pinhole,
                image: keyframe.image.as_ref().map(ImageOf::Held),
                semi_dense: SemiDense::recorded(*id, camera, &keyframe.pixels),
            })
        });
        let posed: Vec<ShownKeyframe> = posed.collect();
        let groups = point_groups(&posed, &colours);
        let begin = posed.first().map_or(0, |keyframe| keyframe.timestamp_ns);
        let (cloud, keyframes) = cloud_and_keyframes(&posed, &groups, &colours, begin);
        let path = posed.iter().map(|keyframe| {
            let [x, y, z] = <[f64; 3]>::from(keyframe.map_from_keyframe.translation);
            (keyframe.frame_index as usize, x as f32, y as f32, z as f32)
        });
        let camera = self.session.camera();
        let scene = Scene {
            unit: unit_name(self.is_metric()).to_owned(),
            cloud: Some(cloud),
            camera: Some(Camera::new(&camera.pinhole, [camera.width, camera.height])),
            keyframes,
            path: path.collect(),
            ..Scene::default()
        };
        (scene, groups.concat())
    }

    /// The keyframes for a surface that they see.
    pub fn surface_views(&self) -> Vec<SurfaceView<'_>> {
        let views = self.keyframes.iter().filter_map(|keyframe| {
            Some(SurfaceView {
                id: keyframe.id,
                image: keyframe.image.as_ref().map(ImageOf::Held),
                pinhole: keyframe.camera.pinhole,
                map_from_keyframe: self.frame.map_from_world * keyframe.world_from_keyframe?,
            })
        });
        views.collect()
    }

    /// Whether lengths are metres.
    fn is_metric(&self) -> bool {
        self.frame.is_aligned || self.session.scale == Scale::Metric
    }

    /// The scans of keyframes with a pose, and these in the frame of maps.
    pub fn posed<'a>(
        &'a self,
        scans: &'a [KeyframeScan],
    ) -> impl Iterator<Item = (&'a KeyframeScan, Sim3)> {
        let posed = self.keyframes.iter().zip(scans);
        posed.filter_map(|(keyframe, scan)| {
            Some((
                scan,
                self.frame.map_from_world * keyframe.world_from_keyframe?,
            ))
        })
    }

    /// Poses of the keyframes in the world of the run.
    pub fn world_from_keyframes(&self) -> Vec<Option<Sim3>> {
        let keyframes = self.keyframes.iter();
        keyframes.map(|k| k.world_from_keyframe).collect()
    }

    /// What the keyframes look at, in the frame of maps.
    pub fn views(&self) -> Vec<View> {
        let view = |keyframe: &RecordedKeyframe| {
            let pose = self.frame.map_from_world * keyframe.world_from_keyframe?;
            Some(View {
                world_from_camera: pose.to_se3(),
                camera: keyframe.camera.pinhole,
                width: keyframe.camera.width,
                height: keyframe.camera.height,
            })
        };
        self.keyframes.iter().filter_map(view).collect()
    }
}

/// What of each keyframe is mapped.
pub fn scans_of(
    keyframes: &[RecordedKeyframe],
    config: &MappingConfig,
    threads: usize,
) -> Vec<KeyframeScan> {
    by_camera(keyframes, |posed, camera| {
        final_scans(posed, camera, config, threads)
    })
}

/// Something of each keyframe, made from those of the same camera: depth is made better by images
/// of its own camera only.
pub fn by_camera<T>(
    keyframes: &[RecordedKeyframe],
    of_camera: impl Fn(&[PosedKeyframe], &KeyframeCamera) -> Vec<T>,
) -> Vec<T> {
    let mut made: Vec<(u32, T)> = Vec::with_capacity(keyframes.len());
    for camera in cameras_of(keyframes) {
        let same = || keyframes.iter().filter(|k| k.camera == camera);
        let posed: Vec<PosedKeyframe> = same()
            .map(|keyframe| PosedKeyframe {
                id: keyframe.id,
                image: keyframe.image.as_ref().map(ImageOf::Held),
                depth: DepthOf::Held(&keyframe.pixels),
                world_from_keyframe: keyframe.world_from_keyframe,
            })
            .collect();
        let size = (camera.width, camera.height);
        let of_camera = of_camera(&posed, &KeyframeCamera::new(camera.pinhole, size));
        made.extend(posed.iter().map(|posed| posed.id).zip(of_camera));
    }
    made.sort_by_key(|(id, _)| *id);
    made.into_iter().map(|(_, made)| made).collect()
}

/// The cameras of keyframes, in the order in which they come.
pub fn cameras_of(keyframes: &[RecordedKeyframe]) -> Vec<RecordedCamera> {
    let mut cameras: Vec<RecordedCamera> = Vec::new();
    for keyframe in keyframes {
        if !cameras.contains(&keyframe.camera) {
            cameras.push(keyframe.camera);
        }
    }
    cameras
}

/// Keyframes as the search for up needs them.
fn views_of<'a>(
    keyframes: &'a [RecordedKeyframe],
    scans: &'a [KeyframeScan],
) -> Vec<UprightView<'a>> {
    let posed = keyframes.iter().zip(scans).filter_map(|(keyframe, scan)| {
        Some(UprightView {
            scan,
            image: keyframe.image.as_ref().map(ImageOf::Held),
            world_from_keyframe: keyframe.world_from_keyframe?,
        })
    });
    posed.collect()
}

/// What the user should know; a part of a run has no end.
fn warnings(recording: &Recording, has_settings: bool, is_part: bool) -> Vec<String> {
    let mut warnings = Vec::new();
    if !has_settings {
        warnings.push("the recording holds no usable settings; the defaults are used".to_owned());
    }
    if recording.end.is_none() && !is_part {
        warnings.push("the run that wrote this recording did not end by itself".to_owned());
    }
    if recording.damage.num_gaps > 0 {
        warnings.push(format!(
            "{} bytes of the recording are damaged and were left out",
            recording.damage.lost_bytes
        ));
    }
    warnings
}
