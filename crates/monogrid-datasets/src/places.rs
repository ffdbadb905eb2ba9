//! Places on the globe that a camera writes down: DJI's subtitles, and Exif of photographs.

use crate::images::exif_place;
use crate::text::read_text;
use crate::{DatasetError, FrameEntry};
use monogrid_geometry::Vec3;
use std::path::Path;

/// A place on the globe (WGS 84) and when the camera was there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GlobalPlace {
    /// Degrees, north of the equator.
    pub latitude: f64,
    /// Degrees, east of Greenwich.
    pub longitude: f64,
    /// Metres, over the sea or over where a drone took off.
    pub altitude: Option<f64>,
}

/// A place with its time in the source, ns.
pub type TimedPlace = (i64, GlobalPlace);

impl GlobalPlace {
    /// `None` for what is nowhere; receivers write 0, 0 as long as they do not know where they are.
    pub(crate) fn new([latitude, longitude]: [f64; 2], altitude: Option<f64>) -> Option<Self> {
        let is_somewhere = latitude.abs() <= 90.0
            && longitude.abs() <= 180.0
            && (latitude, longitude) != (0.0, 0.0);
        is_somewhere.then_some(Self {
            latitude,
            longitude,
            altitude: altitude.filter(|metres| metres.abs() < 1e5),
        })
    }

    /// Metres from the centre of the earth towards Greenwich, 90 degrees east and north.
    fn geocentric(&self) -> Vec3 {
        // WGS 84: half of the longer axis, m, and flattening
        const AXIS: f64 = 6_378_137.0;
        const FLATTENING: f64 = 1.0 / 298.257_223_563;
        const ECCENTRICITY_SQ: f64 = FLATTENING * (2.0 - FLATTENING);
        let (sin, cos) = self.latitude.to_radians().sin_cos();
        let (sin_east, cos_east) = self.longitude.to_radians().sin_cos();
        let altitude = self.altitude.unwrap_or(0.0);
        let normal = AXIS / (1.0 - ECCENTRICITY_SQ * sin * sin).sqrt();
        let across = (normal + altitude) * cos;
        let north = (normal * (1.0 - ECCENTRICITY_SQ) + altitude) * sin;
        Vec3::new(across * cos_east, across * sin_east, north)
    }

    /// Where another place is: metres to the east, to the north and up of this one.
    #[must_use]
    pub fn east_north_up(&self, other: &Self) -> Vec3 {
        let (sin, cos) = self.latitude.to_radians().sin_cos();
        let (sin_east, cos_east) = self.longitude.to_radians().sin_cos();
        let way = other.geocentric() - self.geocentric();
        let east = Vec3::new(-sin_east, cos_east, 0.0);
        let up = Vec3::new(cos * cos_east, cos * sin_east, sin);
        Vec3::new(east.dot(&way), up.cross(&east).dot(&way), up.dot(&way))
    }
}

/// Reads the subtitles that a drone of DJI writes beside a video (`.srt`): the times are those of
/// the video. Of equal places behind each other the first counts, since receivers are slower than
/// cameras.
///
/// # Errors
/// When the file cannot be read, or names no places.
pub fn read_places_of_subtitles(path: &Path) -> Result<Vec<TimedPlace>, DatasetError> {
    let text = read_text(path)?;
    let mut places: Vec<TimedPlace> = Vec::new();
    let mut begins_ns = None;
    for line in text.lines() {
        if let Some((begin, _)) = line.split_once("-->") {
            begins_ns = clock_ns(begin);
        } else if let (Some(time_ns), Some(place)) = (begins_ns, place_in(line))
            && places.last().is_none_or(|(_, last)| *last != place)
        {
            places.push((time_ns, place));
        }
    }
    if places.is_empty() {
        let expected = "subtitles of a drone: `00:00:01,000 --> 00:00:01,033`, then a line with \
                        [latitude: ...] [longitude: ...] or GPS (longitude, latitude, ...)";
        return Err(DatasetError::content(path, "no places", expected));
    }
    Ok(places)
}

/// The places that the Exif blocks of images say, of those that say one.
#[must_use]
pub fn places_of_photographs(frames: &[FrameEntry]) -> Vec<TimedPlace> {
    let placed = |frame: &FrameEntry| Some((frame.timestamp_ns, exif_place(&frame.path)?));
    frames.iter().filter_map(placed).collect()
}

/// A time in a video, `00:01:02,345`.
fn clock_ns(text: &str) -> Option<i64> {
    let mut parts = text.trim().splitn(3, ':');
    let mut whole = || {
        parts
            .next()?
            .parse::<i64>()
            .ok()
            .filter(|n| (0..1000).contains(n))
    };
    let (hours, minutes) = (whole()?, whole()?);
    let seconds: f64 = parts.next()?.replace(',', ".").parse().ok()?;
    let ns = (0.0..60.0)
        .contains(&seconds)
        .then(|| (seconds * 1e9).round() as i64)?;
    Some((60 * hours + minutes) * 60_000_000_000 + ns)
}

