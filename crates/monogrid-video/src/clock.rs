//! Times of frames, which only grow.

/// How far a time must go back to be a clock that was set anew, and not frames that were swapped,
/// ns.
const CLOCK_JUMP_NS: i64 = 500_000_000;

/// Swapped times up to this are rounding of editors and not worth a word, ns.
const ROUNDING_NS: i64 = 1_000_000;

/// Makes times increase: editors repeat times or swap them by microseconds, and clocks of robots
/// are set back.
#[derive(Debug, Default)]
pub(crate) struct Clock {
    /// Whether its source has a clock. In a file of a video, frames behind damage are out of order.
    pub(crate) can_be_set_back: bool,
    /// The last time that was given out.
    last_ns: Option<i64>,
    /// The last difference between two of them that was as the source had it.
    step_ns: i64,
    /// Added to times since the clock was set back.
    shift_ns: i64,
    /// Times that did not come after the one before.
    pub(crate) repaired: usize,
    /// Frames that have not even another time than the one before, or go back by more than
    /// rounding.
    faulty: usize,
    /// How often the clock was set back, and how far at most, ns.
    jumps: usize,
    largest_jump_ns: i64,
}

impl Clock {
    /// Of a source that has a clock, which can be set back, or of a file.
    pub(crate) fn new(can_be_set_back: bool) -> Self {
        Self {
            can_be_set_back,
            ..Self::default()
        }
    }

    /// The time that is used for a frame of this time.
    pub(crate) fn increasing(&mut self, time_ns: i64) -> i64 {
        let mut used_ns = time_ns.saturating_add(self.shift_ns);
        if let Some(last_ns) = self.last_ns {
            let step_ns = used_ns.saturating_sub(last_ns);
            if step_ns > 0 {
                self.step_ns = step_ns;
            } else {
                let back_ns = step_ns.saturating_neg();
                self.repaired += 1;
                self.faulty += usize::from(back_ns == 0 || back_ns > ROUNDING_NS);
                let is_jump = self.can_be_set_back && back_ns > CLOCK_JUMP_NS;
                let after_ns = if is_jump { self.step_ns.max(1) } else { 1 };
                let right_ns = last_ns.saturating_add(after_ns);
                if is_jump {
                    self.jumps += 1;
                    self.largest_jump_ns = self.largest_jump_ns.max(back_ns);
                    let shift_ns = right_ns.saturating_sub(used_ns);
                    self.shift_ns = self.shift_ns.saturating_add(shift_ns);
                }
                used_ns = right_ns;
            }
        }
        self.last_ns = Some(used_ns);
        used_ns
    }

    /// What people should know of it.
    pub(crate) fn fault(&self) -> Option<String> {
        let faulty = self.faulty;
        let set_back = format!(
            "; the clock was set back {} times, by up to {:.3} s: times behind that go on from \
             those before",
            self.jumps,
            self.largest_jump_ns as f64 * 1e-9
        );
        (faulty > 0).then(|| {
            format!(
                "{faulty} times do not come after those of the frames before{}",
                if self.jumps > 0 {
                    &set_back
                } else {
                    ": these frames are put right behind them"
                }
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::Clock;

    fn used_by(can_be_set_back: bool, times_ns: &[i64]) -> (Vec<i64>, Clock) {
        let mut clock = Clock::new(can_be_set_back);
        let used = times_ns.iter().map(|t| clock.increasing(*t)).collect();
        (used, clock)
    }

    fn used(times_ns: &[i64]) -> (Vec<i64>, Clock) {
        used_by(true, times_ns)
    }

    #[test]
    fn frames_of_a_file_that_are_out_of_order_set_no_clock_back() {
        let times = [
            0,
            33 * MS,
            1100 * MS,
            66 * MS,
            1133 * MS,
            99 * MS,
            1166 * MS,
        ];
        let (times, clock) = used_by(false, &times);
        let (first, last) = (times[..3].to_vec(), times[6]);
        assert_eq!((first, last), (vec![0, 33 * MS, 1100 * MS], 1166 * MS));
        assert!(times.is_sorted(), "{times:?}");
        assert_eq!((clock.repaired, clock.jumps), (2, 0));
    }

    const MS: i64 = 1_000_000;

    #[test]
    fn times_that_are_repeated_or_swapped_are_put_right_behind() {
        let (times, clock) = used(&[0, 33 * MS, 33 * MS, 20 * MS, 66 * MS]);
        assert_eq!(times, [0, 33 * MS, 33 * MS + 1, 33 * MS + 2, 66 * MS]);
        assert_eq!(clock.repaired, 2);
        let fault = clock.fault().unwrap();
        assert!(fault.starts_with("2 times do not"), "{fault}");
        assert!(!fault.contains("set back"), "{fault}");
        // what an editor rounds
        let (_, clock) = used(&[0, 33 * MS, 33 * MS - 900, 66 * MS]);
        assert_eq!((clock.repaired, clock.fault()), (1, None));
    }

    #[test]
    fn a_clock_that_is_set_back_goes_on() {
        let (times, clock) = used(&[9000 * MS, 9100 * MS, 100 * MS, 200 * MS, 0, 300 * MS]);
        let expected = [9000, 9100, 9200, 9300, 9300, 9400].map(|t| t * MS);
        assert_eq!(times[..4], expected[..4]);
        assert_eq!((times[4], times[5]), (9300 * MS + 1, 9400 * MS));
        let fault = clock.fault().unwrap();
        assert!(
            fault.contains("2 times do not") && fault.contains("back 1 times"),
            "{fault}"
        );
        assert!(fault.contains("9.000 s"), "{fault}");
        let (times, _) = used(&[i64::MAX, i64::MIN, i64::MAX]);
        assert!(times.is_sorted(), "{times:?}");
    }
}
