//! Packets of rays with a common origin: one walk through the hierarchy serves all of them.
//!
//! With a common origin most of the Möller-Trumbore test is shared: per triangle and ray three dot
//! products remain. All loops run over fixed lanes, which the compiler turns into vector code.

use super::bvh::{Bounds, Bvh, EDGE_SLACK, Hit, P3, Triangle, safe_reciprocal};

/// `N` rays from one point, and the nearest hit of each so far.
#[derive(Clone, Debug)]
pub struct Packet<const N: usize> {
    origin: P3,
    direction: [[f32; N]; 3],
    inverse: [[f32; N]; 3],
    t: [f32; N],
    u: [f32; N],
    v: [f32; N],
    triangle: [u32; N],
    /// Smallest and largest inverse direction per axis, when all rays point to the same side.
    spread: [Option<(f32, f32)>; 3],
}

/// Mark of a ray that has not met anything.
const NOTHING: u32 = u32::MAX;

impl<const N: usize> Packet<N> {
    /// Rays from `origin` along `direction[axis][ray]`, up to `t_max` direction lengths, and what
    /// they meet.
    #[must_use]
    pub fn traced(origin: P3, direction: [[f32; N]; 3], t_max: f32, bvh: &Bvh) -> Self {
        let mut inverse = [[0.0; N]; 3];
        let mut spread = [None; 3];
        for axis in 0..3 {
            let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
            for lane in 0..N {
                let reciprocal = safe_reciprocal(direction[axis][lane]);
                inverse[axis][lane] = reciprocal;
                low = least(low, reciprocal);
                high = greatest(high, reciprocal);
            }
            let same_side = low > 0.0 || high < 0.0;
            spread[axis] = same_side.then_some((low, high));
        }
        let mut packet = Self {
            origin,
            direction,
            inverse,
            t: [t_max; N],
            u: [0.0; N],
            v: [0.0; N],
            triangle: [NOTHING; N],
            spread,
        };
        packet.trace(bvh);
        packet
    }

    /// Distance of a ray's nearest hit; its initial limit when there is none.
    #[inline]
    #[must_use]
    pub fn distance(&self, lane: usize) -> f32 {
        self.t[lane]
    }

    /// Index of the triangle that a ray meets.
    #[inline]
    #[must_use]
    pub fn hit(&self, lane: usize) -> Option<Hit> {
        (self.triangle[lane] != NOTHING).then(|| Hit {
            t: self.t[lane],
            u: self.u[lane],
            v: self.v[lane],
            triangle: self.triangle[lane],
        })
    }

    /// Direction of a ray.
    #[inline]
    #[must_use]
    pub fn direction(&self, lane: usize) -> P3 {
        P3::from_fn(|axis, _| self.direction[axis][lane])
    }

    /// Finds the nearest hits.
    fn trace(&mut self, bvh: &Bvh) {
        if bvh.is_empty() {
            return;
        }
        // near child first: decided by the first ray
        let positive: [u32; 3] = std::array::from_fn(|a| u32::from(self.direction[a][0] >= 0.0));
        let mut farthest = self.farthest();
        let mut stack = [0u32; 64];
        let mut depth = 1;
        while depth > 0 {
            depth -= 1;
            let node = &bvh.nodes[stack[depth] as usize];
            if !self.enters(&node.bounds, farthest) {
                continue;
            }
            if node.count == 0 {
                let second = positive[usize::from(node.axis)];
                stack[depth] = node.first + second;
                stack[depth + 1] = node.first + 1 - second;
                depth += 2;
                continue;
            }
            let first = node.first as usize;
            for index in first..first + usize::from(node.count) {
                self.intersect(&bvh.triangles[index], index as u32);
            }
            farthest = self.farthest();
        }
    }

    fn farthest(&self) -> f32 {
        self.t.iter().copied().fold(0.0, greatest)
    }

    /// Whether some ray may enter the box before the farthest of the hits so far.
    #[inline]
    fn enters(&self, bounds: &Bounds, farthest: f32) -> bool {
        let (mut near, mut far) = (0.0f32, farthest);
        let mut mixed = false;
        for axis in 0..3 {
            let Some((low, high)) = self.spread[axis] else {
                mixed = true;
                continue;
            };
            let to_min = bounds.min[axis] - self.origin[axis];
            let to_max = bounds.max[axis] - self.origin[axis];
            let (entry, exit) = if low > 0.0 {
                (to_min, to_max)
            } else {
                (to_max, to_min)
            };
            // smallest entry and largest exit over all rays of the packet
            near = greatest(near, entry * if entry >= 0.0 { low } else { high });
            far = least(far, exit * if exit >= 0.0 { high } else { low });
        }
        near <= far * (1.0 + 1e-6) && (!mixed || self.any_enters(bounds))
    }

