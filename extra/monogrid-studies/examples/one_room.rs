//! A camera that stays in one place: plays a sequence forth and back and prints what grows.
//!
//! `cargo run --release -p monogrid-studies --example one_room -- FOLDER [key=value …]`
//!
//! Keys: `frames=N` (to play in all, default 18000), `max=N` (use the first N images), `shift=N`
//! (each way back and forth begins N images later: not the same views), `size=WxH`, and settings as
//! `keyframes.min_mapped_frames=5`. One line per way: keyframes, edges of the graph, points,
//! memory, time per frame, keyframes used again, and the error of the frames so far.
#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "a tool for development, read from top to bottom"
)]

use monogrid_evaluation::{StampedPose, TrajectoryConfig, evaluate_trajectory};
use monogrid_image::{Image, WorkingSize};
use monogrid_slam::settings::SLAM;
use monogrid_slam::{FrameInput, Slam, SlamConfig};
use monogrid_studies::{Options, Sequence};

/// Time between two frames.
const INTERVAL_NS: i64 = 33_333_333;

fn main() {
    let mut args = std::env::args().skip(1);
    let folder = args.next().unwrap();
    let options = Options::read(args);
    let sequence = Sequence::open_with_size(&folder, working_size(&options));
    let config = options.applied_to(SlamConfig::default(), SLAM, "slam");
    let mut slam = sequence.system(config, 0);
    let images = images(&sequence, options.number("max", usize::MAX));
    let order = forth_and_back(
        images.len(),
        options.number("shift", 0),
        options.number("frames", 18_000),
    );
    let mut played: Vec<StampedPose> = Vec::new();
    let (mut lost, mut used_again) = (0, 0);
    let (mut millis, mut frames) = (0.0, 0);
    println!(
        "way, frames, keyframes, edges, points, depth MB, RSS MB, ms per frame, used again, lost, \
         ATE m"
    );
    for (index, &(way, source)) in order.iter().enumerate() {
        let timestamp_ns = index as i64 * INTERVAL_NS;
        played.push((timestamp_ns, sequence.true_pose(source)));
        let begin = std::time::Instant::now();
        let report = slam.process_frame(FrameInput {
            index,
            timestamp_ns,
            image: images[source].map(f32::from),
            depth: None,
        });
        millis += begin.elapsed().as_secs_f64() * 1e3;
        frames += 1;
        lost += usize::from(index > 200 && report.world_from_camera.is_none());
        used_again += usize::from(report.reactivated_keyframe.is_some());
        if order.get(index + 1).is_none_or(|next| next.0 != way) {
            let error = error_m(&slam, &played);
            let size = slam.map_size();
            println!(
                "{way}, {}, {}, {}, {}, {:.1}, {:.0}, {:.1}, {used_again}, {lost}, {error:.4}",
                index + 1,
                size.keyframes,
                size.edges,
                size.points,
                size.bytes.keyframes as f64 * 1e-6,
                rss_bytes() * 1e-6,
                millis / f64::from(frames),
            );
            (millis, frames, used_again) = (0.0, 0, 0);
        }
    }
}

fn working_size(options: &Options) -> WorkingSize {
    match options.0.get("size").and_then(|s| s.split_once('x')) {
        Some((w, h)) => WorkingSize::Exact {
            width: w.parse().unwrap(),
            height: h.parse().unwrap(),
        },
        None => WorkingSize::AUTOMATIC,
    }
}

/// The first `count` images.
fn images(sequence: &Sequence, count: usize) -> Vec<Image<u8>> {
    let to_bytes = |frame| {
        let image = sequence.image(frame);
        image.map(|v| v.round().clamp(0.0, 255.0) as u8)
    };
    let count = sequence.dataset.frames.len().min(count);
    (0..count).map(to_bytes).collect()
}

/// Error of the frames so far, metres.
fn error_m(slam: &Slam, played: &[StampedPose]) -> f64 {
    let path = slam.trajectory();
    let estimate = path.iter().map(|p| (p.timestamp_ns, p.world_from_camera));
    let estimate: Vec<StampedPose> = estimate.collect();
    evaluate_trajectory(&estimate, played, &TrajectoryConfig::default())
        .map_or(f64::NAN, |errors| errors.ate_rmse)
}

/// Which way and which image comes when.
fn forth_and_back(images: usize, shift: usize, frames: usize) -> Vec<(usize, usize)> {
    let mut order = Vec::new();
    let mut way = 0;
    while order.len() < frames {
        let first = (way * shift) % (images / 3 + 1);
        let one_way: Vec<usize> = if way % 2 == 0 {
            (first..images).collect()
        } else {
            (first..images).rev().collect()
        };
        order.extend(one_way.into_iter().map(|source| (way, source)));
        way += 1;
    }
    order.truncate(frames);
    order
}

fn rss_bytes() -> f64 {
    let text = std::fs::read_to_string("/proc/self/statm").unwrap_or_default();
    let pages = text
        .split_whitespace()
        .nth(1)
        .and_then(|p| p.parse::<f64>().ok());
    pages.unwrap_or(f64::NAN) * 4096.0
}
