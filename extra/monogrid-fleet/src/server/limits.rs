//! How much agents may make a server keep.

use std::iter::Sum;
use std::ops::Add;

/// What a server keeps at most, of all agents. One agent may take a quarter of each, so that it
/// leaves room for others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Runs: each has a folder, and is read by every joining.
    pub runs: u64,
    /// Keyframes: the memory of the server, and the time of a joining, grow with them.
    pub keyframes: u64,
    /// Bytes on the disk: packets, and the recordings that are made of them.
    pub disk_bytes: u64,
}

impl Default for Limits {
    /// 256 runs, 100,000 keyframes (a day of one camera) and 64 GB, which so many small keyframes
    /// take.
    fn default() -> Self {
        Self {
            runs: 256,
            keyframes: 100_000,
            disk_bytes: 64_000_000_000,
        }
    }
}

/// Bytes that stay free on the disk, for the joined map and for everybody else.
pub const KEPT_FREE_BYTES: u64 = 1_000_000_000;
/// Packets per keyframe: it, its poses, new depth, and its share of points and edges are some six.
/// Where each of them begins is kept in memory.
const PACKETS_PER_KEYFRAME: u64 = 16;
/// The share that one agent may take is one of so many.
const SHARES: u64 = 4;

/// What is kept of a run, of an agent, or of all.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Usage {
    /// Runs.
    pub runs: u64,
    /// Keyframes.
    pub keyframes: u64,
    /// Packets.
    pub packets: u64,
    /// Bytes on the disk.
    pub bytes: u64,
}

/// A limit that would be passed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{who} would have {found} {what}, expected at most {limit}: end here, or start the server with \
     a larger {option}"
)]
pub struct OverLimit {
    who: String,
    found: u64,
    what: &'static str,
    limit: u64,
    option: &'static str,
}

impl Limits {
    /// None at all.
    pub const NONE: Self = Self {
        runs: u64::MAX,
        keyframes: u64::MAX,
        disk_bytes: u64::MAX,
    };

    /// Refuses what passes a limit: `of_agent` and `of_all` are what there would be.
    ///
    /// # Errors
    /// The limit.
    pub fn check(&self, agent: &str, of_agent: &Usage, of_all: &Usage) -> Result<(), OverLimit> {
        let packets = self.keyframes.saturating_mul(PACKETS_PER_KEYFRAME);
        let (mine, all) = (of_agent, of_all);
        let limits = [
            ("runs", mine.runs, all.runs, self.runs, "--max-runs"),
            (
                "keyframes",
                mine.keyframes,
                all.keyframes,
                self.keyframes,
                "--max-keyframes",
            ),
            (
                "packets",
                mine.packets,
                all.packets,
                packets,
                "--max-keyframes",
            ),
            (
                "bytes on the disk",
                mine.bytes,
                all.bytes,
                self.disk_bytes,
                "--max-disk",
            ),
        ];
        for (what, mine, all, limit, option) in limits {
            let share = limit.div_ceil(SHARES);
            let whose = [
                (format!("agent {agent}"), mine, share),
                ("all agents".to_owned(), all, limit),
            ];
            for (who, found, limit) in whose {
                if found > limit {
                    return Err(OverLimit {
                        who,
                        found,
                        what,
                        limit,
                        option,
                    });
                }
            }
        }
        Ok(())
    }
}

impl Add for Usage {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            runs: self.runs + other.runs,
            keyframes: self.keyframes + other.keyframes,
            packets: self.packets + other.packets,
            bytes: self.bytes + other.bytes,
        }
    }
}

impl Sum for Usage {
    fn sum<I: Iterator<Item = Self>>(usages: I) -> Self {
        usages.fold(Self::default(), Self::add)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_agent_has_a_quarter_and_what_passes_a_limit_is_named() {
        let limits = Limits {
            runs: 8,
            keyframes: 100,
            disk_bytes: 1000,
        };
        let usage = |runs, keyframes, packets, bytes| Usage {
            runs,
            keyframes,
            packets,
            bytes,
        };
        let (agent, all) = (usage(2, 25, 400, 250), usage(8, 100, 1600, 1000));
        assert_eq!(limits.check("a", &agent, &all), Ok(()));
        let one_more = [
            (usage(1, 0, 0, 0), "runs", "--max-runs"),
            (usage(0, 1, 0, 0), "keyframes", "--max-keyframes"),
            (usage(0, 0, 1, 0), "packets", "--max-keyframes"),
            (usage(0, 0, 0, 1), "bytes on the disk", "--max-disk"),
        ];
        for (more, what, option) in one_more {
            let of_agent = limits.check("a", &(agent + more), &all).unwrap_err();
            let of_all = limits.check("a", &agent, &(all + more)).unwrap_err();
            assert!(of_agent.to_string().starts_with("agent a "), "{of_agent}");
            assert!(of_all.to_string().starts_with("all agents "), "{of_all}");
            for over in [of_agent.to_string(), of_all.to_string()] {
                assert!(over.contains(what) && over.contains(option), "{over}");
            }
        }
    }
}
