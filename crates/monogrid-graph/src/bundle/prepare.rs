//! Checks of a problem, and the orders in which the solver walks through it.

use super::shares::Shares;
use super::{BundleConfig, BundleError, BundleProblem, Observation, PoseFreedom};
use crate::blocks::BlockPattern;
use std::ops::Range;

/// The places of the blocks of the reduced system: of poses that share points, given as (point,
/// slot) by point.
fn pattern(entries: &[(u32, u32)], num_slots: usize) -> BlockPattern<6> {
    let n = num_slots;
    // what points make dependent, as a matrix of flags
    let mut is_there = vec![false; n * n];
    for fan in entries.chunk_by(|a, b| a.0 == b.0) {
        for (i, (_, column)) in fan.iter().enumerate() {
            for (_, row) in &fan[i + 1..] {
                is_there[*column as usize * n + *row as usize] = true;
            }
        }
    }
    let there = (0..n * n).filter(|at| is_there[*at]);
    let pairs: Vec<(usize, usize)> = there.map(|at| (at / n, at % n)).collect();
    BlockPattern::new(n, &pairs)
}

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

fn finite(what: impl Fn() -> String, number: f64) -> Result<(), BundleError> {
    value(what, number, true, "finite")
}

fn positive(what: impl Fn() -> String, number: f64) -> Result<(), BundleError> {
    value(what, number, number > 0.0, "positive")
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
    finite(|| "principal point (cx + cy)".into(), centre)?;
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
        finite(|| format!("pixel of point {i} (x + y)"), sum)?;
        let idepth = point.inverse_depth;
        positive(|| format!("inverse depth of point {i}"), idepth)?;
        if let Some(prior) = point.prior {
            let mean = prior.mean;
            finite(|| format!("prior inverse depth of point {i}"), mean)?;
            positive(|| format!("prior sigma of point {i}"), prior.sigma)?;
            let (threshold, is_valid) = (prior.kernel.cost(1.0), prior.kernel.is_valid());
            let what = || format!("threshold of the prior of point {i}");
            value(what, threshold, is_valid, "a positive threshold")?;
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
        finite(|| format!("pixel of observation {i} (x + y)"), sum)?;
        let weight = o.inv_sigma_px;
        positive(|| format!("inverse sigma of observation {i}"), weight)?;
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
    positive(|| "initial_damping".into(), config.initial_damping)?;
    positive(|| "inlier_chi2".into(), config.inlier_chi2)?;
    let (low, high) = config.inverse_depth_range;
    positive(|| "lower inverse depth".into(), low)?;
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
pub(super) const NO_PAIR: u32 = u32::MAX;

/// How the parts of a problem hang together; computed once. Lists as long as the observations are
/// narrow: those of a long run are hundreds of thousands.
#[derive(Debug)]
pub(super) struct Layout {
    /// Per keyframe its place among the free ones.
    pub slot_of_keyframe: Vec<Option<usize>>,
    /// Free keyframes, in order.
    pub free_keyframes: Vec<usize>,
    /// Distinct pairs (host, observer), sorted.
    pub pairs: Vec<(usize, usize)>,
    /// Per observation its pair, or [`NO_PAIR`] when the host observes itself.
    pub pair_of_observation: Vec<u32>,
    /// Blocks of the lower triangle (row, column; slots) that pairs or the diagonal have, sorted.
    pub blocks: Vec<(usize, usize)>,
    /// The poses that each point depends on.
    pub fans: FanLayout,
    /// The places of the blocks of the reduced system.
    pub pattern: BlockPattern<6>,
    /// Points that threads take together.
    pub shares: Shares,
}

/// Marks what has no entry in [`FanLayout`].
const NO_ENTRY: u32 = u32::MAX;

/// For every point the free poses that it depends on: those of its observers and of its host.
#[derive(Debug)]
pub(super) struct FanLayout {
    /// Where the entries of each point start; one more than there are points.
    starts: Vec<u32>,
    /// Slots, each once per point, in the order in which the reduced system is eliminated.
    slots: Vec<u32>,
    of_observation: Vec<u32>,
    of_host: Vec<u32>,
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
        let pairs = pairs(problem);
        let find = |o| {
            let found = pairs.binary_search(&pair(problem, o));
            found.map_or(NO_PAIR, |pair| pair as u32)
        };
        let entries = fan_entries(problem, &slot_of_keyframe);
        let pattern = pattern(&entries, free_keyframes.len());
        let fans = FanLayout::new(problem, &slot_of_keyframe, entries, &pattern);
        Self {
            pattern,
            shares: Shares::new(problem),
            pair_of_observation: problem.observations.iter().map(find).collect(),
            blocks: blocks(&pairs, &slot_of_keyframe, free_keyframes.len()),
            fans,
            slot_of_keyframe,
            free_keyframes,
            pairs,
        }
    }
}

/// Host and observer of an observation.
fn pair(problem: &BundleProblem, observation: &Observation) -> (usize, usize) {
    (problem.points[observation.point].host, observation.keyframe)
}

fn pairs(problem: &BundleProblem) -> Vec<(usize, usize)> {
    let observations = problem.observations.iter();
    let pairs = observations.map(|observation| pair(problem, observation));
    let mut pairs: Vec<_> = pairs.filter(|(host, observer)| host != observer).collect();
    pairs.sort_unstable();
    pairs.dedup();
    pairs.shrink_to_fit();
    pairs
}

fn blocks(
    pairs: &[(usize, usize)],
    slot_of_keyframe: &[Option<usize>],
    num_slots: usize,
) -> Vec<(usize, usize)> {
    let of_pair = |&(host, observer): &(usize, usize)| {
        let (a, b) = (slot_of_keyframe[host]?, slot_of_keyframe[observer]?);
        Some((a.max(b), a.min(b)))
    };
    let diagonal = (0..num_slots).map(|slot| (slot, slot));
    let mut blocks: Vec<_> = pairs.iter().filter_map(of_pair).chain(diagonal).collect();
    blocks.sort_unstable();
    blocks.dedup();
    blocks
}

/// The free poses (slots) on which points depend: (point, slot), sorted.
fn fan_entries(problem: &BundleProblem, slot_of_keyframe: &[Option<usize>]) -> Vec<(u32, u32)> {
    let entry = |point: usize, keyframe: usize| {
        let slot = slot_of_keyframe[keyframe]?;
        Some((point as u32, slot as u32))
    };
    let observations = problem.observations.iter();
    let seen = observations.filter_map(|o| entry(o.point, o.keyframe));
    let points = problem.points.iter().enumerate();
    let hosts = points.filter_map(|(i, point)| entry(i, point.host));
    let mut entries: Vec<(u32, u32)> = seen.chain(hosts).collect();
    entries.sort_unstable();
    entries.dedup();
    entries
}

impl FanLayout {
    fn new(
        problem: &BundleProblem,
        slot_of_keyframe: &[Option<usize>],
        mut entries: Vec<(u32, u32)>,
        pattern: &BlockPattern<6>,
    ) -> Self {
        let key = |&(point, slot): &(u32, u32)| (point, pattern.place(slot as usize));
        entries.sort_unstable_by_key(key);
        let find = |point: usize, keyframe: usize| {
            let entry = slot_of_keyframe[keyframe].map(|slot| key(&(point as u32, slot as u32)));
            let found = entry.and_then(|entry| entries.binary_search_by_key(&entry, key).ok());
            found.map_or(NO_ENTRY, |at| at as u32)
        };
        let (observations, points) = (problem.observations.iter(), problem.points.iter());
        let start = |point: usize| entries.partition_point(|e| (e.0 as usize) < point) as u32;
        Self {
            starts: (0..=problem.points.len()).map(start).collect(),
            of_observation: observations.map(|o| find(o.point, o.keyframe)).collect(),
            of_host: (points.enumerate().map(|(i, point)| find(i, point.host))).collect(),
            slots: entries.iter().map(|entry| entry.1).collect(),
        }
    }

    /// The entries of a point.
    pub(super) fn of(&self, point: usize) -> Range<usize> {
        self.of_all(&(point..point + 1))
    }

    /// The entries of neighbouring points.
    pub(super) fn of_all(&self, points: &Range<usize>) -> Range<usize> {
        self.starts[points.start] as usize..self.starts[points.end] as usize
    }

    /// The slot of an entry.
    pub(super) fn slot(&self, entry: usize) -> usize {
        self.slots[entry] as usize
    }

    /// The entry of an observation's point for its observer, where that is free.
    pub(super) fn of_observation(&self, observation: usize) -> Option<usize> {
        let entry = self.of_observation[observation];
        (entry != NO_ENTRY).then_some(entry as usize)
    }

    /// The entry of a point for its host, where that is free.
    pub(super) fn of_host(&self, point: usize) -> Option<usize> {
        let entry = self.of_host[point];
        (entry != NO_ENTRY).then_some(entry as usize)
    }
}
