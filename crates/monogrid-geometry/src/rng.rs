//! The seeded random numbers of every sampling step.

/// What the state grows by with each word: odd, near the golden ratio of 64 bits.
const STEP: u64 = 0x9e37_79b9_7f4a_7c15;

/// Mixes the bits of a word: what SplitMix64 gives in this state.
#[inline]
#[must_use]
pub fn mix(state: u64) -> u64 {
    let mut word = state.wrapping_add(STEP);
    word = (word ^ (word >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    word = (word ^ (word >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    word ^ (word >> 31)
}

/// SplitMix64 (`[STEELE14]`), which gives the same on every platform.
#[derive(Clone, Debug)]
pub struct Rng {
    state: u64,
}

impl Rng {
    /// A generator that always gives the same numbers for the same seed.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self { state: seed }
    }

    /// The next 64 random bits.
    pub fn next_u64(&mut self) -> u64 {
        let word = mix(self.state);
        self.state = self.state.wrapping_add(STEP);
        word
    }

    /// Uniform in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        (self.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform in `0..bound`; zero when `bound` is zero.
    pub fn below(&mut self, bound: usize) -> usize {
        ((u128::from(self.next_u64()) * bound as u128) >> 64) as usize
    }

    /// Standard normal (Box-Muller, one of the pair).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }

    /// `K` different indices below `bound` (which must be at least `K`), in random order.
    pub fn sample<const K: usize>(&mut self, bound: usize) -> [usize; K] {
        debug_assert!(bound >= K);
        let mut out = [usize::MAX; K];
        let mut filled = 0;
        while filled < K {
            let index = self.below(bound);
            if !out[..filled].contains(&index) {
                out[filled] = index;
                filled += 1;
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_those_of_the_published_program() {
        let mut rng = Rng::new(1_477_776_061_723_855_037);
        let expected = [
            1_985_237_415_132_408_290,
            2_979_275_885_539_914_483,
            13_511_426_838_097_143_398,
        ];
        assert_eq!(expected.map(|_| rng.next_u64()), expected);
    }

    #[test]
    fn samples_are_distinct_and_reproducible() {
        let (mut a, mut b) = (Rng::new(7), Rng::new(7));
        for _ in 0..100 {
            let s: [usize; 5] = a.sample(6);
            assert_eq!(s, b.sample(6));
            let mut sorted = s;
            sorted.sort_unstable();
            assert!(sorted.windows(2).all(|w| w[0] < w[1]) && sorted[4] < 6);
        }
    }

    #[test]
    fn normal_numbers_have_unit_variance() {
        let mut rng = Rng::new(1);
        let draws: Vec<f64> = (0..20_000).map(|_| rng.normal()).collect();
        let mean = draws.iter().sum::<f64>() / draws.len() as f64;
        let var = draws.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / draws.len() as f64;
        assert!(
            mean.abs() < 0.03 && (var - 1.0).abs() < 0.05,
            "{mean} {var}"
        );
    }
}
