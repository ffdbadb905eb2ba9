//! What happens to the depth of a keyframe, stage by stage, in this order:
//!
//! 1. [`Stage::Matched`]: dense depth by the images of its neighbours (`stereo`); that of a depth
//!    camera where there is one;
//! 2. [`Stage::Found`]: what these confirm of it with the depth of the filter, or where there is
//!    none, that of the filter made better by the images around (`stereo`); what of it is precise
//!    enough (`sensor`), and plain surfaces between it (`planes`);
//! 3. [`Stage::Agreed`]: as certain as keyframes agree, one depth from all that see the same
//!    (`agreement`).
//!
//! Then it is [`mapped`]: large planes beyond what was measured of them, and what lies on them put
//! on them (`planes`).
//!
//! Each stage of a keyframe looks at what others had at the stage before. All keyframes take a
//! stage together at the final poses (`last`), and one at a time while a run goes on (`live`).

use crate::agreement::{Certainty, fused};
use crate::planes::{Cloud, on_planes};
use crate::scene::{Depths, KeptDepths, Scene, View, probes};
use crate::stereo::{confirmed, half_size, is_measured, merged, refined, stereo};
use crate::{KeyframeCamera, KeyframeScan};
use monogrid_depth::DenseDepth;
use monogrid_geometry::Sim3;
use monogrid_slam::store::{Kept, Store};
use std::borrow::Cow;
use std::sync::Arc;

/// Largest relative standard deviation of depth as it is stated, before the agreement of keyframes
/// sets the true one: that of filled planes is most often two or three times smaller. Measured:
/// with 0.035, walls with few points on them were left open (icl-office-kt3 had 4 % less of its
/// surfaces).
const MAX_STATED_SIGMA: f64 = 0.08;

/// How far a keyframe has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Stage {
    Waiting,
    /// Its image was matched with those of its neighbours.
    Matched,
    /// What these confirm was merged with its own depth, or that was refined, and filled.
    Found,
    /// As certain as they agree, and fused with theirs.
    Agreed,
    /// Mapped.
    Ready,
}

impl Stage {
    /// Those that make depth better, in their order.
    pub const ALL: [Self; 3] = [Self::Matched, Self::Found, Self::Agreed];

    /// The one after it.
    pub fn next(self) -> Self {
        let later = Self::ALL.into_iter().find(|stage| *stage > self);
        later.unwrap_or(Self::Ready)
    }

    /// What keyframes that are about to take it tell together about the certainty of their depth.
    pub fn certainty(self, scene: &Scene) -> Certainty {
        match self {
            Self::Agreed => Certainty::of_scene(scene),
            _ => Certainty::UNCHANGED,
        }
    }
}

/// What a keyframe has at a stage; nothing before the first one.
#[derive(Clone, Debug, Default)]
pub(super) struct Progress {
    /// Its dense depth, as it was matched.
    dense: Option<Kept<DenseDepth>>,
    /// From the second stage on.
    found: Option<Found>,
    /// Some of it in which planes are looked for, from the last stage on.
    cloud: Cloud,
}

#[derive(Clone, Debug)]
struct Found {
    depths: KeptDepths,
    /// As others see it, where it has a pose.
    view: Option<View>,
}

/// What each keyframe had at one stage, for those that take the next one.
pub(super) type Before<'a> = [Option<&'a Progress>];

/// Keyframes as others see them.
pub(super) fn views_of(before: &Before) -> Vec<Option<View>> {
    let view = |this: &Option<&Progress>| this.as_ref()?.found.as_ref()?.view.clone();
    before.iter().map(view).collect()
}

