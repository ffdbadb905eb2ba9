//! What the user reads when a run is over.

use crate::input::seen::{name, no_map};
use crate::output::OutputFolder;
use crate::process::failure::{CommandResult, Failure};
use crate::process::print_json;
use crate::run::sensed::InertialSummary;
use crate::run::summary::{Status, Summary};
use crate::run::tracking::tracked::Tracked;
use crate::run::whole::Finished;
use monogrid_calibration::CameraMotion;
use std::path::Path;

/// Says how it went; the exit code.
pub fn conclude(finished: &Finished, folder: &OutputFolder, json: bool) -> CommandResult {
    let lines = summary_lines(&finished.summary, folder.path());
    let text = format!("{}\n{lines}\n", finished.verdict);
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
    let (num_apart, num_lost) = (summary.num_apart(), summary.lost_episodes);
    match summary.status {
        Status::NotInitialised => {
            let last = tracked.rows.iter().rev().find_map(|row| row.report());
            let reason = last.and_then(|report| report.reason);
            let reason = reason.map_or("no usable frame".into(), |reason| reason.to_string());
            format!(
                "Tracking never started ({reason}). The camera must move sideways while it sees \
                 texture; there is no map."
            )
        }
        Status::StandsStill | Status::OnlyTurns => {
            let said = tracked.no_map.and_then(no_map);
            said.unwrap_or("There is no map.").to_owned()
        }
        Status::NotRecognised if num_apart > 0 => format!(
            "The camera was never recognised in the map. What it saw is kept as {num_apart} \
             fragment(s) beside it, which a later run may join."
        ),
        Status::NotRecognised => "The camera was never recognised in the map: no frame shows a \
            place that it holds. The map is as it was."
            .to_owned(),
        Status::Fragment => format!(
            "Tracking was lost and went on in a fragment that was never recognised as part of the \
             map; {share} % of the frames have a pose in the map."
        ),
        Status::Lost => format!(
            "Tracking was lost for good; {share} % of the frames have a pose, and what was mapped \
             until then is saved."
        ),
        Status::Failed => {
            format!("A part of the program failed; {share} % of the frames until then have a pose.")
        }
        Status::Unreadable => {
            format!("The images became unreadable; {share} % of the frames until then have a pose.")
        }
        Status::BrokeOff => format!(
            "The source broke off before its end; {share} % of the frames until then have a pose."
        ),
        Status::Interrupted if summary.keyframes == 0 => {
            "Interrupted before tracking started; there is no map.".to_owned()
        }
        Status::Interrupted => format!(
            "Interrupted; {share} % of the frames until then have a pose, everything is saved."
        ),
        Status::Partial => format!(
            "Only {share} % of the frames have a pose in the map: {}.",
            after_losses(num_lost, num_apart)
        ),
        Status::Uncertain => format!(
            "{share} % of the frames have a pose, but only {} % one that is certain: too little in \
             view held the others, and the map may be wrong. Film so that something with texture \
             is always in view, and nobody fills it.",
            percent(summary.certain(), summary.frames)
        ),
        Status::Done => done(summary, &share),
    }
}

/// What is said of a run that went well.
fn done(summary: &Summary, share: &str) -> String {
    if summary.keyframes == 1 && !summary.localise_only {
        return format!(
            "All that is mapped was seen from about one place: the map has one keyframe, and {} of \
             {} frames were seen from near it.",
            summary.tracked, summary.frames
        );
    }
    let losses = after_losses(summary.lost_episodes, summary.num_apart());
    let interpolated = (summary.interpolated > 0).then(|| {
        let share = percent(summary.interpolated, summary.frames);
        format!(" ({share} % by the frames before and after short losses)")
    });
    let interpolated = interpolated.unwrap_or_default();
    format!("{share} % of the frames have a pose{interpolated}; {losses}.")
}

/// What became of tracking after it was lost so many times, of which so many left fragments that
/// are not in the map.
fn after_losses(num_lost: usize, num_apart: usize) -> String {
    let times = |num: usize| match num {
        1 => "once".to_owned(),
        num => format!("{num} times"),
    };
    match (num_lost, num_apart) {
        (0, _) => "tracking was never lost".to_owned(),
        (_, 0) => format!("tracking was lost {} and found again", times(num_lost)),
        (_, 1) => format!(
            "tracking was lost {}, and what was seen after one of the losses is not in the map",
            times(num_lost)
        ),
        _ => format!(
            "tracking was lost {}, and what was seen after {num_apart} of the losses is not in the \
             map",
            times(num_lost)
        ),
    }
}

/// A share in percent, rounded down where only some are missing: 100 is all of them.
fn percent(part: usize, whole: usize) -> String {
    let share = 100.0 * part as f64 / whole.max(1) as f64;
    match share {
        99.0..100.0 => format!("{:.1}", (10.0 * share).floor() / 10.0),
        _ => format!("{share:.0}"),
    }
}

