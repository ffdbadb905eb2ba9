//! Maps of a recording of a built-in world against its exact truth, under any settings: the loop in which
//! the defaults of mapping are found.
//!
//! `cargo run --release -p monogrid-slam --example map_study -- WORLD FOLDER RECORDING [res=R,R…]
//! [VARIANT…]`
//!
//! `FOLDER` is what `monogrid synth WORLD` wrote, with its finest `truth.ot`. A variant is a list of
//! `key=value` with commas between (`update_limits=[-0.2;1.2]` has a semicolon inside): keys of `[mapping]` (`filter.min_support=4`), `depth=true` (the
//! rendered depth of the mapped pixels), `depth=true-filled` (of those in filled plain regions only), `depth=dense` (rendered depth of all pixels), `poses=true`, `sigma=0.5` (a factor on the
//! standard deviations of what is mapped).
//!
//! In the environment: `VIEW=1` adds the coverage of what is in view, `VERBOSE=1` tells how far false
//! positives are from the true surface, `TRUTH=MAP.ot` is read instead of the folder's truth.
#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::too_many_lines,
    missing_docs,
    reason = "a tool for development, read from top to bottom"
)]

use monogrid_datasets::synth::{LightingConfig, Renderer, Shutter, World};
use monogrid_datasets::{ReadOptions, Recording, read_trajectory};
use monogrid_evaluation::{
    MapEvaluationConfig, TrajectoryConfig, TruthGrid, View, cells_in_view, evaluate_map,
    evaluate_trajectory,
};
use monogrid_geometry::{Camera, Distortion, Se3, Sim3};
use monogrid_image::GrayImage;
use monogrid_occupancy::{Occupancy, read_ot};
use monogrid_slam::DepthPixel;
use monogrid_slam::mapping::{
    KeyframeCamera, KeyframeScan, Mapper, MappingConfig, PosedKeyframe, final_scans,
};
use std::fs::File;
use std::path::Path;

struct Frame {
    id: u32,
    pixels: Vec<DepthPixel>,
    estimated: Sim3,
    truth: Se3,
    depth: GrayImage,
    image: monogrid_image::Image<u8>,
}

