//! Foxglove's messages (<https://docs.foxglove.dev/docs/sdk/schemas>) in Protocol Buffers, JSON and
//! as ROS writes them, as those of ROS that say the same.

use crate::message::{Raw, Wire};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use monogrid_messages::builtin_interfaces::Time;
use monogrid_messages::sensor_msgs::{CameraInfo, CompressedImage, Image};
use monogrid_messages::std_msgs::Header;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

/// Numbers of the fields that we look at, and their names in JSON.
mod field {
    pub type Field = (u64, &'static str);

    pub const TIMESTAMP: Field = (1, "timestamp");
    pub const WIDTH: Field = (2, "width");
    pub const HEIGHT: Field = (3, "height");

    pub mod raw {
        pub const ENCODING: super::Field = (4, "encoding");
        pub const STEP: super::Field = (5, "step");
        pub const DATA: super::Field = (6, "data");
    }

    pub mod compressed {
        pub const DATA: super::Field = (2, "data");
        pub const FORMAT: super::Field = (3, "format");
    }

    pub mod video {
        pub const DATA: super::Field = (3, "data");
        pub const FORMAT: super::Field = (4, "format");
    }

    pub mod camera {
        pub const MODEL: super::Field = (4, "distortion_model");
        pub const D: super::Field = (5, "D");
        pub const K: super::Field = (6, "K");
        pub const R: super::Field = (7, "R");
        pub const P: super::Field = (8, "P");
    }
}

use field::Field;

/// What ROS writes has the fields of the file of its definition, in their order.
#[derive(Deserialize)]
struct RosRaw {
    timestamp: Time,
    _frame_id: String,
    width: u32,
    height: u32,
    encoding: String,
    step: u32,
    #[serde(with = "serde_bytes")]
    data: Vec<u8>,
}

/// Files of images and packets of videos.
#[derive(Deserialize)]
struct RosCompressed {
    timestamp: Time,
    _frame_id: String,
    #[serde(with = "serde_bytes")]
    data: Vec<u8>,
    format: String,
}

#[derive(Deserialize)]
struct RosCamera {
    _timestamp: Time,
    _frame_id: String,
    width: u32,
    height: u32,
    distortion_model: String,
    d: Vec<f64>,
    k: [f64; 9],
    r: [f64; 9],
    p: [f64; 12],
}

fn stamped(stamp: Time) -> Header {
    Header {
        stamp,
        ..Header::default()
    }
}

/// `foxglove.RawImage`.
pub fn raw_image(message: &Raw) -> Result<Image, String> {
    use field::raw::{DATA, ENCODING, STEP};
    let fields = match Message::of(message)? {
        Message::Ros(read) => {
            let raw: RosRaw = read?;
            return Ok(Image {
                header: stamped(raw.timestamp),
                height: raw.height,
                width: raw.width,
                encoding: raw.encoding,
                is_bigendian: 0,
                step: raw.step,
                data: raw.data,
            });
        }
        Message::Fields(fields) => fields,
    };
    Ok(Image {
        header: stamped(fields.time()?),
        height: fields.whole(field::HEIGHT)?,
        width: fields.whole(field::WIDTH)?,
        encoding: fields.text(ENCODING)?,
        is_bigendian: 0,
        step: fields.whole(STEP)?,
        data: fields.bytes(DATA)?,
    })
}

/// `foxglove.CompressedImage`.
pub fn compressed_image(message: &Raw) -> Result<CompressedImage, String> {
    file(message, field::compressed::DATA, field::compressed::FORMAT)
}

/// `foxglove.CompressedVideo`: a packet in the place of a file.
pub fn compressed_video(message: &Raw) -> Result<CompressedImage, String> {
    file(message, field::video::DATA, field::video::FORMAT)
}

fn file(message: &Raw, data: Field, format: Field) -> Result<CompressedImage, String> {
    match Message::of(message)? {
        Message::Ros(read) => {
            let compressed: RosCompressed = read?;
            Ok(CompressedImage {
                header: stamped(compressed.timestamp),
                format: compressed.format,
                data: compressed.data,
            })
        }
        Message::Fields(fields) => Ok(CompressedImage {
            header: stamped(fields.time()?),
            format: fields.text(format)?,
            data: fields.bytes(data)?,
        }),
    }
}

/// `foxglove.CameraCalibration`.
pub fn camera_info(message: &Raw) -> Result<CameraInfo, String> {
    use field::camera::{D, K, MODEL, P, R};
    let mut info = match Message::of(message)? {
        Message::Ros(read) => {
            let camera: RosCamera = read?;
            CameraInfo {
                height: camera.height,
                width: camera.width,
                distortion_model: camera.distortion_model,
                d: camera.d,
                k: camera.k,
                r: camera.r,
                p: camera.p,
                ..CameraInfo::default()
            }
        }
        Message::Fields(fields) => CameraInfo {
            height: fields.whole(field::HEIGHT)?,
            width: fields.whole(field::WIDTH)?,
            distortion_model: fields.text(MODEL)?,
            d: fields.numbers(D)?,
            k: matrix(fields.numbers(K)?)?,
            r: matrix(fields.numbers(R)?)?,
            p: matrix(fields.numbers(P)?)?,
            ..CameraInfo::default()
        },
    };
    if info.distortion_model == "kannala_brandt" {
        info.distortion_model = "equidistant".to_owned();
    }
    Ok(info)
}

/// All numbers of a matrix, or none.
fn matrix<const N: usize>(numbers: Vec<f64>) -> Result<[f64; N], String> {
    match numbers.len() {
        0 => Ok([0.0; N]),
        count => numbers
            .try_into()
            .map_err(|_| format!("a matrix of {count} numbers, expected {N}")),
    }
}

/// A message by how it is written.
enum Message<M> {
    Ros(Result<M, String>),
    Fields(Fields),
}

impl<M: DeserializeOwned> Message<M> {
    fn of(message: &Raw) -> Result<Self, String> {
        let bytes = &message.data;
        Ok(match message.wire {
            Some(Wire::Cdr | Wire::Ros1) => Self::Ros(message.content()),
            Some(Wire::Protobuf) => Self::Fields(Fields::Protobuf(bytes.clone())),
            Some(Wire::Json) => {
                let value = serde_json::from_slice(bytes);
                Self::Fields(Fields::Json(
                    value.map_err(|error| format!("no JSON: {error}"))?,
                ))
            }
            None => return Err("its encoding is not known".to_owned()),
        })
    }
}

/// A message whose fields have numbers or names. A field that is not there is empty or 0.
enum Fields {
    Protobuf(Vec<u8>),
    Json(Value),
}

impl Fields {
    /// The last field of this number.
    fn last(bytes: &[u8], number: u64) -> Result<Option<Wired<'_>>, String> {
        let mut last = None;
        for field in wired(bytes) {
            let (found, value) = field?;
            if found == number {
                last = Some(value);
            }
        }
        Ok(last)
    }

