//! Questions to a map: cells in a box, rays, collisions, distances, surfaces, projections.

pub(crate) mod cast;
pub(crate) mod cells;
pub(crate) mod collide;
pub(crate) mod distance;
pub(crate) mod mesh;
pub(crate) mod project;
pub(crate) mod snapshot;
