//! Keyframe pose graph on Sim(3), bundle adjustment and the g2o file format.
