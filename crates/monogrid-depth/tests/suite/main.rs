//! Tests of depth on rendered images; one program, so that it links once.

mod sequence;
mod stereo;
mod world;
