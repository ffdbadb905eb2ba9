//! Tests of the solvers through their interface; one program, so that it links once.

mod bundle;
mod common;
mod pose_graph;
mod pose_only;