    fn whole(&self, (number, name): Field) -> Result<u32, String> {
        let found = match self {
            Self::Protobuf(bytes) => Self::last(bytes, number)?.map_or(Some(0), Wired::whole),
            Self::Json(value) => value.get(name).map_or(Some(0), Value::as_u64),
        };
        let found = found.and_then(|number| u32::try_from(number).ok());
        found.ok_or_else(|| format!("{name} is no whole number"))
    }

    fn time(&self) -> Result<Time, String> {
        let (seconds, nanoseconds) = match self {
            Self::Protobuf(bytes) => {
                let Some(Wired::Bytes(time)) = Self::last(bytes, field::TIMESTAMP.0)? else {
                    return Ok(Time::default());
                };
                let part = |number: u64| -> Result<u64, String> {
                    let found = Self::last(time, number)?.map_or(Some(0), Wired::whole);
                    found.ok_or_else(|| "the time is no number".to_owned())
                };
                (part(1)?, part(2)?)
            }
            Self::Json(value) => {
                let part = |name: &str| {
                    let part = value
                        .get(field::TIMESTAMP.1)
                        .and_then(|time| time.get(name));
                    part.and_then(Value::as_u64).unwrap_or(0)
                };
                (part("sec"), part("nsec"))
            }
        };
        let total = u128::from(seconds) * 1_000_000_000 + u128::from(nanoseconds);
        let total = i64::try_from(total).map_err(|_| format!("a time of {seconds} s"))?;
        Ok(Time::from_nanoseconds(total))
    }

