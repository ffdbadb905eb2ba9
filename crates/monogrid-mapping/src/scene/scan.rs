//! The measurements of keyframes, in memory or where there is room.

use crate::KeyframeCamera;
use monogrid_occupancy::DepthPixel as Measurement;
use monogrid_slam::KeyframeId;
use monogrid_slam::store::{Keepable, Kept, Measured, Store, pack_pixels, unpack_pixels};
use std::ops::Deref;
use std::sync::Arc;

/// Measurements that are kept where there is room.
#[derive(Debug, Default, PartialEq)]
pub struct Measurements(Vec<Measurement>);

impl Deref for Measurements {
    type Target = [Measurement];

    fn deref(&self) -> &[Measurement] {
        &self.0
    }
}

impl Measured for Measurements {
    fn bytes(&self) -> usize {
        self.0.capacity() * size_of::<Measurement>()
    }
}

impl Keepable for Measurements {
    fn pack(&self) -> Vec<u8> {
        pack_pixels(self.iter().map(|p| (p.x, p.y, p.idepth, p.sigma_idepth)))
    }

    fn unpack(bytes: &[u8]) -> Option<Self> {
        let pixel = |(x, y, idepth, sigma_idepth)| Measurement {
            x,
            y,
            idepth,
            sigma_idepth,
        };
        unpack_pixels(bytes, pixel).map(Self)
    }
}

/// What of a keyframe is mapped; its measurements are where there is room
/// ([`monogrid_slam::Slam::spill_into`]), or in memory.
#[derive(Clone, Debug)]
pub struct KeyframeScan {
    /// The keyframe.
    pub id: KeyframeId,
    /// Its camera.
    pub camera: KeyframeCamera,
    /// The number of its measurements.
    pub num_pixels: usize,
    /// How many of them were not measured, but filled in between ([`super::fill_plain_regions`]).
    pub num_filled: usize,
    pixels: Kept<Measurements>,
}

impl PartialEq for KeyframeScan {
    fn eq(&self, other: &Self) -> bool {
        self.id == other.id
            && self.camera == other.camera
            && self.num_filled == other.num_filled
            && *self.pixels() == *other.pixels()
    }
}

impl KeyframeScan {
    /// A scan of these measurements, row-major, in units of the keyframe; `num_filled` of them were
    /// not measured. They stay in memory.
    #[must_use]
    pub fn of_measurements(
        id: KeyframeId,
        camera: KeyframeCamera,
        pixels: Vec<Measurement>,
        num_filled: usize,
    ) -> Self {
        Self::kept(id, camera, (pixels, num_filled), &Store::default())
    }

    fn kept(
        id: KeyframeId,
        camera: KeyframeCamera,
        (pixels, num_filled): (Vec<Measurement>, usize),
        store: &Store,
    ) -> Self {
        Self {
            id,
            camera,
            num_pixels: pixels.len(),
            num_filled,
            pixels: store.keep(Measurements(pixels)),
        }
    }

    /// Those of its measurements that are wanted, none of which counts as filled in; they lie where
    /// these do.
    #[must_use]
    pub fn only(&self, is_wanted: impl FnMut(&&Measurement) -> bool) -> Self {
        let pixels = self.pixels().iter().filter(is_wanted).copied().collect();
        Self::kept(self.id, self.camera, (pixels, 0), self.pixels.store())
    }

    /// Its measurements, row-major, in units of the keyframe, in memory as long as this is held;
    /// none where they cannot be read back, which is an error in the end
    /// ([`monogrid_slam::Slam::check_spilled`]).
    #[must_use]
    pub fn pixels(&self) -> Arc<Measurements> {
        self.pixels.get().unwrap_or_default()
    }
}

/// A measurement of a pixel of the image.
pub(crate) fn measurement((x, y): (usize, usize), idepth: f32, sigma_idepth: f32) -> Measurement {
    Measurement {
        x: x as u16,
        y: y as u16,
        idepth,
        sigma_idepth,
    }
}

/// The depth of a keyframe before measured and filled depth become one.
#[derive(Clone, Debug, Default)]
pub(crate) struct Depths {
    /// What passed the filter, row-major.
    pub measured: Vec<Measurement>,
    /// What was filled in between, row-major.
    pub filled: Vec<Measurement>,
}

impl Depths {
    /// With further depths, which were not measured, at pixels that have none.
    pub fn with_filled(mut self, added: Vec<Measurement>) -> Self {
        self.filled.reserve_exact(added.len());
        self.filled.extend(added);
        self.filled.sort_unstable_by_key(|p| (p.y, p.x));
        self
    }

    /// Both together as they are mapped.
    pub fn joined(self, id: KeyframeId, camera: &KeyframeCamera, store: &Store) -> KeyframeScan {
        let num_filled = self.filled.len();
        let mut pixels = self.measured;
        pixels.reserve_exact(num_filled);
        pixels.extend(self.filled);
        if num_filled > 0 {
            pixels.sort_unstable_by_key(|p| (p.y, p.x));
        }
        KeyframeScan::kept(id, *camera, (pixels, num_filled), store)
    }
}

/// [`Depths`] where there is room.
#[derive(Clone, Debug)]
pub(crate) struct KeptDepths {
    measured: Kept<Measurements>,
    filled: Kept<Measurements>,
}

impl KeptDepths {
    pub fn new(store: &Store, depths: Depths) -> Self {
        Self {
            measured: store.keep(Measurements(depths.measured)),
            filled: store.keep(Measurements(depths.filled)),
        }
    }

    /// A copy of both.
    pub fn depths(&self) -> Depths {
        let [measured, filled] = self.kinds().map(|kind| kind.to_vec());
        Depths { measured, filled }
    }

    /// What keeps them.
    pub fn store(&self) -> &Store {
        self.measured.store()
    }

    /// What was measured, and what was filled in; none where it cannot be read back, which is an
    /// error in the end ([`monogrid_slam::Slam::check_spilled`]).
    pub fn kinds(&self) -> [Arc<Measurements>; 2] {
        [&self.measured, &self.filled].map(|kind| kind.get().unwrap_or_default())
    }
}
