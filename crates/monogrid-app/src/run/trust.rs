//! How far to trust a map, in one sentence: what is least certain, and how to film so that it is.

use crate::input::seen;
use crate::run::summary::{Status, Summary};
use monogrid_calibration::CameraMotion;

/// Things that are named, at most: the least certain ones.
const MAX_NAMED: usize = 3;
/// Share of the frames without a pose from which coverage is named.
const MIN_MISSING: f64 = 0.1;

/// Share of the poses from which it is said that they are uncertain.
const MIN_UNCERTAIN: f64 = 0.2;

/// What is uncertain of a map, and what makes it certain.
struct Uncertainty {
    what: &'static str,
    cure: &'static str,
}

/// The sentence; `None` where there is no map.
pub fn trust(summary: &Summary) -> Option<String> {
    let has_map = summary.keyframes > 0 && !summary.localise_only;
    let is_refused = matches!(summary.status, Status::StandsStill | Status::OnlyTurns);
    if !has_map || is_refused {
        return None;
    }
    Some(sentence(&uncertainties(summary)))
}

/// What is uncertain, the worst first.
fn uncertainties(summary: &Summary) -> Vec<Uncertainty> {
    let depth = of_depth(summary);
    let all = depth.into_iter().chain(of_places(summary));
    let found = all.filter(|(is_doubted, ..)| *is_doubted);
    found
        .map(|(_, what, cure)| Uncertainty { what, cure })
        .collect()
}

/// Whether something is uncertain, what it is, and what makes it certain.
type Doubt = (bool, &'static str, &'static str);

fn of_depth(summary: &Summary) -> [Doubt; 4] {
    [
        (
            summary.points == 0,
            "the depth, none of which is precise enough to be mapped",
            "give --calibration, or move sideways before what is near",
        ),
        (
            summary.keyframes == 1,
            "the depth, which was seen from about one place",
            "move sideways",
        ),
        (
            summary.motion == Some(seen::name(CameraMotion::Unclear)),
            "the depth: the images do not show whether the camera moved or only turned",
            "move sideways, by a tenth of the distance to what it sees or more",
        ),
        (
            summary.camera.is_focal_assumed,
            "the focal length, which is assumed: depth and shape may be stretched",
            "turn the camera while moving it sideways, or give --calibration",
        ),
    ]
}

fn of_places(summary: &Summary) -> [Doubt; 8] {
    let missing = 1.0 - summary.seen() as f64 / summary.frames.max(1) as f64;
    let is_open = summary.loop_closures == 0 && summary.keyframes >= OPEN_PATH;
    let uncertain = summary.uncertain as f64 / summary.tracked.max(1) as f64;
    [
        (
            uncertain >= MIN_UNCERTAIN,
            "the poses of many frames, which too little in view held",
            "keep something with texture in view",
        ),
        (
            missing >= MIN_MISSING,
            "what the frames without a pose saw, which is not in the map",
            "film slowly where tracking was lost",
        ),
        (
            summary.parts > 1 || !summary.bridges.is_empty(),
            "how its parts lie to each other",
            "film again across the places where tracking was lost",
        ),
        (
            !summary.up.is_certain,
            "up, and with it the floor",
            "hold the camera level while filming walls and floor, or give --up",
        ),
        (
            summary.up.is_certain && summary.level_surface.is_some(),
            "the floor: z = 0 is the largest level surface, perhaps a table",
            "film the floor too",
        ),
        (
            summary.up.is_certain && summary.floor.is_none() && summary.level_surface.is_none(),
            "the floor, which was not seen",
            "film the floor too",
        ),
        (
            summary.scale == crate::run::summary::ARBITRARY,
            "the scale, which one camera does not show",
            "see monogrid rescale",
        ),
        (
            is_open,
            "drift, which no closed loop has corrected",
            "end where you began",
        ),
    ]
}

/// Keyframes from which a path without a loop may have drifted.
const OPEN_PATH: usize = 30;

fn sentence(uncertainties: &[Uncertainty]) -> String {
    if uncertainties.is_empty() {
        return "How far to trust this map: camera, scale, up and floor are known, and (nearly) all \
            frames are in it.".to_owned();
    }
    let named = uncertainties.iter().take(MAX_NAMED);
    let named: Vec<String> = named
        .map(|one| format!("{} ({})", one.what, one.cure))
        .collect();
    format!(
        "How far to trust this map: least certain {} {}.",
        if named.len() == 1 { "is" } else { "are" },
        named.join("; ")
    )
}

#[cfg(test)]
mod tests {
    use super::{Uncertainty, sentence};

    #[test]
    fn the_three_least_certain_things_are_named() {
        assert!(sentence(&[]).contains("are known"));
        let uncertainties =
            ["focal length", "up", "scale", "drift"].map(|what| Uncertainty { what, cure: "x" });
        let said = sentence(&uncertainties);
        assert!(
            said.contains("focal length (x); up (x); scale (x)."),
            "{said}"
        );
        assert!(!said.contains("drift"));
        assert!(sentence(&uncertainties[..1]).contains("least certain is focal length"));
    }
}