/// The place that a line of a subtitle names.
fn place_in(line: &str) -> Option<GlobalPlace> {
    let lower = line.to_ascii_lowercase();
    let after = |name: &str| number_after(&lower, name);
    let altitude = ["rel_alt", "barometer", "abs_alt", "altitude"]
        .into_iter()
        .find_map(after);
    if let Some(latitude) = after("latitude") {
        // "longtitude" is DJI's own
        let longitude = after("longitude").or_else(|| after("longtitude"))?;
        return GlobalPlace::new([latitude, longitude], altitude);
    }
    let (_, inside) = lower.split_once("gps")?;
    let inside = inside.trim_start().strip_prefix('(')?;
    let mut numbers = inside
        .split([',', ')'])
        .map(|word| word.trim().parse().ok());
    let (longitude, latitude) = (numbers.next()??, numbers.next()??);
    GlobalPlace::new([latitude, longitude], altitude)
}

/// The number behind a name and what separates them.
fn number_after(line: &str, name: &str) -> Option<f64> {
    let (_, rest) = line.split_once(name)?;
    let rest = rest.trim_start_matches([' ', ':', '=']);
    let is_part = |c: char| c.is_ascii_digit() || matches!(c, '.' | '-' | '+');
    let end = rest.find(|c| !is_part(c)).unwrap_or(rest.len());
    rest[..end]
        .parse()
        .ok()
        .filter(|number: &f64| number.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<TimedPlace>, DatasetError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("DJI_0001.SRT");
        std::fs::write(&path, text).unwrap();
        read_places_of_subtitles(&path)
    }

    #[test]
    fn subtitles_of_three_generations_are_read() {
        let new = "1\n00:00:00,000 --> 00:00:00,033\n<font size=\"28\">FrameCnt: 1, \
            DiffTime: 33ms\n2023-06-11 11:21:05.345\n[iso: 100] [latitude: 47.25] \
            [longitude: -8.5] [rel_alt: 30.400 abs_alt: 495.123] </font>\n\n\
            2\n00:00:00,033 --> 00:00:00,066\n[latitude: 47.25] [longitude: -8.5] [rel_alt: \
            30.400 abs_alt: 495.1]\n\n\
            3\n01:02:03,500 --> 01:02:04,000\n[latitude: 47.26] [longitude: -8.5] [rel_alt: 31 \
            abs_alt: 495.1]\n";
        let place = |latitude, altitude| GlobalPlace {
            latitude,
            longitude: -8.5,
            altitude: Some(altitude),
        };
        let expected = [
            (0, place(47.25, 30.4)),
            (3_723_500_000_000, place(47.26, 31.0)),
        ];
        assert_eq!(read(new).unwrap(), expected);
        for line in [
            "[latitude : 47.25] [longtitude : -8.5] [altitude: 30.4]",
            "F/2.8, SS 320, GPS (-8.5, 47.25, 18), D 24.70m, BAROMETER:30.4",
            "HOME(-8.5,47.2) GPS(-8.5,47.25,16) BAROMETER:30.4",
        ] {
            let text = format!("1\r\n00:00:00,000 --> 00:00:01,000\r\n{line}\r\n");
            assert_eq!(read(&text).unwrap(), expected[..1], "{line}");
        }
        // before the receiver knows, and subtitles of a film
        for line in [
            "[latitude: 0.0] [longitude: 0.0]",
            "Latitude is a novel",
            "GPS()",
            "GPS (1",
        ] {
            let text = format!("1\n00:00:00,000 --> 00:00:01,000\n{line}\n");
            let error = read(&text).unwrap_err().to_string();
            assert!(error.contains("no places"), "{error}");
        }
    }

    #[test]
    fn a_minute_of_arc_is_a_sea_mile_to_the_north_and_less_to_the_east() {
        let at =
            |latitude, longitude| GlobalPlace::new([latitude, longitude], Some(100.0)).unwrap();
        let origin = at(60.0, 10.0);
        let north = origin.east_north_up(&at(60.0 + 1.0 / 60.0, 10.0));
        // 1857 m at 60 degrees, on the ground; 100 m higher 3 cm more
        assert!(
            (north - Vec3::new(0.0, 1856.9, -0.27)).norm() < 0.5,
            "{north}"
        );
        let east = origin.east_north_up(&at(60.0, 10.0 + 1.0 / 60.0));
        assert!((east - Vec3::new(930.1, 0.1, 0.0)).norm() < 0.5, "{east}");
        let above = GlobalPlace {
            altitude: Some(150.0),
            ..origin
        };
        assert!((origin.east_north_up(&above) - Vec3::new(0.0, 0.0, 50.0)).norm() < 1e-6);
    }
}
