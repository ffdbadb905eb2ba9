//! Direct alignment of two keyframes over Sim(3): photometric and depth error together.
//!
//! Flow: two [`KeyframeView`]s (points and image of each, with inverse depth in its own units) →
//! [`align_similarity`] minimises over `b_from_a` the sum of a robust cost of
//!
//! ```text
//! r_p = I_b(pi(q)) - (g I_a + h)          variance  sigma_I^2 + (dr_p/dd)^2 V_a
//! r_d = 1/z(q) - D_b(pi(q))               variance  V_b + (dr_d/dd)^2 V_a
//! ```
//!
//! with `q = b_from_a * (m / d)`, coarse to fine → [`align_reciprocally`] does it in both
//! directions and fuses the two when they agree.
//!
//! Conventions: tangents `[v, w, s]`, updates on the left of `b_from_a`, so in the coordinates and
//! units of `b`. The derivative of `D_b` by the position is neglected, as in `[LSD14]`: depth is
//! looked up at the nearest pixel.
//!
//! Reference: `[LSD14]` section 3.5 (equations 15 to 19); the bivariate Student-t weight in place
//! of its joint Huber weight after `[KERL13]`.

mod config;
mod kernel;
mod reciprocal;
mod solver;
mod view;

pub use config::SimilarityConfig;
pub use kernel::{
    SimilarityLinearization, SimilarityState, SimilarityWeighting, linearize_similarity,
};
pub use reciprocal::{Disagreement, SimilarityConstraint, align_reciprocally};
pub use solver::{SimilarityAlignment, align_similarity};
pub use view::{DepthLevel, KeyframeView};
