//! What is to be explained, what explains it, and the way from a first guess to the best
//! explanation.

use super::band::{Block, Solved, System};
use super::measurements::Sum;
use super::types::{EstimateConfig, Fix, Motion, NotDetermined, Observation};
use crate::{Bias, Imu, ImuNoise, Preintegrated};
use monogrid_geometry::{Mat3, Rotation, Se3, Sim3, Vec3, rotation_exp, rotation_log};

/// Shortest path with inertial readings that is used, s.
const MIN_SECS: f64 = 2.0;

/// Rows of a state: orientation, velocity, position, bias of gyroscope and accelerometer.
pub(super) const TURN: usize = 0;
pub(super) const VELOCITY: usize = 3;
pub(super) const POSITION: usize = 6;
pub(super) const BIAS: usize = 9;
/// Global numbers: two of gravity, the scale of the first part, and rotation, translation and scale
/// of each other.
pub(super) const GRAVITY: usize = 0;
const FIRST_SCALE: usize = 2;
pub(super) const OTHER_PARTS: usize = 3;
pub(super) const OTHER_PART: usize = 7;

/// What is to be explained.
pub(super) struct Problem {
    pub observations: Vec<Observation>,
    /// Between a frame and the next one; `None` where readings are missing.
    pub between: Vec<Option<Preintegrated>>,
    pub imu_from_camera: Se3,
    pub num_parts: usize,
    /// Standard deviation of positions of the path, in the unit of their part.
    pub position_sigma: f64,
    /// Of its orientations, rad.
    pub rotation_sigma: f64,
    /// What positions are known to at best: a share of the extent of the path.
    pub least_position_sigma: f64,
    pub noise: ImuNoise,
    pub bias_sigma: [f64; 2],
}

/// What explains it.
#[derive(Clone, Debug)]
pub(super) struct States {
    /// `world_from_imu` as rotation, velocity (m/s) and position (m).
    pub frames: Vec<Motion>,
    pub biases: Vec<Bias>,
    /// Unit vector along which gravity pulls.
    pub down: Vec3,
    pub parts: Vec<Sim3>,
}

impl Problem {
    /// The frames with readings between them.
    pub(super) fn new(
        imu: &Imu,
        observations: Vec<Observation>,
        config: &EstimateConfig,
    ) -> Result<Self, NotDetermined> {
        let (observations, between) = connected(imu, observations);
        let seen_secs = observations
            .windows(2)
            .zip(&between)
            .filter(|(pair, _)| pair.iter().all(|o| o.seen.is_some()));
        let found: f64 = seen_secs
            .filter_map(|(_, between)| Some(between.as_ref()?.secs))
            .sum();
        if found < MIN_SECS {
            return Err(NotDetermined::TooShort {
                found,
                needed: MIN_SECS,
            });
        }
        let parts = observations.iter().filter_map(|o| Some(o.seen?.0 + 1));
        let places = observations
            .iter()
            .filter_map(|o| Some(o.seen?.1.translation));
        Ok(Self {
            num_parts: parts.max().unwrap_or(0),
            least_position_sigma: LEAST_SHARE * extent(&places.collect::<Vec<Vec3>>()),
            observations,
            between,
            imu_from_camera: imu.imu_from_camera,
            position_sigma: f64::NAN,
            rotation_sigma: f64::NAN,
            noise: imu.noise,
            bias_sigma: [config.gyroscope_bias_sigma, config.accelerometer_bias_sigma],
        })
    }

    /// Preintegrates again with the biases of now.
    pub(super) fn integrate(&mut self, imu: &Imu, states: &States) {
        let times = self.observations.windows(2);
        self.between = times
            .zip(&states.biases)
            .map(|(pair, bias)| {
                Preintegrated::between(imu, pair[0].timestamp_ns, pair[1].timestamp_ns, bias)
            })
            .collect();
    }

    pub(super) fn num_globals(&self) -> usize {
        OTHER_PARTS + OTHER_PART * (self.num_parts - 1)
    }

