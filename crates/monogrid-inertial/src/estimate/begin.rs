//! Where the estimate begins: in closed form, with the orientations that were seen.

use super::problem::{Problem, States};
use super::types::{Motion, NotDetermined};
use crate::{Bias, GRAVITY_M_S2, Imu, Preintegrated};
use monogrid_geometry::{Rotation, Se3, Sim3, Vec3, rotation_log};

/// Time between the three frames that show an acceleration, ns.
const SPACING_NS: i64 = 250_000_000;

/// Standard deviation of orientations before anything is known of it, rad.
const FIRST_ROTATION_SIGMA: f64 = 0.005;

/// Three frames of a part: what the camera saw of the acceleration, and what the sensor did.
struct Triple {
    /// Difference of the mean velocities of both halves, in units of the part per second.
    seen: Vec3,
    /// The same of the sensor against the camera, m/s.
    lever: Vec3,
    /// What the sensor measured of it, m/s; gravity is in it.
    measured: Vec3,
    /// Time between the middles of both halves, s.
    secs: f64,
}

/// First states, and the errors of the path as they look then.
pub(super) fn begin(problem: &mut Problem, imu: &Imu) -> Result<States, NotDetermined> {
    let bias = Bias {
        gyroscope: gyroscope_bias(problem),
        ..Bias::default()
    };
    let triples = triples(problem, imu, 0, &bias);
    let total: Vec3 = triples.iter().map(|t| t.measured).sum();
    let down = -total.try_normalize(1e-9).ok_or(NotDetermined::Singular)?;
    let unit = unit_of(&triples, &down)?;
    let mut parts = vec![Sim3::new(unit, Rotation::identity(), Vec3::zeros())];
    let mut frames = seen_frames(problem, 0, &parts[0]);
    for part in 1..problem.num_parts {
        let (place, moved) = place_of(problem, imu, part, &frames, (&down, &bias))?;
        parts.push(place);
        frames = merged(frames, moved);
    }
    problem.position_sigma = noise_of(&triples, &down, unit).max(problem.least_position_sigma);
    problem.rotation_sigma = FIRST_ROTATION_SIGMA;
    Ok(States {
        biases: vec![bias; frames.len()],
        frames: filled(problem, frames, &down, &bias),
        down,
        parts,
    })
}

/// Mean of what the sensor turned more than the camera, over the time.
fn gyroscope_bias(problem: &Problem) -> Vec3 {
    let mount = problem.imu_from_camera.rotation;
    let (mut turn, mut secs) = (Vec3::zeros(), 0.0);
    for (pair, between) in problem.observations.windows(2).zip(&problem.between) {
        let (Some((part, a)), Some((same, b)), Some(between)) =
            (pair[0].seen, pair[1].seen, between)
        else {
            continue;
        };
        if part == same {
            let seen = mount * (a.rotation.inverse() * b.rotation) * mount.inverse();
            turn += rotation_log(&(seen.inverse() * between.rotation));
            secs += between.secs;
        }
    }
    turn / f64::max(secs, 1e-9)
}

/// The accelerations of a part.
fn triples(problem: &Problem, imu: &Imu, part: usize, bias: &Bias) -> Vec<Triple> {
    let seen = seen_in(problem, part);
    let later = |from: usize| {
        let due = seen.get(from)?.0 + SPACING_NS;
        let found = from + seen[from..].partition_point(|(ns, _)| *ns < due);
        (found < seen.len()).then_some(found)
    };
    (0..seen.len())
        .filter_map(|a| {
            let b = later(a)?;
            let c = later(b)?;
            triple(problem, imu, [seen[a], seen[b], seen[c]], bias)
        })
        .collect()
}

fn seen_in(problem: &Problem, part: usize) -> Vec<(i64, Se3)> {
    let observations = problem.observations.iter();
    let seen = observations
        .filter_map(|o| Some((o.timestamp_ns, o.seen.filter(|seen| seen.0 == part)?.1)));
    seen.collect()
}

fn triple(problem: &Problem, imu: &Imu, frames: [(i64, Se3); 3], bias: &Bias) -> Option<Triple> {
    let [a, b, c] = frames;
    let first = Preintegrated::between(imu, a.0, b.0, bias)?;
    let second = Preintegrated::between(imu, b.0, c.0, bias)?;
    let difference = |of: &dyn Fn(&Se3) -> Vec3| {
        (of(&c.1) - of(&b.1)) / second.secs - (of(&b.1) - of(&a.1)) / first.secs
    };
    let camera_from_imu = problem.imu_from_camera.inverse();
    let imu_turn = |pose: &Se3| pose.rotation * camera_from_imu.rotation;
    let measured = imu_turn(&a.1) * (first.velocity - first.position / first.secs)
        + imu_turn(&b.1) * second.position / second.secs;
    Some(Triple {
        seen: difference(&|pose| pose.translation),
        lever: difference(&|pose| pose.rotation * camera_from_imu.translation),
        measured,
        secs: 0.5 * (first.secs + second.secs),
    })
}

impl Triple {
    /// What the camera should have seen, in metres per second.
    fn expected(&self, down: &Vec3) -> Vec3 {
        self.measured + down * (GRAVITY_M_S2 * self.secs) - self.lever
    }
}

