//! The built-in sequence that tests share: to make it takes seconds.

use monogrid_worlds::SynthSequence;
use std::sync::OnceLock;

/// The small demonstration.
pub(crate) fn small_demo() -> &'static SynthSequence {
    static SEQUENCE: OnceLock<SynthSequence> = OnceLock::new();
    SEQUENCE.get_or_init(|| SynthSequence::small_demo().unwrap())
}
