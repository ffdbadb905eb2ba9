//! Where the scale of a run comes from afterwards.

use super::gps::Georeference;
use monogrid_app::process::failure::{Classify, Failure};
use monogrid_app::run::align::stamped_all;
use monogrid_datasets::{Recording, read_path};
use monogrid_evaluation::{TrajectoryConfig, evaluate_trajectory};
use monogrid_geometry::{Sim3, Vec2, Vec3};
use std::path::{Path, PathBuf};

/// How far from a named pixel depth is looked for, px.
const MAX_PIXEL_DISTANCE: f64 = 6.0;

/// What `--scale-from` names.
#[derive(Clone, Debug, PartialEq)]
pub enum ScaleFrom {
    /// Metres per map unit.
    Factor(f64),
    /// Two places and their distance in metres.
    Distance([Place; 2], f64),
    /// Median height of the camera over the floor, metres.
    CameraHeight(f64),
    /// A trajectory in metres.
    Trajectory(PathBuf),
    /// Subtitles of a drone, or a folder of photographs, that say where on the globe they are.
    Gps(PathBuf),
}

/// A place in a run.
#[derive(Clone, Debug, PartialEq)]
pub enum Place {
    /// A point of the results.
    Point(Vec3),
    /// A pixel of a keyframe.
    Pixel(u32, Vec2),
}

/// The results that a scale is found in.
#[derive(Debug)]
pub struct Results<'a> {
    /// Keyframes.
    pub recording: &'a Recording,
    /// From their world to the results.
    pub map_from_world: Sim3,
    /// Median height of the camera over the floor, map units, where a floor was found.
    pub camera_height: Option<f64>,
    /// Whether up is certain: else there is no floor.
    pub is_up_certain: bool,
    /// Whether a level surface was found that is no floor.
    pub is_over_surface: bool,
    /// Folder of the run.
    pub run: PathBuf,
}

impl ScaleFrom {
    /// Reads `factor=F`, `distance:A,B=L`, `camera-height=L`, `trajectory:FILE` or `gps:PATH`;
    /// lengths are metres, with or without `m`.
    pub fn parse(text: &str) -> Result<Self, String> {
        let parsed = if let Some(file) = text.strip_prefix("trajectory:") {
            Some(Self::Trajectory(file.into()))
        } else if let Some(path) = text.strip_prefix("gps:") {
            Some(Self::Gps(path.into()))
        } else if let Some(rest) = text.strip_prefix("distance:") {
            rest.split_once('=').and_then(|(places, metres)| {
                let (a, b) = places.split_once(',')?;
                Some(Self::Distance([place(a)?, place(b)?], length(metres)?))
            })
        } else {
            match text.split_once('=') {
                Some(("factor", factor)) => length(factor).map(Self::Factor),
                Some(("camera-height", metres)) => length(metres).map(Self::CameraHeight),
                _ => None,
            }
        };
        parsed.ok_or_else(|| {
            "expected factor=F, camera-height=1.5m, trajectory:FILE, gps:PATH, or \
             distance:A,B=1.2m, A and B points X:Y:Z of the results or pixels kID:X:Y of keyframes"
                .to_owned()
        })
    }

    /// Metres per map unit, and where the map lies on the globe where that is known.
    pub fn factor(&self, results: &Results) -> Result<(f64, Option<Georeference>), Failure> {
        let mut georeference = None;
        let factor = match self {
            Self::Factor(factor) => *factor,
            Self::Distance(places, metres) => {
                let [a, b] = [results.point(&places[0])?, results.point(&places[1])?];
                metres / (a - b).norm()
            }
            Self::CameraHeight(metres) => {
                let height = results.camera_height.ok_or_else(|| {
                    Failure::input(match results.is_over_surface {
                        _ if !results.is_up_certain => {
                            "camera-height: up is uncertain in this run, so that no floor is \
                            claimed; use a distance, or run again with --up"
                        }
                        true => {
                            "camera-height: found the largest level surface, below which \
                            things lie (a table?), expected a floor; use a distance"
                        }
                        false => "camera-height: no floor was found in this run; use a distance",
                    })
                })?;
                metres / height
            }
            Self::Trajectory(path) => {
                let read = |path: &Path| read_path(path).bad_input();
                let estimate = results.run.join("trajectory.txt");
                let (estimate, truth) = (read(&estimate)?, read(path)?);
                let config = TrajectoryConfig::default();
                let fit =
                    evaluate_trajectory(&stamped_all(&estimate), &stamped_all(&truth), &config);
                fit.map_err(Failure::input)?.gt_from_est.scale
            }
            Self::Gps(path) => {
                let found = Georeference::find(&results.run, path)?;
                georeference.insert(found).factor()
            }
        };
        if factor.is_normal() && (1e-6..=1e6).contains(&factor) {
            return Ok((factor, georeference));
        }
        Err(Failure::input(format!(
            "--scale-from gives {factor} metres per map unit, expected 0.000001 to 1000000"
        )))
    }
}

