//! Many recordings, each by a run of its own: `monogrid batch`.
//!
//! Flow: [`list`] (which recordings) → [`task`] (names, options, settings) → [`schedule`] (how many
//! at once, by processors and memory) → [`work`] (one task: is it done already? else a process of
//! this program, [`child`]) → [`record`] (`task.json`) → [`page`] (`monogrid report`).
//!
//! `DEST/tasks/NAME` holds `task.json` and `log.txt`, `DEST/runs/NAME` is the folder of the run, as
//! `monogrid run --out` writes it. Both are output folders of their own: whoever works on a task
//! holds the lock of the former, which ends with its process, so that several batches can share a
//! destination. A task is done when its `task.json` says so, is of the same source, options,
//! settings and version, and neither what was read nor what was written has changed; it is written
//! last, whole or not at all, so that a batch that is killed at any moment has lost nothing but the
//! tasks in progress.

pub mod child;
pub mod class;
pub mod digest;
pub mod keys;
pub mod list;
pub mod metrics;
pub mod outputs;
pub mod page;
pub mod record;
pub mod schedule;
pub mod sha256;
pub mod task;
pub mod work;
