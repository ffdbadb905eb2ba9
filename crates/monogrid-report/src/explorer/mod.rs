//! The part of a page that is explored: cells, cloud, path and keyframes in three dimensions, a map
//! from above, a timeline and the pictures of keyframes, all linked.
//!
//! [`Scene`] holds what there is to see, [`section`] makes a piece of a page of it that needs no
//! other file and no network: numbers as JSON, geometry as blocks of 16-bit integers in base64, and
//! the scripts of `assets/` as an import map of data URLs.
//!
//! The scripts are plain modules without a build step; only three.js is minified. A content
//! security policy keeps a page from loading anything else, but for the answers of its own server
//! while a run goes on. `scripts/look.sh` looks at pages in a browser.

mod cells;
mod cloud;
mod look;
mod mesh;
mod page;
mod scene;
mod server;
mod shown;

pub use cells::Cells;
pub use cloud::{Cloud, CloudPoint, SemiDense};
pub use look::Look;
pub use mesh::PageMesh;
pub use page::{LIVE_POLICY, POLICY, STYLE, live_section, section, write_section};
pub use scene::{Camera, Frames, Keyframe, PagePlan, PathPoint, Scene, seconds_since};
pub use server::{Answer, Server, Serving};
pub use shown::{
    ShownKeyframe, cloud_and_keyframes, measured_in, picture, point_groups, small_jpeg,
};