/// Numbers for people.
fn summary_lines(summary: &Summary, folder: &Path) -> String {
    let unit = summary.unit();
    let (frames, keyframes) = (summary.frames, summary.keyframes);
    let mut lines = vec![if summary.localise_only {
        format!(
            "{frames} frames; the map of {keyframes} keyframes stays as it is, no new one is \
             written"
        )
    } else {
        let (points, map) = (summary.points, &summary.map);
        format!(
            "{frames} frames, {keyframes} keyframes, {points} measurements mapped\n  \
             map: cells of {} {unit}, {} leaves",
            map.resolution, map.leaves
        )
    }];
    if !summary.localise_only && keyframes > 0 {
        lines.push(format!("frame: {}", summary.frame));
    }
    lines.extend(summary.trust.clone());
    lines.extend(summary.inertial.as_ref().map(InertialSummary::line));
    let shows_depth = summary
        .motion
        .is_none_or(|did| did == name(CameraMotion::Moves));
    let cell = summary.map.cell;
    lines.extend(cell.map(|cell| cell.reason(unit, shows_depth)));
    lines.extend(about_fragments(summary));
    if summary.parts > 1 {
        lines.push(format!(
            "the map has {} parts that only tracked motion holds together (last column of \
             keyframes.txt)",
            summary.parts
        ));
    }
    for bridge in &summary.bridges {
        lines.push(format!(
            "after a loss the map goes on at frame {} with a scale known to {:.0} % (95 %)",
            bridge.first_frame,
            196.0 * bridge.scale_sigma
        ));
    }
    if summary.repeated > 0 {
        let repeated = summary.repeated;
        lines.push(format!(
            "{repeated} more frames repeat the one before and were left out"
        ));
    }
    let (seconds, rate) = (summary.seconds.total, summary.frames_per_second);
    let memory = summary.peak_rss_bytes.map(|bytes| bytes as f64 / 1e6);
    let memory = memory
        .map(|mb| format!(", {mb:.0} MB of memory"))
        .unwrap_or_default();
    lines.push(format!(
        "{seconds:.1} s, {rate:.1} frames per second{memory}"
    ));
    lines.extend(error_lines(summary));
    lines.push(format!("look at {}", folder.join("report.html").display()));
    format!("  {}", lines.join("\n  "))
}

/// What is known from a truth.
fn error_lines(summary: &Summary) -> impl Iterator<Item = String> {
    let path = summary.trajectory.as_ref();
    let path = path.map(|fit| format!("error against the reference: {:.4} m", fit.ate_rmse));
    let depth = summary.depth.as_ref().map(|depth| {
        let percent = 100.0 * depth.shares.within_3_percent;
        format!("depth: {percent:.0} % of the textured pixels within 3 %")
    });
    let map = summary.observed_map_error().zip(summary.map_error.as_ref());
    let map = map.map(|(map, report)| {
        format!(
            "map against the truth: AUC {:.3}, MCC {:.3}; {} cells over 10 cm outside the room, \
             MCC {:.3} with these",
            map.auc, map.mcc, report.predicted_beyond, report.mcc_with_beyond
        )
    });
    path.into_iter().chain(depth).chain(map)
}

/// What became of what was mapped after losses.
fn about_fragments(summary: &Summary) -> impl Iterator<Item = String> {
    let (num, num_apart) = (summary.fragments.len(), summary.num_apart());
    let joined = (num > 0).then(|| {
        let fragments = if num == 1 { "fragment" } else { "fragments" };
        let num_joined = num - num_apart;
        format!("{num} {fragments} after losses, {num_joined} joined to the map, {num_apart} apart")
    });
    let exchanged = summary
        .map_was_fragment
        .filter(|_| num > 0)
        .map(|fragment| {
            format!(
                "the map is what was made after a loss, which is much larger; the first one is in \
             trajectory_fragment_{fragment}.txt"
            )
        });
    joined.into_iter().chain(exchanged)
}

#[cfg(test)]
mod tests {
    use super::{after_losses, percent};

    #[test]
    fn found_again_is_what_is_in_the_map() {
        assert_eq!(after_losses(0, 0), "tracking was never lost");
        assert!(after_losses(1, 0).ends_with("once and found again"));
        for said in [after_losses(2, 1), after_losses(3, 2)] {
            assert!(!said.contains("found again"), "{said}");
            assert!(said.contains("not in the map"), "{said}");
        }
    }

    #[test]
    fn a_hundred_percent_are_all() {
        let said = [(613, 613), (610, 613), (9999, 10000), (605, 613), (0, 0)];
        let said = said.map(|(part, whole)| percent(part, whole));
        assert_eq!(said, ["100", "99.5", "99.9", "99", "0"]);
    }
}
