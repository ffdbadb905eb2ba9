//! Time.

use serde::{Deserialize, Serialize};

/// A moment, since the epoch of the clock that gave it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Time {
    /// Whole seconds.
    pub sec: i32,
    /// Nanoseconds after them, below 1e9.
    pub nanosec: u32,
}

const NANOSECONDS: i64 = 1_000_000_000;

impl Time {
    /// The moment at so many nanoseconds; those that 32 bits of seconds cannot hold become the
    /// nearest that they can.
    #[must_use]
    pub fn from_nanoseconds(nanoseconds: i64) -> Self {
        let sec = nanoseconds.div_euclid(NANOSECONDS);
        Self {
            sec: sec.clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32,
            nanosec: nanoseconds.rem_euclid(NANOSECONDS) as u32,
        }
    }

    /// Nanoseconds of this moment.
    #[must_use]
    pub fn nanoseconds(self) -> i64 {
        i64::from(self.sec) * NANOSECONDS + i64::from(self.nanosec)
    }
}

#[cfg(test)]
mod tests {
    use super::Time;

    #[test]
    fn nanoseconds_come_back_also_before_the_epoch() {
        for nanoseconds in [0, 1, 1_500_000_000, 1_770_000_000_123_456_789, -1] {
            let time = Time::from_nanoseconds(nanoseconds);
            assert_eq!(time.nanoseconds(), nanoseconds);
        }
        let before = Time::from_nanoseconds(-1);
        assert_eq!((before.sec, before.nanosec), (-1, 999_999_999));
        assert_eq!(Time::from_nanoseconds(i64::MAX).sec, i32::MAX);
    }
}
