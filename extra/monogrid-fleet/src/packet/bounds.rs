//! What a packet may hold. Whoever can reach the server can send it anything: memory is taken only
//! for what is within these bounds, and only numbers that a run can have come any further.

use super::PacketError;
use monogrid_datasets::{Continuation, PoseSnapshot, Record, RecordedCamera, SessionInfo};
use monogrid_geometry::{Camera, Distortion, Sim3};

/// Bytes of a packet at most: a keyframe of [`MAX_PIXELS`] takes some 5 MB at the best quality.
pub const MAX_PACKET_BYTES: usize = 8 << 20;
/// Longest side of an image, px: recordings have none that is longer.
pub const MAX_SIDE: u16 = 8192;
/// Pixels of an image at most: 3840 x 2160. Unpacked, with depth in all of them, they take some 300
/// MB.
pub const MAX_PIXELS: usize = 1 << 23;
/// Bytes of a record at most: the points and edges of some 5000 keyframes.
pub const MAX_RECORD_BYTES: usize = 512 << 20;
/// Bytes of a record that belong to no keyframe: the settings of a run and its summary.
const MAX_BYTES_OF_NO_KEYFRAME: u64 = 1 << 20;
/// Bytes of a record for each keyframe that has come: ten times what points, edges and frames of
/// one take.
const MAX_BYTES_PER_KEYFRAME: u64 = 512 << 10;
/// Sessions of a recording that can have no keyframe.
const MAX_EMPTY_SESSIONS: usize = 1000;
/// Largest coordinate, units of the world: a map in metres can lie in the grid of a country.
const MAX_COORDINATE: f64 = 1e8;
/// Largest factor by which a keyframe's unit differs from that of the world, either way.
const MAX_SCALE: f64 = 1e6;
/// Any other number: information of measurements is the largest, with an error of 1e-9 units.
const MAX_NUMBER: f64 = 1e18;
/// Times are within 146 years around zero, so that the difference of two is a time.
const MAX_TIME_NS: u64 = 1 << 62;

fn beyond(what: &'static str, found: impl ToString, expected: impl ToString) -> PacketError {
    let (found, expected) = (found.to_string(), expected.to_string());
    PacketError::Beyond {
        what,
        found,
        expected,
    }
}

/// Refuses more than `limit` bytes.
pub(super) fn at_most(what: &'static str, bytes: u64, limit: u64) -> Result<(), PacketError> {
    if bytes > limit {
        let (found, expected) = (format!("{bytes} bytes"), format!("at most {limit}"));
        return Err(beyond(what, found, expected));
    }
    Ok(())
}

/// Refuses a size that no image of a recording has.
pub(crate) fn check_size((width, height): (u16, u16)) -> Result<(), PacketError> {
    let pixels = usize::from(width) * usize::from(height);
    if width.max(height) > MAX_SIDE || !(1..=MAX_PIXELS).contains(&pixels) {
        let found = format!("{width}x{height} px");
        let expected = format!("at most {MAX_SIDE} px a side and {MAX_PIXELS} in all");
        return Err(beyond("an image", found, expected));
    }
    Ok(())
}

/// Refuses a time that cannot be subtracted from another one.
pub(super) fn check_time(timestamp_ns: i64) -> Result<(), PacketError> {
    if timestamp_ns.unsigned_abs() > MAX_TIME_NS {
        return Err(beyond(
            "a time",
            format!("{timestamp_ns} ns"),
            "146 years at most",
        ));
    }
    Ok(())
}

/// Refuses what is no camera.
pub(super) fn check_camera(camera: &RecordedCamera) -> Result<(), PacketError> {
    let RecordedCamera {
        pinhole,
        width,
        height,
    } = *camera;
    let side = |side: usize| u16::try_from(side).unwrap_or(u16::MAX);
    check_size((side(width), side(height)))?;
    let camera = Camera::try_new(width, height, pinhole, Distortion::None);
    camera
        .map(|_| ())
        .map_err(|error| beyond("a camera", error, "one that can be"))
}

