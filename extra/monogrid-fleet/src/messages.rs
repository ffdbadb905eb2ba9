//! Keys and small messages between agents, server and those who listen.
//!
//! | key, behind `monogrid/fleet/1/` | who asks or publishes | what it is |
//! |---|---|---|
//! | `agents/NAME/RUN/packets/N` | agent asks, with a packet | taken; the answer is [`Missing`] |
//! | `agents/NAME/RUN/packets/N` | anyone asks, without | the packet, if the server has it |
//! | `agents/NAME/RUN/missing` | agent asks the server | [`Missing`] |
//! | `agents/NAME/RUN/pose` | agent publishes | [`AgentPose`] |
//! | `fleet` | anyone asks the server, which also publishes it | [`Fleet`] |
//!
//! All but packets is JSON.

use monogrid_datasets::Record;
use monogrid_geometry::{Rotation, Sim3, Vec3, nalgebra};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// Start of all keys, with their version.
pub const PREFIX: &str = "monogrid/fleet/1";
/// What news of agents and servers begin with that should be looked at.
pub const WARNING: &str = "warning: ";

/// Which run of which agent.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct RunKey {
    name: String,
    run: u64,
}

/// A name that cannot be one.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("found the name {0:?}; expected 1 to 64 letters, digits, - and _")]
pub struct BadName(String);

impl RunKey {
    /// A run of an agent.
    ///
    /// # Errors
    /// For names that cannot be part of a key and the name of a folder.
    pub fn new(name: &str, run: u64) -> Result<Self, BadName> {
        let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        let is_name = (1..=64).contains(&name.len()) && name.chars().all(is_plain);
        if !is_name {
            return Err(BadName(name.to_owned()));
        }
        let name = name.to_owned();
        Ok(Self { name, run })
    }

    /// Name of the agent.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// A key of the run.
    #[must_use]
    pub fn key(&self, rest: &str) -> String {
        format!("{PREFIX}/agents/{self}/{rest}")
    }
}

/// `NAME/RUN`.
impl fmt::Display for RunKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{:016x}", self.name, self.run)
    }
}

impl FromStr for RunKey {
    type Err = BadName;

    fn from_str(text: &str) -> Result<Self, BadName> {
        let bad = || BadName(text.to_owned());
        let (name, run) = text.split_once('/').ok_or_else(bad)?;
        if run.len() != 16 {
            return Err(bad());
        }
        Self::new(name, u64::from_str_radix(run, 16).map_err(|_| bad())?)
    }
}

/// The number that tells a run from others of the same agent: checksums of what holds for all of
/// it, and of its first keyframe. The same recording gives the same number, so that it can be
/// delivered by any process.
#[must_use]
pub fn run_number(session: &Record, first_keyframe: &Record) -> u64 {
    let crc = |record: &Record| crc32fast::hash(&record.encode().unwrap_or_default());
    u64::from(crc(session)) << 32 | u64::from(crc(first_keyframe))
}

/// What a key asks for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Asked {
    /// A packet of a run, or to take it.
    Packet(RunKey, u64),
    /// The number of the first packet of a run that is missing.
    Missing(RunKey),
    /// The state of the fleet.
    Fleet,
}

impl Asked {
    /// What a key asks for; `None` for keys that mean nothing.
    #[must_use]
    pub fn of(key: &str) -> Option<Self> {
        let rest = key.strip_prefix(PREFIX)?.strip_prefix('/')?;
        let parts: Vec<&str> = rest.split('/').collect();
        let run = |name: &str, run: &str| format!("{name}/{run}").parse().ok();
        match parts.as_slice() {
            ["fleet"] => Some(Self::Fleet),
            ["agents", name, number, "missing"] => Some(Self::Missing(run(name, number)?)),
            ["agents", name, number, "packets", packet] => {
                Some(Self::Packet(run(name, number)?, packet.parse().ok()?))
            }
            _ => None,
        }
    }
}

