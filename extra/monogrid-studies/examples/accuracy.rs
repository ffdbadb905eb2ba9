//! Runs the system on a sequence and prints trajectory and depth errors: the loop in which its
//! parameters are found.
//!
//! `cargo run --release -p monogrid-studies --example accuracy -- FOLDER [key=value …]`
//!
//! Keys: `seed=I`, `start=N`, `every=N` (a slower camera), `max=N` (frames), `profile=thesis`,
//! `init=depth` (metric start from the sequence's depth image), `truth_every=N` (evaluate the depth
//! of every n-th keyframe), `verbose=1`.
#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a tool for development, read from top to bottom"
)]

use monogrid_evaluation::{StampedPose, TrajectoryConfig, evaluate_trajectory};
use monogrid_image::GrayImage;
use monogrid_slam::settings::SLAM;
use monogrid_slam::{FrameInput, FrameReport, Keyframe, Slam, SlamConfig, TrackingState};
use monogrid_studies::{Options, Sequence};

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
    let config = options.applied_to(profile, SLAM, "slam");
    let mut slam = sequence.system(config, options.number("seed", 0));
    let live = track(&mut slam, &sequence, &options);
    let truth = match sequence.dataset.ground_truth {
        Some(_) => sequence.stamped_truth(),
        None => Vec::new(),
    };
    if options.number("edges", 0) > 0 {
        edge_report(&slam, &truth, &sequence);
    }
    let path = slam.trajectory();
    let path = path.iter().map(|p| (p.timestamp_ns, p.world_from_camera));
    let scale = print_errors("final", &path.collect::<Vec<_>>(), &truth);
    print_errors("live", &live, &truth);
    depth_report(&slam, &sequence, scale.unwrap_or(1.0));
}

/// Plays the frames that are asked for; the poses as they were reported.
fn track(slam: &mut Slam, sequence: &Sequence, options: &Options) -> Vec<StampedPose> {
    let frames = &sequence.dataset.frames;
    let first = options.number("start", 0);
    let used: Vec<usize> = (first..frames.len())
        .step_by(options.number("every", 1))
        .take(options.number("max", usize::MAX))
        .collect();
    let begin = std::time::Instant::now();
    let mut live = Vec::new();
    let mut counts = [0usize; 5];
    let mut times = [0.0f64; 3];
    for &at in &used {
        let entry = &frames[at];
        let is_seeded = at == first && options.is("init", "depth");
        let seed_depth = is_seeded.then(|| sequence.true_depth(entry.timestamp_ns));
        let report = slam.process_frame(FrameInput {
            index: entry.index,
            timestamp_ns: entry.timestamp_ns,
            image: sequence.image(at),
            depth: seed_depth.flatten().map(Into::into),
        });
        counts[report.state as usize] += 1;
        let stages = report.milliseconds;
        for (time, stage) in times
            .iter_mut()
            .zip([stages.tracking, stages.depth, stages.graph])
        {
            *time += stage;
        }
        if options.number("verbose", 0) > 0 || report.state == TrackingState::Lost {
            print_frame(&report);
        }
        live.extend(
            report
                .world_from_camera
                .map(|pose| (report.timestamp_ns, pose)),
        );
    }
    slam.finish();
    let frames = used.len() as f64;
    let [tracking, depth, graph] = times.map(|time| time / frames);
    println!(
        "{frames} frames, {} keyframes, states {counts:?} [init good degraded fragment lost], \
         {:.1} fps, ms/frame tracking {tracking:.1} depth {depth:.1} graph {graph:.1}",
        slam.keyframes().len(),
        frames / begin.elapsed().as_secs_f64(),
    );
    println!("graph: {:?}", slam.graph_stats());
    println!(
        "in the map: {:.3} of the frames, fragments {:?}",
        slam.trajectory().len() as f64 / frames,
        slam.fragments()
    );
    live
}

