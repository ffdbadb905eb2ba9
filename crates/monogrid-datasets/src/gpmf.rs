//! What cameras of GoPro write beside the picture (GPMF,
//! <https://github.com/gopro/gpmf-parser>): where they are, and how they turn and accelerate.

use crate::{GlobalPlace, TimedPlace};
use monogrid_geometry::Vec3;
use monogrid_inertial::ImuSample;

/// Readings of one kind with their times, ns.
type Readings = Vec<(i64, Vec3)>;

/// What a camera wrote beside a video, on the clock of the video.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CameraTelemetry {
    /// Places while the receiver knew where it is; of equal ones behind each other the first.
    pub places: Vec<TimedPlace>,
    /// Angular velocities, rad/s.
    rates: Readings,
    /// Specific forces, m/s².
    forces: Readings,
    /// Whether readings were passed over since nothing says which axes they are along.
    pub has_unknown_axes: bool,
}

impl CameraTelemetry {
    /// Adds a packet that was written within these times, ns; readings of a kind are spread evenly
    /// over them. What is damaged, or of another kind, is passed over.
    pub fn add(&mut self, packet: &[u8], [begin_ns, end_ns]: [i64; 2]) {
        for stream in nested(packet, *b"DEVC").flat_map(|device| nested(device, *b"STRM")) {
            let text = |key: &[u8; 4]| items(stream).find(|item| item.key == *key).map(|i| i.data);
            let scales = items(stream).find(|item| item.key == *b"SCAL");
            let scales: Vec<f64> = scales.map_or(vec![], |s| s.rows(None).concat());
            let fix = items(stream).find(|item| item.key == *b"GPSF");
            let fix = fix.and_then(|fix| fix.rows(None).concat().first().copied());
            for item in items(stream) {
                let rows = match &item.key {
                    b"ACCL" | b"GYRO" | b"GPS5" | b"GPS9" => item.rows(text(b"TYPE")),
                    _ => continue,
                };
                let span_ns = end_ns.saturating_sub(begin_ns) as f64 / rows.len().max(1) as f64;
                for (at, row) in rows.iter().enumerate() {
                    let time_ns = begin_ns.saturating_add((at as f64 * span_ns) as i64);
                    let scale = |k: usize| scales.get(k).or(scales.last()).copied().unwrap_or(1.0);
                    let row = row.iter().enumerate().map(|(k, value)| value / scale(k));
                    let row: Vec<f64> = row.collect();
                    if row.iter().all(|value| value.is_finite()) {
                        self.add_row(&item.key, (time_ns, &row), fix, text(b"ORIN"));
                    }
                }
            }
        }
    }

    fn add_row(
        &mut self,
        key: &[u8; 4],
        (time_ns, row): (i64, &[f64]),
        fix: Option<f64>,
        axes: Option<&[u8]>,
    ) {
        if let b"ACCL" | b"GYRO" = key {
            let Some(vector) = axes.and_then(|axes| along_axes(row, axes)) else {
                self.has_unknown_axes = true;
                return;
            };
            let readings = if key == b"ACCL" {
                &mut self.forces
            } else {
                &mut self.rates
            };
            if readings
                .last()
                .is_none_or(|(last_ns, _)| *last_ns < time_ns)
            {
                readings.push((time_ns, vector));
            }
            return;
        }
        // the newer kind says of each place whether it is one: 2 on the ground, 3 in space
        let fix = if key == b"GPS9" {
            row.get(8).copied()
        } else {
            fix
        };
        let &[latitude, longitude, altitude, ..] = row else {
            return;
        };
        let place = GlobalPlace::new([latitude, longitude], Some(altitude));
        if let Some(place) = place.filter(|_| fix.is_none_or(|fix| fix >= 2.0))
            && self
                .places
                .last()
                .is_none_or(|(last_ns, last)| *last != place && *last_ns < time_ns)
        {
            self.places.push((time_ns, place));
        }
    }

