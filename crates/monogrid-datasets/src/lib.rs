//! Image sources, calibration and trajectory files, recordings and synthetic worlds.