fn print_frame(report: &FrameReport) {
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

/// Errors of a trajectory; its scale, true over estimated.
fn print_errors(name: &str, poses: &[StampedPose], truth: &[StampedPose]) -> Option<f64> {
    if truth.is_empty() {
        return None;
    }
    let errors = evaluate_trajectory(poses, truth, &TrajectoryConfig::default());
    let errors = errors.inspect_err(|e| println!("{name}: {e}")).ok()?;
    println!(
        "{name}: ATE {:.4} m, RPE {:.4} m {:.3} deg, scale {:.4}, drift {:?}, coverage {:.3}, \
         matched {}",
        errors.ate_rmse,
        errors.rpe_trans_rmse,
        errors.rpe_rot_rmse_deg,
        errors.scale,
        errors.scale_drift,
        errors.coverage,
        errors.matched
    );
    println!("  scale of windows: {:.2?}", errors.window_scales);
    Some(errors.scale)
}

/// Error of every edge of the graph: rotation (degrees), direction of the translation (degrees) and
/// scale (where both keyframes have true depth); then those of the final poses; then the edge's own
/// sigmas.
fn edge_report(slam: &Slam, truth: &[StampedPose], sequence: &Sequence) {
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
            let truth = sequence.true_depth(k.timestamp_ns)?;
            let z = |p: &monogrid_slam::DepthPixel| f64::from(truth.at(p.x.into(), p.y.into()));
            let keyframe = k.load()?;
            let mut ratios: Vec<f64> = keyframe
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

/// A depth of a keyframe and the true one in its unit.
#[derive(Clone, Copy)]
struct Compared {
    idepth: f64,
    var: f64,
    true_idepth: f64,
}

impl Compared {
    fn ratio(&self) -> f64 {
        self.idepth / self.true_idepth
    }

    fn error(&self) -> f64 {
        self.idepth - self.true_idepth
    }
}

/// Depth of the keyframes that have a true depth image.
fn depth_report(slam: &Slam, sequence: &Sequence, true_over_estimated: f64) {
    let snapshot = slam.snapshot();
    let mut pooled: Vec<Compared> = Vec::new();
    for keyframe in slam.keyframes() {
        let unit = snapshot.world_from_keyframe[keyframe.id as usize].scale * true_over_estimated;
        let truth = sequence.true_depth(keyframe.timestamp_ns);
        let keyframe = keyframe.load().unwrap();
        let compared = truth.map_or(Vec::new(), |truth| compared(&keyframe, &truth, unit));
        if compared.len() < 100 {
            continue;
        }
        print_keyframe(&keyframe, &compared);
        pooled.extend(compared);
    }
    if !pooled.is_empty() {
        print_sigmas(&pooled);
    }
}

/// The pixels of a keyframe that have a true depth, `unit` metres in its unit.
fn compared(keyframe: &Keyframe, truth: &GrayImage, unit: f64) -> Vec<Compared> {
    let pixels = keyframe.pixels.iter();
    let compared = pixels.map(|p| Compared {
        idepth: p.idepth.into(),
        var: p.idepth_var.into(),
        true_idepth: unit / f64::from(truth.at(p.x.into(), p.y.into())),
    });
    let is_known = |c: &Compared| c.true_idepth.is_finite() && c.true_idepth > 0.0;
    compared.filter(is_known).collect()
}

/// What is left after the keyframe's own scale.
fn print_keyframe(keyframe: &Keyframe, compared: &[Compared]) {
    let mut ratios: Vec<f64> = compared.iter().map(Compared::ratio).collect();
    let median = median(&mut ratios);
    let normalised = |c: &Compared| (c.idepth - median * c.true_idepth).abs() / c.var.sqrt();
    let mut errors: Vec<f64> = compared.iter().map(normalised).collect();
    let within = |values: &[f64], test: &dyn Fn(f64) -> bool| {
        values.iter().filter(|v| test(**v)).count() as f64 / values.len() as f64
    };
    println!(
        "kf {} frame {} points {} scale {median:.3} within 3% {:.2} 10% {:.2} | normalised: within \
         2 sigma {:.2}, abs median {:.2}",
        keyframe.id,
        keyframe.frame_index,
        keyframe.pixels.len(),
        within(&ratios, &|r| (r / median - 1.0).abs() < 0.03),
        within(&ratios, &|r| (r / median - 1.0).abs() < 0.10),
        within(&errors, &|e| e < 2.0),
        self::median(&mut errors),
    );
}

/// How large the errors of all keyframes are beside sigmas that are `factor` times larger, with a
/// relative part.
fn print_sigmas(pooled: &[Compared]) {
    for factor in [1.0, 1.3, 1.6, 2.0] {
        for relative in [0.0, 0.01, 0.02] {
            let sigma =
                |c: &Compared| (c.var * factor * factor + (relative * c.idepth).powi(2)).sqrt();
            let mut errors: Vec<f64> = pooled.iter().map(|c| c.error() / sigma(c)).collect();
            let inside =
                errors.iter().filter(|e| e.abs() < 2.0).count() as f64 / errors.len() as f64;
            let median = median(&mut errors);
            let mut deviations: Vec<f64> = errors.iter().map(|e| (e - median).abs()).collect();
            println!(
                "sigma x {factor} + {relative} d: median {median:.2}, robust deviation {:.2}, \
                 within 2 sigma {inside:.3}",
                1.4826 * self::median(&mut deviations)
            );
        }
    }
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
