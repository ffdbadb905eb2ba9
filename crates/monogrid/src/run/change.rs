//! What tracking tells the recorder and the mapper.

use monogrid_datasets::{Continuation, EndRecord};
use monogrid_slam::{Keyframe, PoseSnapshot};
use std::sync::Arc;

/// A change of the map of keyframes.
#[derive(Clone, Debug)]
pub enum Change {
    /// A keyframe was finished.
    Finished(Arc<Keyframe>, Arc<PoseSnapshot>),
    /// The depth of a finished keyframe became better.
    Revised(Arc<Keyframe>),
    /// Finished keyframes have other poses.
    Moved(Arc<PoseSnapshot>),
    /// The run is over: its last poses, and what a later one needs to go on.
    End(Arc<PoseSnapshot>, Arc<Continuation>, EndRecord),
}
