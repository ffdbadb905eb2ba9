//! What a path that a camera found, without scale, and the readings of an inertial sensor say
//! together.
//!
//! Maximum a posteriori over orientation, velocity, position and biases of the sensor at every
//! frame, the scale of the path and the direction of gravity: readings are preintegrated between
//! frames (`[FORSTER17]`), and every pose of the camera counts as a measurement. As in the
//! initialisation of `[CAMPOS20]` poses are taken as given but for their scale; unlike there each
//! has an error of its own, since an error of positions that explain accelerations makes the scale
//! too small. How large these errors are is found from what is left of them.
//!
//! A path may have parts, each with its own place and unit, with nothing seen between them: the
//! readings say where they lie.

mod band;
mod begin;
mod measurements;
mod noise;
mod problem;
mod scatter;
mod types;

pub use types::{Estimate, EstimateConfig, Fix, NotDetermined, Observation, PartPlace};

use crate::Imu;
use problem::{Problem, States};
use scatter::Scatter;

/// Frames with a pose that are used at most, evenly chosen.
const MAX_FRAMES: usize = 2000;

/// The estimate; `observations` are in the order of time.
///
/// # Errors
/// When the path is too short, or the readings do not explain it. A scale or a gravity that is less
/// sure than was asked for is no error: see [`Estimate::is_scale_determined`].
pub fn estimate(
    imu: &Imu,
    observations: &[Observation],
    config: &EstimateConfig,
) -> Result<Estimate, NotDetermined> {
    let chosen = chosen(observations, MAX_FRAMES);
    let mut problem = Problem::new(imu, chosen, config)?;
    let mut states = begin::begin(&mut problem, imu)?;
    for _ in 0..ROUNDS_OF_NOISE {
        problem.integrate(imu, &states);
        problem.minimise(&mut states, STEPS_OF_ROUND)?;
        noise::update(&mut problem, &states);
    }
    problem.integrate(imu, &states);
    let solved = problem.minimise(&mut states, MAX_STEPS)?;
    let scatter = scatter::scatter(&mut problem, &states);
    conclude(&problem, &states, (&solved, &scatter), config)
}

/// Times that the errors of the path are found from what is left of them.
const ROUNDS_OF_NOISE: usize = 4;
/// Steps of the minimisation in each of these rounds, and at the end.
const STEPS_OF_ROUND: usize = 4;
const MAX_STEPS: usize = 25;

/// Every n-th frame with a pose, and those without one for a while after the last of these.
fn chosen(observations: &[Observation], max_frames: usize) -> Vec<Observation> {
    let num_seen = observations.iter().filter(|o| o.seen.is_some()).count();
    let every = num_seen.div_ceil(max_frames.max(2)).max(1);
    let (mut count, mut last_ns) = (0, None);
    let is_chosen = |observation: &&Observation| {
        if observation.seen.is_none() {
            return last_ns.is_some_and(|last| observation.timestamp_ns - last <= BLIND_NS);
        }
        last_ns = Some(observation.timestamp_ns);
        count += 1;
        (count - 1) % every == 0
    };
    observations.iter().filter(is_chosen).copied().collect()
}

/// Time without a pose after which nothing is said of where the camera is, ns.
const BLIND_NS: i64 = 5_000_000_000;

fn conclude(
    problem: &Problem,
    states: &States,
    (solved, scatter): (&band::Solved, &Scatter),
    config: &EstimateConfig,
) -> Result<Estimate, NotDetermined> {
    let covariance = &solved.global_covariance;
    let gravity = covariance[(0, 0)] + covariance[(1, 1)];
    let gravity_sigma_rad = gravity.max(scatter.gravity).sqrt();
    let parts: Vec<PartPlace> = states
        .parts
        .iter()
        .enumerate()
        .map(|(part, place)| {
            let column = problem.scale_column(part);
            // translation and rotation stand before the scale
            let sigma = |before: usize| {
                let block = covariance.fixed_view::<3, 3>(column - before, column - before);
                block.symmetric_eigenvalues().max().max(0.0).sqrt()
            };
            PartPlace {
                metric_from_part: *place,
                scale_sigma: covariance[(column, column)]
                    .max(scatter.scales[part])
                    .sqrt(),
                position_sigma_m: if part > 0 { sigma(3) } else { 0.0 },
                rotation_sigma_rad: if part > 0 { sigma(6) } else { 0.0 },
            }
        })
        .collect();
    let fixes = problem.fixes(states, solved);
    let is_known = |sigma: f64| sigma.is_finite();
    if !is_known(gravity_sigma_rad) || !parts.iter().all(|part| is_known(part.scale_sigma)) {
        return Err(NotDetermined::Singular);
    }
    let way_between_parts_m = problem.way_between_parts(states);
    Ok(Estimate {
        way_between_parts_m,
        is_scale_determined: parts[0].scale_sigma <= config.max_scale_sigma,
        is_gravity_determined: gravity_sigma_rad.to_degrees() <= config.max_gravity_sigma_deg,
        parts,
        down: states.down,
        gravity_sigma_rad,
        fixes,
        position_noise: problem.position_sigma,
        rotation_noise_rad: problem.rotation_sigma,
        excitation: problem.excitation(states),
    })
}
