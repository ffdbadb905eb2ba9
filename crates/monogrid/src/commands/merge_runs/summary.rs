//! What was joined and what was not, for people and as `summary.json`.

use super::component::Written;
use super::inputs::Part;
use crate::config::RunConfig;
use monogrid_slam::{FragmentId, Meeting};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;

/// `summary.json`.
pub fn summary(
    parts: &[Part],
    owners: &BTreeMap<FragmentId, usize>,
    meetings: &[Meeting],
    written: &[Written],
    config: &RunConfig,
) -> Value {
    let mut recordings: Vec<&Part> = parts.iter().collect();
    recordings.sort_by_key(|part| part.number);
    let recordings: Vec<Value> = recordings
        .iter()
        .map(|part| {
            json!({
                "number": part.number,
                "path": part.path.display().to_string(),
                "source": part.earlier.session.source,
                "keyframes": part.keyframes.len(),
            })
        })
        .collect();
    let meetings: Vec<Value> = meetings
        .iter()
        .map(|meeting| {
            let (a, b) = meeting.fragments;
            let (a, b) = (owners.get(&a), owners.get(&b));
            json!({
                "recordings": [a.min(b), a.max(b)],
                "sightings": meeting.sightings,
                "agreeing": meeting.agreeing,
                "contradicting": meeting.contradicting,
                "is_enough": meeting.is_enough(&config.slam.merge),
            })
        })
        .collect();
    let components: Vec<Value> = written.iter().map(component).collect();
    let facts = &written[0].facts;
    json!({
        "scale": facts["scale"],
        "frame": facts["frame"],
        "up": facts["up"],
        "floor": facts["floor"],
        "recordings": recordings,
        "meetings": meetings,
        "components": components,
    })
}

fn component(written: &Written) -> Value {
    let mut recordings = written.recordings.clone();
    recordings.sort_unstable();
    let said = recordings
        .iter()
        .map(|(number, keyframes)| json!({ "number": number, "keyframes": keyframes }));
    json!({
        "recording": format!("{}recording.mgk", written.place),
        "scale": written.facts["scale"],
        "recordings": said.collect::<Vec<Value>>(),
    })
}

/// Says what was joined, what was not, and why.
pub fn print_summary(out: &Path, summary: &Value) {
    for recording in summary["recordings"].as_array().into_iter().flatten() {
        let (number, path) = (&recording["number"], &recording["path"]);
        println!(
            "{number}: {}, {} keyframes",
            path.as_str().unwrap_or_default(),
            recording["keyframes"]
        );
    }
    for meeting in summary["meetings"].as_array().into_iter().flatten() {
        let pair = &meeting["recordings"];
        let (agreeing, contradicting) = (&meeting["agreeing"], &meeting["contradicting"]);
        println!(
            "{} and {}: {} pairs of keyframes show the same; {} keyframes agree ({} pairs aligned), {} contradict them{}",
            pair[0],
            pair[1],
            meeting["sightings"],
            agreeing["keyframes"],
            agreeing["aligned"],
            contradicting["keyframes"],
            match meeting["is_enough"].as_bool() {
                Some(true) => "",
                _ => ": not enough",
            }
        );
    }
    for component in summary["components"].as_array().into_iter().flatten() {
        let recordings = component["recordings"].as_array();
        let recordings = recordings.into_iter().flatten();
        let numbers = recordings.map(|recording| recording["number"].to_string());
        let numbers: Vec<String> = numbers.collect();
        println!(
            "{}: {} (scale {})",
            out.join(component["recording"].as_str().unwrap_or_default())
                .display(),
            numbers.join(" + "),
            component["scale"].as_str().unwrap_or_default()
        );
    }
}
