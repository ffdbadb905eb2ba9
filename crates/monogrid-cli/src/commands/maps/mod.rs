//! Maps: made from recordings, and what is done with one.

pub mod distances;
pub mod info;
pub mod map;
pub mod posed_depth;
pub mod slice;
pub mod tools;
