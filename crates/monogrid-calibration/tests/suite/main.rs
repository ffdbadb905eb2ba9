//! Tests of calibration without and with a target; one program, so that it links once.

mod synthetic;
mod target;
