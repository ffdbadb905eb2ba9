//! Several cameras, one map.
//!
//! An *agent* is an ordinary `monogrid run` in a process of its own and a process beside it that
//! reads the recording as it grows, makes it small ([`packet`]) and delivers it to a *server*
//! whenever there is a way to it. The recording is the queue: whatever the link does, the run does
//! not notice, and what was not delivered is delivered afterwards. The server keeps the packets of
//! every agent, joins their maps as `monogrid merge-runs` does, and publishes where each agent's
//! world lies in one shared world: similarities only.
//!
//! Lengths are in units of the agents' worlds, times nanoseconds, transforms `a_from_b`.
#![deny(missing_docs)]

pub mod agent;
pub mod config;
pub mod messages;
pub mod network;
pub mod packet;
pub mod packet_log;
pub mod panics;
pub mod program;
pub mod server;
