//! Cost and normal equations of a window.

use super::prepare::{Layout, NO_PAIR};
use super::shares::Share;
use super::{Appearance, BundleConfig, BundleProblem};
use crate::RobustKernel;
use crate::reprojection::{
    BEHIND_CHI2, adjoint_transpose, pose_jacobian, project, projection_jacobian,
};
use monogrid_geometry::{Mat3, Mat6, Se3, Vec2, Vec3, Vec6, hat};
use nalgebra::DVector;

/// The unknowns.
#[derive(Clone, Debug)]
pub(super) struct State {
    pub camera_from_world: Vec<Se3>,
    pub inverse_depths: Vec<f64>,
}

/// Observer from host, as a matrix.
#[derive(Clone, Copy, Debug)]
pub(super) struct Relative {
    pub rotation: Mat3,
    pub translation: Vec3,
}

/// Everything that does not change while the unknowns do.
#[derive(Debug)]
pub(super) struct Window<'a> {
    pub problem: &'a BundleProblem,
    pub layout: &'a Layout,
    pub kernel: RobustKernel,
    /// Per point its direction in the host, z = 1.
    pub bearings: Vec<Vec3>,
    /// Per observation whether it takes part.
    pub active: Vec<bool>,
    /// What images say of observations, beside their pixels.
    pub appearance: Option<&'a dyn Appearance>,
}

/// Gauss-Newton system before the points are eliminated.
#[derive(Debug)]
pub(super) struct Normal {
    /// Poses x poses: the blocks that the layout names.
    pub h_poses: Vec<Mat6>,
    /// Negative gradient by the poses.
    pub b_poses: DVector<f64>,
    /// Per point second derivative.
    pub h_points: Vec<f64>,
    /// Per point negative gradient.
    pub b_points: Vec<f64>,
    /// Per entry of the points' fans the mixed derivative by its pose and the inverse depth.
    pub fans: Vec<Vec6>,
    /// Per pair observer from host at the point of linearisation.
    pub relatives: Vec<Relative>,
}

/// What the observations of a share add.
struct Sums {
    first_point: usize,
    h_points: Vec<f64>,
    b_points: Vec<f64>,
    first_entry: usize,
    fans: Vec<Vec6>,
    /// Of every pair, as seen by the observer's pose: second derivatives (their lower triangle) and
    /// negative gradient.
    per_pair: Vec<(Mat6, Vec6)>,
}

impl Sums {
    fn new(layout: &Layout, share: &Share) -> Self {
        let (points, entries) = (share.points.len(), layout.fans.of_all(&share.points));
        Self {
            first_point: share.points.start,
            h_points: vec![0.0; points],
            b_points: vec![0.0; points],
            first_entry: entries.start,
            fans: vec![Vec6::zeros(); entries.len()],
            per_pair: vec![(Mat6::zeros(), Vec6::zeros()); layout.pairs.len()],
        }
    }

    fn add_to_point(&mut self, point: usize, h: f64, b: f64) {
        self.h_points[point - self.first_point] += h;
        self.b_points[point - self.first_point] += b;
    }

    fn fan(&mut self, entry: usize) -> &mut Vec6 {
        &mut self.fans[entry - self.first_entry]
    }
}

impl<'a> Window<'a> {
    pub(super) fn new(
        problem: &'a BundleProblem,
        layout: &'a Layout,
        appearance: Option<&'a dyn Appearance>,
        config: &BundleConfig,
    ) -> Self {
        let bearing = |p: &super::AnchoredPoint| problem.pinhole.unproject(&p.pixel);
        let is_seen = |&pair: &u32| pair != NO_PAIR;
        Self {
            problem,
            layout,
            kernel: config.kernel,
            bearings: problem.points.iter().map(bearing).collect(),
            active: layout.pair_of_observation.iter().map(is_seen).collect(),
            appearance,
        }
    }

    /// Observer from host for every pair.
    pub(super) fn relatives(&self, state: &State) -> Vec<Relative> {
        let relative = |&(host, observer): &(usize, usize)| {
            let observer_from_host =
                state.camera_from_world[observer] * state.camera_from_world[host].inverse();
            Relative {
                rotation: observer_from_host.rotation_matrix(),
                translation: observer_from_host.translation,
            }
        };
        self.layout.pairs.iter().map(relative).collect()
    }

    /// The point of observation `i` in its observer, times its inverse depth.
    #[inline]
    fn scaled_point(&self, i: usize, relative: &Relative, state: &State) -> Vec3 {
        let point = self.problem.observations[i].point;
        relative.rotation * self.bearings[point]
            + relative.translation * state.inverse_depths[point]
    }

