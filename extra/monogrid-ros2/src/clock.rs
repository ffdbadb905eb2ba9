//! The time of what the node says of itself: the system's, or that of a simulation.

use monogrid_messages::builtin_interfaces::Time;
use std::sync::atomic::{AtomicBool, AtomicI64, Ordering::Relaxed};
use std::time::{SystemTime, UNIX_EPOCH};

/// Name of the parameter that says whether `/clock` counts.
pub const SIMULATED: &str = "use_sim_time";
/// What is older than the last of its kind by more than this, ns, is the first of a recording or
/// simulation that begins again.
pub const BEGINS_AGAIN_NS: i64 = 1_000_000_000;

/// A clock that several threads read.
#[derive(Debug, Default)]
pub struct Clock {
    /// Whether the time of a simulation counts.
    is_simulated: AtomicBool,
    /// The last one that came, ns; 0 before.
    simulated_ns: AtomicI64,
}

impl Clock {
    /// The time of the system counts, or that of a simulation.
    pub fn simulate(&self, is_simulated: bool) {
        self.is_simulated.store(is_simulated, Relaxed);
    }

    /// Takes the time of a simulation; whether that counts and begins again.
    pub fn take(&self, time: Time) -> bool {
        let last_ns = self.simulated_ns.swap(time.nanoseconds(), Relaxed);
        let is_back = last_ns.saturating_sub(time.nanoseconds()) > BEGINS_AGAIN_NS;
        is_back && self.is_simulated.load(Relaxed)
    }

    /// The time now; of a simulation that has not begun it is 0.
    #[must_use]
    pub fn now(&self) -> Time {
        if self.is_simulated.load(Relaxed) {
            return Time::from_nanoseconds(self.simulated_ns.load(Relaxed));
        }
        let now = SystemTime::now().duration_since(UNIX_EPOCH);
        Time::from_nanoseconds(now.map_or(0, |now| now.as_nanos() as i64))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_time_of_a_simulation_counts_when_it_is_asked_for() {
        let (clock, at) = (Clock::default(), Time::from_nanoseconds);
        assert!(!clock.take(at(9_000_000_000)));
        assert!(clock.now().sec > 1_600_000_000);
        assert!(!clock.take(at(1)), "nobody asks for it");
        clock.simulate(true);
        assert_eq!(clock.now(), at(1));
        assert!(!clock.take(at(5_000_000_000)));
        // late
        assert!(!clock.take(at(4_500_000_000)));
        assert!(clock.take(at(3_000_000_000)));
        assert_eq!(clock.now().sec, 3);
    }
}
