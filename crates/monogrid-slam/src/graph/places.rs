//! The memory of places as the configuration asks for it.

use super::config::{PlaceMethod, PlaceRecognitionConfig};
use monogrid_features::{
    FabMap, FabMapConfig, PlaceMemory, PlaceMemoryConfig, PlaceVocabulary, VocabularyError,
};
use monogrid_geometry::Pinhole;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use thiserror::Error;

/// Why places cannot be recognised as configured.
#[derive(Debug, Error)]
pub enum PlacesError {
    /// The file of the vocabulary cannot be read.
    #[error("vocabulary {}: {source}; set `slam.graph.places.vocabulary` to a file of `monogrid \
        vocabulary`", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The vocabulary is not one.
    #[error("vocabulary {}: {source}", path.display())]
    Vocabulary {
        /// The file; empty for the built-in one.
        path: PathBuf,
        /// What is wrong with it.
        source: VocabularyError,
    },
}

/// An empty memory for images of one camera.
///
/// # Errors
/// FAB-MAP with a vocabulary that cannot be used.
pub(super) fn memory_of_places(
    config: &PlaceRecognitionConfig,
    pinhole: Pinhole,
) -> Result<PlaceMemory, PlacesError> {
    let memory = PlaceMemory::new(pinhole, PlaceMemoryConfig::default());
    Ok(match config.method {
        PlaceMethod::Corners => memory,
        PlaceMethod::FabMap => {
            let vocabulary = Arc::new(vocabulary(config)?);
            memory.with_fab_map(FabMap::new(vocabulary, FabMapConfig::default()))
        }
    })
}

/// Largest vocabulary that is read: a hundred times ours.
const MAX_VOCABULARY_BYTES: u64 = 64 << 20;

/// The bytes of a regular file; a pipe would wait for ever, a device may have no end.
fn read_vocabulary(path: &Path) -> std::io::Result<Vec<u8>> {
    if !std::fs::metadata(path)?.is_file() {
        return Err(std::io::Error::other("it is no regular file"));
    }
    let mut bytes = Vec::new();
    let file = std::fs::File::open(path)?;
    file.take(MAX_VOCABULARY_BYTES).read_to_end(&mut bytes)?;
    Ok(bytes)
}

fn vocabulary(config: &PlaceRecognitionConfig) -> Result<PlaceVocabulary, PlacesError> {
    let path = &config.vocabulary;
    let vocabulary = if path.as_os_str().is_empty() {
        PlaceVocabulary::built_in()
    } else {
        let bytes = read_vocabulary(path).map_err(|source| PlacesError::Unreadable {
            path: path.clone(),
            source,
        })?;
        PlaceVocabulary::from_bytes(&bytes)
    };
    vocabulary.map_err(|source| PlacesError::Vocabulary {
        path: path.clone(),
        source,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fab_map_needs_a_sound_vocabulary() {
        let pinhole = Pinhole::new(300.0, 300.0, 160.0, 120.0);
        let config = |vocabulary: PathBuf| PlaceRecognitionConfig {
            method: PlaceMethod::FabMap,
            vocabulary,
            ..PlaceRecognitionConfig::default()
        };
        assert!(memory_of_places(&config(PathBuf::new()), pinhole).is_ok());
        let missing = memory_of_places(&config("no/such/file".into()), pinhole);
        assert!(matches!(missing, Err(PlacesError::Unreadable { .. })));
        let other = std::env::temp_dir().join(format!("vocabulary-{}", std::process::id()));
        std::fs::write(&other, "not a vocabulary").unwrap();
        let damaged = memory_of_places(&config(other.clone()), pinhole);
        std::fs::remove_file(other).unwrap();
        assert!(matches!(damaged, Err(PlacesError::Vocabulary { .. })));
    }
}
