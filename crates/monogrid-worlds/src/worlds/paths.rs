//! The built-in camera motions of each world.

use super::{stairs, street};
use crate::path::{CameraPath, Carrier, PathError, Waypoint};

/// Sideways along the sofa first, then round the room and back to where it began.
pub(super) const LIVING_ROOM: [Waypoint; 42] = [
    ([3.60, 1.50, 1.40], [2.40, 4.60, 0.70]),
    ([3.10, 1.40, 1.42], [2.30, 4.60, 0.75]),
    ([2.60, 1.32, 1.38], [2.20, 4.60, 0.80]),
    ([2.10, 1.36, 1.35], [2.10, 4.70, 0.80]),
    ([1.70, 1.60, 1.38], [2.00, 4.80, 0.90]),
    ([1.48, 2.00, 1.42], [2.20, 4.80, 0.95]),
    ([1.55, 2.45, 1.45], [3.00, 4.80, 0.90]),
    ([1.80, 2.80, 1.42], [4.40, 4.70, 0.90]),
    ([2.20, 2.90, 1.36], [5.50, 4.30, 0.85]),
    ([2.60, 2.80, 1.34], [5.80, 3.50, 0.85]),
    ([2.95, 2.45, 1.38], [5.80, 2.60, 0.90]),
    ([3.05, 2.00, 1.42], [5.90, 2.00, 1.00]),
    ([2.85, 1.65, 1.45], [5.90, 2.10, 1.05]),
    ([2.60, 1.95, 1.42], [5.80, 2.90, 1.00]),
    ([2.75, 2.45, 1.38], [5.60, 3.90, 0.95]),
    ([3.10, 2.90, 1.36], [5.00, 4.70, 0.95]),
    ([3.40, 2.80, 1.38], [3.90, 4.90, 0.95]),
    ([3.50, 2.45, 1.42], [2.80, 4.80, 0.90]),
    ([3.60, 2.25, 1.45], [1.50, 4.40, 0.85]),
    ([3.80, 2.50, 1.44], [0.50, 3.50, 0.95]),
    ([3.85, 2.95, 1.40], [0.30, 2.60, 1.05]),
    ([3.70, 3.35, 1.38], [0.40, 1.80, 1.00]),
    ([3.35, 3.60, 1.40], [0.80, 0.90, 0.90]),
    ([2.95, 3.70, 1.44], [1.50, 0.30, 0.85]),
    ([2.60, 3.60, 1.46], [2.30, 0.20, 0.85]),
    ([2.75, 3.30, 1.42], [3.20, 0.20, 0.95]),
    ([3.10, 3.10, 1.38], [4.00, 0.20, 1.05]),
    ([3.20, 2.85, 1.36], [3.50, 0.20, 1.00]),
    ([2.90, 2.75, 1.40], [2.40, 0.20, 0.90]),
    ([2.60, 2.90, 1.44], [1.20, 0.50, 0.85]),
    ([2.75, 2.90, 1.44], [0.50, 1.40, 0.95]),
    ([3.05, 2.60, 1.40], [0.30, 2.50, 1.00]),
    ([3.20, 2.20, 1.38], [0.70, 3.60, 0.90]),
    ([3.20, 1.80, 1.40], [1.50, 4.50, 0.80]),
    ([3.35, 1.50, 1.42], [2.30, 4.60, 0.75]),
    ([3.60, 1.45, 1.40], [2.60, 4.60, 0.70]),
    ([3.40, 1.75, 1.38], [3.20, 4.70, 0.80]),
    ([3.00, 2.15, 1.40], [4.20, 4.70, 0.90]),
    ([2.85, 2.50, 1.44], [5.00, 4.40, 0.90]),
    ([3.05, 2.40, 1.42], [4.20, 4.70, 0.90]),
    ([3.35, 2.00, 1.38], [3.20, 4.70, 0.85]),
    ([3.50, 1.60, 1.40], [2.60, 4.60, 0.75]),
];

