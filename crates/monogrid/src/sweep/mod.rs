//! The thesis' experiments on recordings: every resolution with every sensor model and parameter,
//! measured, compared with the truth, and put beside the thesis' own numbers.
//!
//! Flow: [`plan`] (what to build) → [`schedule`] (several maps at once, within a memory limit, what was
//! done before is kept) → [`build`] (one map: growth, time, sizes, scores, pictures) → [`record`] (one
//! JSON file per map) → [`tables`] and [`figures`] → [`page`].

pub mod build;
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
