//! Checks of a problem, and the orders in which the solver walks through it.

use super::{BundleConfig, BundleError, BundleProblem, PoseFreedom};

fn index(
    what: impl Fn() -> String,
    of: &'static str,
    index: usize,
    len: usize,
) -> Result<(), BundleError> {
    if index < len {
        return Ok(());
    }
    Err(BundleError::Index {
        what: what(),
        of,
        index,
        len,
    })
}

fn value(
    what: impl Fn() -> String,
    value: f64,
    is_valid: bool,
    expected: &'static str,
) -> Result<(), BundleError> {
    if is_valid && value.is_finite() {
        return Ok(());
    }
    Err(BundleError::Value {
        what: what(),
        value,
        expected,
    })
}

/// Checks every index and number, so that the solver need not.
pub(super) fn validate(problem: &BundleProblem, config: &BundleConfig) -> Result<(), BundleError> {
    validate_config(config)?;
    let p = &problem.pinhole;
    value(
        || "focal length fx".into(),
        p.fx,
        p.fx > 0.0,
        "a positive number of pixels",
    )?;
    value(
        || "focal length fy".into(),
        p.fy,
        p.fy > 0.0,
        "a positive number of pixels",
    )?;
    let centre = p.cx + p.cy;
    value(
        || "principal point (cx + cy)".into(),
        centre,
        true,
        "finite",
    )?;
    validate_keyframes(problem)?;
    validate_points(problem)?;
    validate_observations(problem)
}

fn validate_points(problem: &BundleProblem) -> Result<(), BundleError> {
    for (i, point) in problem.points.iter().enumerate() {
        let host = point.host;
        index(
            || format!("the host of point {i}"),
            "keyframe",
            host,
            problem.keyframes.len(),
        )?;
        let sum = point.pixel.sum();
        value(
            || format!("pixel of point {i} (x + y)"),
            sum,
            true,
            "finite",
        )?;
        let d = point.inverse_depth;
        value(
            || format!("inverse depth of point {i}"),
            d,
            d > 0.0,
            "positive",
        )?;
        if let Some(prior) = point.prior {
            value(
                || format!("prior inverse depth of point {i}"),
                prior.mean,
                true,
                "finite",
            )?;
            let sigma = prior.sigma;
            value(
                || format!("prior sigma of point {i}"),
                sigma,
                sigma > 0.0,
                "positive",
            )?;
        }
    }
    Ok(())
}

fn validate_observations(problem: &BundleProblem) -> Result<(), BundleError> {
    let (keyframes, points) = (problem.keyframes.len(), problem.points.len());
    for (i, o) in problem.observations.iter().enumerate() {
        let name = || format!("observation {i}");
        index(name, "keyframe", o.keyframe, keyframes)?;
        index(name, "point", o.point, points)?;
        let sum = o.pixel.sum();
        value(
            || format!("pixel of observation {i} (x + y)"),
            sum,
            true,
            "finite",
        )?;
        let weight = o.inv_sigma_px;
        value(
            || format!("inverse sigma of observation {i}"),
            weight,
            weight > 0.0,
            "positive",
        )?;
    }
    Ok(())
}

fn validate_config(config: &BundleConfig) -> Result<(), BundleError> {
    let threshold = config.kernel.cost(1.0);
    let kernel = config.kernel.is_valid();
    value(
        || "kernel threshold".into(),
        threshold,
        kernel,
        "a positive threshold",
    )?;
    let damping = config.initial_damping;
    value(
        || "initial_damping".into(),
        damping,
        damping > 0.0,
        "positive",
    )?;
    let gate = config.inlier_chi2;
    value(|| "inlier_chi2".into(), gate, gate > 0.0, "positive")?;
    let (low, high) = config.inverse_depth_range;
    value(|| "lower inverse depth".into(), low, low > 0.0, "positive")?;
    value(
        || "upper inverse depth".into(),
        high,
        high > low,
        "above the lower bound",
    )
}

fn validate_keyframes(problem: &BundleProblem) -> Result<(), BundleError> {
    let len = problem.keyframes.len();
    for (i, keyframe) in problem.keyframes.iter().enumerate() {
        let pose = &keyframe.camera_from_world;
        let sum = pose.translation.sum() + pose.rotation.coords.sum();
        value(
            || format!("pose of keyframe {i} (sum of its numbers)"),
            sum,
            pose.is_finite(),
            "finite",
        )?;
        if let PoseFreedom::FixedDistance { to } = keyframe.freedom {
            index(
                || format!("the distance of keyframe {i}"),
                "keyframe",
                to,
                len,
            )?;
            let reference = &problem.keyframes[to];
            let distance = (reference.camera_from_world.inverse().translation
                - pose.inverse().translation)
                .norm();
            if to == i || reference.freedom != PoseFreedom::Fixed || distance <= 1e-12 {
                return Err(BundleError::Distance { keyframe: i, to });
            }
        }
    }
    Ok(())
}

/// Marks an anchor observation in [`Layout::pair_of_observation`].
pub(super) const NO_PAIR: usize = usize::MAX;

/// How the parts of a problem hang together; computed once.
#[derive(Debug)]
pub(super) struct Layout {
    /// Per keyframe its place among the free ones.
    pub slot_of_keyframe: Vec<Option<usize>>,
    /// Free keyframes, in order.
    pub free_keyframes: Vec<usize>,
    /// Distinct pairs (host, observer), sorted.
    pub pairs: Vec<(usize, usize)>,
    /// Per observation its pair, or [`NO_PAIR`] when the host observes itself.
    pub pair_of_observation: Vec<usize>,
    /// Observations sorted by point (stable).
    pub by_point: Vec<usize>,
    /// Where each point's observations start in `by_point`; one more than there are points.
    pub point_starts: Vec<usize>,
}

impl Layout {
    pub(super) fn new(problem: &BundleProblem) -> Self {
        let mut slot_of_keyframe = vec![None; problem.keyframes.len()];
        let mut free_keyframes = vec![];
        for (i, keyframe) in problem.keyframes.iter().enumerate() {
            if keyframe.freedom != PoseFreedom::Fixed {
                slot_of_keyframe[i] = Some(free_keyframes.len());
                free_keyframes.push(i);
            }
        }
        let observations = &problem.observations;
        let pair = |o: &super::Observation| (problem.points[o.point].host, o.keyframe);
        let mut pairs: Vec<_> = observations
            .iter()
            .map(pair)
            .filter(|(h, k)| h != k)
            .collect();
        pairs.sort_unstable();
        pairs.dedup();
        let find = |o| pairs.binary_search(&pair(o)).unwrap_or(NO_PAIR);
        let pair_of_observation = observations.iter().map(find).collect();
        let mut point_starts = vec![0; problem.points.len() + 1];
        for o in observations {
            point_starts[o.point + 1] += 1;
        }
        for i in 1..point_starts.len() {
            point_starts[i] += point_starts[i - 1];
        }
        let mut next = point_starts.clone();
        let mut by_point = vec![0; observations.len()];
        for (i, o) in observations.iter().enumerate() {
            by_point[next[o.point]] = i;
            next[o.point] += 1;
        }
        Self {
            slot_of_keyframe,
            free_keyframes,
            pairs,
            pair_of_observation,
            by_point,
            point_starts,
        }
    }
}