/// Along the desks, round the meeting table, and back.
const OFFICE: [Waypoint; 30] = [
    ([4.6, 2.0, 1.5], [1.2, 4.4, 0.9]),
    ([4.3, 1.7, 1.5], [1.0, 4.0, 0.9]),
    ([3.9, 1.5, 1.5], [0.9, 3.6, 1.0]),
    ([3.4, 1.4, 1.5], [0.8, 4.0, 1.0]),
    ([2.9, 1.5, 1.5], [0.9, 5.0, 1.0]),
    ([2.5, 1.9, 1.5], [1.2, 6.4, 1.0]),
    ([2.3, 2.5, 1.5], [2.0, 7.8, 1.0]),
    ([2.2, 3.1, 1.5], [2.8, 7.9, 1.1]),
    ([2.2, 3.8, 1.5], [3.8, 7.9, 1.1]),
    ([2.3, 4.4, 1.5], [5.0, 7.8, 1.1]),
    ([2.6, 4.9, 1.5], [6.4, 7.2, 1.0]),
    ([3.1, 5.1, 1.5], [6.9, 5.9, 1.1]),
    ([3.6, 5.0, 1.5], [6.9, 4.6, 1.1]),
    ([3.9, 4.7, 1.5], [6.9, 3.4, 1.1]),
    ([4.1, 4.3, 1.5], [6.8, 2.2, 1.1]),
    ([4.2, 4.7, 1.5], [6.4, 0.8, 1.0]),
    ([4.0, 5.1, 1.5], [5.2, 0.3, 1.1]),
    ([3.5, 5.4, 1.5], [4.0, 0.2, 1.1]),
    ([3.0, 5.5, 1.5], [3.0, 0.2, 1.1]),
    ([2.6, 5.3, 1.5], [2.0, 0.2, 1.1]),
    ([2.5, 4.9, 1.5], [1.0, 0.6, 1.1]),
    ([2.7, 4.6, 1.5], [0.3, 2.0, 1.2]),
    ([3.1, 4.6, 1.5], [0.2, 3.4, 1.2]),
    ([3.6, 4.7, 1.5], [0.3, 4.8, 1.1]),
    ([4.1, 4.5, 1.5], [0.5, 5.4, 1.0]),
    ([4.5, 4.0, 1.5], [0.8, 5.4, 1.0]),
    ([4.7, 3.4, 1.5], [1.0, 5.0, 0.9]),
    ([4.7, 2.8, 1.5], [1.1, 4.6, 0.9]),
    ([4.7, 2.3, 1.5], [1.2, 4.4, 0.9]),
    ([4.5, 1.9, 1.5], [1.2, 4.3, 0.9]),
];

/// Once round the hall at two heights, looking across it.
const MACHINE_HALL: [Waypoint; 26] = [
    ([12.0, 3.5, 1.8], [14.0, 12.0, 1.6]),
    ([14.0, 3.3, 1.8], [15.5, 12.0, 1.8]),
    ([16.5, 3.4, 1.9], [18.0, 13.0, 2.0]),
    ([19.0, 3.8, 2.2], [21.0, 14.0, 2.2]),
    ([21.5, 4.8, 2.6], [24.0, 14.0, 2.4]),
    ([24.0, 6.3, 3.0], [25.0, 16.0, 2.4]),
    ([25.6, 8.5, 3.2], [22.5, 18.5, 2.2]),
    ([26.0, 11.0, 3.2], [20.0, 20.0, 2.0]),
    ([25.6, 13.5, 3.0], [18.0, 22.0, 2.2]),
    ([25.0, 16.0, 2.8], [14.0, 24.0, 2.4]),
    ([24.2, 18.3, 2.6], [11.0, 24.0, 2.6]),
    ([22.0, 22.8, 2.6], [8.0, 24.5, 2.6]),
    ([19.5, 23.6, 2.6], [6.0, 23.0, 2.4]),
    ([17.0, 23.8, 2.6], [4.5, 20.5, 2.2]),
    ([14.5, 23.6, 2.6], [4.0, 17.0, 2.0]),
    ([12.2, 22.6, 2.5], [4.0, 13.0, 2.0]),
    ([11.4, 20.8, 2.4], [5.0, 9.5, 2.0]),
    ([11.6, 18.0, 2.4], [6.5, 7.0, 1.8]),
    ([8.5, 15.6, 2.3], [8.0, 6.0, 1.8]),
    ([6.6, 13.4, 2.2], [9.5, 6.0, 1.8]),
    ([5.2, 11.0, 2.0], [11.5, 6.5, 1.8]),
    ([4.2, 8.6, 1.9], [13.0, 8.0, 1.7]),
    ([4.4, 6.2, 1.8], [14.0, 9.5, 1.7]),
    ([6.2, 4.5, 1.8], [14.2, 11.0, 1.7]),
    ([9.0, 3.7, 1.8], [14.2, 11.8, 1.7]),
    ([12.2, 3.5, 1.8], [14.2, 12.0, 1.6]),
];