    /// Where the scale of a part stands among the global numbers.
    pub(super) fn scale_column(&self, part: usize) -> usize {
        match part.checked_sub(1) {
            None => FIRST_SCALE,
            Some(other) => OTHER_PARTS + OTHER_PART * other + 6,
        }
    }

    /// Levenberg and Marquardt's method; the solution at the minimum.
    pub(super) fn minimise(
        &self,
        states: &mut States,
        max_steps: usize,
    ) -> Result<Solved, NotDetermined> {
        /// Share of the cost below which a gain ends it.
        const MIN_GAIN: f64 = 1e-6;
        let (mut system, mut cost) = self.linearise(states);
        let mut damping = 1e-6;
        for _ in 0..max_steps {
            let solved = system.solve(damping).ok_or(NotDetermined::Singular)?;
            let moved = self.moved(states, &solved);
            let (next, next_cost) = self.linearise(&moved);
            if next_cost.is_finite() && next_cost <= cost {
                let gain = cost - next_cost;
                (*states, system) = (moved, next);
                damping = f64::max(damping * 0.1, 1e-9);
                let is_minimum = gain <= MIN_GAIN * cost;
                cost = next_cost;
                if is_minimum {
                    break;
                }
            } else {
                damping *= 30.0;
            }
        }
        system.solve(0.0).ok_or(NotDetermined::Singular)
    }

    /// All residuals around the states.
    fn linearise(&self, states: &States) -> (System, f64) {
        let mut sum = Sum {
            system: System::new(self.observations.len(), self.num_globals()),
            cost: 0.0,
        };
        for k in 0..self.observations.len() {
            if let Some((part, pose)) = self.observations[k].seen {
                self.add_view(&mut sum, states, k, (part, &pose));
            }
            // without readings the next frame begins anew, with nothing known of its motion
            if let Some(Some(between)) = self.between.get(k) {
                self.add_readings(&mut sum, states, k, between);
            }
            if k == 0 || self.between[k - 1].is_none() {
                self.add_start(&mut sum, states, k);
            }
        }
        (sum.system, sum.cost)
    }

    /// Errors of a view: rotation (rad), and position in the unit of its part.
    pub(super) fn view_errors(
        &self,
        states: &States,
        k: usize,
        (part, seen): (usize, &Se3),
    ) -> (Vec3, Vec3) {
        let (rotation, _, position) = states.frames[k];
        let metric_from_part = &states.parts[part];
        let part_from_imu = seen.rotation * self.imu_from_camera.rotation.inverse();
        let turn = rotation_log(
            &(part_from_imu.inverse() * metric_from_part.rotation.inverse() * rotation),
        );
        let camera = position + rotation * self.imu_from_camera.translation;
        (turn, metric_from_part.inverse() * camera - seen.translation)
    }

    /// The states after a step.
    fn moved(&self, states: &States, solved: &Solved) -> States {
        let mut moved = states.clone();
        for (k, step) in solved.states.iter().enumerate() {
            let part = |row: usize| step.fixed_rows::<3>(row).into_owned();
            let (rotation, velocity, position) = &mut moved.frames[k];
            *rotation =
                Rotation::new_normalize((*rotation * rotation_exp(&part(TURN))).into_inner());
            *velocity += part(VELOCITY);
            *position += part(POSITION);
            moved.biases[k].gyroscope += part(BIAS);
            moved.biases[k].accelerometer += part(BIAS + 3);
        }
        let [a, b] = tangents(&states.down);
        moved.down = (states.down + a * solved.globals[GRAVITY] + b * solved.globals[GRAVITY + 1])
            .normalize();
        for (part, place) in moved.parts.iter_mut().enumerate() {
            // a step of the scale by more than half says that it is not linear there
            place.scale *= solved.globals[self.scale_column(part)]
                .clamp(-0.7, 0.7)
                .exp();
            if let Some(other) = part.checked_sub(1) {
                let column = OTHER_PARTS + OTHER_PART * other;
                let step = |row: usize| Vec3::from(solved.globals.fixed_rows::<3>(column + row));
                place.rotation =
                    Rotation::new_normalize((place.rotation * rotation_exp(&step(0))).into_inner());
                place.translation += step(3);
            }
        }
        moved
    }

