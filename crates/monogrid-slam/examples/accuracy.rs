//! Runs the system on a sequence and prints trajectory and depth errors: the loop in which its
//! parameters are found.
//!
//! `cargo run --release -p monogrid-slam --example accuracy -- FOLDER [key=value …]`
//!
//! Keys: `seed=I`, `start=N`, `every=N` (a slower camera), `max=N` (frames), `profile=thesis`, `init=depth` (metric start from the
//! sequence's depth image), `truth_every=N` (evaluate the depth of every n-th keyframe), `verbose=1`.
#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    clippy::too_many_lines,
    reason = "a tool for development, read from top to bottom"
)]

mod options;
mod sequence;

use monogrid_evaluation::{StampedPose, TrajectoryConfig, evaluate_trajectory};
use monogrid_image::GrayImage;
use monogrid_slam::{FrameInput, Slam, SlamConfig, TrackingState};
use options::Options;
use sequence::Sequence;

fn main() {
    let mut args = std::env::args().skip(1);
    let folder = args.next().unwrap();
    let options = Options::read(args);
    let sequence = Sequence::open(&folder);
    let profile = if options.is("profile", "thesis") {
        SlamConfig::thesis()
    } else {
        SlamConfig::default()
    };
    let config = options.applied_to(&profile);
    let mut slam = sequence.system(config, options.number("seed", 0));
    let frames = &sequence.dataset.frames;
    let first = options.number("start", 0);
    let every: usize = options.number("every", 1);
    let used: Vec<usize> = (first..frames.len())
        .step_by(every)
        .take(options.number("max", usize::MAX))
        .collect();
    let true_depth = |timestamp_ns: i64| sequence.true_depth(timestamp_ns);
    let begin = std::time::Instant::now();
    let mut live = Vec::new();
    let mut counts = [0usize; 5];
    let mut times = [0.0f64; 3];
    for &at in &used {
        let entry = &frames[at];
        let image = sequence.image(at);
        let seed_depth = (at == first && options.is("init", "depth"))
            .then(|| true_depth(entry.timestamp_ns))
            .flatten();
        let report = slam.process_frame(FrameInput {
            index: entry.index,
            timestamp_ns: entry.timestamp_ns,
            image,
            seed_depth,
        });
        counts[report.state as usize] += 1;
        times[0] += report.milliseconds.tracking;
        times[1] += report.milliseconds.depth;
        times[2] += report.milliseconds.graph;
        if options.number("verbose", 0) > 0 || report.state == TrackingState::Lost {
            println!(
                "{} {} {:?} kf {:?} res {:.1} good {:.2} usage {:.2} gain {:.2} {}",
                report.index,
                report.state.name(),
                report.reason,
                report.keyframe,
                report.residual,
                report.good_share,
                report.usage,
                report.exposure_gain,
                if report.created_keyframe { "NEW" } else { "" }
            );
        }
        if let Some(pose) = report.world_from_camera {
            live.push((report.timestamp_ns, pose));
        }
    }
    slam.finish();
    let frames = used.len();
    println!(
        "{frames} frames, {} keyframes, states {counts:?} [init good degraded fragment lost], {:.1} fps, ms/frame tracking {:.1} depth {:.1} graph {:.1}",
        slam.keyframes().len(),
        frames as f64 / begin.elapsed().as_secs_f64(),
        times[0] / frames as f64,
        times[1] / frames as f64,
        times[2] / frames as f64
    );
    println!("graph: {:?}", slam.graph_stats());
    println!(
        "in the map: {:.3} of the frames, fragments {:?}",
        slam.trajectory().len() as f64 / frames as f64,
        slam.fragments()
    );
    let mut target_over_source = 1.0;
    if sequence.dataset.ground_truth.is_some() {
        let truth: Vec<StampedPose> = sequence.stamped_truth();
        let estimate: Vec<StampedPose> = slam
            .trajectory()
            .iter()
            .map(|p| (p.timestamp_ns, p.world_from_camera))
            .collect();
        for (name, poses) in [("final", &estimate), ("live", &live)] {
            if name == "final" && options.number("edges", 0) > 0 {
                edge_report(&slam, &truth, &true_depth);
            }
            match evaluate_trajectory(poses, &truth, &TrajectoryConfig::default()) {
                Ok(r) => {
                    println!(
                        "{name}: ATE {:.4} m, RPE {:.4} m {:.3} deg, scale {:.4}, drift {:?}, coverage {:.3}, matched {}",
                        r.ate_rmse,
                        r.rpe_trans_rmse,
                        r.rpe_rot_rmse_deg,
                        r.scale,
                        r.scale_drift,
                        r.coverage,
                        r.matched
                    );
                    if name == "final" {
                        target_over_source = r.scale;
                        for w in &r.window_scales {
                            print!("{w:.2?} ");
                        }
                        println!();
                    }
                }
                Err(e) => println!("{name}: {e}"),
            }
        }
    }
    depth_report(&slam, &true_depth, target_over_source);
}

