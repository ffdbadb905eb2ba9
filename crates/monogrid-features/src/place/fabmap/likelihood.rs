//! How likely a place gives an image: `p(Z | L)`.

use super::tree::Node;

/// How well words tell what exists.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Detector {
    /// `p(z = 1 | e = 1)`: a thing that is there is seen as its word.
    pub p_seen: f64,
    /// `p(z = 1 | e = 0)`: its word is seen without it.
    pub p_phantom: f64,
}

impl Detector {
    /// `p(z | e)`.
    fn p(&self, z: bool, e: bool) -> f64 {
        let p = if e { self.p_seen } else { self.p_phantom };
        if z { p } else { 1.0 - p }
    }

    /// `p(e = 1)` of a thing whose word is in the share `p_word` of all images:
    /// `p(z) = p(z | e) p(e) + p(z | not e) (1 - p(e))`, kept off the certain.
    pub(super) fn existence(&self, p_word: f64) -> f64 {
        let share = (p_word - self.p_phantom) / (self.p_seen - self.p_phantom);
        share.clamp(1e-4, 1.0 - 1e-4)
    }

    /// `p(e = 1 | z)` after one image, from the prior `p(e = 1)`.
    pub(super) fn existence_after(&self, existence: f64, z: bool) -> f64 {
        let with = self.p(z, true) * existence;
        with / (with + self.p(z, false) * (1.0 - existence))
    }

    /// `p(z_q | e_q, z_p)`, from `p(e_q | z_q, z_p) = p(e_q | z_q)` and Bayes' rule.
    pub(super) fn word(&self, node: &Node, z: bool, e: bool, z_parent: bool) -> f64 {
        let of = |p: f64, z: bool| if z { p } else { 1.0 - p };
        let p_given_parent = node.p_given_parent[usize::from(z_parent)];
        let a = of(node.p, !z) * self.p(z, e) * of(p_given_parent, z);
        let b = of(node.p, z) * self.p(!z, e) * of(p_given_parent, !z);
        a / (a + b)
    }
}

/// `ln p(z_q | z_p, L)` for the three beliefs about a thing: not seen in the place, seen in it, and
/// not known at all.
#[derive(Clone, Copy, Debug, PartialEq)]
struct WordTable {
    /// `[belief][z_p][z_q]`
    ln_p: [[[f64; 2]; 2]; 3],
}

/// Index of the belief about a thing of which nothing is known.
const UNKNOWN: usize = 2;

/// All tables of a vocabulary.
#[derive(Clone, Debug)]
pub(super) struct Likelihoods {
    tables: Vec<WordTable>,
    parents: Vec<Option<usize>>,
}

/// An image prepared for comparing with places: their likelihoods differ only in their own words.
#[derive(Clone, Debug)]
pub(super) struct Query {
    /// `ln p(Z | L)` of a place in which nothing was seen.
    empty: f64,
    /// What each word that was seen in the place adds to it.
    gain: Vec<f64>,
    /// `ln p(Z | L)` of the mean of all places.
    pub mean_field: f64,
}

impl Likelihoods {
    pub(super) fn new(nodes: &[Node], detector: Detector) -> Self {
        let table = |node: &Node| {
            let prior = detector.existence(node.p);
            let beliefs = [
                detector.existence_after(prior, false),
                detector.existence_after(prior, true),
                prior,
            ];
            let ln_p = beliefs.map(|existence| {
                [false, true].map(|z_parent| {
                    [false, true].map(|z| {
                        let there = detector.word(node, z, true, z_parent);
                        let absent = detector.word(node, z, false, z_parent);
                        (there * existence + absent * (1.0 - existence)).ln()
                    })
                })
            });
            WordTable { ln_p }
        };
        Self {
            tables: nodes.iter().map(table).collect(),
            parents: nodes.iter().map(|node| node.parent).collect(),
        }
    }

    /// Prepares an image with these words.
    pub(super) fn query(&self, words: &[u16]) -> Query {
        let mut seen = vec![false; self.tables.len()];
        for word in words {
            if let Some(z) = seen.get_mut(usize::from(*word)) {
                *z = true;
            }
        }
        let mut query = Query {
            empty: 0.0,
            gain: Vec::with_capacity(seen.len()),
            mean_field: 0.0,
        };
        for (word, (table, parent)) in self.tables.iter().zip(&self.parents).enumerate() {
            let z_parent = usize::from(parent.is_some_and(|parent| seen[parent]));
            let ln_p = |belief: usize| table.ln_p[belief][z_parent][usize::from(seen[word])];
            query.empty += ln_p(0);
            query.gain.push(ln_p(1) - ln_p(0));
            query.mean_field += ln_p(UNKNOWN);
        }
        query
    }
}

impl Query {
    /// `ln p(Z | L)` of the place that one image with these (different) words has shown.
    pub(super) fn ln_likelihood(&self, place: &[u16]) -> f64 {
        let gains = place.iter().filter_map(|w| self.gain.get(usize::from(*w)));
        self.empty + gains.sum::<f64>()
    }
}
