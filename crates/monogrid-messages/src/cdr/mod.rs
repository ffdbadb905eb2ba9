//! Plain CDR, version 1, as ROS 2 sends and stores messages: fields one after the other, numbers aligned to their own size.
//!
//! The rules are those of DDSI-RTPS 2.5, clause 10, and of OMG DDS-XTypes 1.3, clause 7.4.1 (`PLAIN_CDR`): a number begins at a
//! multiple of its size, counted from the first byte of the body; a string is its length (`u32`, with the 0 at its end) and its
//! bytes; a sequence is the number of its elements (`u32`) and these; arrays and structs are their elements alone. The four bytes
//! of encapsulation that stand before a body are not part of it and left to whoever reads or writes them.
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

pub use read::from_bytes;
pub use write::to_vec;

use std::fmt::{self, Display, Formatter};
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
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum CdrError {
    /// The bytes end within a field.
    TooShort {
        /// Bytes of the field.
        needed: usize,
        /// Bytes that are left.
        left: usize,
    },
    /// A sequence claims more elements than bytes are left.
    TooManyElements {
        /// Elements that are claimed.
        claimed: u32,
        /// Bytes that are left.
        left: usize,
    },
    /// A boolean that is neither 0 nor 1.
    NoBoolean(u8),
    /// A string whose last byte, which is given here, is not 0.
    NotTerminated(u8),
    /// A string that is not UTF-8.
    NoText(Utf8Error),
    /// A string or sequence that is longer than 32 bits can say.
    TooLong(usize),
    /// Something that no message of ROS contains.
    Unsupported(&'static str),
    /// What the type says itself.
    Other(String),
}

impl Display for CdrError {
    fn fmt(&self, f: &mut Formatter) -> fmt::Result {
        match self {
            Self::TooShort { needed, left } => {
                write!(f, "a field needs {needed} bytes, {left} are left")
            }
            Self::TooManyElements { claimed, left } => {
                write!(
                    f,
                    "a sequence claims {claimed} elements, {left} bytes are left"
                )
            }
            Self::NoBoolean(byte) => write!(f, "a boolean is {byte}, expected 0 or 1"),
            Self::NotTerminated(byte) => write!(f, "a string ends in {byte}, expected 0"),
            Self::NoText(error) => write!(f, "a string is not UTF-8: {error}"),
            Self::TooLong(length) => write!(f, "a length of {length} does not fit into 32 bits"),
            Self::Unsupported(what) => write!(f, "messages of ROS have no {what}"),
            Self::Other(reason) => f.write_str(reason),
        }
    }
}

impl std::error::Error for CdrError {}

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
