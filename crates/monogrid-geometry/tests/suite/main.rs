//! Tests of cameras, groups and alignment; one program, so that it links once.

#[macro_use]
mod common;

mod cameras;
mod group_laws;
mod umeyama;