/// What a keyframe has when it has taken a stage; its view is that of its index in the scene.
pub(super) fn taken(
    stage: Stage,
    scene: &Scene,
    index: usize,
    before: &Before,
    (certainty, store): (Certainty, &Store),
) -> Progress {
    let this = before[index].and_then(|this| this.found.as_ref());
    match stage {
        Stage::Waiting => Progress::default(),
        Stage::Matched => Progress {
            dense: matched(scene, index).map(|depth| store.keep(depth)),
            ..Progress::default()
        },
        Stage::Found => Progress {
            found: Some(found(scene, index, before, store)),
            ..Progress::default()
        },
        Stage::Agreed | Stage::Ready => this.map_or_else(Progress::default, |this| {
            agreed(scene, this, index, certainty)
        }),
    }
}

/// Dense depth of a keyframe as a depth camera measured it, or by its neighbours; none where there
/// is no image, no pose or no neighbour, or where the quality asks for none.
fn matched(scene: &Scene, index: usize) -> Option<DenseDepth> {
    if !scene.config.quality.has_dense_depth() {
        return None;
    }
    let pixels = scene.keyframes[index].depth.get();
    match is_measured(&pixels, scene.camera) {
        true => Some(half_size(&pixels, scene.camera)),
        false => stereo(scene, index),
    }
}

/// The depth of a keyframe by all that itself and its neighbours tell.
fn found(scene: &Scene, index: usize, before: &Before, store: &Store) -> Found {
    let Scene { camera, config, .. } = *scene;
    let keyframe = &scene.keyframes[index];
    let pixels = keyframe.depth.get();
    let dense = |other: usize| -> Option<Arc<DenseDepth>> { before[other]?.dense.as_ref()?.get() };
    let pixels = if is_measured(&pixels, camera) {
        pixels
    } else if let Some(dense) = confirmed(scene, index, dense) {
        Cow::Owned(merged(&pixels, &dense, camera))
    } else {
        refined(scene, index, pixels)
    };
    let limit = MAX_STATED_SIGMA.max(config.filter.max_relative_sigma);
    let image = keyframe.image();
    let depths = Depths::new(keyframe.id, &pixels, image.as_deref(), config, limit);
    Found::new(depths, keyframe.world_from_keyframe, camera, store)
}

/// What was found of a keyframe, as certain as it is, each depth fused with those of others that
/// agree, and some of it in which planes are looked for.
fn agreed(scene: &Scene, this: &Found, index: usize, certainty: Certainty) -> Progress {
    let Scene { camera, config, .. } = *scene;
    let depths = certainty.apply(&this.depths);
    let found = this.with_depths(fused(scene, index, depths, certainty), camera);
    let view = found.view.as_ref();
    let view = view.filter(|_| config.quality.has_dense_depth());
    Progress {
        cloud: Cloud::new(view, camera, config),
        found: Some(found),
        ..Progress::default()
    }
}

/// What of a keyframe is mapped when it has taken all stages: its depths on the large planes that
/// it shares with others, and these planes beyond what was measured of them.
pub(super) fn mapped(scene: &Scene, index: usize, before: &Before, store: &Store) -> KeyframeScan {
    let this = before[index].and_then(|this| this.found.as_ref());
    let mut depths = this.map_or_else(Depths::default, |this| this.depths.depths());
    if this.is_some() && scene.config.quality.has_dense_depth() {
        let cloud = |other: usize| before[other].map(|other| &other.cloud);
        depths = on_planes(scene, index, depths, cloud);
    }
    depths.joined(scene.keyframes[index].id, scene.camera, store)
}

impl Found {
    fn new(
        depths: Depths,
        world_from_keyframe: Option<Sim3>,
        camera: &KeyframeCamera,
        store: &Store,
    ) -> Self {
        let probes = probes(&depths, camera);
        let depths = KeptDepths::new(store, depths);
        Self {
            view: world_from_keyframe.map(|world_from_keyframe| View {
                depths: depths.clone(),
                probes,
                world_from_keyframe,
            }),
            depths,
        }
    }

    /// With other depths.
    fn with_depths(&self, depths: Depths, camera: &KeyframeCamera) -> Self {
        let pose = self.view.as_ref().map(|view| view.world_from_keyframe);
        Self::new(depths, pose, camera, self.depths.store())
    }
}
