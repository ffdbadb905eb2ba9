//! The rules of CDR one by one, on bytes that are written out here.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use monogrid_messages::cdr::{ByteOrder, CdrError, from_bytes, to_vec};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize, Serializer};
use std::collections::BTreeMap;
use std::fmt::Debug;

/// A value becomes these bytes, and these bytes the value.
fn is_written_as<T: Serialize + DeserializeOwned + PartialEq + Debug>(value: &T, bytes: &[u8]) {
    assert_eq!(to_vec(value).unwrap(), bytes);
    assert_eq!(&read::<T>(bytes).unwrap(), value);
    for end in 0..bytes.len() {
        assert!(read::<T>(&bytes[..end]).is_err(), "{value:?} to {end}");
    }
}

fn read<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, CdrError> {
    from_bytes(bytes, ByteOrder::Little)
}

fn from_big<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, CdrError> {
    from_bytes(bytes, ByteOrder::Big)
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Inner {
    small: u8,
    large: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Metres(u16);

#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Pair(u8, u16);

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Nothing {}

#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Bytes(#[serde(with = "serde_bytes")] Vec<u8>);

#[test]
fn numbers_begin_at_multiples_of_their_size() {
    is_written_as(&(true, -2_i8), &[1, 254]);
    is_written_as(&(1_u8, 2_u16), &[1, 0, 2, 0]);
    is_written_as(&(1_u8, -2_i32), &[1, 0, 0, 0, 254, 255, 255, 255]);
    is_written_as(&(1_u8, 1.0_f32), &[1, 0, 0, 0, 0, 0, 128, 63]);
    let wide = [7, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 240, 63];
    is_written_as(&(7_u8, 1.0_f64), &wide);
    let after_four = [1, 0, 0, 0, 0, 0, 0, 0, 2, 0, 0, 0, 0, 0, 0, 0, 3, 0];
    is_written_as(&(1_i32, 2_i64, 3_i16), &after_four);
    is_written_as(
        &(u64::MAX, 3_u8, 4_u8),
        &[255, 255, 255, 255, 255, 255, 255, 255, 3, 4],
    );
}

#[test]
fn structs_and_arrays_add_nothing_of_their_own() {
    let inner = Inner {
        small: 5,
        large: 0.0,
    };
    // the second begins where the first ends: it is not aligned as a whole
    let mut bytes = [0; 32];
    (bytes[0], bytes[16]) = (5, 5);
    is_written_as(&[inner.clone(), inner], &bytes);
    is_written_as(&[Metres(1), Metres(2)], &[1, 0, 2, 0]);
    is_written_as(&[1_u8, 2, 3], &[1, 2, 3]);
    is_written_as(&(Nothing {}, [0_u8; 0]), &[]);
}

#[test]
fn strings_count_the_0_at_their_end() {
    is_written_as(&String::new(), &[1, 0, 0, 0, 0]);
    is_written_as(&"ab".to_owned(), &[3, 0, 0, 0, 97, 98, 0]);
    is_written_as(&"ä".to_owned(), &[3, 0, 0, 0, 195, 164, 0]);
    let two = [2, 0, 0, 0, 97, 0, 0, 0, 2, 0, 0, 0, 98, 0];
    is_written_as(&["a".to_owned(), "b".to_owned()], &two);
    // as some writers have it
    assert_eq!(read::<String>(&[0; 4]).unwrap(), "");
}

#[test]
fn strings_that_are_none_are_errors() {
    let unterminated = read::<String>(&[2, 0, 0, 0, 97, 98]);
    assert_eq!(unterminated, Err(CdrError::NotTerminated(98)));
    let no_text = read::<String>(&[3, 0, 0, 0, 195, 40, 0]).unwrap_err();
    assert!(matches!(no_text, CdrError::NoText(_)), "{no_text}");
    let claimed = read::<String>(&[255, 255, 255, 255, 97, 0]);
    let error = CdrError::TooShort {
        needed: u32::MAX as usize,
        left: 2,
    };
    assert_eq!(claimed, Err(error));
}

#[test]
fn sequences_begin_with_the_number_of_their_elements() {
    is_written_as(&Vec::<f64>::new(), &[0; 4]);
    is_written_as(&vec![1_u16, 2], &[2, 0, 0, 0, 1, 0, 2, 0]);
    is_written_as(&vec![-1_i8, 2], &[2, 0, 0, 0, 255, 2]);
    let padded = [1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 240, 63];
    is_written_as(&vec![1.0_f64], &padded);
    is_written_as(&Bytes(vec![1, 2, 3]), &[3, 0, 0, 0, 1, 2, 3]);
    is_written_as(&(1_u8, Bytes(Vec::new())), &[1, 0, 0, 0, 0, 0, 0, 0]);
    let nested = [2, 0, 0, 0, 1, 0, 0, 0, 9, 0, 0, 0, 0, 0, 0, 0];
    is_written_as(&vec![vec![9_u8], Vec::new()], &nested);
}

#[test]
fn what_a_sequence_claims_is_compared_with_what_is_there() {
    let claims = [255, 255, 255, 255, 1, 2];
    let error = CdrError::TooManyElements {
        claimed: u32::MAX,
        left: 2,
    };
    assert_eq!(read::<Vec<u8>>(&claims), Err(error.clone()));
    assert_eq!(read::<Vec<Nothing>>(&claims), Err(error));
    assert!(read::<Bytes>(&claims).is_err());
    // as many bytes as elements, but elements are longer
    let cut = read::<Vec<u32>>(&[3, 0, 0, 0, 1, 0, 0, 0]);
    assert_eq!(cut, Err(CdrError::TooShort { needed: 4, left: 0 }));
    // elements without bytes would never come to an end of them
    let error = read::<Vec<Nothing>>(&[2, 0, 0, 0, 1, 2]).unwrap_err();
    assert!(error.to_string().contains("without bytes"), "{error}");
}

#[test]
fn big_endian_differs_in_numbers_and_lengths() {
    let pair = from_big::<(u8, u32)>(&[1, 0, 0, 0, 0, 0, 1, 2]);
    assert_eq!(pair, Ok((1, 258)));
    assert_eq!(from_big::<f64>(&[63, 240, 0, 0, 0, 0, 0, 0]), Ok(1.0));
    assert_eq!(from_big::<String>(&[0, 0, 0, 2, 97, 0]).unwrap(), "a");
    let sequence = from_big::<Vec<i16>>(&[0, 0, 0, 2, 255, 254, 0, 3]);
    assert_eq!(sequence, Ok(vec![-2, 3]));
    assert_eq!(from_big::<Bytes>(&[0, 0, 0, 1, 8]), Ok(Bytes(vec![8])));
}

#[test]
fn booleans_are_0_or_1_and_bytes_behind_a_message_are_left_alone() {
    assert_eq!(read::<bool>(&[2]), Err(CdrError::NoBoolean(2)));
    assert_eq!(read::<u8>(&[2, 3, 4]), Ok(2));
}

#[derive(Debug, PartialEq, Serialize, Deserialize)]
enum Choice {
    Unit,
    Newtype(u8),
    Tuple(u8, u8),
    Struct { a: u8 },
}

#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Unit;

/// A sequence that does not say beforehand how long it is.
struct Endless;

impl Serialize for Endless {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq((0_u8..9).filter(|number| number % 3 == 0))
    }
}

fn is_refused<T: Serialize + DeserializeOwned + Debug>(value: &T, what: &str) {
    for error in [to_vec(value).unwrap_err(), read::<T>(&[1; 64]).unwrap_err()] {
        assert!(error.to_string().contains(what), "{error}, not {what}");
    }
}

#[test]
fn what_messages_do_not_have_is_named() {
    is_refused(&Some(1_u8), "optional");
    is_refused(&None::<u8>, "optional");
    is_refused(&'a', "character");
    is_refused(&1_i128, "128 bits");
    is_refused(&1_u128, "128 bits");
    is_refused(&(), "unit");
    is_refused(&Unit, "unit");
    is_refused(&Pair(1, 2), "tuple with a name");
    is_refused(&BTreeMap::from([(1_u8, 2_u8)]), "map");
    is_refused(&Choice::Unit, "enum");
    is_refused(&Choice::Newtype(1), "enum");
    is_refused(&Choice::Tuple(1, 2), "enum");
    is_refused(&Choice::Struct { a: 1 }, "enum");
    let error = to_vec(&Endless).unwrap_err();
    assert!(error.to_string().contains("unknown length"), "{error}");
}
