//! Where the worlds of agents lie in a joined map.

use crate::messages::RunKey;
use monogrid_datasets::{DatasetError, ReadOptions, Recording};
use monogrid_geometry::{Rotation, Sim3, Vec3, rotation_exp, rotation_log};
use std::collections::BTreeMap;
use std::path::Path;

/// Identity of a frame: its index in the source and its time, nanoseconds.
pub type Frame = (u64, i64);

/// Poses of the keyframes of a run in its own world, by frame.
pub type OwnPoses = BTreeMap<Frame, Sim3>;

/// Where the worlds of runs lie in a map that holds together, or in the world of one of them.
pub type Place = BTreeMap<RunKey, Sim3>;

/// The run in whose world all others are placed: `current` as long as it is joined with another
/// one, so that worlds do not change; else the first of those that are in the largest map, so that
/// a run that is joined with nobody keeps nobody from having a place. `order` has the runs in the
/// order in which they came, `joined` the largest map first.
#[must_use]
pub fn shared_run(current: Option<&RunKey>, order: &[&RunKey], joined: &[Place]) -> Option<RunKey> {
    let with_others = |run: &RunKey| joined.iter().any(|m| m.len() >= 2 && m.contains_key(run));
    let current_stays = current.filter(|run| with_others(run));
    let largest = joined.iter().find(|map| map.len() >= 2);
    let in_largest = || {
        let map = largest?;
        order.iter().copied().find(|run| map.contains_key(*run))
    };
    let run = current_stays.or_else(in_largest);
    run.or(current).or(order.first().copied()).cloned()
}

/// Where the worlds of all lie in the world of one of them: those that hold together with it in one
/// of the joined maps.
#[must_use]
pub fn shared_from_agents(joined: &[Place], shared: &RunKey) -> Place {
    let Some(map) = joined.iter().find(|map| map.contains_key(shared)) else {
        return Place::from([(shared.clone(), Sim3::identity())]);
    };
    let shared_from_merged = map[shared].inverse();
    let in_shared = |(run, merged_from_agent): (&RunKey, &Sim3)| {
        let similarity = if run == shared {
            Sim3::identity()
        } else {
            shared_from_merged * *merged_from_agent
        };
        (run.clone(), similarity)
    };
    map.iter().map(in_shared).collect()
}

/// Reads where the runs lie in the result of `merge-runs` in a folder: in each map that holds
/// together, the largest first. The recordings that were joined name their sources `NAME/RUN`;
/// `own` has the poses with which they were joined.
///
/// # Errors
/// When a recording cannot be read.
pub fn read_joined(
    folder: &Path,
    own: &BTreeMap<RunKey, OwnPoses>,
) -> Result<Vec<Place>, DatasetError> {
    let place = |number: usize| match number {
        0 => folder.to_owned(),
        apart => folder.join(format!("apart_{apart}")),
    };
    let files = (0..).map(|number| place(number).join("recording.mgk"));
    let files = files.take_while(|file| file.is_file());
    files
        .map(|file| {
            let merged = Recording::read(&file, ReadOptions { with_images: false })?;
            Ok(merged_from_agents(&merged, own))
        })
        .collect()
}

/// Where the worlds of runs lie in a recording that was merged of theirs.
fn merged_from_agents(merged: &Recording, own: &BTreeMap<RunKey, OwnPoses>) -> Place {
    let continuation = merged.continuation.as_ref();
    let sessions = continuation.map_or(&[][..], |c| &c.sessions);
    let mut pairs: BTreeMap<RunKey, Vec<(Sim3, Sim3)>> = BTreeMap::new();
    for keyframe in &merged.keyframes {
        let mut before = sessions.iter().filter(|s| s.first_keyframe <= keyframe.id);
        let source = before.next_back().map(|session| session.source.as_str());
        let run = source.and_then(|source| source.parse::<RunKey>().ok());
        let (Some(run), Some(in_merged)) = (run, keyframe.world_from_keyframe) else {
            continue;
        };
        let frame = (keyframe.frame_index, keyframe.timestamp_ns);
        if let Some(in_own) = own.get(&run).and_then(|poses| poses.get(&frame)) {
            pairs.entry(run).or_default().push((in_merged, *in_own));
        }
    }
    let similarities = pairs.into_iter();
    similarities
        .filter_map(|(run, pairs)| Some((run, similarity_of(&pairs)?)))
        .collect()
}