fn main() {
    let mut args = std::env::args().skip(1);
    let (world, folder, recording) = (
        args.next().expect("world"),
        args.next().expect("folder"),
        args.next().expect("recording"),
    );
    let mut resolutions = vec![0.064];
    let mut variants = Vec::new();
    for arg in args {
        match arg.strip_prefix("res=") {
            Some(list) => resolutions = list.split(',').map(|r| r.parse().unwrap()).collect(),
            None => variants.push(arg),
        }
    }
    let recording =
        Recording::read(Path::new(&recording), ReadOptions { with_images: true }).unwrap();
    let session = &recording.session;
    let camera = KeyframeCamera {
        pinhole: session.pinhole,
        width: session.width,
        height: session.height,
    };
    let truth_poses = read_trajectory(&Path::new(&folder).join("groundtruth.txt")).unwrap();
    let stamped = |poses: &[(i64, Se3)]| poses.to_vec();
    let estimate: Vec<(i64, Se3)> = recording
        .keyframes
        .iter()
        .map(|k| (k.timestamp_ns, k.world_from_keyframe.unwrap().to_se3()))
        .collect();
    let gt: Vec<(i64, Se3)> = truth_poses
        .iter()
        .map(|p| (p.timestamp_ns, p.world_from_camera))
        .collect();
    let fit = evaluate_trajectory(&stamped(&estimate), &gt, &TrajectoryConfig::default()).unwrap();
    let map_from_world = fit.gt_from_est;
    println!("{} keyframes", estimate.len());
    let world = World::by_name_with(&world, &LightingConfig::quick()).unwrap();
    let renderer = Renderer::new(
        &Camera {
            width: camera.width,
            height: camera.height,
            pinhole: camera.pinhole,
            distortion: Distortion::None,
        },
        2.2,
    );
    let frames: Vec<Frame> = recording
        .keyframes
        .iter()
        .map(|k| {
            let truth = truth_poses
                .iter()
                .min_by_key(|p| p.timestamp_ns.abs_diff(k.timestamp_ns))
                .unwrap()
                .world_from_camera;
            Frame {
                id: k.id,
                pixels: k
                    .pixels
                    .iter()
                    .map(|p| DepthPixel {
                        x: p.x,
                        y: p.y,
                        idepth: p.idepth,
                        idepth_var: p.idepth_var,
                    })
                    .collect(),
                estimated: map_from_world * k.world_from_keyframe.unwrap(),
                truth,
                image: k.image.clone().unwrap(),
                depth: renderer.depth(&world, &[], Shutter::Global(truth)),
            }
        })
        .collect();
    let finest = {
        let map = read_ot(
            File::open(
                std::env::var_os("TRUTH")
                    .map_or_else(|| Path::new(&folder).join("truth.ot"), Into::into),
            )
            .unwrap(),
            usize::MAX,
        );
        TruthGrid::from_map(&map.unwrap(), 4_000_000_000).unwrap()
    };
    for resolution in resolutions {
        let factor = |r: f64| (r / finest.resolution()).round() as u32;
        let truth = finest.coarsened(factor(resolution).max(1)).unwrap();
        let coarse = finest.coarsened(factor(resolution.max(0.064))).unwrap();
        let views: Vec<View> = frames
            .iter()
            .map(|f| View {
                world_from_camera: f.truth,
                camera: camera.pinhole,
                width: camera.width,
                height: camera.height,
            })
            .collect();
        let in_view = std::env::var_os("VIEW").map(|_| cells_in_view(&coarse, &views, 10.0));
        println!(
            "{:<60} {:>5} {:>6} {:>6} {:>5} {:>5} {:>5} {:>6} {:>5} {:>5} {:>5} {:>6} {:>7}",
            "variant",
            "mm",
            "AUC",
            "known",
            "MCC",
            "prec",
            "rec",
            "cov F",
            "O",
            "viewF",
            "O",
            "acc m",
            "points"
        );
        for variant in &variants {
            let mut mapping = serde_json::to_value(MappingConfig::default()).unwrap();
            let (mut depth_source, mut true_poses, mut sigma_scale) = ("estimated", false, 1.0f32);
            mapping["resolution"] = resolution.into();
            for (key, value) in variant.split(',').filter_map(|s| s.split_once('=')) {
                match key {
                    "depth" => depth_source = value,
                    "sigma" => sigma_scale = value.parse().unwrap(),
                    "poses" => true_poses = value == "true",
                    _ => {
                        let mut node = &mut mapping;
                        for part in key.split('.') {
                            node = node.get_mut(part).expect(key);
                        }
                        *node = serde_json::from_str(&value.replace(';', ","))
                            .unwrap_or_else(|_| value.into());
                    }
                }
            }
            let config: MappingConfig = serde_json::from_value(mapping).unwrap();
            config.validate().unwrap();
            let mapper = Mapper::new(config, camera, 2);
            let mut map = mapper.empty_map().unwrap();
            let mut points = 0;
            let mut errors = [Errors::default(), Errors::default()];
            let mut scans = Vec::new();
            let mut poses = Vec::new();
            let keyframes: Vec<PosedKeyframe> = frames
                .iter()
                .map(|frame| PosedKeyframe {
                    id: frame.id,
                    image: Some(&frame.image),
                    pixels: &frame.pixels,
                    world_from_keyframe: Some(frame.estimated),
                })
                .collect();
            let measured = final_scans(&keyframes, &camera, mapper.config(), 2);
            for (frame, mut scan) in frames.iter().zip(measured) {
                let mut pose = frame.estimated;
                if true_poses {
                    pose = frame.truth.with_scale(pose.scale);
                }
                for p in &mut scan.pixels {
                    p.sigma_idepth *= sigma_scale;
                    let z = frame.depth.at(p.x.into(), p.y.into()) / pose.scale as f32;
                    let is_filled = || {
                        let measured = frame
                            .pixels
                            .binary_search_by_key(&(p.y, p.x), |m| (m.y, m.x));
                        measured.is_err()
                    };
                    let is_replaced =
                        depth_source == "true" || depth_source == "true-filled" && is_filled();
                    if is_replaced && z.is_finite() {
                        p.idepth = 1.0 / z;
                    }
                }
                if depth_source == "dense" {
                    scan = KeyframeScan::from_depth_image(frame.id, &frame.depth, mapper.config());
                    pose = pose.to_se3().with_scale(1.0);
                }
                scans.push(scan);
                poses.push(pose);
            }
            for ((frame, scan), pose) in frames.iter().zip(&scans).zip(&poses) {
                for p in &scan.pixels {
                    let z = frame.depth.at(p.x.into(), p.y.into()) / pose.scale as f32;
                    let is_filled = frame
                        .pixels
                        .binary_search_by_key(&(p.y, p.x), |m| (m.y, m.x))
                        .is_err();
                    errors[usize::from(is_filled)].add(p.idepth, p.sigma_idepth, 1.0 / z);
                }
                points += mapper.integrate(&mut map, scan, pose).unwrap();
            }
            let report = evaluate_map(
                &map,
                &truth,
                &MapEvaluationConfig {
                    in_view: in_view.as_ref(),
                    max_distance_queries: 20_000,
                    ..MapEvaluationConfig::default()
                },
            )
            .unwrap();
            let (o, k) = (&report.policies.observed, &report.policies.known);
            println!(
                "{:<60} {:>5} {:>6.4} {:>6.4} {:>5.3} {:>5.3} {:>5.3} {:>6.3} {:>5.3} {:>5.3} {:>5.3} {:>6.3} {:>7} {}\n  {} fill {}",
                variant,
                resolution * 1e3,
                o.auc,
                k.auc,
                o.mcc,
                o.precision,
                o.recall,
                report.coverage_free,
                report.coverage_occupied,
                report.coverage_free_in_view.unwrap_or(f64::NAN),
                report.coverage_occupied_in_view.unwrap_or(f64::NAN),
                report.surface.accuracy_m.unwrap_or(f64::NAN),
                points,
                errors[0],
                errors[1].relative.len(),
                errors[1],
            );
            if std::env::var_os("VERBOSE").is_some() {
                describe(&map, &truth);
                ranks(&map, &truth);
            }
        }
    }
}

