//! Probabilistic voxel map compatible with OctoMap, with inverse sensor models and queries.