    /// Residual of observation `i` in pixels; `None` when the point is not in front of the camera.
    #[inline]
    fn residual(&self, i: usize, q: &Vec3) -> Option<Vec2> {
        let seen = project(&self.problem.pinhole, q)?;
        Some(seen - self.problem.observations[i].pixel)
    }

    /// Squared error of observation `i` in standard deviations; `None` when behind or an anchor.
    pub(super) fn chi2(&self, i: usize, relatives: &[Relative], state: &State) -> Option<f64> {
        let relative = relatives.get(self.layout.pair_of_observation[i] as usize)?;
        let q = self.scaled_point(i, relative, state);
        let weight = self.problem.observations[i].inv_sigma_px;
        self.residual(i, &q)
            .map(|r| r.norm_squared() * weight * weight)
    }

    /// What images say against observation `i`; nothing of a point that is not in front of the
    /// camera, which costs most anyway.
    fn look(&self, i: usize, relatives: &[Relative], state: &State) -> f64 {
        let Some(appearance) = self.appearance else {
            return 0.0;
        };
        let relative = relatives.get(self.layout.pair_of_observation[i] as usize);
        let seen = relative.and_then(|relative| {
            let q = self.scaled_point(i, relative, state);
            project(&self.problem.pinhole, &q)
        });
        seen.map_or(0.0, |pixel| appearance.cost(i, &pixel))
    }

    /// Robust cost of the observations for which `includes` is true, and of the priors of all
    /// points.
    pub(super) fn cost(&self, state: &State, includes: &[bool]) -> f64 {
        let relatives = self.relatives(state);
        let shares = &self.layout.shares;
        let of_share = |share: &Share| {
            let mut sum = 0.0;
            for i in shares.observations(share).filter(|i| includes[*i]) {
                let chi2 = self.chi2(i, &relatives, state).unwrap_or(BEHIND_CHI2);
                sum += self.kernel.cost(chi2.min(BEHIND_CHI2));
                sum += 2.0 * self.look(i, &relatives, state);
            }
            sum
        };
        let mut sum: f64 = shares.each(of_share).iter().sum();
        for (point, &d) in self.problem.points.iter().zip(&state.inverse_depths) {
            if let Some(prior) = point.prior {
                sum += prior.kernel.cost(prior.chi2(d));
            }
        }
        0.5 * sum
    }

    /// Normal equations at `state`, over the active observations and the priors.
    pub(super) fn linearise(&self, state: &State) -> Normal {
        let n = 6 * self.layout.free_keyframes.len();
        let relatives = self.relatives(state);
        let sums = self.layout.shares.each(|share| {
            let mut sums = Sums::new(self.layout, share);
            self.add_share(share, state, &relatives, &mut sums);
            sums
        });
        let mut normal = Normal {
            h_poses: vec![Mat6::zeros(); self.layout.blocks.len()],
            b_poses: DVector::zeros(n),
            h_points: sums.iter().flat_map(|s| &s.h_points).copied().collect(),
            b_points: sums.iter().flat_map(|s| &s.b_points).copied().collect(),
            fans: sums.iter().flat_map(|s| &s.fans).copied().collect(),
            relatives,
        };
        for pair in 0..self.layout.pairs.len() {
            let (mut h, mut b) = (Mat6::zeros(), Vec6::zeros());
            for (h_share, b_share) in sums.iter().map(|s| &s.per_pair[pair]) {
                h += h_share;
                b += b_share;
            }
            self.add_pair(pair, &h, &b, &mut normal);
        }
        normal
    }

    /// Adds the points of a share: their priors, and who sees them.
    fn add_share(&self, share: &Share, state: &State, relatives: &[Relative], sums: &mut Sums) {
        let observations = self.layout.shares.observations(share);
        for i in observations.filter(|i| self.active[*i]) {
            self.add_observation(i, state, relatives, sums);
        }
        for i in share.points.clone() {
            if let Some(prior) = self.problem.points[i].prior {
                let idepth = state.inverse_depths[i];
                let robust = prior.kernel.weight(prior.chi2(idepth));
                let weight = robust / (prior.sigma * prior.sigma);
                let difference = idepth - prior.mean;
                sums.add_to_point(i, weight, -weight * difference);
            }
        }
    }