/// The `a_from_b` of keyframes whose poses are known in both worlds: means of the logarithms of
/// scale and rotation, and of what is then left of the positions. Unlike a fit of positions it
/// needs one keyframe only, and no way that is bent. `None` without keyframes.
#[must_use]
pub fn similarity_of(poses: &[(Sim3, Sim3)]) -> Option<Sim3> {
    let (first_a, first_b) = poses.first()?;
    let mean = |of: &dyn Fn(&(Sim3, Sim3)) -> Vec3| {
        poses.iter().map(of).sum::<Vec3>() / poses.len() as f64
    };
    let log_scale = mean(&|(a, b)| Vec3::repeat((a.scale / b.scale).ln())).x;
    let about = first_a.rotation * first_b.rotation.inverse();
    let rotation_of = |a: &Sim3, b: &Sim3| a.rotation * b.rotation.inverse();
    let left = mean(&|(a, b)| rotation_log(&(rotation_of(a, b) * about.inverse())));
    let rotation: Rotation = rotation_exp(&left) * about;
    let scale = log_scale.exp();
    let translation = mean(&|(a, b)| a.translation - scale * (rotation * b.translation));
    Some(Sim3::new(scale, rotation, translation))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(scale: f64, angles: [f64; 3], at: [f64; 3]) -> Sim3 {
        Sim3::new(scale, rotation_exp(&Vec3::from(angles)), Vec3::from(at))
    }

    #[test]
    fn the_similarity_of_keyframes_is_found_again_on_a_straight_way() {
        let a_from_b = pose(2.5, [0.3, -1.2, 0.4], [1.0, -2.0, 3.0]);
        let in_b =
            (0..4).map(|k| pose(1.0 + 0.1 * f64::from(k), [0.0; 3], [f64::from(k), 0.0, 0.0]));
        let pairs: Vec<(Sim3, Sim3)> = in_b.map(|b| (a_from_b * b, b)).collect();
        for count in [1, 4] {
            let found = similarity_of(&pairs[..count]).unwrap();
            assert!((found.inverse() * a_from_b).log().norm() < 1e-9);
        }
        assert_eq!(similarity_of(&[]), None);
    }

    #[test]
    fn who_is_apart_has_no_place_in_the_shared_world() {
        let run = |name: &str| RunKey::new(name, 1).unwrap();
        let at = |x: f64| pose(2.0, [0.0; 3], [x, 0.0, 0.0]);
        let joined = [
            Place::from([(run("c"), at(7.0))]),
            Place::from([(run("a"), at(1.0)), (run("b"), at(3.0))]),
        ];
        let shared = shared_from_agents(&joined, &run("a"));
        assert_eq!(shared.len(), 2);
        assert_eq!(shared[&run("a")], Sim3::identity());
        // two units of the map are one of a, as of b
        assert_eq!(shared[&run("b")].translation, Vec3::new(1.0, 0.0, 0.0));
        assert_eq!(shared_from_agents(&joined, &run("d")).len(), 1);
    }

    #[test]
    fn the_shared_world_stays_and_is_not_that_of_a_run_that_is_alone() {
        let run = |name: &str| RunKey::new(name, 1).unwrap();
        let map = |names: &[&str]| -> Place {
            let runs = names.iter().map(|name| (run(name), Sim3::identity()));
            runs.collect()
        };
        let runs = ["x", "a", "b", "c"].map(run);
        let order: Vec<&RunKey> = runs.iter().collect();
        let shared = |current: Option<&str>, joined: &[Place]| {
            shared_run(current.map(run).as_ref(), &order, joined).unwrap()
        };
        assert_eq!(shared(None, &[]), run("x"));
        // who came first and is joined with nobody
        let without_x = [map(&["a", "b"]), map(&["x"])];
        assert_eq!(shared(None, &without_x), run("a"));
        assert_eq!(shared(Some("x"), &without_x), run("a"));
        // who is joined with it later does not move the others
        assert_eq!(shared(Some("a"), &[map(&["a", "b", "x"])]), run("a"));
        assert_eq!(
            shared(Some("a"), &[map(&["b", "c"]), map(&["a"])]),
            run("b")
        );
        assert_eq!(shared(Some("a"), &[map(&["a"]), map(&["b"])]), run("a"));
    }
}
