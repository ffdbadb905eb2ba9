//! Numbers for tests that are the same in every run.

/// A linear congruential generator; holds its state.
pub(crate) struct Random(pub u64);

impl Random {
    /// The next so many bits, the upper ones of the state.
    pub(crate) fn bits(&mut self, count: u32) -> u64 {
        self.0 = self
            .0
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        self.0 >> (64 - count)
    }

    /// From 0 to 1.
    pub(crate) fn unit(&mut self) -> f32 {
        self.bits(24) as f32 / (1 << 24) as f32
    }
}