    /// Adds one observation to its point, and to its pair as seen by the observer's pose.
    #[inline]
    fn add_observation(&self, i: usize, state: &State, relatives: &[Relative], sums: &mut Sums) {
        let pair = self.layout.pair_of_observation[i] as usize;
        let observation = &self.problem.observations[i];
        let relative = &relatives[pair];
        let q = self.scaled_point(i, relative, state);
        let Some(residual) = self.residual(i, &q) else {
            return;
        };
        let information = observation.inv_sigma_px * observation.inv_sigma_px;
        let chi2 = residual.norm_squared() * information;
        if chi2 >= BEHIND_CHI2 {
            return; // constant cost, see `cost`
        }
        let weight = information * self.kernel.weight(chi2);
        let projection = projection_jacobian(&self.problem.pinhole, &q);
        let j_depth = projection * relative.translation;
        let j_pose = pose_jacobian(&projection, &q, state.inverse_depths[observation.point]);
        let mut h_point = weight * j_depth.norm_squared();
        let mut b_point = -weight * j_depth.dot(&residual);
        let mut cross = Vec6::zeros();
        let (h, b) = &mut sums.per_pair[pair];
        for c in 0..6 {
            let (x, y) = (weight * j_pose[(0, c)], weight * j_pose[(1, c)]);
            for r in c..6 {
                h[(r, c)] += x * j_pose[(0, r)] + y * j_pose[(1, r)];
            }
            b[c] -= x * residual.x + y * residual.y;
            cross[c] = x * j_depth.x + y * j_depth.y;
        }
        let pixel = residual + observation.pixel;
        if let Some(look) = self.appearance.and_then(|images| images.slope(i, &pixel)) {
            *h += j_pose.tr_mul(&(look.information * j_pose));
            *b -= j_pose.tr_mul(&look.gradient);
            let weighted = look.information * j_depth;
            h_point += j_depth.dot(&weighted);
            b_point -= j_depth.dot(&look.gradient);
            cross += j_pose.tr_mul(&weighted);
        }
        sums.add_to_point(observation.point, h_point, b_point);
        if let Some(entry) = self.layout.fans.of_observation(i) {
            *sums.fan(entry) += cross;
        }
        if let Some(entry) = self.layout.fans.of_host(observation.point) {
            *sums.fan(entry) -=
                adjoint_transpose(&relative.rotation, &relative.translation, &cross);
        }
    }

    /// Distributes the sums of a pair over its two poses. A left update of the host acts like minus
    /// its adjoint on the observer: `T_k T_h^-1 exp(-d) = exp(-Ad d) T_k T_h^-1`.
    fn add_pair(&self, pair: usize, lower: &Mat6, b: &Vec6, normal: &mut Normal) {
        let (host, observer) = self.layout.pairs[pair];
        let slot = |k: usize| self.layout.slot_of_keyframe[k];
        let mut h = *lower;
        h.fill_upper_triangle_with_lower_triangle();
        let adjoint = adjoint(&normal.relatives[pair]);
        let h_ad = h * adjoint;
        if let Some(k) = slot(observer) {
            self.add_block(normal, (k, k), &h);
            add_segment(&mut normal.b_poses, k, b);
        }
        if let Some(l) = slot(host) {
            self.add_block(normal, (l, l), &adjoint.tr_mul(&h_ad));
            add_segment(&mut normal.b_poses, l, &-adjoint.tr_mul(b));
            match slot(observer) {
                Some(k) if k > l => self.add_block(normal, (k, l), &-h_ad),
                Some(k) => self.add_block(normal, (l, k), &-h_ad.transpose()),
                None => {}
            }
        }
    }

    /// Adds to a block (row, column) of the lower triangle; the layout names all that there are.
    fn add_block(&self, normal: &mut Normal, at: (usize, usize), block: &Mat6) {
        if let Ok(at) = self.layout.blocks.binary_search(&at) {
            normal.h_poses[at] += block;
        }
    }

    /// The diagonal of the poses.
    pub(super) fn diagonal(&self, normal: &Normal) -> DVector<f64> {
        let mut diagonal = DVector::zeros(normal.b_poses.len());
        for ((row, column), block) in self.layout.blocks.iter().zip(&normal.h_poses) {
            if row == column {
                let mut view = diagonal.fixed_rows_mut::<6>(6 * row);
                view.copy_from(&block.diagonal());
            }
        }
        diagonal
    }

    /// The free poses (slots) on which a point depends, with the mixed derivatives.
    pub(super) fn fan<'b>(
        &'b self,
        normal: &'b Normal,
        point: usize,
    ) -> impl Iterator<Item = (usize, &'b Vec6)> {
        let fans = &self.layout.fans;
        let entries = fans.of(point);
        entries.map(|entry| (fans.slot(entry), &normal.fans[entry]))
    }
}

fn adjoint(relative: &Relative) -> Mat6 {
    let mut ad = Mat6::zeros();
    ad.fixed_view_mut::<3, 3>(0, 0)
        .copy_from(&relative.rotation);
    ad.fixed_view_mut::<3, 3>(3, 3)
        .copy_from(&relative.rotation);
    let upper = hat(&relative.translation) * relative.rotation;
    ad.fixed_view_mut::<3, 3>(0, 3).copy_from(&upper);
    ad
}

fn add_segment(b: &mut DVector<f64>, row: usize, segment: &Vec6) {
    let mut view = b.fixed_rows_mut::<6>(6 * row);
    view += segment;
}
