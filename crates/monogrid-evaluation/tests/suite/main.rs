//! Tests of the metrics against definitions and other programs; one program, so that it links once.

mod depth;
mod evo;
mod map;
mod paths;
mod truth;
