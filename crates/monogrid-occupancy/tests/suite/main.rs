//! Tests of the map through its interface; one program, so that it links once.

mod combine;
mod common;
mod compact_file;
mod distance;
mod fused;
mod keyframes;
mod mesh;
mod moving_obstacles;
mod octomap_files;
mod packed;
mod queries;
mod rays;
mod scans;