/// Waypoints along the middle line of the corridor, looking ahead and a little to the side where
/// there is something to see, once round and a bit further.
fn corridor_loop() -> Vec<Waypoint> {
    let corners = [[1.0, 1.0], [19.0, 1.0], [19.0, 15.0], [1.0, 15.0]];
    let lengths = [18.0, 14.0, 18.0, 14.0];
    let perimeter: f64 = lengths.iter().sum();
    // corners are cut by a quarter circle: blend of the points half a metre before and after
    let on_line = |distance: f64| -> [f64; 2] {
        let mut rest = distance.rem_euclid(perimeter);
        for k in 0..4 {
            if rest <= lengths[k] {
                let (a, b): ([f64; 2], [f64; 2]) = (corners[k], corners[(k + 1) % 4]);
                let f = rest / lengths[k];
                return [a[0] + f * (b[0] - a[0]), a[1] + f * (b[1] - a[1])];
            }
            rest -= lengths[k];
        }
        corners[0]
    };
    let step = 1.0;
    let count = ((perimeter + 6.0) / step) as usize;
    (0..=count)
        .map(|k| {
            let distance = 3.0 + step * k as f64;
            let eye = on_line(distance);
            let ahead = on_line(distance + 3.2);
            let sway = 0.25 * (0.7 * k as f64).sin();
            // towards the outer wall, where doors and rooms are, and back
            let out = 0.55 * (0.35 * k as f64).sin();
            let middle = [10.0, 8.0];
            let push = |p: [f64; 2], by: f64| -> [f64; 2] {
                let d = [p[0] - middle[0], p[1] - middle[1]];
                let n = (d[0] * d[0] + d[1] * d[1]).sqrt().max(1e-9);
                [p[0] + by * d[0] / n, p[1] + by * d[1] / n]
            };
            let (e, a) = (push(eye, sway), push(ahead, out));
            ([e[0], e[1], 1.45], [a[0], a[1], 1.30])
        })
        .collect()
}

/// How the camera moves through a built-in world.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Motion {
    /// Who carries it.
    pub carrier: Carrier,
    /// The same way from its end to its beginning.
    pub is_reversed: bool,
}

/// Names of the built-in motions.
pub const MOTION_NAMES: [&str; 6] = [
    "hand",
    "drone",
    "car",
    "hand-back",
    "drone-back",
    "car-back",
];

impl Motion {
    /// One of [`MOTION_NAMES`].
    #[must_use]
    pub fn by_name(name: &str) -> Option<Self> {
        let (base, is_reversed) = match name.strip_suffix("-back") {
            Some(base) => (base, true),
            None => (name, false),
        };
        let carrier = match base {
            "hand" => Carrier::Hand,
            "drone" => Carrier::Drone,
            "car" => Carrier::Car,
            _ => return None,
        };
        Some(Self {
            carrier,
            is_reversed,
        })
    }
}

impl From<Carrier> for Motion {
    fn from(carrier: Carrier) -> Self {
        Self {
            carrier,
            is_reversed: false,
        }
    }
}

/// Frames at 30 per second in which a built-in motion goes at a walking pace, or at that of a car
/// in a town.
#[must_use]
pub fn usual_frames(world: &str) -> usize {
    match world {
        "corridor-loop" => 3000,
        "machine-hall" | "stairs" => 2400,
        "street" => 600,
        _ => 1500,
    }
}

/// The motion of a built-in world, stretched to a duration.
pub(crate) fn path_of(
    world: &str,
    motion: Motion,
    duration_secs: f64,
    seed: u64,
) -> Result<CameraPath, PathError> {
    let mut waypoints: Vec<Waypoint> = match world {
        "office" => OFFICE.to_vec(),
        "machine-hall" => MACHINE_HALL.to_vec(),
        "corridor-loop" => corridor_loop(),
        "stairs" => stairs::way(),
        "street" => street::way(),
        _ => LIVING_ROOM.to_vec(),
    };
    if motion.is_reversed {
        waypoints.reverse();
    }
    if motion.carrier == Carrier::Drone {
        // a drone also climbs and sinks
        for (k, (eye, _)) in waypoints.iter_mut().enumerate() {
            let is_above_steps = world == "stairs";
            let height_m = if is_above_steps {
                stairs::EYE_M
            } else {
                eye[2]
            };
            eye[2] += 0.15 * height_m * (0.9 * k as f64).sin();
        }
    }
    let path = CameraPath::scripted(&waypoints, motion.carrier, duration_secs, seed)?;
    Ok(match motion.is_reversed {
        true => path.played_backwards(),
        false => path,
    })
}