/// Metres per unit of a part: what was seen is regressed on what was measured, whose errors are
/// small.
fn unit_of(triples: &[Triple], down: &Vec3) -> Result<f64, NotDetermined> {
    let sums = triples.iter().map(|triple| {
        let expected = triple.expected(down);
        (triple.seen.dot(&expected), expected.norm_squared())
    });
    let (both, measured) = sums.fold((0.0, 0.0), |sum, of| (sum.0 + of.0, sum.1 + of.1));
    let unit = measured / both;
    if !unit.is_finite() {
        return Err(NotDetermined::Singular);
    }
    let positive = Some(unit).filter(|unit| *unit > 0.0);
    positive.ok_or(NotDetermined::Contradiction)
}

/// Standard deviation of positions, in the unit of the path.
fn noise_of(triples: &[Triple], down: &Vec3, unit: f64) -> f64 {
    let square = |t: &Triple| ((t.seen - t.expected(down) / unit) * t.secs).norm_squared();
    let squares: f64 = triples.iter().map(square).sum();
    // a second difference has six times the variance of a position
    let variance = squares / (18.0 * triples.len().max(1) as f64);
    variance.sqrt().max(f64::MIN_POSITIVE)
}

/// States of the frames of a part as it lies; `None` for the others.
fn seen_frames(problem: &Problem, part: usize, metric_from_part: &Sim3) -> Vec<Option<Motion>> {
    let camera_from_imu = problem.imu_from_camera.inverse();
    let mut frames: Vec<Option<Motion>> = problem
        .observations
        .iter()
        .map(|o| {
            let (_, pose) = o.seen.filter(|seen| seen.0 == part)?;
            let rotation = metric_from_part.rotation * pose.rotation;
            let position =
                *metric_from_part * pose.translation + rotation * camera_from_imu.translation;
            Some((rotation * camera_from_imu.rotation, Vec3::zeros(), position))
        })
        .collect();
    for k in 0..frames.len() {
        let (before, after) = (k.saturating_sub(1), (k + 1).min(frames.len() - 1));
        let ends = [before, after].map(|end| {
            frames[end]
                .map(|frame| (end, frame.2))
                .or(frames[k].map(|frame| (k, frame.2)))
        });
        if let ([Some((from, a)), Some((to, b))], Some(frame)) = (ends, &mut frames[k]) {
            let ns =
                problem.observations[to].timestamp_ns - problem.observations[from].timestamp_ns;
            frame.1 = (b - a) / (ns as f64 * 1e-9).max(1e-9);
        }
    }
    frames
}

/// Where a part lies that nothing seen connects with the frames before it: where the readings lead,
/// with its own unit.
fn place_of(
    problem: &Problem,
    imu: &Imu,
    part: usize,
    known: &[Option<Motion>],
    (down, bias): (&Vec3, &Bias),
) -> Result<(Sim3, Vec<Option<Motion>>), NotDetermined> {
    let is_part = |k: &usize| {
        problem.observations[*k]
            .seen
            .is_some_and(|seen| seen.0 == part)
    };
    let first = (0..known.len())
        .find(is_part)
        .ok_or(NotDetermined::Singular)?;
    let last = (0..first)
        .rev()
        .find(|&k| known[k].is_some())
        .ok_or(NotDetermined::Singular)?;
    let start = known[last].ok_or(NotDetermined::Singular)?;
    let [from, to] = [last, first].map(|k| problem.observations[k].timestamp_ns);
    let between = Preintegrated::between(imu, from, to, bias).ok_or(NotDetermined::Singular)?;
    let (rotation, _, position) = between.predict(start, down, bias);
    let (_, seen) = problem.observations[first]
        .seen
        .ok_or(NotDetermined::Singular)?;
    let world_from_camera = Se3::new(rotation, position) * problem.imu_from_camera;
    let turn = world_from_camera.rotation * seen.rotation.inverse();
    // gravity as the part has it, which turns with it
    let unit = unit_of(&triples(problem, imu, part, bias), &(turn.inverse() * down))?;
    let translation = world_from_camera.translation - turn * seen.translation * unit;
    let place = Sim3::new(unit, turn, translation);
    let frames = seen_frames(problem, part, &place);
    Ok((place, frames))
}

fn merged(a: Vec<Option<Motion>>, b: Vec<Option<Motion>>) -> Vec<Option<Motion>> {
    a.into_iter().zip(b).map(|(a, b)| a.or(b)).collect()
}

/// States of all frames: those that nothing shows are where the readings lead from the one before.
fn filled(problem: &Problem, frames: Vec<Option<Motion>>, down: &Vec3, bias: &Bias) -> Vec<Motion> {
    let mut last: Motion = frames.iter().flatten().next().copied().unwrap_or((
        Rotation::identity(),
        Vec3::zeros(),
        Vec3::zeros(),
    ));
    let mut out = Vec::with_capacity(frames.len());
    for (k, frame) in frames.into_iter().enumerate() {
        let between = k
            .checked_sub(1)
            .and_then(|before| problem.between[before].as_ref());
        last = frame
            .unwrap_or_else(|| between.map_or(last, |between| between.predict(last, down, bias)));
        out.push(last);
    }
    out
}