/// Error of every edge of the graph: rotation (degrees), direction of the translation (degrees) and scale
/// (where both keyframes have true depth); then those of the final poses; then the edge's own sigmas.
fn edge_report(slam: &Slam, truth: &[StampedPose], true_depth: &dyn Fn(i64) -> Option<GrayImage>) {
    let graph = slam.pose_graph();
    let keyframes = slam.keyframes();
    let true_pose = |id: u64| {
        let time = keyframes[id as usize].timestamp_ns;
        truth
            .iter()
            .min_by_key(|(t, _)| (t - time).abs())
            .unwrap()
            .1
    };
    let units: Vec<Option<f64>> = keyframes
        .iter()
        .map(|k| {
            let truth = true_depth(k.timestamp_ns)?;
            let z = |p: &monogrid_slam::DepthPixel| f64::from(truth.at(p.x.into(), p.y.into()));
            let mut ratios: Vec<f64> = k
                .pixels
                .iter()
                .filter(|p| z(p).is_finite() && z(p) > 0.0)
                .map(|p| z(p) * f64::from(p.idepth))
                .collect();
            ratios.sort_by(f64::total_cmp);
            ratios.get(ratios.len() / 2).copied()
        })
        .collect();
    for edge in graph.edges() {
        let i_from_j = true_pose(edge.i).inverse() * true_pose(edge.j);
        let unit = |id: u64| units[id as usize];
        let ratio = unit(edge.i).zip(unit(edge.j)).map(|(i, j)| j / i);
        let (a, b) = (graph.pose(edge.i).unwrap(), graph.pose(edge.j).unwrap());
        let print = |found: &monogrid_geometry::Sim3| {
            let turn = (found.rotation.inverse() * i_from_j.rotation)
                .angle()
                .to_degrees();
            let angle = found.translation.angle(&i_from_j.translation).to_degrees();
            let scale = ratio.map_or(f64::NAN, |ratio| (found.scale / ratio).ln());
            print!(" {turn:.3} {angle:.2} {scale:.4}");
        };
        print!(
            "edge {} {} {:?} t {:.3}",
            edge.i,
            edge.j,
            edge.kernel,
            edge.i_from_j.translation.norm()
        );
        print(&edge.i_from_j);
        print!(" pose");
        print(&(a.inverse() * b));
        let sigma = |k: usize| edge.information[(k, k)].powf(-0.5);
        println!(" sigma {:.5} {:.5} {:.5}", sigma(0), sigma(3), sigma(6));
    }
}

/// Depth of the keyframes that have a true depth image.
fn depth_report(
    slam: &Slam,
    true_depth: &dyn Fn(i64) -> Option<GrayImage>,
    target_over_source: f64,
) {
    let snapshot = slam.snapshot();
    // (error, variance, inverse depth, unit-free truth) of all pixels after the keyframe's own scale
    let mut pooled: Vec<[f64; 3]> = Vec::new();
    for keyframe in slam.keyframes() {
        let Some(truth) = true_depth(keyframe.timestamp_ns) else {
            println!(
                "kf {} frame {} points {}",
                keyframe.id,
                keyframe.frame_index,
                keyframe.pixels.len()
            );
            continue;
        };
        let unit = snapshot.world_from_keyframe[keyframe.id as usize].scale * target_over_source;
        let mut ratios = Vec::new();
        let mut normalised = Vec::new();
        for p in &keyframe.pixels {
            let z = truth.at(usize::from(p.x), usize::from(p.y));
            if z.is_finite() && z > 0.0 {
                ratios.push(f64::from(z) * f64::from(p.idepth) / unit);
                normalised.push((p, z));
            }
        }
        if ratios.len() < 100 {
            continue;
        }
        ratios.sort_by(f64::total_cmp);
        let median = ratios[ratios.len() / 2];
        let mut errors: Vec<f64> = normalised
            .iter()
            .map(|(p, z)| {
                let true_idepth = median * unit / f64::from(*z);
                (f64::from(p.idepth) - true_idepth) / f64::from(p.idepth_var).sqrt()
            })
            .collect();
        pooled.extend(normalised.iter().map(|(p, z)| {
            [
                f64::from(p.idepth) - unit / f64::from(*z),
                f64::from(p.idepth_var),
                f64::from(p.idepth),
            ]
        }));
        errors.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
        let n = errors.len() as f64;
        let within = |t: f64| {
            ratios
                .iter()
                .filter(|r| (*r / median - 1.0).abs() < t)
                .count() as f64
                / n
        };
        println!(
            "kf {} frame {} points {} scale {:.3} within 3% {:.2} 10% {:.2} | normalised: abs median {:.2}, within 2 sigma {:.2}",
            keyframe.id,
            keyframe.frame_index,
            keyframe.pixels.len(),
            median,
            within(0.03),
            within(0.10),
            errors[errors.len() / 2].abs(),
            errors.iter().filter(|e| e.abs() < 2.0).count() as f64 / n
        );
    }
    if pooled.is_empty() {
        return;
    }
    for factor in [1.0, 1.3, 1.6, 2.0] {
        for relative in [0.0, 0.01, 0.02] {
            let mut errors: Vec<f64> = pooled
                .iter()
                .map(|[e, var, d]| e / (var * factor * factor + (relative * d).powi(2)).sqrt())
                .collect();
            errors.sort_by(f64::total_cmp);
            let n = errors.len();
            let median = errors[n / 2];
            let mut deviations: Vec<f64> = errors.iter().map(|e| (e - median).abs()).collect();
            deviations.sort_by(f64::total_cmp);
            let inside = errors.iter().filter(|e| e.abs() < 2.0).count() as f64 / n as f64;
            println!(
                "sigma x {factor} + {relative} d: median {median:.2}, robust deviation {:.2}, within 2 sigma {inside:.3}",
                1.4826 * deviations[n / 2]
            );
        }
    }
}
