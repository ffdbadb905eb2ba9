//! Scale and place on the globe from where a receiver says that the camera was.
//!
//! A similarity takes positions of the camera to the places, in metres to the east, to the north
//! and up of the first of them. The errors of a receiver stay the same for minutes, so that many
//! places are hardly better than a few: what is said of the uncertainty takes all of them for one.

use monogrid_app::process::failure::{Classify, Failure};
use monogrid_app::run::outputs::frame_times_ns;
use monogrid_datasets::{
    Dataset, GlobalPlace, SourceOptions, TimedPlace, TimedPose, places_of_photographs,
    read_places_of_subtitles, read_trajectory,
};
use monogrid_geometry::nalgebra::Matrix3;
use monogrid_geometry::{Sim3, Vec3, align_similarity};
use monogrid_video::{is_video_file, read_telemetry};
use serde_json::{Value, json};
use std::path::Path;

/// Most time between two poses that a place lies between.
const MAX_GAP_NS: i64 = 1_000_000_000;
/// Most relative uncertainty of a scale that is one.
const MAX_SIGMA: f64 = 0.1;
/// How far from a line, in errors of the receiver, positions say how the map is turned around it.
const ACROSS: f64 = 3.0;

/// Where a map lies on the globe.
#[derive(Debug)]
pub struct Georeference {
    /// The first place.
    origin: GlobalPlace,
    /// Metres to the east, to the north and up of the origin.
    enu_from_map: Sim3,
    num_places: usize,
    /// Root mean square of the distances between path and places, m.
    rmse: f64,
    /// Root mean square of the distances of the places from their middle, m.
    spread: f64,
    /// Root mean square of their distances from the line that fits them best, m.
    across: f64,
}

impl Georeference {
    /// Of the run in a folder, by the subtitles of its video or the photographs that it is made of.
    pub fn find(run: &Path, places: &Path) -> Result<Self, Failure> {
        let path = read_trajectory(&run.join("trajectory.txt")).bad_input()?;
        let timed = match places.is_dir() {
            true => of_photographs(run, places)?,
            false if is_video_file(places) => of_video(places)?,
            false => read_places_of_subtitles(places).bad_input()?,
        };
        let found = Self::fit(&path, &timed)
            .map_err(|reason| Failure::input(format!("gps:{}: {reason}", places.display())))?;
        Ok(found)
    }

    fn fit(path: &[TimedPose], places: &[TimedPlace]) -> Result<Self, String> {
        let Some((_, origin)) = places.first() else {
            return Err("found no photograph with a place in its Exif block".to_owned());
        };
        let has_heights = places.iter().all(|(_, place)| place.altitude.is_some());
        let flat = |place: &GlobalPlace| GlobalPlace {
            altitude: place.altitude.filter(|_| has_heights),
            ..*place
        };
        let origin = flat(origin);
        let pairs = places.iter().filter_map(|(time_ns, place)| {
            let there = origin.east_north_up(&flat(place));
            Some((position_at(path, *time_ns)?, there))
        });
        let (positions, there): (Vec<Vec3>, Vec<Vec3>) = pairs.unzip();
        if there.len() < 3 {
            return Err(format!(
                "found {} places while the camera was known, of {}, expected three at least; are \
                 they of this video?",
                there.len(),
                places.len()
            ));
        }
        let fit = align_similarity(&positions, &there, true).map_err(|error| error.to_string())?;
        let [along, across, height] = spreads(&there);
        let found = Self {
            origin,
            enu_from_map: fit.target_from_source,
            num_places: there.len(),
            rmse: fit.rmse,
            spread: along.hypot(across).hypot(height),
            across: across.hypot(height),
        };
        if found.sigma() <= MAX_SIGMA {
            return Ok(found);
        }
        Err(format!(
            "the places do not say the scale: they lie {:.1} m from their middle and {:.1} m off \
             the path of the camera (root mean squares); fly or walk farther",
            found.spread, found.rmse
        ))
    }

    /// Metres per map unit.
    pub fn factor(&self) -> f64 {
        self.enu_from_map.scale
    }

    /// Standard deviation of the scale, relative.
    fn sigma(&self) -> f64 {
        self.rmse / self.spread
    }

