//! Corners, binary descriptors, patch alignment and two-view geometry.