    /// What is known of every frame at the end.
    pub(super) fn fixes(&self, states: &States, solved: &Solved) -> Vec<Fix> {
        let frames = states
            .frames
            .iter()
            .zip(&states.biases)
            .zip(solved.covariances());
        let fix = |(observation, ((motion, bias), covariance)): (
            &Observation,
            ((&Motion, &Bias), Block),
        )| {
            let (rotation, velocity, position) = *motion;
            let sigma = |row: usize| {
                let block: Mat3 = covariance.fixed_view::<3, 3>(row, row).into_owned();
                block.symmetric_eigenvalues().max().max(0.0).sqrt()
            };
            Fix {
                timestamp_ns: observation.timestamp_ns,
                world_from_camera: Se3::new(rotation, position) * self.imu_from_camera,
                velocity,
                position_sigma_m: sigma(POSITION),
                rotation_sigma_rad: sigma(TURN),
                bias: *bias,
            }
        };
        self.observations.iter().zip(frames).map(fix).collect()
    }

    /// Longest distance between the last frame of a part and the first of another, m.
    pub(super) fn way_between_parts(&self, states: &States) -> f64 {
        let seen = self.observations.iter().zip(&states.frames);
        let seen = seen.filter_map(|(o, frame)| Some((o.seen?.0, frame.2)));
        let seen: Vec<(usize, Vec3)> = seen.collect();
        let changes = seen.windows(2).filter(|pair| pair[0].0 != pair[1].0);
        let ways = changes.map(|pair| (pair[1].1 - pair[0].1).norm());
        ways.fold(0.0, f64::max)
    }

    /// Root mean square of the acceleration, m/s².
    pub(super) fn excitation(&self, states: &States) -> f64 {
        let accelerations = self.between.iter().enumerate().filter_map(|(k, between)| {
            let secs = between.as_ref()?.secs;
            Some((states.frames[k + 1].1 - states.frames[k].1) / secs)
        });
        let squares: Vec<f64> = accelerations.map(|a| a.norm_squared()).collect();
        (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt()
    }
}

/// The observations with the readings between each and the next; one that neither the camera nor
/// the sensor knows is left out.
fn connected(
    imu: &Imu,
    observations: Vec<Observation>,
) -> (Vec<Observation>, Vec<Option<Preintegrated>>) {
    let mut kept: Vec<Observation> = Vec::with_capacity(observations.len());
    let mut between = Vec::with_capacity(observations.len());
    for observation in observations {
        if let Some(last) = kept.last() {
            let (from, to) = (last.timestamp_ns, observation.timestamp_ns);
            let readings = Preintegrated::between(imu, from, to, &Bias::default());
            if readings.is_none() && observation.seen.is_none() {
                continue;
            }
            between.push(readings);
        }
        kept.push(observation);
    }
    (kept, between)
}

/// Share of its extent to which a path is known at best.
const LEAST_SHARE: f64 = 1e-4;

/// Root mean square distance from the middle.
fn extent(places: &[Vec3]) -> f64 {
    let count = places.len().max(1) as f64;
    let middle = places.iter().sum::<Vec3>() / count;
    let squares = places.iter().map(|place| (place - middle).norm_squared());
    let squares: f64 = squares.sum();
    (squares / count).sqrt()
}

/// Two unit vectors at right angles to a direction and to each other.
pub(super) fn tangents(direction: &Vec3) -> [Vec3; 2] {
    let axis = if direction.x.abs() < 0.7 {
        Vec3::x()
    } else {
        Vec3::y()
    };
    let first = direction.cross(&axis).normalize();
    [first, direction.cross(&first)]
}
