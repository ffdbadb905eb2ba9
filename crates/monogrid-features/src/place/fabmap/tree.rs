//! The tree of Chow and Liu: which word depends on which.

/// Which of the training images show a word: one bit per image.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Occurrences {
    num_images: usize,
    /// Per word.
    bits: Vec<Vec<u64>>,
}

impl Occurrences {
    /// From the words of each image.
    pub(super) fn new(num_words: usize, images: &[Vec<u16>]) -> Self {
        let mut bits = vec![vec![0u64; images.len().div_ceil(64)]; num_words];
        for (i, words) in images.iter().enumerate() {
            for word in words {
                if let Some(row) = bits.get_mut(usize::from(*word)) {
                    row[i / 64] |= 1 << (i % 64);
                }
            }
        }
        Self {
            num_images: images.len(),
            bits,
        }
    }

    /// Number of images with the word.
    fn count(&self, word: usize) -> usize {
        self.bits[word]
            .iter()
            .map(|b| b.count_ones() as usize)
            .sum()
    }

    /// Number of images with both words.
    fn count_both(&self, a: usize, b: usize) -> usize {
        let pairs = self.bits[a].iter().zip(&self.bits[b]);
        pairs.map(|(a, b)| (a & b).count_ones() as usize).sum()
    }

    /// Mutual information of two words over the images, nats.
    #[cfg(test)]
    pub(super) fn mutual_information(&self, a: usize, b: usize) -> f64 {
        self.information(self.count(a), self.count(b), self.count_both(a, b))
    }

    /// Mutual information of two words, nats, `sum p(a,b) ln(p(a,b) / (p(a) p(b)))`, from the
    /// number of images with `a`, with `b`, and with both.
    fn information(&self, num_a: usize, num_b: usize, num_both: usize) -> f64 {
        let n = self.num_images as f64;
        let term = |joint: usize, of_a: usize, of_b: usize| {
            if joint == 0 {
                return 0.0;
            }
            let joint = joint as f64;
            joint / n * (joint * n / (of_a as f64 * of_b as f64)).ln()
        };
        let (without_a, without_b) = (self.num_images - num_a, self.num_images - num_b);
        term(num_both, num_a, num_b)
            + term(num_a - num_both, num_a, without_b)
            + term(num_b - num_both, without_a, num_b)
            + term(without_a + num_both - num_b, without_a, without_b)
    }
}

/// What the tree knows about one word.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Node {
    /// The word that it depends on; `None` at the root.
    pub parent: Option<usize>,
    /// Probability that an image shows the word.
    pub p: f64,
    /// The same when the parent is absent, and when it is there.
    pub p_given_parent: [f64; 2],
}

/// Nodes with the most mutual information along their edges, word 0 at the root.
pub(super) fn chow_liu(occurrences: &Occurrences) -> Vec<Node> {
    let parents = maximum_spanning_tree(occurrences);
    let n = occurrences.num_images as f64;
    parents
        .iter()
        .enumerate()
        .map(|(word, parent)| {
            let count = occurrences.count(word) as f64;
            // a word that was never or always there may be otherwise in the next image
            let p = (count + 0.5) / (n + 1.0);
            let p_given_parent = parent.map_or([p; 2], |parent| {
                let with_parent = occurrences.count(parent) as f64;
                let both = occurrences.count_both(word, parent) as f64;
                // one observation's worth of independence
                let shrunk = |count: f64, of: f64| (count + p) / (of + 1.0);
                [
                    shrunk(count - both, n - with_parent),
                    shrunk(both, with_parent),
                ]
            });
            // as exact as the file keeps them, so that reading gives the same vocabulary
            let stored = |p: f64| f64::from(p as f32);
            Node {
                parent: *parent,
                p: stored(p),
                p_given_parent: p_given_parent.map(stored),
            }
        })
        .collect()
}

/// Parent of each word in the spanning tree with the largest sum of mutual information (Prim, from
/// word 0; the smallest indices on ties).
pub(super) fn maximum_spanning_tree(occurrences: &Occurrences) -> Vec<Option<usize>> {
    let num_words = occurrences.bits.len();
    let counts: Vec<usize> = (0..num_words).map(|w| occurrences.count(w)).collect();
    let mut parents = vec![None; num_words];
    let mut best = vec![f64::NEG_INFINITY; num_words];
    let mut is_in = vec![false; num_words];
    let mut newest = 0;
    for _ in 1..num_words {
        is_in[newest] = true;
        let mut next: Option<usize> = None;
        for word in (0..num_words).filter(|word| !is_in[*word]) {
            let both = occurrences.count_both(newest, word);
            let information = occurrences.information(counts[newest], counts[word], both);
            if information > best[word] {
                best[word] = information;
                parents[word] = Some(newest);
            }
            if next.is_none_or(|n| best[word] > best[n]) {
                next = Some(word);
            }
        }
        if let Some(next) = next {
            newest = next;
        }
    }
    parents
}
