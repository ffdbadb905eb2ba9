//! Every map in one line.

use super::csv_cell;
use crate::sweep::record::Scores;
use crate::sweep::result::RecordingResult;
use std::fmt::Write;

/// Every map in one line, for other programs.
pub fn all_maps_csv(results: &[RecordingResult]) -> String {
    let mut text = String::from(
        "recording,profile,model,parameter,resolution,keyframes,points,seconds,bytes,bytes_likelihood,\
         nodes,leaves,extent_x,extent_y,extent_z,bt_bytes,ot_bytes,auc_observed,auc_known,\
         auc_everything,auc_safety,auc_26_observed,auc_26_known,mcc_observed,precision_observed,\
         recall_observed,f1_observed,mcc_known,coverage_free,coverage_occupied,\
         coverage_free_in_view,coverage_occupied_in_view,brier,ssd,occupied_ratio\n",
    );
    for result in results {
        for record in &result.records {
            let entry = &record.entry;
            let parameter = entry.model.parameter().map(|p| p.to_string());
            let _ = write!(
                text,
                "{},{},{},{},{}",
                csv_cell(&result.name),
                result.profile,
                entry.model.family(),
                parameter.unwrap_or_default(),
                entry.resolution
            );
            let Some(built) = record.built() else {
                text.push_str(",x\n");
                continue;
            };
            let optional = |value: Option<String>| value.unwrap_or_default();
            let _ = write!(
                text,
                ",{},{},{:.4},{},{},{},{},{:.3},{:.3},{:.3},{},{}",
                built.keyframes,
                built.points,
                built.seconds,
                built.bytes,
                built.bytes_likelihood,
                optional(built.nodes.map(|n| n.to_string())),
                built.leaves,
                built.extent[0],
                built.extent[1],
                built.extent[2],
                optional(built.bt_bytes.map(|n| n.to_string())),
                optional(built.ot_bytes.map(|n| n.to_string())),
            );
            if let Some(scores) = &built.scores {
                for value in score_columns(scores) {
                    let _ = write!(
                        text,
                        ",{}",
                        value.map_or(String::new(), |v| format!("{v:.6}"))
                    );
                }
            }
            text.push('\n');
        }
    }
    text
}

fn score_columns(scores: &Scores) -> [Option<f64>; 18] {
    [
        Some(scores.observed.auc),
        Some(scores.known.auc),
        Some(scores.everything.auc),
        Some(scores.safety.auc),
        Some(scores.observed.auc_26),
        Some(scores.known.auc_26),
        Some(scores.observed.mcc),
        Some(scores.observed.precision),
        Some(scores.observed.recall),
        Some(scores.observed.f1),
        Some(scores.known.mcc),
        Some(scores.coverage_free),
        Some(scores.coverage_occupied),
        scores.coverage_free_in_view,
        scores.coverage_occupied_in_view,
        scores.brier,
        Some(scores.ssd),
        scores.occupied_ratio,
    ]
}
