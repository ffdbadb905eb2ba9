//! Nearest cell of a set, by a balanced k-d tree in one array.

/// Squared distances are in cells².
#[derive(Clone, Debug)]
pub(crate) struct CellTree {
    /// The middle of every range splits it along the axis of its depth, modulo 3.
    keys: Vec<[i32; 3]>,
}

impl CellTree {
    pub fn new(mut keys: Vec<[i32; 3]>) -> Self {
        arrange(&mut keys, 0);
        Self { keys }
    }

    /// Squared distance to the nearest cell; `None` when the set is empty.
    pub fn distance_sq(&self, key: [i32; 3]) -> Option<u64> {
        let mut best = u64::MAX;
        search(&self.keys, 0, key, &mut best);
        (!self.keys.is_empty()).then_some(best)
    }
}

fn arrange(keys: &mut [[i32; 3]], axis: usize) {
    if keys.len() < 2 {
        return;
    }
    let middle = keys.len() / 2;
    keys.select_nth_unstable_by_key(middle, |k| k[axis]);
    let (before, rest) = keys.split_at_mut(middle);
    arrange(before, (axis + 1) % 3);
    arrange(&mut rest[1..], (axis + 1) % 3);
}

fn search(keys: &[[i32; 3]], axis: usize, key: [i32; 3], best: &mut u64) {
    let middle = keys.len() / 2;
    let Some(node) = keys.get(middle) else {
        return;
    };
    *best = (*best).min(distance_sq(*node, key));
    let offset = i64::from(key[axis]) - i64::from(node[axis]);
    let (before, after) = (&keys[..middle], &keys[middle + 1..]);
    let (near, far) = if offset < 0 {
        (before, after)
    } else {
        (after, before)
    };
    let next_axis = (axis + 1) % 3;
    search(near, next_axis, key, best);
    if offset.unsigned_abs().pow(2) < *best {
        search(far, next_axis, key, best);
    }
}

fn distance_sq(a: [i32; 3], b: [i32; 3]) -> u64 {
    (0..3)
        .map(|axis| i64::from(a[axis]).abs_diff(i64::from(b[axis])).pow(2))
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_a_linear_search() {
        let mut state = 11_u64;
        let mut key = || -> [i32; 3] {
            std::array::from_fn(|_| {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(5);
                (state >> 33) as i32 % 40 - 20
            })
        };
        for count in [0, 1, 2, 3, 50, 1000] {
            let keys: Vec<_> = (0..count).map(|_| key()).collect();
            let tree = CellTree::new(keys.clone());
            for _ in 0..100 {
                let query = key();
                let expected = keys.iter().map(|k| distance_sq(*k, query)).min();
                assert_eq!(tree.distance_sq(query), expected);
            }
        }
    }
}
