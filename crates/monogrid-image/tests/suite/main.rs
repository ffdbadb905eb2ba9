//! Tests of the image crate; one program, so that it links once.

mod gradient;
mod photometric;
mod pyramid;
mod resize;
mod undistort;