    /// Whether it is known how the map is turned.
    fn is_turned(&self) -> bool {
        self.across > ACROSS * self.rmse
    }

    /// For people.
    pub fn finding(&self) -> String {
        let turned = match self.is_turned() {
            true => "",
            false => {
                "; they lie on a line, and do not say how the map is turned around it: it has a \
                 scale and no place"
            }
        };
        format!(
            "{} places agree with the path to {:.2} m over {:.0} m: the scale is known to {:.1} %\
             {turned}",
            self.num_places,
            self.rmse,
            self.spread,
            100.0 * self.sigma()
        )
    }

    /// For programs; `enu_from_map` is of the map in metres.
    pub fn summary(&self) -> Value {
        let [x, y, z] = self.enu_from_map.translation.into();
        let [qx, qy, qz, qw] = self.enu_from_map.rotation.coords.into();
        json!({
            "origin": {
                "latitude": self.origin.latitude,
                "longitude": self.origin.longitude,
                "altitude": self.origin.altitude,
            },
            "enu_from_map": self.is_turned().then_some([1.0, x, y, z, qx, qy, qz, qw]),
            "places": self.num_places,
            "rmse_m": self.rmse,
            "spread_m": self.spread,
            "scale_sigma": self.sigma(),
        })
    }
}

/// Where the camera was, between the poses around that time.
fn position_at(path: &[TimedPose], time_ns: i64) -> Option<Vec3> {
    let after = path.partition_point(|pose| pose.timestamp_ns < time_ns);
    let next = path.get(after)?;
    if next.timestamp_ns == time_ns {
        return Some(next.world_from_camera.translation);
    }
    let before = path.get(after.checked_sub(1)?)?;
    let gap_ns = next.timestamp_ns.checked_sub(before.timestamp_ns)?;
    let share = (time_ns - before.timestamp_ns) as f64 / gap_ns as f64;
    let [from, to] = [before, next].map(|pose| pose.world_from_camera.translation);
    (gap_ns <= MAX_GAP_NS).then(|| from.lerp(&to, share))
}

/// Standard deviations of points along the axes of their spread, largest first.
fn spreads(points: &[Vec3]) -> [f64; 3] {
    let count = points.len() as f64;
    let middle = points.iter().sum::<Vec3>() / count;
    let squares = points
        .iter()
        .map(|point| (point - middle) * (point - middle).transpose());
    let covariance = squares.sum::<Matrix3<f64>>() / count;
    let mut spreads: [f64; 3] = covariance.symmetric_eigenvalues().into();
    spreads.sort_by(|a, b| b.total_cmp(a));
    spreads.map(|variance| variance.max(0.0).sqrt())
}

/// The places that a camera wrote beside a video.
fn of_video(video: &Path) -> Result<Vec<TimedPlace>, Failure> {
    let found = read_telemetry(video).bad_input()?;
    let places = found.map(|found| found.places).unwrap_or_default();
    if places.is_empty() {
        return Err(Failure::input(format!(
            "gps:{}: found no places in the video, expected those that a GoPro writes (GPMF, with \
             the receiver switched on); with the subtitles of a drone give the .srt file",
            video.display()
        )));
    }
    Ok(places)
}

