//! Settings of the room of keyframes.

/// How much of keyframes is in memory. No result depends on it.
#[derive(Clone, Debug, PartialEq)]
pub struct MemoryConfig {
    /// Images and depth of keyframes in memory, MB; what is beyond that and was not used for
    /// longest lies in a temporary file, where there is one.
    pub keyframes_mb: f64,
    /// Pyramids of keyframes in memory, which are made again when they are needed, MB.
    pub prepared_mb: f64,
}

impl Default for MemoryConfig {
    fn default() -> Self {
        Self {
            keyframes_mb: 8.0,
            prepared_mb: 8.0,
        }
    }
}