    /// The same ray by ray, for packets that straddle an axis.
    fn any_enters(&self, bounds: &Bounds) -> bool {
        let mut near = [0.0f32; N];
        let mut far = self.t;
        for axis in 0..3 {
            let to_min = bounds.min[axis] - self.origin[axis];
            let to_max = bounds.max[axis] - self.origin[axis];
            let inverse = &self.inverse[axis];
            for lane in 0..N {
                let a = to_min * inverse[lane];
                let b = to_max * inverse[lane];
                near[lane] = greatest(near[lane], least(a, b));
                far[lane] = least(far[lane], greatest(a, b));
            }
        }
        let mut entering = 0u32;
        for lane in 0..N {
            entering += u32::from(near[lane] <= far[lane] * (1.0 + 1e-6));
        }
        entering > 0
    }

    /// Möller and Trumbore 1997, two-sided:
    /// det = -d·n, u = d·(e2 x s) / det, v = d·(s x e1) / det, t = e2·(s x e1) / det, s = o - v0.
    #[inline]
    fn intersect(&mut self, triangle: &Triangle, index: u32) {
        let s = self.origin - triangle.v0;
        let n = triangle.e1.cross(&triangle.e2);
        let for_u = triangle.e2.cross(&s);
        let for_v = s.cross(&triangle.e1);
        let for_t = triangle.e2.dot(&for_v);
        let [dx, dy, dz] = &self.direction;
        let (mut tt, mut uu, mut vv) = ([0.0f32; N], [0.0f32; N], [0.0f32; N]);
        let mut margin = [0.0f32; N];
        for lane in 0..N {
            let det = dx[lane] * n.x + dy[lane] * n.y + dz[lane] * n.z;
            // a ray in the plane gets t = 0, which is no hit
            let inverse = if det * det > 1e-36 { -1.0 / det } else { 0.0 };
            let u = (dx[lane] * for_u.x + dy[lane] * for_u.y + dz[lane] * for_u.z) * inverse;
            let v = (dx[lane] * for_v.x + dy[lane] * for_v.y + dz[lane] * for_v.z) * inverse;
            let t = for_t * inverse;
            // positive when all conditions hold
            let inside = least(least(u, v) + EDGE_SLACK, 1.0 + EDGE_SLACK - u - v);
            margin[lane] = least(least(inside, t), self.t[lane] - t);
            tt[lane] = t;
            uu[lane] = u;
            vv[lane] = v;
        }
        let hits: u32 = margin.iter().map(|&m| u32::from(m > 0.0)).sum();
        if hits == 0 {
            return;
        }
        for lane in 0..N {
            if margin[lane] > 0.0 {
                self.t[lane] = tt[lane];
                self.u[lane] = uu[lane];
                self.v[lane] = vv[lane];
                self.triangle[lane] = index;
            }
        }
    }
}

/// Stores the direction of one ray of a packet.
#[inline]
pub(crate) fn set_lane<const N: usize>(direction: &mut [[f32; N]; 3], lane: usize, ray: &P3) {
    for (component, value) in direction.iter_mut().zip(ray.iter()) {
        component[lane] = *value;
    }
}

/// The smaller number, without the care for NaN that keeps `f32::min` from becoming one
/// instruction.
#[inline]
fn least(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

#[inline]
fn greatest(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

#[cfg(test)]
mod tests {
    use super::super::random::Random;
    use super::*;

    #[test]
    fn packets_agree_with_single_rays() {
        let mut random = Random::new(11);
        let triangles: Vec<Triangle> = (0..500)
            .map(|_| {
                let mut p = |s: f32| {
                    P3::new(
                        random.range(-s, s),
                        random.range(-s, s),
                        random.range(-s, s),
                    )
                };
                let a = p(3.0);
                Triangle::new(a, a + p(0.5), a + p(0.5))
            })
            .collect();
        let bvh = Bvh::new(&triangles);
        let mut hits = 0;
        for _ in 0..300 {
            let mut p = |s: f32| {
                P3::new(
                    random.range(-s, s),
                    random.range(-s, s),
                    random.range(-s, s),
                )
            };
            let (origin, axis) = (p(4.0), p(1.0));
            let mut direction = [[0.0f32; 16]; 3];
            for lane in 0..16 {
                let d = axis + p(0.1);
                for (component, value) in direction.iter_mut().zip(d.iter()) {
                    component[lane] = *value;
                }
            }
            let packet = Packet::traced(origin, direction, f32::INFINITY, &bvh);
            for lane in 0..16 {
                let single = bvh.nearest(&origin, &packet.direction(lane), 0.0, f32::INFINITY);
                match (packet.hit(lane), single) {
                    (Some(a), Some(b)) => {
                        assert!((a.t - b.t).abs() <= 1e-4 * b.t, "{a:?} {b:?}");
                        hits += 1;
                    }
                    (None, None) => {}
                    // only at an edge may rounding decide differently
                    (a, b) => {
                        let h = a.or(b).map_or(0.5, |h| h.u.min(h.v).min(1.0 - h.u - h.v));
                        assert!(h.abs() < 1e-3, "{a:?} {b:?}");
                    }
                }
            }
        }
        assert!(hits > 500, "{hits}");
    }
}
