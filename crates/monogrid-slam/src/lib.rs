//! Direct semi-dense monocular SLAM that feeds an occupancy map.
