//! How tracking went, frame by frame: states as colours, losses as a table, what was measured as
//! plots.

use crate::run::tracking::frames::{FrameFate, FrameRow};
use monogrid_report::svg::{Plot, Series};
use monogrid_slam::{FrameReport, TrackingState};

/// A state of a frame: its name and its colour.
type State = (&'static str, &'static str);

const STARTING: State = ("starting", "#7fa8d8");
const GOOD: State = ("good", "#5fb36a");
const DEGRADED: State = ("degraded", "#e8c547");
const FRAGMENT: State = ("in a fragment", "#a06cc4");
const LOST: State = ("lost", "#cc4b37");
const UNREADABLE: State = ("unreadable", "#999999");
const REPEATED: State = ("repeated", "#cccccc");
const DROPPED: State = ("dropped", "#777777");

/// All states, in the order of a legend.
pub(super) const STATES: [State; 8] = [
    GOOD, DEGRADED, LOST, FRAGMENT, STARTING, UNREADABLE, REPEATED, DROPPED,
];

/// What became of a frame.
pub(super) fn state(row: &FrameRow) -> State {
    match &row.fate {
        FrameFate::Processed(report) => match report.state {
            TrackingState::Initialising => STARTING,
            TrackingState::Good => GOOD,
            TrackingState::Degraded => DEGRADED,
            TrackingState::Fragment => FRAGMENT,
            TrackingState::Lost => LOST,
        },
        FrameFate::Skipped(_) => UNREADABLE,
        FrameFate::Repeated => REPEATED,
        FrameFate::Dropped => DROPPED,
    }
}

/// Stretches of equal state.
fn stretches(rows: &[FrameRow]) -> impl Iterator<Item = &[FrameRow]> {
    rows.chunk_by(|a, b| state(a) == state(b))
}

/// Numbers of the first and the last frame.
fn range(rows: &[FrameRow]) -> String {
    format!("{} to {}", rows[0].index, rows[rows.len() - 1].index)
}

/// Coloured stretches over the frames: share of the width, colour, description.
pub(super) fn ribbon(rows: &[FrameRow]) -> Vec<(f64, &'static str, String)> {
    let stretch = |alike: &[FrameRow]| {
        let (name, colour) = state(&alike[0]);
        let share = alike.len() as f64 / rows.len() as f64;
        (share, colour, format!("{name}: frames {}", range(alike)))
    };
    stretches(rows).map(stretch).collect()
}

/// Where tracking was lost or images were missing, and why.
pub(super) fn losses(rows: &[FrameRow]) -> Vec<Vec<String>> {
    let loss = |alike: &[FrameRow]| {
        let what = match &alike[0].fate {
            FrameFate::Processed(report) if report.state == TrackingState::Lost => {
                let reason = report.reason.map(|r| r.to_string()).unwrap_or_default();
                format!("lost: {reason}")
            }
            FrameFate::Processed(report) => format!("fragment {}", report.fragment?.id),
            FrameFate::Skipped(reason) => format!("unreadable: {reason}"),
            FrameFate::Dropped => "dropped: the program was behind".to_owned(),
            _ => return None,
        };
        Some(vec![range(alike), what])
    };
    stretches(rows).filter_map(loss).collect()
}

/// What was measured with each frame.
pub(super) fn tracking_plots(rows: &[FrameRow]) -> Vec<Plot> {
    let curve = |name: &str, colour, value: fn(&FrameReport) -> f64| {
        let point = |row: &FrameRow| {
            let report = row.report();
            let tracked = report.filter(|report| report.state != TrackingState::Initialising);
            [row.index as f64, tracked.map_or(f64::NAN, value)]
        };
        Series::new(name, colour, rows.iter().map(point).collect())
    };
    let plot = |title: &str, y_label: &str, series: &[Series]| Plot {
        from_zero: true,
        ..Plot::new(title, ["frame", y_label], series.to_vec())
    };
    let seen = curve("seen", "#b0b0b0", |report| report.usage.into());
    let agrees = curve("agrees", "#1f6fb4", |report| report.good_share.into());
    let residual = curve("", "#1f6fb4", |report| report.residual.into());
    let gain = curve("", "#1f6fb4", |report| report.exposure_gain.into());
    let tracking = curve("tracking", "#1f6fb4", |report| report.milliseconds.tracking);
    let both = curve("tracking and depth", "#c07a28", |report| {
        report.milliseconds.tracking + report.milliseconds.depth
    });
    let seen_again = "How much of the keyframe is seen again and agrees";
    let exposure = "Exposure relative to the keyframe";
    vec![
        plot(seen_again, "share", &[seen, agrees]),
        plot("Difference of grey values", "grey levels", &[residual]),
        plot(exposure, "gain", &[gain]),
        plot("Time per frame", "ms", &[both, tracking]),
    ]
}
