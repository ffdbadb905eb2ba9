//! Messages into bytes, little endian.

use super::CdrError;
use serde::Serialize;
use serde::ser::{Impossible, SerializeSeq, SerializeStruct, SerializeTuple, Serializer};

/// The body of a message, little endian.
///
/// # Errors
/// Types that messages of ROS do not have, and strings and sequences of 4 GiB or more.
pub fn to_vec<M: Serialize>(message: &M) -> Result<Vec<u8>, CdrError> {
    let mut writer = Writer(Vec::new());
    message.serialize(&mut writer)?;
    Ok(writer.0)
}

/// The body as far as it is written.
struct Writer(Vec<u8>);

impl Writer {
    /// A number at a multiple of its size.
    fn number<const N: usize>(&mut self, bytes: [u8; N]) {
        let start = self.0.len().next_multiple_of(N);
        self.0.resize(start, 0);
        self.0.extend_from_slice(&bytes);
    }

    fn length(&mut self, length: usize) -> Result<(), CdrError> {
        let length = u32::try_from(length).map_err(|_| CdrError::TooLong(length))?;
        self.number(length.to_le_bytes());
        Ok(())
    }
}

macro_rules! numbers {
    ($($method:ident($type:ty)),*) => {$(
        fn $method(self, value: $type) -> Result<(), CdrError> {
            self.number(value.to_le_bytes());
            Ok(())
        }
    )*};
}

macro_rules! unsupported {
    ($($method:ident($($type:ty),*) -> $ok:ty, $what:literal;)*) => {$(
        fn $method(self, $(_: $type),*) -> Result<$ok, CdrError> {
            Err(CdrError::Unsupported($what))
        }
    )*};
}

type Never = Impossible<(), CdrError>;
type Name = &'static str;

impl Serializer for &mut Writer {
    type Ok = ();
    type Error = CdrError;
    type SerializeSeq = Self;
    type SerializeTuple = Self;
    type SerializeStruct = Self;
    type SerializeTupleStruct = Never;
    type SerializeTupleVariant = Never;
    type SerializeMap = Never;
    type SerializeStructVariant = Never;

    numbers! {
        serialize_i8(i8), serialize_i16(i16), serialize_i32(i32), serialize_i64(i64),
        serialize_u8(u8), serialize_u16(u16), serialize_u32(u32), serialize_u64(u64),
        serialize_f32(f32), serialize_f64(f64)
    }

    fn serialize_bool(self, value: bool) -> Result<(), CdrError> {
        self.serialize_u8(u8::from(value))
    }

    fn serialize_str(self, text: &str) -> Result<(), CdrError> {
        self.length(text.len().saturating_add(1))?;
        self.0.extend_from_slice(text.as_bytes());
        self.0.push(0);
        Ok(())
    }

    fn serialize_bytes(self, bytes: &[u8]) -> Result<(), CdrError> {
        self.length(bytes.len())?;
        self.0.extend_from_slice(bytes);
        Ok(())
    }

    fn serialize_seq(self, length: Option<usize>) -> Result<Self, CdrError> {
        let unknown = CdrError::Unsupported("sequence of unknown length");
        self.length(length.ok_or(unknown)?)?;
        Ok(self)
    }

    fn serialize_tuple(self, _length: usize) -> Result<Self, CdrError> {
        Ok(self)
    }

    fn serialize_struct(self, _: Name, _length: usize) -> Result<Self, CdrError> {
        Ok(self)
    }

    fn serialize_newtype_struct<T: Serialize + ?Sized>(
        self,
        _: Name,
        value: &T,
    ) -> Result<(), CdrError> {
        value.serialize(self)
    }

    unsupported! {
        serialize_i128(i128) -> (), "number of 128 bits";
        serialize_u128(u128) -> (), "number of 128 bits";
        serialize_char(char) -> (), "character";
        serialize_none() -> (), "optional value";
        serialize_unit() -> (), "unit";
        serialize_unit_struct(Name) -> (), "unit";
        serialize_unit_variant(Name, u32, Name) -> (), "enum";
        serialize_tuple_struct(Name, usize) -> Never, "tuple with a name";
        serialize_tuple_variant(Name, u32, Name, usize) -> Never, "enum";
        serialize_struct_variant(Name, u32, Name, usize) -> Never, "enum";
        serialize_map(Option<usize>) -> Never, "map";
    }

    fn serialize_some<T: Serialize + ?Sized>(self, _: &T) -> Result<(), CdrError> {
        self.serialize_none()
    }

    fn serialize_newtype_variant<T: Serialize + ?Sized>(
        self,
        name: Name,
        index: u32,
        variant: Name,
        _: &T,
    ) -> Result<(), CdrError> {
        self.serialize_unit_variant(name, index, variant)
    }

    fn is_human_readable(&self) -> bool {
        false
    }
}

/// Elements and fields, which have nothing between them.
macro_rules! in_order {
    ($($of:ident::$method:ident($($key:ty)?)),*) => {$(
        impl $of for &mut Writer {
            type Ok = ();
            type Error = CdrError;

            fn $method<T: Serialize + ?Sized>(
                &mut self,
                $(_: $key,)?
                value: &T,
            ) -> Result<(), CdrError> {
                value.serialize(&mut **self)
            }

            fn end(self) -> Result<(), CdrError> {
                Ok(())
            }
        }
    )*};
}

in_order! {
    SerializeSeq::serialize_element(),
    SerializeTuple::serialize_element(),
    SerializeStruct::serialize_field(Name)
}
