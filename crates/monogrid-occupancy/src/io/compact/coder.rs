//! Adaptive binary arithmetic coding with 12-bit probabilities and 32-bit bounds, carryless: the
//! interval `[low, high]` is cut in proportion to the probability of a bit, and a byte leaves as
//! soon as both ends agree on it.

/// Probability of a zero, learned from the bits that came before: 1/4096.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bit(u16);

const PROBABILITY_BITS: u32 = 12;
/// One part in 32 of the distance to the certain value is learned from every bit.
const LEARNING_SHIFT: u16 = 5;

impl Bit {
    pub(super) const NEW: Self = Self(1 << (PROBABILITY_BITS - 1));

    #[inline]
    fn learn(&mut self, bit: bool) {
        if bit {
            self.0 -= self.0 >> LEARNING_SHIFT;
        } else {
            self.0 += ((1 << PROBABILITY_BITS) - self.0) >> LEARNING_SHIFT;
        }
    }
}

/// The numbers that the bits so far leave, both ends inclusive.
struct Interval {
    low: u32,
    high: u32,
}

impl Interval {
    const ALL: Self = Self {
        low: 0,
        high: u32::MAX,
    };

    /// The last value of the part that stands for a zero.
    #[inline]
    fn cut(&self, zero: Bit) -> u32 {
        self.low
            + ((u64::from(self.high - self.low) * u64::from(zero.0)) >> PROBABILITY_BITS) as u32
    }

    /// Keeps the part that stands for a bit, which is learned; bytes leave that both ends agree on.
    #[inline]
    fn keep(&mut self, context: &mut Bit, bit: bool, mut leave: impl FnMut(u8)) {
        let middle = self.cut(*context);
        if bit {
            self.low = middle + 1;
        } else {
            self.high = middle;
        }
        context.learn(bit);
        while (self.low ^ self.high) >> 24 == 0 {
            leave((self.high >> 24) as u8);
            self.low <<= 8;
            self.high = self.high << 8 | 255;
        }
    }
}

/// What encodes or decodes bits: both sides run the same code over it.
pub(super) trait Coder {
    /// Encodes `bit` and returns it, or decodes a bit.
    fn bit(&mut self, context: &mut Bit, bit: bool) -> bool;
}

pub(super) struct Encoder {
    interval: Interval,
    pub(super) bytes: Vec<u8>,
}

impl Encoder {
    /// Appends to `bytes`.
    pub(super) fn new(bytes: Vec<u8>) -> Self {
        let interval = Interval::ALL;
        Self { interval, bytes }
    }

    /// Ends the code with the bytes that tell the last interval apart.
    pub(super) fn finish(mut self) -> Vec<u8> {
        self.bytes.extend(self.interval.high.to_be_bytes());
        self.bytes
    }
}

impl Coder for Encoder {
    #[inline]
    fn bit(&mut self, context: &mut Bit, bit: bool) -> bool {
        let bytes = &mut self.bytes;
        self.interval.keep(context, bit, |byte| bytes.push(byte));
        bit
    }
}

/// Reads zeros beyond the end of its bytes: damage gives wrong bits, never a failure.
pub(super) struct Decoder<'a> {
    interval: Interval,
    code: u32,
    bytes: std::slice::Iter<'a, u8>,
}

impl<'a> Decoder<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        let mut bytes = bytes.iter();
        let mut next = || bytes.next().copied().unwrap_or(0);
        let code = u32::from_be_bytes([next(), next(), next(), next()]);
        Self {
            interval: Interval::ALL,
            code,
            bytes,
        }
    }
}

impl Coder for Decoder<'_> {
    #[inline]
    fn bit(&mut self, context: &mut Bit, _: bool) -> bool {
        let bit = self.code > self.interval.cut(*context);
        self.interval.keep(context, bit, |_| {
            let byte = self.bytes.next().copied().unwrap_or(0);
            self.code = self.code << 8 | u32::from(byte);
        });
        bit
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_come_back_and_skewed_ones_cost_little() {
        let mut state = 1_u32;
        let bits: Vec<bool> = (0..100_000)
            .map(|i| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (state >> 8) % 100 < if i % 2 == 0 { 2 } else { 50 }
            })
            .collect();
        let mut contexts = [Bit::NEW; 2];
        let mut encoder = Encoder::new(Vec::new());
        for (i, &bit) in bits.iter().enumerate() {
            encoder.bit(&mut contexts[i % 2], bit);
        }
        let bytes = encoder.finish();
        // Entropy of 2 % is 0.141 bits, of 50 % one bit.
        let entropy_bytes = 50_000.0 * 1.1415 / 8.0;
        assert!(
            (bytes.len() as f64) < 1.05 * entropy_bytes,
            "{}",
            bytes.len()
        );
        let mut decoder = Decoder::new(&bytes);
        let mut contexts = [Bit::NEW; 2];
        for (i, &bit) in bits.iter().enumerate() {
            assert_eq!(decoder.bit(&mut contexts[i % 2], false), bit, "bit {i}");
        }
    }

    #[test]
    fn certainty_in_either_direction_is_never_complete() {
        let mut context = Bit::NEW;
        for bit in [true, false] {
            for _ in 0..1000 {
                context.learn(bit);
            }
            assert!(
                (1..1 << PROBABILITY_BITS).contains(&context.0),
                "{context:?}"
            );
        }
    }
}
