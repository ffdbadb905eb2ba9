//! From the video of one camera to a 3D occupancy map.

fn main() {}