/// Bytes that a record of a run with so many keyframes can have.
pub(super) fn record_limit(num_keyframes: u64) -> u64 {
    let of_keyframes = num_keyframes.saturating_mul(MAX_BYTES_PER_KEYFRAME);
    let limit = of_keyframes.saturating_add(MAX_BYTES_OF_NO_KEYFRAME);
    limit.min(MAX_RECORD_BYTES as u64)
}

/// Refuses a record with numbers that no run has; `is_known` says whether a keyframe has come,
/// `num_keyframes` how many have.
pub(crate) fn check_record(
    record: &Record,
    num_keyframes: usize,
    is_known: impl Fn(u32) -> bool,
) -> Result<(), PacketError> {
    match record {
        Record::Session(session) => check_camera(&SessionInfo::camera(session)),
        Record::Poses(poses) => check_poses(poses, is_known),
        Record::Continuation(continuation) => check_continuation(continuation, num_keyframes),
        Record::End(_) => Ok(()),
        // made small, and bounded, as packets of their own
        Record::Keyframe(_) | Record::Depth(_) | Record::Colour(_) => Err(PacketError::Content(
            "a keyframe, depth or colour came as a record",
        )),
    }
}

fn check_poses(poses: &PoseSnapshot, is_known: impl Fn(u32) -> bool) -> Result<(), PacketError> {
    for (id, pose) in &poses.poses {
        if !is_known(*id) {
            return Err(PacketError::Content(
                "a pose is of no keyframe that has come",
            ));
        }
        check_pose("the pose of a keyframe", pose)?;
    }
    Ok(())
}

/// Refuses a pose that is not finite, far from everything, or of a unit that no keyframe has.
/// Readers have made its quaternion a rotation.
fn check_pose(what: &'static str, pose: &Sim3) -> Result<(), PacketError> {
    let is_sane = pose.is_finite()
        && pose.translation.amax() <= MAX_COORDINATE
        && (MAX_SCALE.recip()..=MAX_SCALE).contains(&pose.scale);
    if !is_sane {
        let [x, y, z]: [f64; 3] = pose.translation.into();
        let found = format!("translation {x:e} {y:e} {z:e}, scale {:e}", pose.scale);
        let expected = format!(
            "coordinates up to {MAX_COORDINATE:e} and a scale of {:e} to {MAX_SCALE:e}",
            MAX_SCALE.recip()
        );
        return Err(beyond(what, found, expected));
    }
    Ok(())
}

fn check_continuation(
    continuation: &Continuation,
    num_keyframes: usize,
) -> Result<(), PacketError> {
    let Continuation {
        sessions,
        keyframes,
        edges,
        points,
        frames,
        fragments,
    } = continuation;
    let most = num_keyframes + MAX_EMPTY_SESSIONS;
    if sessions.len() > most {
        let expected = format!("at most {most}");
        return Err(beyond("a list of sessions", sessions.len(), expected));
    }
    for edge in edges {
        check_pose("an edge", &edge.i_from_j)?;
        check_numbers("an edge", &edge.information)?;
        check_numbers("an edge", &[edge.kernel_parameter])?;
    }
    for keyframe in keyframes {
        check_numbers("brightness", &[keyframe.gain, keyframe.bias])?;
    }
    for point in points {
        check_numbers("a point", &point.pixel)?;
        check_numbers("a point", &point.idepth)?;
        for (_, pixel) in &point.observations {
            check_numbers("a point", pixel)?;
        }
    }
    for frame in frames {
        check_time(frame.timestamp_ns)?;
        check_pose(
            "the pose of a frame",
            &frame.keyframe_from_frame.with_scale(1.0),
        )?;
    }
    for member in fragments {
        check_pose("the pose of a keyframe", &member.fragment_from_keyframe)?;
    }
    Ok(())
}