/// The places of the photographs in a folder at the times that the run gave to its frames.
fn of_photographs(run: &Path, folder: &Path) -> Result<Vec<TimedPlace>, Failure> {
    let times = frame_times_ns(&run.join("frames.csv"))?;
    let mut frames = Dataset::open(folder, SourceOptions::default())
        .bad_input()?
        .frames;
    frames.retain_mut(|frame| {
        let time_ns = times.get(&frame.index);
        frame.timestamp_ns = time_ns.copied().unwrap_or_default();
        time_ns.is_some()
    });
    Ok(places_of_photographs(&frames))
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::{Rotation, Se3};

    const START: GlobalPlace = GlobalPlace {
        latitude: 47.3,
        longitude: 8.5,
        altitude: Some(400.0),
    };

    /// A place so many metres to the east, to the north and up of the start, on a small globe of
    /// the same curvature there.
    fn place(enu: Vec3) -> GlobalPlace {
        let mut found = START;
        for _ in 0..4 {
            let missing = enu - START.east_north_up(&found);
            found.longitude += missing.x / (111_320.0 * found.latitude.to_radians().cos());
            found.latitude += missing.y / 111_320.0;
            found.altitude = found.altitude.map(|metres| metres + missing.z);
        }
        found
    }

    /// A path of a map whose unit is `unit` metres, turned and moved, and its places; `across`: how
    /// far it leaves a line.
    fn flight(unit: f64, across: f64, error: f64) -> (Vec<TimedPose>, Vec<TimedPlace>, Sim3) {
        let rotation = Rotation::from_euler_angles(0.3, -0.2, 1.1);
        let enu_from_map = Sim3::new(unit, rotation, Vec3::new(3.0, -8.0, 20.0));
        let at = |k: usize| {
            let t = k as f64 / 300.0;
            Vec3::new(60.0 * t, across * (6.0 * t).sin(), across * (4.0 * t).cos())
        };
        let map_from_enu = enu_from_map.inverse();
        let pose = |k: usize| TimedPose {
            timestamp_ns: 33_000_000 * k as i64,
            world_from_camera: Se3 {
                rotation: Rotation::identity(),
                translation: map_from_enu * at(k),
            },
        };
        // between the frames
        let timed = (0..29).map(|k| {
            let wrong = error * Vec3::new((k as f64).sin(), (2.0 * k as f64).cos(), 0.5);
            let there = (at(10 * k) + at(10 * k + 1)) / 2.0;
            (
                33_000_000 * 10 * k as i64 + 16_500_000,
                place(there + wrong),
            )
        });
        ((0..300).map(pose).collect(), timed.collect(), enu_from_map)
    }

    #[test]
    fn a_flight_says_the_scale_and_where_the_map_lies() {
        let (path, places, enu_from_map) = flight(7.5, 15.0, 0.0);
        let found = Georeference::fit(&path, &places).unwrap();
        assert!((found.factor() - 7.5).abs() < 1e-3, "{}", found.factor());
        let summary = found.summary();
        assert!(summary["scale_sigma"].as_f64().unwrap() < 1e-3);
        // a point of the map in metres, by what is written
        let written: Vec<f64> = summary["enu_from_map"]
            .as_array()
            .unwrap()
            .iter()
            .map(|number| number.as_f64().unwrap())
            .collect();
        let q = monogrid_geometry::nalgebra::Quaternion::new(
            written[7], written[4], written[5], written[6],
        );
        let turned = Rotation::from_quaternion(q) * (7.5 * Vec3::new(1.0, 2.0, 3.0));
        let there = turned + Vec3::new(written[1], written[2], written[3]);
        let start = places[0].1;
        let expected = enu_from_map * Vec3::new(1.0, 2.0, 3.0) - START.east_north_up(&start);
        assert!((there - expected).norm() < 0.02, "{there} {expected}");
        assert_eq!(summary["origin"]["latitude"], start.latitude);
    }

    #[test]
    fn errors_of_the_receiver_are_said_and_a_short_way_says_nothing() {
        let (path, places, _) = flight(7.5, 15.0, 1.0);
        let found = Georeference::fit(&path, &places).unwrap();
        let sigma = found.sigma();
        assert!(
            (found.factor() / 7.5 - 1.0).abs() < sigma && sigma > 0.02,
            "{sigma}"
        );
        assert!(
            found.is_turned() && found.finding().ends_with(" %"),
            "{}",
            found.finding()
        );
        // along a street
        let (path, places, _) = flight(7.5, 0.3, 1.0);
        let street = Georeference::fit(&path, &places).unwrap();
        assert!((street.factor() / 7.5 - 1.0).abs() < street.sigma());
        assert!(street.summary()["enu_from_map"].is_null());
        assert!(
            street.finding().contains("on a line"),
            "{}",
            street.finding()
        );
        // errors as large as the way
        let (path, places, _) = flight(7.5, 15.0, 20.0);
        let error = Georeference::fit(&path, &places).unwrap_err();
        assert!(error.contains("do not say the scale"), "{error}");
        // of another video
        let later: Vec<TimedPlace> = places
            .iter()
            .map(|(t, p)| (t + 1_000_000_000_000, *p))
            .collect();
        let error = Georeference::fit(&path, &later).unwrap_err();
        assert!(error.contains("found 0 places"), "{error}");
        assert!(Georeference::fit(&path, &[]).is_err());
    }
}
