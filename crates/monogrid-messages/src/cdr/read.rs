//! Bytes into messages. What a length claims is compared with what is there before anything is done
//! with it.

use super::{ByteOrder, CdrError};
use serde::de::{DeserializeOwned, DeserializeSeed, Deserializer, SeqAccess, Visitor};
use std::borrow::Cow;

/// The message at the beginning of a body. Bytes behind it, as some writers append them to fill up
/// a packet, are left alone.
///
/// # Errors
/// What is too short or no such message, and types that messages of ROS do not have.
pub fn from_bytes<M: DeserializeOwned>(body: &[u8], order: ByteOrder) -> Result<M, CdrError> {
    read(body, order, false)
}

/// The message at the beginning of what ROS 1 stored: nothing is aligned, strings have no 0 at
/// their end, headers begin with a number.
///
/// # Errors
/// As of [`from_bytes`].
pub fn from_ros1<M: DeserializeOwned>(body: &[u8]) -> Result<M, CdrError> {
    read(body, ByteOrder::Little, true)
}

fn read<M: DeserializeOwned>(body: &[u8], order: ByteOrder, is_ros1: bool) -> Result<M, CdrError> {
    M::deserialize(&mut Reader {
        body,
        at: 0,
        order,
        is_ros1,
    })
}

struct Reader<'de> {
    body: &'de [u8],
    /// How much is read; padding before a number may lead behind the end.
    at: usize,
    order: ByteOrder,
    is_ros1: bool,
}

impl<'de> Reader<'de> {
    fn left(&self) -> usize {
        self.body.len().saturating_sub(self.at)
    }

    fn take(&mut self, needed: usize) -> Result<&'de [u8], CdrError> {
        let left = self.left();
        let rest = self.body.get(self.at..);
        let bytes = rest.and_then(|rest| rest.get(..needed));
        let bytes = bytes.ok_or(CdrError::TooShort { needed, left })?;
        self.at += needed;
        Ok(bytes)
    }

    /// The bytes of a number, the lowest first.
    fn number<const N: usize>(&mut self) -> Result<[u8; N], CdrError> {
        if !self.is_ros1 {
            self.at = self.at.next_multiple_of(N);
        }
        let mut bytes = [0; N];
        bytes.copy_from_slice(self.take(N)?);
        if self.order == ByteOrder::Big {
            bytes.reverse();
        }
        Ok(bytes)
    }

    fn u32(&mut self) -> Result<u32, CdrError> {
        self.number().map(u32::from_le_bytes)
    }

    /// Bytes behind their number.
    fn bytes(&mut self) -> Result<&'de [u8], CdrError> {
        let length = self.u32()?;
        self.take(length as usize)
    }

    fn text(&mut self) -> Result<Cow<'de, str>, CdrError> {
        let bytes = self.bytes()?;
        if self.is_ros1 {
            return Ok(String::from_utf8_lossy(bytes));
        }
        let text = match bytes.split_last() {
            // some writers leave the 0 of an empty string out
            None => &[],
            Some((0, text)) => text,
            Some((last, _)) => return Err(CdrError::NotTerminated(*last)),
        };
        let text = std::str::from_utf8(text).map_err(CdrError::NoText)?;
        Ok(text.into())
    }
}

macro_rules! numbers {
    ($($method:ident -> $visit:ident($type:ty)),*) => {$(
        fn $method<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, CdrError> {
            visitor.$visit(<$type>::from_le_bytes(self.number()?))
        }
    )*};
}

macro_rules! unsupported {
    ($($method:ident($($type:ty),*), $what:literal;)*) => {$(
        fn $method<V: Visitor<'de>>(self, $(_: $type,)* _: V) -> Result<V::Value, CdrError> {
            Err(CdrError::Unsupported($what))
        }
    )*};
}

type Name = &'static str;
type Names = &'static [&'static str];

impl<'de> Deserializer<'de> for &mut Reader<'de> {
    type Error = CdrError;

    numbers! {
        deserialize_i8 -> visit_i8(i8), deserialize_i16 -> visit_i16(i16),
        deserialize_i32 -> visit_i32(i32), deserialize_i64 -> visit_i64(i64),
        deserialize_u8 -> visit_u8(u8), deserialize_u16 -> visit_u16(u16),
        deserialize_u32 -> visit_u32(u32), deserialize_u64 -> visit_u64(u64),
        deserialize_f32 -> visit_f32(f32), deserialize_f64 -> visit_f64(f64)
    }

    fn deserialize_bool<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, CdrError> {
        match self.number()? {
            [0] => visitor.visit_bool(false),
            [other] if other == 1 || self.is_ros1 => visitor.visit_bool(true),
            [other] => Err(CdrError::NoBoolean(other)),
        }
    }

    fn deserialize_string<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, CdrError> {
        visitor.visit_str(&self.text()?)
    }

    fn deserialize_byte_buf<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, CdrError> {
        visitor.visit_borrowed_bytes(self.bytes()?)
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, CdrError> {
        let claimed = self.u32()?;
        let bytes_left = self.left();
        // an element has a byte or more, see Elements
        if claimed as usize > bytes_left {
            return Err(CdrError::TooManyElements {
                claimed,
                left: bytes_left,
            });
        }
        visitor.visit_seq(Elements {
            reader: self,
            left: claimed as usize,
            is_sequence: true,
        })
    }

    fn deserialize_tuple<V: Visitor<'de>>(
        self,
        left: usize,
        visitor: V,
    ) -> Result<V::Value, CdrError> {
        visitor.visit_seq(Elements {
            reader: self,
            left,
            is_sequence: false,
        })
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        name: Name,
        fields: Names,
        visitor: V,
    ) -> Result<V::Value, CdrError> {
        if self.is_ros1 && name == "Header" {
            let _number = self.u32()?;
        }
        self.deserialize_tuple(fields.len(), visitor)
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _: Name,
        visitor: V,
    ) -> Result<V::Value, CdrError> {
        visitor.visit_newtype_struct(self)
    }

    unsupported! {
        deserialize_any(), "value that says itself what it is";
        deserialize_ignored_any(), "value that says itself what it is";
        deserialize_identifier(), "names of fields";
        deserialize_i128(), "number of 128 bits";
        deserialize_u128(), "number of 128 bits";
        deserialize_char(), "character";
        deserialize_str(), "text of others";
        deserialize_bytes(), "bytes of others";
        deserialize_option(), "optional value";
        deserialize_unit(), "unit";
        deserialize_unit_struct(Name), "unit";
        deserialize_tuple_struct(Name, usize), "tuple with a name";
        deserialize_enum(Name, Names), "enum";
        deserialize_map(), "map";
    }

    fn is_human_readable(&self) -> bool {
        false
    }
}

/// Elements of an array or fields of a struct, as many as the type has; or those of a sequence, as
/// many as the bytes claim, each of which must have bytes, or a few bytes could claim billions.
struct Elements<'a, 'de> {
    reader: &'a mut Reader<'de>,
    left: usize,
    is_sequence: bool,
}

impl<'de> SeqAccess<'de> for Elements<'_, 'de> {
    type Error = CdrError;

    fn next_element_seed<T: DeserializeSeed<'de>>(
        &mut self,
        seed: T,
    ) -> Result<Option<T::Value>, CdrError> {
        let Some(left) = self.left.checked_sub(1) else {
            return Ok(None);
        };
        self.left = left;
        let before = self.reader.at;
        let element = seed.deserialize(&mut *self.reader)?;
        if self.is_sequence && self.reader.at == before {
            return Err(CdrError::Unsupported("sequence of elements without bytes"));
        }
        Ok(Some(element))
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.left)
    }
}
