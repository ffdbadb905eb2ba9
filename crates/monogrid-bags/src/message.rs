//! Messages as they lie in a recording, and what is in them.

use crate::bag::TopicKind;
use crate::fields::Fields;
use monogrid_messages::RosMessage;
use monogrid_messages::builtin_interfaces::Time;
use monogrid_messages::cdr::{self, ByteOrder};
use monogrid_messages::sensor_msgs::{CameraInfo, CompressedImage, Image, RegionOfInterest};
use monogrid_messages::std_msgs::Header;
use std::sync::Arc;

/// How the fields of a message are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wire {
    /// ROS 2: CDR with its four bytes in front, fields aligned.
    Cdr,
    /// ROS 1: little endian, one after the other.
    Ros1,
}

/// A message.
#[derive(Clone, Debug)]
pub struct Raw {
    pub topic: Arc<str>,
    pub kind: TopicKind,
    /// When it was recorded.
    pub log_ns: i64,
    pub wire: Wire,
    /// Nothing of topics that nobody looks at.
    pub data: Vec<u8>,
}

impl Raw {
    pub fn new(topic: &Arc<str>, kind: TopicKind, log_ns: i64, wire: Wire, data: &[u8]) -> Self {
        let is_kept = kind != TopicKind::Other;
        Self {
            topic: Arc::clone(topic),
            kind,
            log_ns,
            wire,
            data: if is_kept { data.to_vec() } else { Vec::new() },
        }
    }
}

/// An image.
pub fn image(message: &Raw) -> Result<Image, String> {
    match message.wire {
        Wire::Cdr => of_cdr(&message.data),
        Wire::Ros1 => Fields(&message.data)
            .image()
            .ok_or_else(|| too_short(message)),
    }
}

/// An image file.
pub fn compressed_image(message: &Raw) -> Result<CompressedImage, String> {
    match message.wire {
        Wire::Cdr => of_cdr(&message.data),
        Wire::Ros1 => Fields(&message.data)
            .compressed_image()
            .ok_or_else(|| too_short(message)),
    }
}

/// A calibration.
pub fn camera_info(message: &Raw) -> Result<CameraInfo, String> {
    match message.wire {
        Wire::Cdr => of_cdr(&message.data),
        Wire::Ros1 => Fields(&message.data)
            .camera_info()
            .ok_or_else(|| too_short(message)),
    }
}

fn too_short(message: &Raw) -> String {
    format!(
        "a message of {} bytes ends within its fields",
        message.data.len()
    )
}

fn of_cdr<M: RosMessage>(data: &[u8]) -> Result<M, String> {
    let Some((&[_, order, _, _], body)) = data.split_first_chunk() else {
        return Err(format!(
            "a message of {} bytes has no encapsulation",
            data.len()
        ));
    };
    let order = match order {
        1 => ByteOrder::Little,
        0 => ByteOrder::Big,
        other => {
            return Err(format!(
                "encapsulation {other} is not supported, expected plain CDR (0 or 1)"
            ));
        }
    };
    cdr::from_bytes(body, order).map_err(|error| error.to_string())
}

/// Fields of messages of ROS 1.
impl Fields<'_> {
    fn f64s<const N: usize>(&mut self) -> Option<[f64; N]> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = f64::from_le_bytes(self.array()?);
        }
        Some(values)
    }

    fn string(&mut self) -> Option<String> {
        Some(String::from_utf8_lossy(self.bytes()?).into_owned())
    }

    fn header(&mut self) -> Option<Header> {
        let _number = self.u32()?;
        let sec = i32::try_from(self.u32()?).ok()?;
        let nanosec = self.u32()?;
        let stamp = Time { sec, nanosec };
        Some(Header {
            stamp,
            frame_id: self.string()?,
        })
    }

    fn image(mut self) -> Option<Image> {
        Some(Image {
            header: self.header()?,
            height: self.u32()?,
            width: self.u32()?,
            encoding: self.string()?,
            is_bigendian: self.u8()?,
            step: self.u32()?,
            data: self.bytes()?.to_vec(),
        })
    }

    fn compressed_image(mut self) -> Option<CompressedImage> {
        Some(CompressedImage {
            header: self.header()?,
            format: self.string()?,
            data: self.bytes()?.to_vec(),
        })
    }

    fn camera_info(mut self) -> Option<CameraInfo> {
        Some(CameraInfo {
            header: self.header()?,
            height: self.u32()?,
            width: self.u32()?,
            distortion_model: self.string()?,
            d: {
                let count = self.u32()?;
                (0..count)
                    .map(|_| Some(self.f64s::<1>()?[0]))
                    .collect::<Option<_>>()?
            },
            k: self.f64s()?,
            r: self.f64s()?,
            p: self.f64s()?,
            binning_x: self.u32()?,
            binning_y: self.u32()?,
            roi: RegionOfInterest {
                x_offset: self.u32()?,
                y_offset: self.u32()?,
                height: self.u32()?,
                width: self.u32()?,
                do_rectify: self.u8()? != 0,
            },
        })
    }
}
