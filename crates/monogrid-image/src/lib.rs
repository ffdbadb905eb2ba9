//! Image buffers, gradients, pyramids, undistortion and photometric correction.
