//! Synthetic worlds with exact depth and pose.
