//! The thread that maps: integrates keyframes as they are finished and lets the maps follow the graph.

use super::change::Change;
use crate::usage::{give_way, thread_cpu};
use monogrid_occupancy::MapError;
use monogrid_slam::Keyframe;
use monogrid_slam::mapping::{KeyframeCamera, KeyframeScan, LiveMaps};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, TryRecvError};
use std::time::Duration;

/// Integrates keyframes as they are finished, and lets the maps follow the graph while there is nothing
/// else to do; returns the maps and the CPU time used.
pub fn grow_maps(
    changes: &Receiver<Change>,
    mut maps: LiveMaps,
    camera: &KeyframeCamera,
) -> (Result<LiveMaps, MapError>, Duration) {
    give_way();
    let mut result = Ok(());
    let mut has_work = false;
    loop {
        let received = if has_work {
            changes.try_recv()
        } else {
            changes.recv().map_err(|_| TryRecvError::Disconnected)
        };
        match received {
            // what is left to be done is done for the final maps, on all threads
            Err(TryRecvError::Disconnected) => break,
            // after an error changes are still received, so that nobody waits for this thread
            _ if result.is_err() => has_work = false,
            Ok(change) => {
                result = take_change(&mut maps, &change, camera);
                has_work = true;
            }
            Err(TryRecvError::Empty) => match maps.step() {
                Ok(has_worked) => has_work = has_worked,
                Err(error) => result = Err(error),
            },
        }
    }
    (result.map(|()| maps), thread_cpu())
}

fn take_change(
    maps: &mut LiveMaps,
    change: &Change,
    camera: &KeyframeCamera,
) -> Result<(), MapError> {
    match change {
        Change::Finished(keyframe, snapshot) => {
            let scan = scan_of(keyframe, maps, camera);
            match snapshot.in_main_map(keyframe.id) {
                Some(pose) => maps.add(scan, *pose)?,
                None => maps.add_apart(scan),
            }
            maps.follow(Arc::clone(snapshot))
        }
        Change::Revised(keyframe) => {
            maps.revise(scan_of(keyframe, maps, camera));
            Ok(())
        }
        Change::Moved(snapshot) | Change::End(snapshot, ..) => maps.follow(Arc::clone(snapshot)),
    }
}

/// What of a keyframe is mapped now. Filling plain surfaces is left for the final maps, which have better
/// depth, as long as nobody looks.
fn scan_of(keyframe: &Keyframe, maps: &LiveMaps, camera: &KeyframeCamera) -> KeyframeScan {
    let config = maps.mapper().config();
    let image = maps.is_read().then_some(&keyframe.image);
    KeyframeScan::new(keyframe.id, &keyframe.pixels, image, camera, config)
}
