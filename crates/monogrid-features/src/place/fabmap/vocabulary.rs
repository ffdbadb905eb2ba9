//! The vocabulary: words, the tree over them, and images of other places.

use super::tree::{Node, Occurrences, chow_liu};
use super::words::{k_majority, nearest};
use crate::{Descriptor, Rng};
use thiserror::Error;

/// Settings of the training.
#[derive(Clone, Debug, PartialEq)]
pub struct VocabularyConfig {
    /// Most words, at most 65535. Default 2000.
    pub max_words: usize,
    /// Descriptors that words are made of at most, drawn from all. Default 80 000.
    pub max_descriptors: usize,
    /// Iterations of the clustering at most. Default 10.
    pub max_iterations: usize,
    /// Training images that are kept as examples of places never seen. Default 200.
    pub max_samples: usize,
    /// Seed of drawing and clustering. Default 1.
    pub seed: u64,
}

impl Default for VocabularyConfig {
    fn default() -> Self {
        Self {
            max_words: 2000,
            max_descriptors: 80_000,
            max_iterations: 10,
            max_samples: 200,
            seed: 1,
        }
    }
}

/// What the training has done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VocabularyProgress {
    /// So many iterations of the clustering.
    Clustering(usize),
    /// So many images have been turned into words.
    Words(usize),
    /// The tree is being searched.
    Tree,
}

/// Why nothing can be trained.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum TrainingError {
    /// Too few images.
    #[error("{found} images with corners were found, expected at least {expected}: add images")]
    FewImages {
        /// Images with descriptors.
        found: usize,
        /// Fewest that are accepted.
        expected: usize,
    },
    /// The number of words is not possible.
    #[error("{found} words were asked for, expected 2 to 65535")]
    NumWords {
        /// What was asked for.
        found: usize,
    },
    /// The images look all alike.
    #[error(
        "the images have {found} different descriptors, expected at least 2: add images with \
         texture"
    )]
    FewWords {
        /// Number of words.
        found: usize,
    },
}

/// Fewest images to train from: frequencies of fewer mean nothing.
const MIN_IMAGES: usize = 10;

/// Words with the tree over them, and images of places that are not those of the user.
#[derive(Clone, Debug, PartialEq)]
pub struct PlaceVocabulary {
    pub(super) words: Vec<Descriptor>,
    /// Of each word.
    pub(super) nodes: Vec<Node>,
    /// Words of images, each ascending.
    pub(super) samples: Vec<Vec<u16>>,
}

impl PlaceVocabulary {
    /// Learns words, tree and samples from the descriptors of images, which should show many places
    /// and each of them few times. Deterministic; `progress` hears how far it is.
    ///
    /// # Errors
    /// With fewer than ten images that have descriptors, or an impossible number of words.
    pub fn train(
        images: &[Vec<Descriptor>],
        config: &VocabularyConfig,
        mut progress: impl FnMut(VocabularyProgress),
    ) -> Result<Self, TrainingError> {
        let found = images.iter().filter(|image| !image.is_empty()).count();
        if found < MIN_IMAGES {
            return Err(TrainingError::FewImages {
                found,
                expected: MIN_IMAGES,
            });
        }
        if !(2..=usize::from(u16::MAX)).contains(&config.max_words) {
            return Err(TrainingError::NumWords {
                found: config.max_words,
            });
        }
        let mut rng = Rng::new(config.seed);
        let all: Vec<Descriptor> = images.iter().flatten().copied().collect();
        let drawn = draw(&all, config.max_descriptors, &mut rng);
        let words = k_majority(
            &drawn,
            config.max_words,
            config.max_iterations,
            rng.next_u64(),
            |n| progress(VocabularyProgress::Clustering(n)),
        );
        if words.len() < 2 {
            return Err(TrainingError::FewWords { found: words.len() });
        }
        let mut vocabulary = Self {
            words,
            nodes: Vec::new(),
            samples: Vec::new(),
        };
        let mut as_words = Vec::with_capacity(images.len());
        for image in images.iter().filter(|image| !image.is_empty()) {
            as_words.push(vocabulary.words_of(image));
            progress(VocabularyProgress::Words(as_words.len()));
        }
        progress(VocabularyProgress::Tree);
        vocabulary.nodes = chow_liu(&Occurrences::new(vocabulary.words.len(), &as_words));
        vocabulary.samples = draw(&as_words, config.max_samples, &mut rng);
        Ok(vocabulary)
    }

    /// The vocabulary that comes with the library. Trained on renderings of built-in worlds, see
    /// `data/README.md`.
    ///
    /// # Errors
    /// Only when the library was built with a damaged file.
    pub fn built_in() -> Result<Self, super::VocabularyError> {
        Self::from_bytes(include_bytes!("../../../data/places.vocabulary"))
    }

    /// Number of words.
    #[must_use]
    pub fn num_words(&self) -> usize {
        self.words.len()
    }

    /// Number of images that stand for places never seen.
    #[must_use]
    pub fn num_samples(&self) -> usize {
        self.samples.len()
    }

    /// The different words of an image, ascending.
    pub(super) fn words_of(&self, descriptors: &[Descriptor]) -> Vec<u16> {
        let nearest = descriptors.iter().filter_map(|d| nearest(&self.words, d));
        let words = nearest.filter_map(|(word, _)| u16::try_from(word).ok());
        let mut words: Vec<u16> = words.collect();
        words.sort_unstable();
        words.dedup();
        words
    }
}

/// At most `count` of the items, in their order, each with the same chance.
fn draw<T: Clone>(items: &[T], count: usize, rng: &mut Rng) -> Vec<T> {
    let mut left = count.min(items.len());
    let mut drawn = Vec::with_capacity(left);
    for (i, item) in items.iter().enumerate() {
        if rng.below(items.len() - i) < left {
            drawn.push(item.clone());
            left -= 1;
        }
    }
    drawn
}
