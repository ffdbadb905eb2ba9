//! Points with their observations in shares that threads take: the same shares, and sums in the
//! same order, with any number of threads.

use super::BundleProblem;
use rayon::prelude::*;
use std::ops::Range;

/// Fewer observations are not worth another thread.
const OBSERVATIONS_PER_SHARE: usize = 1000;

const MAX_SHARES: usize = 4;

/// The points of a problem in shares of about as many observations.
#[derive(Debug)]
pub(super) struct Shares {
    /// Observations by their points.
    by_point: Vec<u32>,
    shares: Vec<Share>,
}

/// Neighbouring points.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Share {
    pub points: Range<usize>,
    /// Where their observations are.
    observations: Range<usize>,
}

impl Shares {
    pub(super) fn new(problem: &BundleProblem) -> Self {
        let count = problem.observations.len() / OBSERVATIONS_PER_SHARE;
        Self::so_many(problem, count.clamp(1, MAX_SHARES))
    }

    pub(super) fn so_many(problem: &BundleProblem, count: usize) -> Self {
        let observations = problem.observations.as_slice();
        let mut by_point: Vec<u32> = (0..observations.len() as u32).collect();
        by_point.sort_by_key(|i| observations[*i as usize].point);
        let all = observations.len();
        let mut shares = Vec::with_capacity(count);
        let (mut point, mut start) = (0, 0);
        for share in 1..=count {
            // all observations of a point, and points that nobody sees, belong to one share
            let end = if share == count {
                problem.points.len()
            } else {
                observations[by_point[all * share / count] as usize].point
            };
            let until = by_point.partition_point(|i| observations[*i as usize].point < end);
            shares.push(Share {
                points: point..end,
                observations: start..until,
            });
            (point, start) = (end, until);
        }
        Self { by_point, shares }
    }

    /// What `work` makes of each share, in their order.
    pub(super) fn each<T: Send>(&self, work: impl Fn(&Share) -> T + Sync) -> Vec<T> {
        match self.shares.as_slice() {
            // a small window is done before another thread would be awake
            [one] => vec![work(one)],
            shares => shares.par_iter().map(&work).collect(),
        }
    }

    /// The observations of a share, by their points.
    pub(super) fn observations(&self, share: &Share) -> impl Iterator<Item = usize> {
        let those = &self.by_point[share.observations.clone()];
        those.iter().map(|i| *i as usize)
    }

    /// How many there are.
    pub(super) fn count(&self) -> usize {
        self.shares.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bundle::{AnchoredPoint, Observation};
    use monogrid_geometry::{Pinhole, Vec2};

    /// Points that are seen that often, the observations in an order of their own.
    fn problem(seen: &[usize]) -> BundleProblem {
        let observation = |point: usize| Observation {
            keyframe: 0,
            point,
            pixel: Vec2::zeros(),
            inv_sigma_px: 1.0,
        };
        let point = AnchoredPoint {
            host: 0,
            pixel: Vec2::zeros(),
            inverse_depth: 1.0,
            prior: None,
        };
        let most = seen.iter().max().copied().unwrap_or(0);
        let rounds = (0..most).flat_map(|k| (0..seen.len()).filter(move |&p| k < seen[p]));
        BundleProblem {
            pinhole: Pinhole::new(1.0, 1.0, 0.0, 0.0),
            keyframes: Vec::new(),
            points: vec![point; seen.len()],
            observations: rounds.map(observation).collect(),
        }
    }

    #[test]
    fn every_point_and_observation_is_in_one_share() {
        let one_is_seen_most = {
            let mut seen = vec![1; 500];
            seen[200] = 9000;
            seen
        };
        let unseen_ends = [vec![0; 3], vec![5; 2000], vec![0; 4]].concat();
        for seen in [
            vec![],
            vec![3; 100],
            vec![7; 1000],
            one_is_seen_most,
            unseen_ends,
        ] {
            let problem = problem(&seen);
            let shares = Shares::new(&problem);
            let all = problem.observations.len();
            assert_eq!(shares.count(), (all / 1000).clamp(1, 4));
            let found = shares.each(|share| {
                let observations: Vec<usize> = shares.observations(share).collect();
                let points = observations.iter().map(|i| problem.observations[*i].point);
                assert!(points.clone().all(|point| share.points.contains(&point)));
                assert!(points.is_sorted());
                (share.points.clone(), observations)
            });
            let points = found.iter().flat_map(|(points, _)| points.clone());
            assert!(points.eq(0..seen.len()));
            let mut observations: Vec<usize> = found.into_iter().flat_map(|f| f.1).collect();
            observations.sort_unstable();
            assert!(observations.into_iter().eq(0..all));
        }
    }

    #[test]
    fn shares_are_alike() {
        let problem = problem(&vec![7; 1000]);
        let shares = Shares::new(&problem);
        let counts = shares.each(|share| shares.observations(share).count());
        assert!(
            counts.iter().all(|count| count.abs_diff(1750) <= 7),
            "{counts:?}"
        );
    }
}
