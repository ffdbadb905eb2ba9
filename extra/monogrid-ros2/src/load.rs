//! A map that was saved, to go on with.

use crate::log::{Log, Severity};
use monogrid_app::process::failure::{Failure, render};
use monogrid_app::run::align::Align;
use monogrid_app::run::sessions::Earlier;
use monogrid_datasets::{RecordedFrame, RecordedSession};
use monogrid_geometry::Sim3;
use monogrid_image::WorkingSize;
use monogrid_pipeline::Preparation;
use monogrid_slam::StoredMap;
use std::fmt::{Display, Formatter};
use std::mem::take;
use std::path::{Path, PathBuf};

/// The map that the service `save` or a run has left.
#[derive(Debug)]
pub struct Loaded {
    /// Its folder.
    pub path: PathBuf,
    /// Runs that made it.
    pub sessions: Vec<RecordedSession>,
    /// Their frames.
    pub frames: Vec<RecordedFrame>,
    /// Its keyframes.
    pub num_keyframes: usize,
    /// The size of its images.
    pub working_size: WorkingSize,
    /// The frame of its results, where that is known.
    pub map_from_world: Option<Sim3>,
    /// Metres of a unit of its world, where that is known.
    pub metres_per_unit: Option<f64>,
    /// What the user should know.
    pub warnings: Vec<String>,
    /// All of it, until the first image comes.
    earlier: Option<Earlier>,
}

impl Loaded {
    /// Reads a map from the folder of `save` or of a run, or from a recording.
    ///
    /// # Errors
    /// Where there is none, or one without images.
    pub fn read(path: &Path) -> Result<Self, String> {
        if path.as_os_str().is_empty() {
            return Err(
                "no map is named: set the parameter load_path to a folder of `save`".into(),
            );
        }
        let mut earlier = Earlier::read(path).map_err(said)?;
        let (map_from_world, is_metric) = match &earlier.frame {
            Some(Align::Map {
                map_from_world,
                is_metric,
                ..
            }) => (Some(*map_from_world), *is_metric),
            _ => (None, false),
        };
        Ok(Self {
            path: path.to_owned(),
            sessions: take(&mut earlier.sessions),
            frames: take(&mut earlier.frames),
            num_keyframes: earlier.map.keyframes.len(),
            working_size: WorkingSize::Exact {
                width: earlier.session.width,
                height: earlier.session.height,
            },
            map_from_world,
            metres_per_unit: map_from_world.filter(|_| is_metric).map(|map| map.scale),
            warnings: take(&mut earlier.warnings),
            earlier: Some(earlier),
        })
    }

    /// Says that the camera is looked for in it.
    pub fn say(&self, log: &Log) {
        log.say(
            Severity::Info,
            &format!("the next image is looked for in {self}"),
        );
        for warning in &self.warnings {
            log.say(Severity::Warn, warning);
        }
    }

    /// The map, for images of a topic.
    ///
    /// # Errors
    /// Images of another camera, or a map that was taken before and was of no use.
    pub fn take(&mut self, images: &Preparation, topic: &str) -> Result<StoredMap, String> {
        if let Some(earlier) = &self.earlier {
            earlier.check_camera(images, topic).map_err(said)?;
        }
        let earlier = self.earlier.take();
        let earlier = earlier.ok_or_else(|| format!("{self} cannot be used"))?;
        Ok(earlier.map)
    }
}

impl Display for Loaded {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        let (count, path) = (self.num_keyframes, self.path.display());
        write!(f, "the map of {count} keyframes in {path}")
    }
}

fn said(failure: Failure) -> String {
    render(&anyhow::Error::from_boxed(failure.into_error()))
}
