//! The thesis' experiments on recordings: every resolution with every sensor model and parameter,
//! measured, compared with the truth, and put beside the thesis' own numbers.
//!
//! Flow: [`plan`] (what to build) → [`schedule`] (several maps at once, within a memory limit, what
//! was done before is kept) → [`build`] (one map: growth, time, sizes, scores, pictures) →
//! [`record`] (one JSON file per map) → [`tables`] and [`figures`] → [`page`].
//!
//! `Thrun`, `Andert`, `ideal` and `none` are built by the thesis' rules (every measurement, every
//! cell on its ray, no filter) with its ten values of L and of k; `automatic` is the default
//! settings. What depends on a truth alone is found once per resolution. Each map is built by one
//! thread, so that CPU times mean something; one that exceeds its share of the memory is built
//! again alone before it is marked. A record carries a fingerprint of all that its map depends on,
//! so an interrupted sweep goes on.
//!
//! "At the limit after one measurement" in the views is not a property of a log-odds map: a second
//! map counts the measurements that speak for each cell, by the same integration with updates of
//! one small step.

pub mod build;
pub mod command;
pub mod figures;
pub mod inputs;
pub mod page;
pub mod pictures;
pub mod plan;
pub mod record;
pub mod result;
pub mod schedule;
pub mod slam_rate;
pub mod tables;
pub mod thesis;
