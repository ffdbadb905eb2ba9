//! Plain CDR, version 1, as ROS 2 sends and stores messages: fields one after the other, numbers
//! aligned to their own size.
//!
//! The rules are those of DDSI-RTPS 2.5, clause 10, and of OMG DDS-XTypes 1.3, clause 7.4.1
//! (`PLAIN_CDR`): a number begins at a multiple of its size, counted from the first byte of the
//! body; a string is its length (`u32`, with the 0 at its end) and its bytes; a sequence is the
//! number of its elements (`u32`) and these; arrays and structs are their elements alone. The four
//! bytes of encapsulation that stand before a body are not part of it and left to whoever reads or
//! writes them. What ROS 1 stores differs from that in little, and is read too.
//!
//! Only what messages of ROS are made of is known; anything else is [`CdrError::Unsupported`].
//!
//! ```
//! use monogrid_messages::builtin_interfaces::Time;
//! use monogrid_messages::cdr::{ByteOrder, from_bytes, to_vec};
//! let time = Time { sec: 1, nanosec: 2 };
//! let bytes = to_vec(&time)?;
//! assert_eq!(bytes, [1, 0, 0, 0, 2, 0, 0, 0]);
//! assert_eq!(from_bytes::<Time>(&bytes, ByteOrder::Little)?, time);
//! # Ok::<(), monogrid_messages::cdr::CdrError>(())
//! ```

mod read;
mod write;

pub use read::{from_bytes, from_ros1};
pub use write::to_vec;

use std::fmt::Display;
use std::str::Utf8Error;

/// Which byte of a number comes first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ByteOrder {
    /// The lowest: encapsulation 1.
    Little,
    /// The highest: encapsulation 0.
    Big,
}

/// Why bytes are no message, or a message cannot become bytes.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum CdrError {
    /// The bytes end within a field.
    #[error("a field needs {needed} bytes, {left} are left")]
    TooShort {
        /// Bytes of the field.
        needed: usize,
        /// Bytes that are left.
        left: usize,
    },
    /// A sequence claims more elements than bytes are left.
    #[error("a sequence claims {claimed} elements, {left} bytes are left")]
    TooManyElements {
        /// Elements that are claimed.
        claimed: u32,
        /// Bytes that are left.
        left: usize,
    },
    /// A boolean that is neither 0 nor 1.
    #[error("a boolean is {0}, expected 0 or 1")]
    NoBoolean(u8),
    /// A string whose last byte, which is given here, is not 0.
    #[error("a string ends in {0}, expected 0")]
    NotTerminated(u8),
    /// A string that is not UTF-8.
    #[error("a string is not UTF-8: {0}")]
    NoText(Utf8Error),
    /// A string or sequence that is longer than 32 bits can say.
    #[error("a length of {0} does not fit into 32 bits")]
    TooLong(usize),
    /// Something that no message of ROS contains.
    #[error("messages of ROS have no {0}")]
    Unsupported(&'static str),
    /// What the type says itself.
    #[error("{0}")]
    Other(String),
}

impl serde::ser::Error for CdrError {
    fn custom<T: Display>(reason: T) -> Self {
        Self::Other(reason.to_string())
    }
}

impl serde::de::Error for CdrError {
    fn custom<T: Display>(reason: T) -> Self {
        Self::Other(reason.to_string())
    }
}