fn check_numbers(what: &'static str, numbers: &[f64]) -> Result<(), PacketError> {
    let bad = numbers.iter().find(|n| n.is_nan() || n.abs() > MAX_NUMBER);
    bad.map_or(Ok(()), |bad| {
        let expected = format!("numbers up to {MAX_NUMBER:e}");
        Err(beyond(what, format!("{bad:e}"), expected))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_datasets::{
        FragmentKeyframe, KeyframeLink, RecordedEdge, RecordedFrame, RecordedPoint, RecordedSession,
    };
    use monogrid_geometry::{Rotation, Se3, Vec3};

    /// A pose at this place, of this scale.
    fn pose(x: f64, scale: f64) -> Sim3 {
        Sim3::new(scale, Rotation::identity(), Vec3::new(x, 0.0, 0.0))
    }

    /// One of each kind, with numbers that a run may have, but for those of one kind.
    fn continuation(kind: usize, bad: f64) -> Continuation {
        let number = |this: usize| if this == kind { bad } else { 1.0 };
        let place = |this: usize| {
            if this == kind {
                pose(bad, 1.0)
            } else {
                pose(1.0, 1.0)
            }
        };
        let mut information = [1.0; 28];
        information[27] = number(0);
        Continuation {
            sessions: vec![RecordedSession {
                source: "a".into(),
                first_keyframe: 0,
            }],
            keyframes: vec![KeyframeLink {
                id: 0,
                parent: None,
                gain: number(1),
                bias: number(2),
            }],
            edges: vec![RecordedEdge {
                i: 0,
                j: 1,
                kind: 0,
                kernel: 0,
                kernel_parameter: number(3),
                i_from_j: place(4),
                information,
            }],
            points: vec![RecordedPoint {
                host: 0,
                pixel: [1.0, number(5)],
                idepth: [1.0, 1.0, number(6)],
                observations: vec![(1, [number(7), 1.0])],
            }],
            frames: vec![RecordedFrame {
                session: 0,
                frame_index: 0,
                timestamp_ns: 0,
                keyframe: 0,
                keyframe_from_frame: Se3::new(Rotation::identity(), Vec3::new(number(8), 0.0, 0.0)),
            }],
            fragments: vec![FragmentKeyframe {
                keyframe: 0,
                fragment: 1,
                fragment_from_keyframe: place(9),
            }],
        }
    }

    #[test]
    fn every_number_of_a_continuation_is_sane() {
        let check = |kind, bad| check_continuation(&continuation(kind, bad), 1);
        assert_eq!(check(99, 0.0), Ok(()));
        for kind in 0..10 {
            for bad in [f64::NAN, f64::INFINITY, -1e19] {
                assert!(check(kind, bad).is_err(), "{kind}, {bad}");
            }
            assert_eq!(check(kind, -1e7), Ok(()), "{kind}");
        }
    }

    #[test]
    fn poses_reach_as_far_as_a_country_and_no_farther() {
        let check = |x: f64, scale: f64| check_pose("a pose", &pose(x, scale)).is_ok();
        assert!(check(MAX_COORDINATE, MAX_SCALE) && check(-MAX_COORDINATE, MAX_SCALE.recip()));
        for (x, scale) in [(1.01e8, 1.0), (-1.01e8, 1.0), (0.0, 1.01e6), (0.0, 0.99e-6)] {
            assert!(!check(x, scale), "{x}, {scale}");
        }
    }

    #[test]
    fn sessions_without_keyframes_are_few() {
        let with = |count: usize, num_keyframes: usize| {
            let mut many = continuation(99, 0.0);
            many.sessions = vec![many.sessions[0].clone(); count];
            check_continuation(&many, num_keyframes).is_ok()
        };
        assert!(with(1000, 0) && with(1007, 7));
        assert!(!with(1001, 0) && !with(1008, 7));
    }

    #[test]
    fn times_are_those_of_a_century_and_records_grow_with_keyframes() {
        let limit = 1_i64 << 62;
        assert!(check_time(limit).is_ok() && check_time(-limit).is_ok());
        assert!(check_time(limit + 1).is_err() && check_time(i64::MIN).is_err());
        assert_eq!(record_limit(0), 1 << 20);
        assert_eq!(record_limit(2), (1 << 20) + (2 << 19));
        assert_eq!(record_limit(u64::MAX), 512 << 20);
    }
}
