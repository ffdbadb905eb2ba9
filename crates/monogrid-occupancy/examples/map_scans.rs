//! Maps a `.scans` file and prints what it cost, comparable with `bench/octomap_baseline`.
//!
//! `cargo run --release -p monogrid-occupancy --example map_scans -- office.scans 0.032
//! [rule=rays|fused] [L=0.08] [threads=1] [max_range=100] [scans=N] [single=1] [image=1]
//! [out=map.ot]`
//!
//! With `single=1` every scan is a call of its own, as of a robot that maps while it drives. With
//! `image=1` the points are put back into the depth images of 640 x 480 pixels that they are of
//! (`generate_scans.py`), outside of the timing.
#![allow(clippy::print_stdout, reason = "an example program talks to its user")]

use std::error::Error;
use std::time::Instant;

use monogrid_datasets::ScansReader;
use monogrid_occupancy::*;

struct Options {
    input: String,
    resolution: f64,
    config: IntegrationConfig,
    threads: usize,
    scans: usize,
    single: bool,
    image: bool,
    out: Option<String>,
}

fn parse() -> Result<Options, Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let usage = "usage: map_scans IN.scans RESOLUTION [key=value ...]";
    let mut options = Options {
        input: arguments.next().ok_or(usage)?,
        resolution: arguments.next().ok_or(usage)?.parse()?,
        config: IntegrationConfig::default(),
        threads: 1,
        scans: usize::MAX,
        single: false,
        image: false,
        out: None,
    };
    for argument in arguments {
        let (key, value) = argument.split_once('=').ok_or(usage)?;
        match key {
            "rule" if value == "rays" => options.config.rule = IntegrationRule::Rays,
            "rule" if value == "fused" => options.config.rule = IntegrationRule::Fused,
            "L" => {
                options.config.model = SensorModel::Thrun {
                    buffer: Buffer::Fixed(value.parse()?),
                    form: ThrunForm::Exact,
                }
            }
            "threads" => options.threads = value.parse()?,
            "max_range" => options.config.max_range = value.parse()?,
            "cutoff" => options.config.cutoff_log_odds = value.parse()?,
            "update_min" => options.config.update_min = value.parse()?,
            "update_max" => options.config.update_max = value.parse()?,
            "sigmas" => {
                let sigmas = value.parse()?;
                options.config.model = SensorModel::Thrun {
                    buffer: Buffer::Auto { sigmas, min: 0.0 },
                    form: ThrunForm::Exact,
                }
            }
            "obstacle" => options.config.obstacle_weight = value.parse()?,
            "image" => options.image = value == "1",
            "single" => options.single = value == "1",
            "scans" => options.scans = value.parse()?,
            "out" => options.out = Some(value.to_owned()),
            _ => return Err(format!("unknown option {argument}; {usage}").into()),
        }
    }
    Ok(options)
}

/// Scans in memory at a time.
const SCANS: usize = 16;

/// CPU seconds of all threads of this process so far, those that ended included.
fn cpu_seconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// End points and standard deviations of the ranges of a scan.
type Ends = (Vec<[f32; 3]>, Vec<f32>);

/// Those of a scan, apart.
fn ends(scan: &monogrid_datasets::Scan) -> Ends {
    let points = scan.points.iter();
    points.map(|p| (p.point_in_sensor, p.range_sigma)).unzip()
}

/// The camera of `generate_scans.py`.
const CAMERA: DepthImage = DepthImage {
    width: 640,
    height: 480,
    fx: 525.0,
    fy: 525.0,
    cx: 319.5,
    cy: 239.5,
    depths: &[],
    sigmas: &[],
};

/// The depth image that points are of; 0 where there are none.
fn depths(points: &[[f32; 3]]) -> Vec<f32> {
    let mut depths = vec![0.0; (CAMERA.width * CAMERA.height) as usize];
    for &[x, y, z] in points {
        let slopes = [f64::from(x / z), f64::from(y / z)];
        let column = (slopes[0] * CAMERA.fx + CAMERA.cx).round() as usize;
        let row = (slopes[1] * CAMERA.fy + CAMERA.cy).round() as usize;
        depths[row * CAMERA.width as usize + column] = z;
    }
    depths
}

/// The image of a scan if it has one, else its points.
fn data<'a>(((points, sigmas), depths): (&'a Ends, &'a Vec<f32>)) -> ScanData<'a> {
    if depths.is_empty() {
        return ScanData::Points(PointScan { points, sigmas });
    }
    ScanData::Image(DepthImage {
        depths,
        sigmas: &sigmas[..1],
        ..CAMERA
    })
}

fn main() -> Result<(), Box<dyn Error>> {
    let options = parse()?;
    let mut map = OccupancyMap::new(MapConfig::with_resolution(options.resolution))?;
    let (mut points, mut wall, mut cpu) = (0, 0.0, 0.0);
    let mut reader = ScansReader::open(options.input.as_ref())?.take(options.scans);
    let mut num_read = 0;
    loop {
        let read: Vec<_> = reader.by_ref().take(SCANS).collect::<Result<_, _>>()?;
        if read.is_empty() {
            break;
        }
        let ends: Vec<_> = read.iter().map(ends).collect();
        let images: Vec<_> = match options.image {
            true => ends.iter().map(|(points, _)| depths(points)).collect(),
            false => vec![Vec::new(); ends.len()],
        };
        let measured = ends.iter().zip(&images).map(data);
        let scans = read.iter().zip(measured).zip(num_read..);
        let scans: Vec<Scan> = scans
            .map(|((scan, data), id)| Scan {
                id,
                world_from_sensor: Similarity::from_rigid(&scan.world_from_sensor),
                pose_sigma: PoseSigma::default(),
                data,
            })
            .collect();
        num_read += scans.len() as u32;
        let (started, cpu_started) = (Instant::now(), cpu_seconds());
        let (config, threads) = (&options.config, options.threads);
        for scans in scans.chunks(if options.single { 1 } else { SCANS }) {
            points += if let [scan] = scans {
                integrate(&mut map, scan, config, threads)?.points
            } else {
                integrate_scans(&mut map, scans, config, threads)?.points
            };
        }
        wall += started.elapsed().as_secs_f64();
        cpu += cpu_seconds() - cpu_started;
    }
    let (payloads, bricks) = map.brick_counts();
    let unpacked = map.bytes_in_memory();
    let cpu_started = cpu_seconds();
    map.pack(options.threads);
    let pack_cpu = cpu_seconds() - cpu_started;
    println!(
        "RESULT peer=monogrid rule={:?} res={} threads={} points={points} wall={wall:.4} \
         cpu={cpu:.4} cpu_per_100k={:.6} wall_per_100k={:.6} leaf={} bricks={bricks} \
         payloads={payloads} mem_mb={:.1} unpacked_mb={:.1} pack_cpu={pack_cpu:.2}",
        options.config.rule,
        options.resolution,
        options.threads,
        cpu / points as f64 * 1e5,
        wall / points as f64 * 1e5,
        map.leaf_count(),
        map.bytes_in_memory() as f64 / 1e6,
        unpacked as f64 / 1e6,
    );
    match options.out {
        Some(path) => save(&map, &path),
        None => Ok(()),
    }
}

fn save(map: &OccupancyMap, path: &str) -> Result<(), Box<dyn Error>> {
    let started = Instant::now();
    save_atomically(path.as_ref(), |file| {
        if path.ends_with(".bt") {
            write_bt(map, file)
        } else {
            write_ot(map, file)
        }
    })?;
    println!("wrote {path} in {:.2} s", started.elapsed().as_secs_f64());
    Ok(())
}
