//! Trajectory, depth, map and path metrics.