/// What the server has not got of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Missing {
    /// The first packet that it has not got; it has all before.
    pub from: u64,
}

/// A similarity as numbers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Similarity {
    /// Length of the source's unit in units of the target.
    pub scale: f64,
    /// Translation, units of the target.
    pub translation: [f64; 3],
    /// Rotation, x, y, z, w.
    pub quaternion: [f64; 4],
}

impl From<&Sim3> for Similarity {
    fn from(a_from_b: &Sim3) -> Self {
        Self {
            scale: a_from_b.scale,
            translation: a_from_b.translation.into(),
            quaternion: a_from_b.rotation.coords.into(),
        }
    }
}

impl From<&Similarity> for Sim3 {
    fn from(a_from_b: &Similarity) -> Self {
        let quaternion = nalgebra::Quaternion::from(a_from_b.quaternion);
        let rotation = Rotation::from_quaternion(quaternion);
        Self::new(a_from_b.scale, rotation, Vec3::from(a_from_b.translation))
    }
}

/// What the server knows.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Fleet {
    /// Counts upwards with every change of the transforms.
    pub version: u64,
    /// The run in whose world all others are placed, `NAME/RUN`: the first one that delivered
    /// something, as long as it is joined with others.
    pub shared: Option<String>,
    /// All runs, in the order in which they came.
    pub agents: Vec<AgentState>,
}

/// A run of an agent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AgentState {
    /// `NAME/RUN`.
    pub run: String,
    /// Packets that have come.
    pub packets: u64,
    /// Keyframes that have come.
    pub keyframes: u64,
    /// Whether it has ended by itself.
    pub has_ended: bool,
    /// Where its world lies in the shared one; nothing as long as no place is known that both saw.
    pub shared_from_agent: Option<Similarity>,
    /// Why the server does not join the run with others, where it does not.
    #[serde(default)]
    pub set_apart: Option<String>,
}

impl Fleet {
    /// Where the worlds of all lie, in words.
    #[must_use]
    pub fn sentence(&self) -> String {
        let mut text = format!("transforms, version {}:", self.version);
        for agent in &self.agents {
            let place = match &agent.shared_from_agent {
                None => match &agent.set_apart {
                    Some(why) => format!("set apart: {why}"),
                    None => "apart".to_owned(),
                },
                Some(place) => {
                    let [x, y, z] = place.translation;
                    format!("at {x:.3} {y:.3} {z:.3}, scale {:.4}", place.scale)
                }
            };
            text += &format!(" {} ({} keyframes) {place};", agent.run, agent.keyframes);
        }
        text
    }

    /// Where the world of a run lies in the shared one.
    #[must_use]
    pub fn shared_from(&self, run: &RunKey) -> Option<Sim3> {
        let run = run.to_string();
        let agent = self.agents.iter().find(|agent| agent.run == run)?;
        agent.shared_from_agent.as_ref().map(Sim3::from)
    }
}

/// Where an agent is: at its newest keyframe.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AgentPose {
    /// Time of the frame, nanoseconds.
    pub timestamp_ns: i64,
    /// The keyframe.
    pub keyframe: u32,
    /// Its pose in the world of the run; `scale` is the keyframe's unit.
    pub world_from_keyframe: Similarity,
    /// The same in the shared world, where that is known.
    pub shared_from_keyframe: Option<Similarity>,
    /// [`Fleet::version`] of the transform.
    pub version: u64,
}

impl AgentPose {
    /// Where the camera is in the shared world, or else in its own, in words.
    #[must_use]
    pub fn sentence(&self) -> String {
        let (pose, world) = match &self.shared_from_keyframe {
            Some(pose) => (pose, "shared"),
            None => (&self.world_from_keyframe, "own"),
        };
        let [x, y, z] = pose.translation;
        let (seconds, keyframe) = (self.timestamp_ns as f64 * 1e-9, self.keyframe);
        format!("{seconds:.3} s: keyframe {keyframe} at {x:.3} {y:.3} {z:.3} in the {world} world")
    }
}