/// What costs AUC: for classes of true occupied cells by log-odds, their share, the AUC that they lose
/// against the free cells, and where the free directions of their surface are.
fn ranks(map: &monogrid_occupancy::OccupancyMap, truth: &TruthGrid) {
    const EDGES: [f32; 8] = [-3.0, -2.0, -1.0, -0.3, 0.0, 0.6, 1.5, 3.0];
    let bin = |l: f32| EDGES.iter().filter(|e| l > **e).count();
    let mut free = Vec::new();
    let mut occupied = Vec::new();
    for brick in map.bricks() {
        for key in (0..monogrid_occupancy::BRICK_CELLS).map(|i| brick.cell(i)) {
            let Some(log_odds) = map.log_odds_of(key) else {
                continue;
            };
            match truth.state(key.to_array()) {
                Occupancy::Free => free.push(log_odds),
                Occupancy::Occupied => occupied.push((log_odds, key)),
                Occupancy::Unknown => {}
            }
        }
    }
    free.sort_by(f32::total_cmp);
    let mut count = [[0usize; 2]; 9];
    let mut loss = [0.0f64; 9];
    let mut faces = [[0usize; 5]; 9];
    for l in &free {
        count[bin(*l)][0] += 1;
    }
    for (l, key) in &occupied {
        let above = free.len() - free.partition_point(|f| f <= l);
        let equal = free.len() - above - free.partition_point(|f| f < l);
        let b = bin(*l);
        count[b][1] += 1;
        loss[b] += (above as f64 + 0.5 * equal as f64) / free.len() as f64 / occupied.len() as f64;
        let k = key.to_array();
        let is_free =
            |d: [i32; 3]| truth.state([k[0] + d[0], k[1] + d[1], k[2] + d[2]]) == Occupancy::Free;
        let up = is_free([0, 0, 1]);
        let down = is_free([0, 0, -1]);
        let side = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]]
            .into_iter()
            .any(is_free);
        let class = match (up || down, side) {
            (true, false) if up => 0,
            (true, false) => 1,
            (false, true) => 2,
            (true, true) => 3,
            (false, false) => 4,
        };
        faces[b][class] += 1;
    }
    println!(
        "    log-odds | free, occupied share | AUC lost | free above only, below only, beside only, both, none"
    );
    for b in 0..9 {
        println!(
            "    > {:>5} | {:.4} {:.4} | {:.4} | {:?}",
            if b == 0 {
                f32::NEG_INFINITY
            } else {
                EDGES[b - 1]
            },
            count[b][0] as f64 / free.len() as f64,
            count[b][1] as f64 / occupied.len() as f64,
            loss[b],
            faces[b],
        );
    }
}

/// Where false cells are: distance (in cells) of false positives to the true surface.
fn describe(map: &monogrid_occupancy::OccupancyMap, truth: &TruthGrid) {
    let mut histogram = [0usize; 8];
    for brick in map.bricks() {
        for key in (0..monogrid_occupancy::BRICK_CELLS).map(|i| brick.cell(i)) {
            let Some(log_odds) = map.log_odds_of(key) else {
                continue;
            };
            let k = key.to_array();
            if log_odds > 0.0 && truth.state(k) == Occupancy::Free {
                let near = (0..7i32).find(|r| {
                    (-r..=*r).any(|x| {
                        (-r..=*r).any(|y| {
                            (-r..=*r).any(|z| {
                                x.abs().max(y.abs()).max(z.abs()) == *r
                                    && truth.state([k[0] + x, k[1] + y, k[2] + z])
                                        == Occupancy::Occupied
                            })
                        })
                    })
                });
                histogram[near.unwrap_or(7) as usize] += 1;
            }
        }
    }
    println!("    false positives by distance in cells: {histogram:?}");
}

#[derive(Default)]
struct Errors {
    relative: Vec<f32>,
    normalised: Vec<f32>,
}

impl Errors {
    fn add(&mut self, idepth: f32, sigma: f32, truth: f32) {
        if truth.is_finite() {
            self.relative.push((idepth / truth - 1.0).abs());
            self.normalised.push(((idepth - truth) / sigma).abs());
        }
    }
}

impl std::fmt::Display for Errors {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let share = |v: &[f32], limit: f32| {
            v.iter().filter(|e| **e > limit).count() as f64 / v.len().max(1) as f64
        };
        let mut sorted = self.relative.clone();
        sorted.sort_by(f32::total_cmp);
        let median = sorted.get(sorted.len() / 2).copied().unwrap_or(f32::NAN);
        write!(
            f,
            "depth error: median {median:.4}, >3% {:.3}, >10% {:.3}; > 2 sigma {:.3}",
            share(&self.relative, 0.03),
            share(&self.relative, 0.1),
            share(&self.normalised, 2.0)
        )
    }
}
