//! One map of a sweep: built keyframe by keyframe, measured, compared with the truth, drawn.

use super::pictures::{self, PictureOrders};
use super::plan::Entry;
use super::record::{Built, Growth, MapResult, Scores};
use monogrid_app::output::OutputFolder;
use monogrid_app::process::failure::{Classify, Failure};
use monogrid_app::process::usage::thread_cpu;
use monogrid_app::recorded::Recorded;
use monogrid_evaluation::MapEvaluator;

use monogrid_mapping::{KeyframeScan, Mapper, MappingConfig};
use monogrid_occupancy::{MapError, OccupancyMap, write_bt, write_ot};
use std::io::{self, Write};
use std::time::Duration;

/// Keyframes at which the maximum-likelihood form is measured: it visits every cell.
const LIKELIHOOD_SAMPLES: usize = 8;

/// What the maps of one recording at one resolution share.
#[derive(Debug)]
pub struct Job<'a> {
    /// The recording.
    pub recorded: &'a Recorded,
    /// What is mapped of its keyframes.
    pub scans: &'a Scans,
    /// The truth at this resolution.
    pub evaluator: Option<&'a MapEvaluator<'a>>,
    /// Heights of slices and views to draw.
    pub orders: &'a PictureOrders,
    /// Where the sweep writes.
    pub out: &'a OutputFolder,
    /// Subfolder of the recording.
    pub name: &'a str,
}

/// Builds, measures and compares one map that may take `budget` bytes.
pub fn build(job: &Job, entry: &Entry, budget: usize) -> Result<MapResult, Failure> {
    let config = entry.model.mapping(entry.resolution);
    let mapper = Mapper::new(config.clone(), 1);
    let scans = job.scans.for_rules(&config);
    let map = empty(&config, budget);
    let mut map = map.while_running("a map of the sweep cannot be made")?;
    let mut grown = Grown::default();
    let built = grown.grow(&mut map, &mapper, job.recorded, scans);
    if let Err(MapError::MemoryBudget { .. }) = built {
        let limit_bytes = budget;
        return Ok(MapResult::BeyondMemory { limit_bytes });
    }
    built.while_running("a map of the sweep cannot be built")?;
    let report = job.evaluator.map(|evaluator| evaluator.evaluate(&map));
    let report = report.transpose();
    let report = report.while_running("a map of the sweep cannot be compared")?;
    let scores = report.as_ref().map(Scores::from_report);
    let pictures = pictures::draw(job, entry, &map, &mapper, scans)?;
    let (low, high) = map.bounds().unwrap_or_default();
    Ok(MapResult::Built(Box::new(Built {
        keyframes: grown.keyframes,
        points: grown.points,
        seconds: grown.cpu.as_secs_f64(),
        bytes: map.bytes_in_memory(),
        bytes_likelihood: map.maximum_likelihood_bytes(),
        nodes: map.octree_node_count().ok(),
        leaves: map.leaf_count(),
        extent: std::array::from_fn(|axis| high[axis] - low[axis]),
        ot_bytes: file_bytes(|out| write_ot(&map, out)),
        bt_bytes: file_bytes(|out| write_bt(&map, out)),
        growth: grown.growth,
        scores,
        pictures,
    })))
}

/// What is mapped of the keyframes of a recording: the same for all resolutions.
#[derive(Debug)]
pub struct Scans {
    /// All measurements, for the thesis' rules.
    pub all: Vec<KeyframeScan>,
    /// What the default settings make of them.
    default: Vec<KeyframeScan>,
}

impl Scans {
    /// Of a recording.
    pub fn new(recorded: &Recorded, threads: usize) -> Self {
        Self {
            all: recorded.scans(&MappingConfig::thesis(), threads),
            default: recorded.scans(&MappingConfig::default(), threads),
        }
    }

    fn for_rules(&self, config: &MappingConfig) -> &[KeyframeScan] {
        match config.filter == MappingConfig::thesis().filter {
            true => &self.all,
            false => &self.default,
        }
    }
}

/// An empty map with a limit to its memory.
pub fn empty(config: &MappingConfig, budget: usize) -> Result<OccupancyMap, MapError> {
    OccupancyMap::new(monogrid_occupancy::MapConfig {
        memory_budget_bytes: budget,
        ..config.map_config()
    })
}

/// A map while it grows.
#[derive(Debug, Default)]
struct Grown {
    keyframes: usize,
    points: usize,
    cpu: Duration,
    growth: Vec<Growth>,
}

impl Grown {
    fn grow(
        &mut self,
        map: &mut OccupancyMap,
        mapper: &Mapper,
        recorded: &Recorded,
        scans: &[KeyframeScan],
    ) -> Result<(), MapError> {
        let sampled = scans.len().div_ceil(LIKELIHOOD_SAMPLES).max(1);
        for (scan, map_from_keyframe) in recorded.posed(scans) {
            let before = thread_cpu();
            self.points += mapper.integrate(map, scan, &map_from_keyframe)?;
            self.cpu += thread_cpu() - before;
            self.keyframes += 1;
            let is_sampled = self.keyframes.is_multiple_of(sampled);
            self.growth.push(Growth {
                keyframes: self.keyframes,
                bytes: map.bytes_in_memory(),
                bytes_likelihood: is_sampled.then(|| map.maximum_likelihood_bytes()),
            });
        }
        Ok(())
    }
}

/// Counts what is written and forgets it.
#[derive(Default)]
struct Counter(u64);

impl Write for Counter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0 += bytes.len() as u64;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

fn file_bytes(write: impl FnOnce(&mut Counter) -> Result<(), MapError>) -> Option<u64> {
    let mut counter = Counter::default();
    write(&mut counter).ok()?;
    Some(counter.0)
}
