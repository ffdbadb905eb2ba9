//! What the user reads when a run is over.

use super::summary::{Status, Summary};
use super::threads::Tracked;
use super::whole::Finished;
use crate::commands::print_json;
use crate::failure::{CommandResult, Failure};
use crate::output::OutputFolder;
use std::path::Path;

/// Says how it went; the exit code.
pub fn conclude(finished: &Finished, folder: &OutputFolder, json: bool) -> CommandResult {
    let text = format!(
        "{}\n{}\n",
        finished.verdict,
        summary_lines(&finished.summary, folder.path())
    );
    if json {
        eprint!("{text}");
        print_json(&finished.summary)?;
    } else {
        print!("{text}");
    }
    match &finished.failure {
        Some(reason) => Err(Failure::running(format!(
            "{reason} (what was found until then is saved in {})",
            folder.path().display()
        ))),
        None => Ok(finished.outcome),
    }
}

/// One sentence for people.
pub fn verdict(summary: &Summary, tracked: &Tracked) -> String {
    let share = percent(summary.tracked, summary.frames);
    let num_apart = summary.num_apart();
    match summary.status {
        Status::NotInitialised => {
            let last = tracked.rows.iter().rev().find_map(|row| row.report());
            let reason = last
                .and_then(|report| report.reason)
                .map(|reason| reason.to_string())
                .unwrap_or_else(|| "no usable frame".into());
            format!(
                "Tracking never started ({reason}). The camera must move sideways while it sees texture; there is no map."
            )
        }
        Status::NotRecognised if num_apart > 0 => format!(
            "The camera was never recognised in the map. What it saw is kept as {num_apart} fragment(s) beside it, which a later run may join."
        ),
        Status::NotRecognised => "The camera was never recognised in the map: no frame shows a place that it holds. The map is as it was.".to_owned(),
        Status::Fragment => format!(
            "Tracking was lost and went on in a fragment that was never recognised as part of the map; {share} % of the frames have a pose in the map."
        ),
        Status::Lost => format!(
            "Tracking was lost for good; {share} % of the frames have a pose, and what was mapped until then is saved."
        ),
        Status::Unreadable => format!(
            "The images became unreadable; {share} % of the frames until then have a pose."
        ),
        Status::Interrupted if summary.keyframes == 0 => {
            "Interrupted before tracking started; there is no map.".to_owned()
        }
        Status::Interrupted => format!(
            "Interrupted; {share} % of the frames until then have a pose, everything is saved."
        ),
        Status::Done if summary.lost_episodes > 0 => format!(
            "{share} % of the frames have a pose; tracking was lost {} times and found again.",
            summary.lost_episodes
        ),
        Status::Done => format!("{share} % of the frames have a pose; tracking was never lost."),
    }
}

/// A share in percent, rounded down where only some are missing: 100 is all of them.
fn percent(part: usize, whole: usize) -> String {
    let share = 100.0 * part as f64 / whole.max(1) as f64;
    if (99.0..100.0).contains(&share) {
        format!("{:.1}", (10.0 * share).floor() / 10.0)
    } else {
        format!("{share:.0}")
    }
}

/// Numbers for people.
fn summary_lines(summary: &Summary, folder: &Path) -> String {
    let unit = summary.unit();
    let memory = summary
        .peak_rss_bytes
        .map(|bytes| format!(", {:.0} MB of memory", bytes as f64 / 1e6))
        .unwrap_or_default();
    let mut lines = if summary.localise_only {
        format!(
            "  {} frames; the map of {} keyframes stays as it is, no new one is written\n",
            summary.frames, summary.keyframes
        )
    } else {
        format!(
            "  {} frames, {} keyframes, {} measurements mapped\n  \
             map: cells of {} {unit}, {} leaves\n",
            summary.frames,
            summary.keyframes,
            summary.points,
            summary.map.resolution,
            summary.map.leaves,
        )
    };
    if !summary.localise_only && summary.keyframes > 0 {
        lines += &format!("  frame: {}\n", summary.frame);
    }
    if let Some(inertial) = &summary.inertial {
        lines += &format!("  {}\n", inertial.line());
    }
    if let Some(cell) = &summary.map.cell {
        lines += &format!("  {}\n", cell.reason(unit));
    }
    lines += &about_fragments(summary);
    if summary.parts > 1 {
        lines += &format!(
            "  the map has {} parts that only tracked motion holds together (last column of keyframes.txt)\n",
            summary.parts
        );
    }
    for bridge in &summary.bridges {
        lines += &format!(
            "  after a loss the map goes on at frame {} with a scale known to {:.0} % (95 %)\n",
            bridge.first_frame,
            196.0 * bridge.scale_sigma
        );
    }
    if summary.repeated > 0 {
        lines += &format!(
            "  {} more frames repeat the one before and were left out\n",
            summary.repeated
        );
    }
    lines += &format!(
        "  {:.1} s, {:.1} frames per second{memory}\n",
        summary.seconds.total, summary.frames_per_second,
    );
    lines += &error_lines(summary);
    lines += &format!("  look at {}", folder.join("report.html").display());
    lines
}

/// What is known from a truth.
fn error_lines(summary: &Summary) -> String {
    let mut lines = String::new();
    if let Some(fit) = &summary.trajectory {
        lines += &format!("  error against the reference: {:.4} m\n", fit.ate_rmse);
    }
    if let Some(depth) = &summary.depth {
        lines += &format!(
            "  depth: {:.0} % of the textured pixels within 3 %\n",
            100.0 * depth.shares.within_3_percent
        );
    }
    if let (Some(map), Some(report)) = (summary.observed_map_error(), &summary.map_error) {
        lines += &format!(
            "  map against the truth: AUC {:.3}, MCC {:.3}; {} cells over 10 cm outside the room, MCC {:.3} with these\n",
            map.auc, map.mcc, report.predicted_beyond, report.mcc_with_beyond
        );
    }
    lines
}

/// What became of what was mapped after losses.
fn about_fragments(summary: &Summary) -> String {
    let (num, num_apart) = (summary.fragments.len(), summary.num_apart());
    if num == 0 {
        return String::new();
    }
    let mut lines = format!(
        "  {num} {} after losses, {} joined to the map, {num_apart} apart\n",
        if num == 1 { "fragment" } else { "fragments" },
        num - num_apart
    );
    if let Some(fragment) = summary.map_was_fragment {
        lines += &format!(
            "  the map is what was made after a loss, which is much larger; the first one is in trajectory_fragment_{fragment}.txt\n"
        );
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::percent;

    #[test]
    fn a_hundred_percent_are_all() {
        let said = [(613, 613), (610, 613), (9999, 10000), (605, 613), (0, 0)];
        let said = said.map(|(part, whole)| percent(part, whole));
        assert_eq!(said, ["100", "99.5", "99.9", "99", "0"]);
    }
}
