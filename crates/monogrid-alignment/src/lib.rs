//! Direct image alignment of frames and keyframes.