fn length(text: &str) -> Option<f64> {
    let number: f64 = text.trim_end_matches('m').parse().ok()?;
    (number.is_normal() && number > 0.0).then_some(number)
}

fn place(text: &str) -> Option<Place> {
    let numbers = |text: &str| -> Option<Vec<f64>> {
        text.split(':')
            .map(|n| n.parse().ok().filter(|n: &f64| n.is_finite()))
            .collect()
    };
    if let Some(pixel) = text.strip_prefix('k') {
        let (id, at) = pixel.split_once(':')?;
        return match numbers(at)?.as_slice() {
            [x, y] => Some(Place::Pixel(id.parse().ok()?, Vec2::new(*x, *y))),
            _ => None,
        };
    }
    match numbers(text)?.as_slice() {
        [x, y, z] => Some(Place::Point(Vec3::new(*x, *y, *z))),
        _ => None,
    }
}

impl Results<'_> {
    /// A place in the results.
    fn point(&self, place: &Place) -> Result<Vec3, Failure> {
        let (id, at) = match place {
            Place::Point(point) => return Ok(*point),
            Place::Pixel(id, at) => (*id, at),
        };
        let keyframes = &self.recording.keyframes;
        let keyframe = keyframes.iter().find(|keyframe| keyframe.id == id);
        let posed = keyframe.and_then(|keyframe| Some((keyframe, keyframe.world_from_keyframe?)));
        let Some((keyframe, pose)) = posed else {
            return Err(Failure::input(format!(
                "k{id}: there is no keyframe {id} with a place in the map"
            )));
        };
        let offset = |x: u16, y: u16| (Vec2::new(x.into(), y.into()) - at).norm();
        let nearest = keyframe
            .pixels
            .iter()
            .min_by(|a, b| offset(a.x, a.y).total_cmp(&offset(b.x, b.y)))
            .filter(|pixel| offset(pixel.x, pixel.y) <= MAX_PIXEL_DISTANCE);
        let Some(pixel) = nearest else {
            return Err(Failure::input(format!(
                "k{id}: no depth within {MAX_PIXEL_DISTANCE} pixels of ({}, {}); choose a point on \
                 an edge",
                at.x, at.y
            )));
        };
        let ray = keyframe.camera.pinhole.unproject(at);
        Ok(self.map_from_world * (pose * (ray / f64::from(pixel.idepth))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sources_of_scale_are_understood() {
        assert_eq!(ScaleFrom::parse("factor=2.5"), Ok(ScaleFrom::Factor(2.5)));
        assert_eq!(
            ScaleFrom::parse("camera-height=1.5m"),
            Ok(ScaleFrom::CameraHeight(1.5))
        );
        assert_eq!(
            ScaleFrom::parse("gps:DJI_0001.SRT"),
            Ok(ScaleFrom::Gps("DJI_0001.SRT".into()))
        );
        let two = [
            Place::Pixel(3, Vec2::new(10.0, 20.5)),
            Place::Point(Vec3::new(-1.0, 0.0, 2.0)),
        ];
        assert_eq!(
            ScaleFrom::parse("distance:k3:10:20.5,-1:0:2=1.2m"),
            Ok(ScaleFrom::Distance(two, 1.2))
        );
        for bad in [
            "",
            "factor=0",
            "factor=-1",
            "camera-height",
            "distance:1:2:3=1",
            "distance:1:2,3:4:5=1",
            "x=2",
        ] {
            assert!(ScaleFrom::parse(bad).is_err(), "{bad}");
        }
    }
}
