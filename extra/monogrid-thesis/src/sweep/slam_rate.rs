//! How fast SLAM is with each way of mapping beside it (thesis 6.1.4, Table 6.5).

use super::plan::{Entry, usual_models};
use monogrid_app::args::Profile;
use monogrid_app::config::RunConfig;
use monogrid_app::input::Input;
use monogrid_app::input::depth_images::FrameDepths;
use monogrid_app::output::{Inputs, OutputFolder};
use monogrid_app::process::failure::Failure;
use monogrid_app::run::RunSettings;
use monogrid_app::run::tracking::threads::track;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::time::Instant;

/// SLAM with one way of mapping.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Rate {
    /// The mapping.
    pub entry: Entry,
    /// Frames tracked.
    pub frames: usize,
    /// Frames over wall time, until the last keyframe was tracked, recorded and mapped.
    pub frames_per_second: f64,
}

/// What is run.
#[derive(Debug)]
pub struct RateJob<'a> {
    /// The frames.
    pub input: &'a Input,
    /// Metric depth to start with.
    pub depth: Option<FrameDepths>,
    /// Rules of SLAM.
    pub profile: Profile,
    /// Threads.
    pub threads: usize,
    /// Where the sweep writes.
    pub out: &'a OutputFolder,
    /// File in it with the rates, for a resumed sweep.
    pub file: String,
    /// Everything that the rates depend on.
    pub fingerprint: String,
}

/// What is kept.
#[derive(Serialize, Deserialize)]
struct Kept {
    fingerprint: String,
    rates: Vec<Rate>,
}

/// Runs SLAM once per usual model and resolution, one after the other.
pub fn measure(job: &RateJob, resolutions: &[f64]) -> Result<Vec<Rate>, Failure> {
    let mut rates = kept(job);
    for &resolution in resolutions {
        for model in usual_models() {
            let entry = Entry { model, resolution };
            if rates.iter().any(|rate| rate.entry == entry) {
                continue;
            }
            let rate = run_once(job, entry)?;
            eprintln!(
                "SLAM beside {}: {:.1} frames per second",
                entry.name(),
                rate.frames_per_second
            );
            rates.push(rate);
            keep(job, &rates)?;
        }
    }
    Ok(rates)
}

fn run_once(job: &RateJob, entry: Entry) -> Result<Rate, Failure> {
    let scratch = format!("monogrid-sweep-{}", std::process::id());
    let scratch = std::env::temp_dir().join(scratch);
    let folder = Arc::new(OutputFolder::replace(&scratch, false, &Inputs::default())?);
    let config = RunConfig {
        mapping: entry.model.mapping(entry.resolution),
        ..RunConfig::of(job.profile)
    };
    let settings = RunSettings {
        depth: job.depth.clone(),
        ..RunSettings::new(config, job.threads)
    };
    let begin = Instant::now();
    let tracked = track(job.input, &folder, &settings, None, None)?;
    let seconds = begin.elapsed().as_secs_f64();
    // the rates are all that is wanted of the run
    if let Some(folder) = Arc::into_inner(folder) {
        folder.discard()?;
    }
    Ok(Rate {
        entry,
        frames: tracked.rows.len(),
        frames_per_second: tracked.rows.len() as f64 / seconds.max(1e-9),
    })
}

fn kept(job: &RateJob) -> Vec<Rate> {
    let text = std::fs::read_to_string(job.out.path().join(&job.file)).unwrap_or_default();
    let kept = serde_json::from_str(&text).ok();
    let kept = kept.filter(|kept: &Kept| kept.fingerprint == job.fingerprint);
    kept.map_or_else(Vec::new, |kept| kept.rates)
}

fn keep(job: &RateJob, rates: &[Rate]) -> Result<(), Failure> {
    let kept = Kept {
        fingerprint: job.fingerprint.clone(),
        rates: rates.to_vec(),
    };
    let text = serde_json::to_string(&kept).map_err(Failure::running)?;
    job.out.write(&job.file, text)
}
