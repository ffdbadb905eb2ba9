//! What happens to the depth of a keyframe, stage by stage, in this order:
//!
//! 1. [`matched`]: dense depth by the images of its neighbours (`dense`);
//! 2. [`found`]: what these confirm of it beside the depth of the filter, both made better by the
//!    images around (`refine_depth`), what is precise enough, and plain surfaces between it
//!    (`scan`, `fill`);
//! 3. [`agreed`]: as certain as keyframes agree (`certainty`), one depth from all that see the same
//!    (`fusion`);
//! 4. [`completed`]: where a keyframe has no depth, that of those that see the same (`completion`);
//! 5. [`mapped`]: large planes beyond what was measured of them, and what lies on them put on them
//!    (`planes`).
//!
//! Each stage of a keyframe looks at what others have from the stage before. All keyframes take a
//! stage together at the final poses (`last`), and one at a time while a run goes on
//! (`live`).

use crate::agreement::fused;
use crate::agreement::{self, Certainty};
use crate::planes::{Cloud, on_planes};
use crate::scene::{Depths, KeptDepths};
use crate::scene::{Neighbour, Scene};
use crate::scene::{View, probes};
use crate::stereo::refined;
use crate::stereo::{confirmed, merged, stereo};
use crate::{KeyframeCamera, KeyframeScan};
use monogrid_depth::DenseDepth;
use monogrid_geometry::Sim3;
use monogrid_slam::store::{Kept, Store};
use std::borrow::Cow;
use std::sync::Arc;

/// Largest relative standard deviation of filled depth by the fit of its plane, where the
/// agreement of keyframes sets the true one afterwards: that of planes is most often two or three
/// times smaller. Measured: with 0.035, walls with few points on them were left open
/// (icl-office-kt3 had 4 % less of its surfaces).
const MAX_STATED_SIGMA: f64 = 0.08;

/// Dense depth of a keyframe by its neighbours; none where there is no image, no pose or no
/// neighbour.
pub(crate) fn matched(
    scene: &Scene,
    index: usize,
    neighbours: &[Neighbour],
    store: &Store,
) -> Option<Kept<DenseDepth>> {
    let depth = stereo(scene, index, neighbours)?;
    Some(store.keep(depth))
}

/// The depth of a keyframe by all that itself and its neighbours tell; `dense` is that of each as
/// it was matched.
pub(crate) fn found(
    scene: &Scene,
    index: usize,
    neighbours: &[Neighbour],
    dense: impl Fn(usize) -> Option<Arc<DenseDepth>>,
    store: &Store,
) -> Found {
    let Scene { camera, config, .. } = *scene;
    let keyframe = &scene.keyframes[index];
    let mut pixels = keyframe.depth.get();
    if let Some(dense) = confirmed(scene, index, neighbours, dense) {
        pixels = Cow::Owned(merged(&pixels, &dense, camera));
    }
    let (pixels, misfits) = match config.refine.enabled {
        true => refined(scene, index, pixels),
        false => (pixels, Vec::new()),
    };
    // how certain a plane is, keyframes tell together
    let limit = match config.sigma_from_agreement {
        true => MAX_STATED_SIGMA,
        false => config.filter.max_relative_sigma,
    };
    let (image, settings) = (keyframe.image(), (config, limit));
    let depths = Depths::new(keyframe.id, &pixels, image.as_deref(), camera, settings);
    let known = keyframe.world_from_keyframe.zip(Some(misfits.into()));
    Found::new(depths, known, camera, store)
}

/// What was found of a keyframe, as certain as it is, each depth fused with those of others that
/// agree.
pub(crate) fn agreed(scene: &Scene, this: &Found, index: usize, certainty: Certainty) -> Found {
    let Scene { camera, config, .. } = *scene;
    let mut depths = certainty.apply(&this.depths);
    if config.fusion.max_witnesses > 0 {
        depths = fused(scene, index, depths, certainty);
    }
    this.with_depths(depths, camera)
}

/// With depth that others have and the keyframe has not.
pub(crate) fn completed(scene: &Scene, this: &Found, index: usize) -> Completed {
    let Scene { camera, config, .. } = *scene;
    if !config.quality.has_dense_depth() {
        return Completed {
            found: this.clone(),
            cloud: Cloud::default(),
        };
    }
    let added = agreement::completed(scene, index);
    let found = this.with_depths(this.depths.depths().with_filled(added), camera);
    let cloud = Cloud::new(found.view.as_ref(), camera, config);
    Completed { found, cloud }
}

/// What of a keyframe is mapped: its depths on the large planes that it shares with others, and
/// these planes beyond what was measured of them; `cloud` is what each keyframe sees.
pub(crate) fn mapped<'a>(
    scene: &Scene,
    this: &Completed,
    index: usize,
    cloud: impl Fn(usize) -> Option<&'a Cloud>,
) -> KeyframeScan {
    let kept = &this.found.depths;
    let mut depths = kept.depths();
    if scene.config.quality.has_dense_depth() {
        depths = on_planes(scene, index, depths, cloud);
    }
    depths.joined(scene.keyframes[index].id, scene.camera, kept.store())
}

/// What was found of a keyframe. Its view is that of its index among those of a scene.
#[derive(Clone, Debug)]
pub(crate) struct Found {
    depths: KeptDepths,
    /// As others see it, where it has a pose.
    pub view: Option<View>,
}

/// What was found of a keyframe with what others have, and some of it in which planes are looked
/// for.
#[derive(Clone, Debug)]
pub(crate) struct Completed {
    pub found: Found,
    pub cloud: Cloud,
}

impl Found {
    /// `known`: its pose, and how far its patches are beside epipolar lines.
    fn new(
        depths: Depths,
        known: Option<(Sim3, Arc<[f32]>)>,
        camera: &KeyframeCamera,
        store: &Store,
    ) -> Self {
        let probes = probes(&depths, camera);
        let depths = KeptDepths::new(store, depths);
        Self {
            view: known.map(|(world_from_keyframe, misfits)| View {
                depths: depths.clone(),
                probes,
                world_from_keyframe,
                misfits,
            }),
            depths,
        }
    }

    /// With other depths.
    fn with_depths(&self, depths: Depths, camera: &KeyframeCamera) -> Self {
        let view = self.view.as_ref();
        let known = view.map(|view| (view.world_from_keyframe, view.misfits.clone()));
        Self::new(depths, known, camera, self.depths.store())
    }
}