    /// Readings of both sensors at the times of the gyroscope.
    #[must_use]
    pub fn samples(&self) -> Vec<ImuSample> {
        let sample = |&(timestamp_ns, angular_velocity): &(i64, Vec3)| {
            let after = self
                .forces
                .partition_point(|(time_ns, _)| *time_ns < timestamp_ns);
            let (next_ns, next) = self.forces.get(after)?;
            let (last_ns, last) = self.forces.get(after.saturating_sub(1))?;
            let share = match next_ns - last_ns {
                0 => 0.0,
                gap => (timestamp_ns - last_ns) as f64 / gap as f64,
            };
            (0.0..=1.0).contains(&share).then(|| ImuSample {
                timestamp_ns,
                angular_velocity,
                specific_force: last.lerp(next, share),
            })
        };
        self.rates.iter().filter_map(sample).collect()
    }
}

/// Three values by the letters of their axes, those of the opposite direction in lower case.
fn along_axes(row: &[f64], axes: &[u8]) -> Option<Vec3> {
    let mut vector = Vec3::repeat(f64::NAN);
    for (value, axis) in row.iter().zip(axes.get(..3)?) {
        let sign = if axis.is_ascii_lowercase() { -1.0 } else { 1.0 };
        let axis = axis.to_ascii_lowercase().checked_sub(b'x')?;
        *vector.get_mut(usize::from(axis))? = sign * value;
    }
    vector
        .iter()
        .all(|value| value.is_finite())
        .then_some(vector)
}

/// Something with a name: `repeat` elements of so many bytes.
struct Item<'a> {
    key: [u8; 4],
    kind: u8,
    size: usize,
    data: &'a [u8],
}

/// The items in some bytes, up to the first that is damaged.
fn items(mut bytes: &[u8]) -> impl Iterator<Item = Item<'_>> {
    std::iter::from_fn(move || {
        let (head, rest) = bytes.split_first_chunk::<8>()?;
        let &[a, b, c, d, kind, size, high, low] = head;
        let size = usize::from(size);
        let length = size * usize::from(u16::from_be_bytes([high, low]));
        let data = rest.get(..length)?;
        // packets may end without the bytes that fill the last item up
        bytes = rest.get(length.next_multiple_of(4)..).unwrap_or_default();
        Some(Item {
            key: [a, b, c, d],
            kind,
            size,
            data,
        })
    })
}

/// The contents of the items of this name that hold others.
fn nested(bytes: &[u8], key: [u8; 4]) -> impl Iterator<Item = &[u8]> {
    let found = move |item: &Item<'_>| item.kind == 0 && item.key == key;
    items(bytes).filter(found).map(|item| item.data)
}

impl Item<'_> {
    /// The numbers of each element; `types` are the kinds of an element of several.
    fn rows(&self, types: Option<&[u8]>) -> Vec<Vec<f64>> {
        let own = [self.kind];
        let kinds = match self.kind {
            b'?' => types.unwrap_or_default(),
            _ => &own[..],
        };
        let row = |mut bytes: &[u8]| {
            let mut row = Vec::new();
            for kind in kinds.iter().cycle() {
                if bytes.is_empty() {
                    break;
                }
                row.push(number(*kind, &mut bytes)?);
            }
            Some(row)
        };
        let elements = self.data.chunks_exact(self.size.max(1));
        elements.filter_map(row).collect()
    }
}

