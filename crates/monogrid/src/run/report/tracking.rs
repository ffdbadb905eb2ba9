//! How tracking went, frame by frame: states as colours, losses as a table, what was measured as plots.

use crate::report::svg::{Plot, Series};
use crate::run::frames::{FrameFate, FrameRow};
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
pub(super) fn states() -> Vec<State> {
    vec![
        GOOD, DEGRADED, LOST, FRAGMENT, STARTING, UNREADABLE, REPEATED, DROPPED,
    ]
}

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
        FrameFate::BeforeSeed => STARTING,
        FrameFate::Skipped(_) => UNREADABLE,
        FrameFate::Repeated => REPEATED,
        FrameFate::Dropped => DROPPED,
    }
}

/// Stretches of equal state as (first row, row after the last).
fn stretches(rows: &[FrameRow]) -> Vec<(usize, usize)> {
    let alike = rows.chunk_by(|a, b| state(a) == state(b));
    let stretches = alike.scan(0, |end, rows| {
        *end += rows.len();
        Some((*end - rows.len(), *end))
    });
    stretches.collect()
}

/// Coloured stretches over the frames: share of the width, colour, description.
pub(super) fn ribbon(rows: &[FrameRow]) -> Vec<(f64, &'static str, String)> {
    stretches(rows)
        .into_iter()
        .map(|(first, end)| {
            let (name, colour) = state(&rows[first]);
            let share = (end - first) as f64 / rows.len() as f64;
            let text = format!(
                "{name}: frames {} to {}",
                rows[first].index,
                rows[end - 1].index
            );
            (share, colour, text)
        })
        .collect()
}

/// Where tracking was lost or images were missing, and why.
pub(super) fn losses(rows: &[FrameRow]) -> Vec<Vec<String>> {
    stretches(rows)
        .into_iter()
        .filter_map(|(first, end)| {
            let what = match &rows[first].fate {
                FrameFate::Processed(report) if report.state == TrackingState::Lost => {
                    let reason = report.reason.map(|r| r.to_string()).unwrap_or_default();
                    format!("lost: {reason}")
                }
                FrameFate::Processed(report) => format!("fragment {}", report.fragment?.id),
                FrameFate::Skipped(reason) => format!("unreadable: {reason}"),
                FrameFate::Dropped => "dropped: the program was behind".to_owned(),
                _ => return None,
            };
            let frames = format!("{} to {}", rows[first].index, rows[end - 1].index);
            Some(vec![frames, what])
        })
        .collect()
}

/// What was measured with each frame.
pub(super) fn tracking_plots(rows: &[FrameRow]) -> Vec<Plot> {
    let curve = |name: &str, colour, value: &dyn Fn(&FrameReport) -> f64| Series {
        name: name.to_owned(),
        colour,
        points: rows
            .iter()
            .map(|row| {
                let value = row
                    .report()
                    .filter(|report| report.state != TrackingState::Initialising)
                    .map_or(f64::NAN, value);
                [row.index as f64, value]
            })
            .collect(),
        ..Series::default()
    };
    let plot = |title: &str, y_label: &str, series| Plot {
        title: title.to_owned(),
        x_label: "frame".into(),
        y_label: y_label.to_owned(),
        series,
        from_zero: true,
        ..Plot::default()
    };
    vec![
        plot(
            "How much of the keyframe is seen again and agrees",
            "share",
            vec![
                curve("seen", "#b0b0b0", &|report| f64::from(report.usage)),
                curve("agrees", "#1f6fb4", &|report| f64::from(report.good_share)),
            ],
        ),
        plot(
            "Difference of grey values",
            "grey levels",
            vec![curve("", "#1f6fb4", &|report| f64::from(report.residual))],
        ),
        plot(
            "Exposure relative to the keyframe",
            "gain",
            vec![curve("", "#1f6fb4", &|report| {
                f64::from(report.exposure_gain)
            })],
        ),
        plot(
            "Time per frame",
            "ms",
            vec![
                curve("tracking and depth", "#c07a28", &|report| {
                    report.milliseconds.tracking + report.milliseconds.depth
                }),
                curve("tracking", "#1f6fb4", &|report| {
                    report.milliseconds.tracking
                }),
            ],
        ),
    ]
}