    fn text(&self, (number, name): Field) -> Result<String, String> {
        let found = match self {
            Self::Protobuf(bytes) => match Self::last(bytes, number)? {
                None => Some(String::new()),
                Some(Wired::Bytes(text)) => String::from_utf8(text.to_vec()).ok(),
                Some(_) => None,
            },
            Self::Json(value) => match value.get(name) {
                None => Some(String::new()),
                Some(text) => text.as_str().map(str::to_owned),
            },
        };
        found.ok_or_else(|| format!("{name} is no text"))
    }

    fn bytes(&self, (number, name): Field) -> Result<Vec<u8>, String> {
        let found = match self {
            Self::Protobuf(bytes) => match Self::last(bytes, number)? {
                None => Some(Vec::new()),
                Some(Wired::Bytes(data)) => Some(data.to_vec()),
                Some(_) => None,
            },
            Self::Json(value) => {
                let text = value.get(name).map_or(Some(""), Value::as_str);
                text.and_then(|text| STANDARD.decode(text).ok())
            }
        };
        found.ok_or_else(|| format!("{name} is no bytes, or no base64"))
    }

    fn numbers(&self, (number, name): Field) -> Result<Vec<f64>, String> {
        let mut numbers = Vec::new();
        match self {
            Self::Protobuf(bytes) => {
                for field in wired(bytes) {
                    match field? {
                        (found, _) if found != number => {}
                        (_, Wired::Fixed64(bits)) => numbers.push(f64::from_bits(bits)),
                        (_, Wired::Bytes(packed)) => {
                            let (packed, _) = packed.as_chunks();
                            numbers.extend(packed.iter().map(|bytes| f64::from_le_bytes(*bytes)));
                        }
                        _ => return Err(format!("{name} has no numbers")),
                    }
                }
            }
            Self::Json(value) => {
                let list = value.get(name).and_then(Value::as_array);
                for number in list.into_iter().flatten() {
                    let no_number = || format!("{name} has no numbers");
                    numbers.push(number.as_f64().ok_or_else(no_number)?);
                }
            }
        }
        Ok(numbers)
    }
}

/// The value of a field in Protocol Buffers.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Wired<'a> {
    Varint(u64),
    Fixed64(u64),
    Fixed32(u32),
    Bytes(&'a [u8]),
}

impl Wired<'_> {
    fn whole(self) -> Option<u64> {
        match self {
            Self::Varint(number) => Some(number),
            Self::Fixed32(number) => Some(number.into()),
            Self::Fixed64(_) | Self::Bytes(_) => None,
        }
    }
}

/// Numbers and values of fields, until the first that is damaged
/// (<https://protobuf.dev/programming-guides/encoding>).
fn wired(bytes: &[u8]) -> impl Iterator<Item = Result<(u64, Wired<'_>), String>> {
    let mut rest = crate::fields::Fields(bytes);
    std::iter::from_fn(move || {
        if rest.0.is_empty() {
            return None;
        }
        let field = next_field(&mut rest);
        if field.is_none() {
            rest.0 = &[];
        }
        Some(field.ok_or_else(|| "a message ends within its fields".to_owned()))
    })
}

fn next_field<'a>(rest: &mut crate::fields::Fields<'a>) -> Option<(u64, Wired<'a>)> {
    let tag = varint(rest)?;
    let value = match tag & 7 {
        0 => Wired::Varint(varint(rest)?),
        1 => Wired::Fixed64(rest.u64()?),
        2 => {
            let length = varint(rest)?;
            Wired::Bytes(rest.slice(length)?)
        }
        5 => Wired::Fixed32(rest.u32()?),
        _ => return None,
    };
    Some((tag >> 3, value))
}

/// A number in groups of seven bits, the lowest first.
fn varint(rest: &mut crate::fields::Fields) -> Option<u64> {
    let mut number = 0;
    for k in 0..10 {
        let byte = rest.u8()?;
        number |= u64::from(byte & 0x7f).checked_shl(7 * k).unwrap_or(0);
        if byte < 0x80 {
            return Some(number);
        }
    }
    None
}