/// The next number of a kind.
fn number(kind: u8, bytes: &mut &[u8]) -> Option<f64> {
    fn take<const N: usize>(bytes: &mut &[u8]) -> Option<[u8; N]> {
        let (number, rest) = bytes.split_first_chunk()?;
        *bytes = rest;
        Some(*number)
    }
    Some(match kind {
        b'b' => i8::from_be_bytes(take(bytes)?).into(),
        b'B' => u8::from_be_bytes(take(bytes)?).into(),
        b's' => i16::from_be_bytes(take(bytes)?).into(),
        b'S' => u16::from_be_bytes(take(bytes)?).into(),
        b'l' => i32::from_be_bytes(take(bytes)?).into(),
        b'L' => u32::from_be_bytes(take(bytes)?).into(),
        b'f' => f32::from_be_bytes(take(bytes)?).into(),
        b'd' => f64::from_be_bytes(take(bytes)?),
        b'q' => f64::from(i32::from_be_bytes(take(bytes)?)) / 65536.0,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn item(key: &[u8; 4], kind: u8, size: u8, data: &[u8]) -> Vec<u8> {
        let repeat = (data.len() / usize::from(size)) as u16;
        let mut bytes = [&key[..], &[kind, size], &repeat.to_be_bytes(), data].concat();
        bytes.resize(bytes.len().next_multiple_of(4), 0);
        bytes
    }

    fn words(values: &[i16]) -> Vec<u8> {
        values
            .iter()
            .flat_map(|value| value.to_be_bytes())
            .collect()
    }

    fn longs(values: &[i32]) -> Vec<u8> {
        values
            .iter()
            .flat_map(|value| value.to_be_bytes())
            .collect()
    }

    fn stream(items: &[Vec<u8>]) -> Vec<u8> {
        item(b"STRM", 0, 1, &items.concat())
    }

    /// A second of three sensors.
    fn packet(fix: u32) -> Vec<u8> {
        let forces = stream(&[
            item(b"SCAL", b's', 2, &words(&[100])),
            item(b"ORIN", b'c', 1, b"YxZ"),
            item(b"ACCL", b's', 6, &words(&[981, 200, 300, 1081, 200, 300])),
        ]);
        let rates = stream(&[
            item(b"SCAL", b's', 2, &words(&[1000])),
            item(b"ORIN", b'c', 1, b"YxZ"),
            item(
                b"GYRO",
                b's',
                6,
                &words(&[1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12]),
            ),
        ]);
        let scales = longs(&[10_000_000, 10_000_000, 1000, 1000, 100]);
        let places = [472_500_000, -85_000_000, 30_400, 0, 0];
        let next = [472_500_010, -85_000_000, 30_400, 0, 0];
        let places = stream(&[
            item(b"GPSF", b'L', 4, &fix.to_be_bytes()),
            item(b"SCAL", b'l', 4, &scales),
            item(
                b"GPS5",
                b'l',
                20,
                &longs(&[places, places, next, next].concat()),
            ),
        ]);
        item(b"DEVC", 0, 1, &[forces, rates, places].concat())
    }

    #[test]
    fn places_and_readings_have_their_units_axes_and_times() {
        let mut found = CameraTelemetry::default();
        found.add(&packet(0), [0, 1_000_000_000]);
        assert_eq!(found.places, [], "the receiver knows nothing yet");
        found.add(&packet(3), [1_000_000_000, 2_000_000_000]);
        let place = |latitude| GlobalPlace {
            latitude,
            longitude: -8.5,
            altitude: Some(30.4),
        };
        let expected = [
            (1_000_000_000, place(47.25)),
            (1_500_000_000, place(47.250_001)),
        ];
        assert_eq!(found.places, expected);
        let samples = found.samples();
        assert_eq!(samples.len(), 7, "one is behind the last force");
        assert_eq!(samples[1].timestamp_ns, 250_000_000);
        assert_eq!(samples[1].angular_velocity, Vec3::new(-0.005, 0.004, 0.006));
        let force = samples[1].specific_force - Vec3::new(-2.0, 10.31, 3.0);
        assert!(force.norm() < 1e-9, "between two: {force}");
        assert!(!found.has_unknown_axes);
    }

    #[test]
    fn the_newer_kind_of_places_has_elements_of_several_kinds() {
        let mut element = longs(&[472_500_000, -85_000_000, 30_400, 0, 0, 8000, 1000]);
        element.extend(words(&[150, 3]));
        let scales = longs(&[10_000_000, 10_000_000, 1000, 1000, 100, 1, 1000, 100, 1]);
        let places = stream(&[
            item(b"TYPE", b'c', 1, b"lllllllSS"),
            item(b"SCAL", b'l', 4, &scales),
            item(b"GPS9", b'?', 32, &element),
        ]);
        let mut found = CameraTelemetry::default();
        found.add(&item(b"DEVC", 0, 1, &places), [5, 10]);
        assert_eq!(found.places.len(), 1);
        assert_eq!(found.places[0].1.altitude, Some(30.4));
    }

    #[test]
    fn damage_and_unknown_axes_are_passed_over() {
        let whole = packet(3);
        for length in 0..whole.len() {
            CameraTelemetry::default().add(&whole[..length], [0, 1]);
            let mut damaged = whole.clone();
            damaged[length] ^= 0xff;
            CameraTelemetry::default().add(&damaged, [i64::MIN, i64::MAX]);
        }
        let rates = stream(&[item(b"GYRO", b's', 6, &words(&[1, 2, 3]))]);
        let mut found = CameraTelemetry::default();
        found.add(&item(b"DEVC", 0, 1, &rates), [0, 1]);
        assert!(found.has_unknown_axes && found.samples().is_empty());
    }
}
