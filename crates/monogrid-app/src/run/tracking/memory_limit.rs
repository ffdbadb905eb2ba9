//! `--memory-limit`: keyframes get the room that everything else leaves.
//!
//! That is looked at with every keyframe. Before the last adjustment, which takes much itself, what
//! only more frames would need is given back (`Slam::conclude`); what comes after the final depth
//! (colours, clouds, report) takes one keyframe after the other. What grows with the path all the
//! same is small: corners and descriptors, points, edges.

use crate::process::memory;
use crate::process::usage::rss_bytes;
use monogrid_slam::{KeyframeRoom, Slam};

/// Share of the limit that is used: what is made and dropped within a frame is not seen.
const SHARE: f64 = 0.9;
/// Room that keyframes have in any case, bytes: a few of them.
const LEAST_ROOM: u64 = 8_000_000;

/// Memory that the process should stay within, bytes.
#[derive(Clone, Copy, Debug)]
pub struct MemoryLimit(pub u64);

impl MemoryLimit {
    /// Gives the keyframes of a system as much room as is left now. What is in memory changes no
    /// result.
    pub fn apply(self, slam: &Slam) {
        self.apply_to(&slam.room());
    }

    /// The same, for a thread beside those that use the system.
    pub fn apply_to(self, keyframes: &KeyframeRoom) {
        memory::give_back();
        // where the system does not say what is used, half is a guess
        let resident = rss_bytes().unwrap_or(self.0 / 2);
        keyframes.give(self.room(resident, keyframes.bytes_in_memory() as u64) as usize);
    }

    /// For work that needs none of the keyframes of a system, or one after the other: they have the
    /// least room where some have had to leave memory already.
    pub fn squeeze(self, slam: &Slam) {
        if slam.map_size().bytes.in_file == 0 {
            return self.apply(slam);
        }
        slam.room().give(LEAST_ROOM as usize);
        memory::give_back();
    }

    /// What keyframes may take of a process that takes `resident` bytes, `kept` of them for
    /// keyframes.
    fn room(self, resident: u64, kept: u64) -> u64 {
        let others = resident.saturating_sub(kept);
        let usable = (self.0 as f64 * SHARE) as u64;
        usable.saturating_sub(others).max(LEAST_ROOM)
    }

    /// What there is to say of a process that has taken more.
    pub fn exceeded(self, peak: Option<u64>) -> Option<String> {
        let megabytes = |bytes: u64| bytes.div_ceil(1_000_000);
        let peak = peak.filter(|peak| *peak > self.0)?;
        Some(format!(
            "the run took {} MB of memory, more than the {} MB that it should stay within: with \
             every keyframe in a file, this is what the rest needs",
            megabytes(peak),
            megabytes(self.0)
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keyframes_get_what_everything_else_leaves() {
        let limit = MemoryLimit(500_000_000);
        assert_eq!(limit.room(300_000_000, 200_000_000), 350_000_000);
        assert_eq!(limit.room(600_000_000, 250_000_000), 100_000_000);
        assert_eq!(limit.room(600_000_000, 0), LEAST_ROOM);
    }

    #[test]
    fn more_than_the_limit_is_said() {
        let limit = MemoryLimit(500_000_000);
        assert!(limit.exceeded(Some(500_000_000)).is_none() && limit.exceeded(None).is_none());
        let said = limit.exceeded(Some(510_000_001)).unwrap_or_default();
        assert!(said.contains("511 MB") && said.contains("500 MB"), "{said}");
    }
}
