//! Every map in one line.

use super::{csv_cell, or};
use crate::sweep::plan::Entry;
use crate::sweep::record::Scores;
use crate::sweep::result::RecordingResult;

/// Every map in one line, for other programs.
pub fn all_maps_csv(results: &[RecordingResult]) -> String {
    let mut text = String::from(
        "recording,profile,model,parameter,resolution,keyframes,points,seconds,bytes,\
         bytes_likelihood,nodes,leaves,extent_x,extent_y,extent_z,bt_bytes,ot_bytes,auc_observed,\
         auc_known,auc_everything,auc_safety,auc_26_observed,auc_26_known,mcc_observed,\
         precision_observed,recall_observed,f1_observed,mcc_known,coverage_free,\
         coverage_occupied,coverage_free_in_view,coverage_occupied_in_view,brier,ssd,\
         occupied_ratio\n",
    );
    for result in results {
        for record in &result.records {
            let Entry { model, resolution } = record.entry;
            let (name, family) = (csv_cell(&result.name), model.family());
            let parameter = or("", model.parameter(), |p| p.to_string());
            text += &format!(
                "{name},{},{family},{parameter},{resolution}",
                result.profile
            );
            let Some(built) = record.built() else {
                text.push_str(",x\n");
                continue;
            };
            let [x, y, z] = built.extent;
            text += &format!(
                ",{},{},{:.4},{},{},{},{},{x:.3},{y:.3},{z:.3},{},{}",
                built.keyframes,
                built.points,
                built.seconds,
                built.bytes,
                built.bytes_likelihood,
                or("", built.nodes, |n| n.to_string()),
                built.leaves,
                or("", built.bt_bytes, |n| n.to_string()),
                or("", built.ot_bytes, |n| n.to_string()),
            );
            for value in built.scores.iter().flat_map(score_columns) {
                text += &format!(",{}", or("", value, |v| format!("{v:.6}")));
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
