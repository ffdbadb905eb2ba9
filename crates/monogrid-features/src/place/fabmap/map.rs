//! Known places and the posterior over them.

use super::PlaceVocabulary;
use super::likelihood::{Detector, Likelihoods};
use crate::Descriptor;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Settings of [`FabMap`].
#[derive(Clone, Debug, PartialEq)]
pub struct FabMapConfig {
    /// `p(z = 1 | e = 1)`, the probability that a thing that exists is seen as its word. Default
    /// 0.39, as LSD-SLAM uses FAB-MAP.
    pub p_seen: f64,
    /// `p(z = 1 | e = 0)`, the probability of a word without its thing. Default 0.01.
    pub p_phantom: f64,
    /// Probability before the image that it shows a place never seen. Default 0.9.
    pub p_new: f64,
    /// Whether the place never seen is the mean of all places instead of a sample of the images
    /// that the vocabulary was trained on. Default false.
    pub is_mean_field: bool,
    /// Smallest logarithm of how many times more probable a candidate is than a place never seen.
    /// Default 0.
    pub min_ln_ratio: f64,
    /// Most candidates that are compared further. Default 5.
    pub max_candidates: usize,
}

impl Default for FabMapConfig {
    fn default() -> Self {
        Self {
            p_seen: 0.39,
            p_phantom: 0.01,
            p_new: 0.9,
            is_mean_field: false,
            min_ln_ratio: 0.0,
            max_candidates: 5,
        }
    }
}

/// What is believed about one place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaceBelief {
    /// The identity given to [`FabMap::add`].
    pub place: u64,
    /// `p(L | Z)`.
    pub probability: f64,
    /// `ln p(L | Z) - ln p(new | Z)`: tells beliefs apart that are all nearly one.
    pub ln_ratio: f64,
}

/// The posterior: a probability for each place asked for, and one for a place never seen; together
/// one.
#[derive(Clone, Debug, PartialEq)]
pub struct PlaceBeliefs {
    /// The most probable first.
    pub places: Vec<PlaceBelief>,
    /// `p(new | Z)`.
    pub new_place: f64,
}

/// Places by their words. About 2 bytes per word of a place.
#[derive(Clone, Debug)]
pub struct FabMap {
    config: FabMapConfig,
    vocabulary: Arc<PlaceVocabulary>,
    likelihoods: Likelihoods,
    places: BTreeMap<u64, Vec<u16>>,
}

impl FabMap {
    /// A map without places.
    #[must_use]
    pub fn new(vocabulary: Arc<PlaceVocabulary>, config: FabMapConfig) -> Self {
        let detector = Detector {
            p_seen: config.p_seen,
            p_phantom: config.p_phantom,
        };
        Self {
            likelihoods: Likelihoods::new(&vocabulary.nodes, detector),
            config,
            vocabulary,
            places: BTreeMap::new(),
        }
    }

    /// Its settings.
    #[must_use]
    pub fn config(&self) -> &FabMapConfig {
        &self.config
    }

    /// Number of places.
    #[must_use]
    pub fn num_places(&self) -> usize {
        self.places.len()
    }

    /// Adds a place with the descriptors of one image; returns whether it was new (a known one
    /// stays as it is).
    pub fn add(&mut self, place: u64, descriptors: &[Descriptor]) -> bool {
        if self.places.contains_key(&place) {
            return false;
        }
        let words = self.vocabulary.words_of(descriptors);
        self.places.insert(place, words);
        true
    }

    /// The posterior over the allowed places given an image with these descriptors.
    #[must_use]
    pub fn query(
        &self,
        descriptors: &[Descriptor],
        is_allowed: impl Fn(u64) -> bool,
    ) -> PlaceBeliefs {
        self.posterior(&self.vocabulary.words_of(descriptors), is_allowed)
    }

    /// `p(L | Z) = p(Z | L) p(L) / p(Z)`, in logarithms: hundreds of words make tiny likelihoods.
    fn posterior(&self, words: &[u16], is_allowed: impl Fn(u64) -> bool) -> PlaceBeliefs {
        let query = self.likelihoods.query(words);
        let ln_new = if self.config.is_mean_field || self.vocabulary.samples.is_empty() {
            query.mean_field
        } else {
            let samples = self.vocabulary.samples.iter();
            let ln_samples: Vec<f64> = samples.map(|s| query.ln_likelihood(s)).collect();
            ln_sum(&ln_samples) - (ln_samples.len() as f64).ln()
        } + self.config.p_new.ln();
        let allowed = self.places.iter().filter(|(place, _)| is_allowed(**place));
        let known = allowed.map(|(place, words)| (*place, query.ln_likelihood(words)));
        let mut known: Vec<(u64, f64)> = known.collect();
        let ln_prior = ((1.0 - self.config.p_new) / known.len().max(1) as f64).ln();
        for (_, ln_p) in &mut known {
            *ln_p += ln_prior;
        }
        let mut all: Vec<f64> = known.iter().map(|(_, ln_p)| *ln_p).collect();
        all.push(ln_new);
        let ln_evidence = ln_sum(&all);
        let mut places: Vec<PlaceBelief> = known
            .into_iter()
            .map(|(place, ln_p)| PlaceBelief {
                place,
                probability: (ln_p - ln_evidence).exp(),
                ln_ratio: ln_p - ln_new,
            })
            .collect();
        places.sort_by(|a, b| {
            b.ln_ratio
                .total_cmp(&a.ln_ratio)
                .then(a.place.cmp(&b.place))
        });
        PlaceBeliefs {
            places,
            new_place: (ln_new - ln_evidence).exp(),
        }
    }
}

/// `ln sum exp`, without overflow.
fn ln_sum(ln_terms: &[f64]) -> f64 {
    let largest = ln_terms.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if largest == f64::NEG_INFINITY {
        return largest;
    }
    let sum: f64 = ln_terms.iter().map(|ln_p| (ln_p - largest).exp()).sum();
    largest + sum.ln()
}
