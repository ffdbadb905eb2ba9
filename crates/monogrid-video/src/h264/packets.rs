//! H.264 in packets of a picture each, with start codes, as recordings of robots have it.

use super::{colour_space, decode_unit, incomplete, may_be_interlaced, shown};
use crate::turn::Turn;
use crate::{ColourSpace, VideoError, VideoFrame};
use monogrid_bags::{Coded, Packets};
use rust_h264::decoder::{Frame, OrderedDecoder};
use rust_h264::nal::parse_annex_b;
use std::collections::VecDeque;

/// What the codec is called.
const FORMAT: &str = "h264";

/// Frames of packets.
pub(crate) struct PacketFrames {
    name: String,
    packets: Packets,
    space: ColourSpace,
    /// Carries the time of each packet, ns, to its frame.
    decoder: OrderedDecoder<i64>,
    ready: VecDeque<(Frame, i64)>,
    /// Packets read so far.
    packet: usize,
    ended: bool,
}

impl PacketFrames {
    pub(crate) fn new(name: &str, packets: Packets) -> Self {
        Self {
            name: name.to_owned(),
            packets,
            space: ColourSpace::default(),
            decoder: OrderedDecoder::new(),
            ready: VecDeque::new(),
            packet: 0,
            ended: false,
        }
    }

    fn decode(&mut self, coded: &Coded) -> Result<(), VideoError> {
        let number = self.packet;
        self.packet += 1;
        if !coded.format.eq_ignore_ascii_case(FORMAT) {
            self.ended = true;
            let found = match coded.format.trim() {
                "" => "video whose messages do not name their codec".to_owned(),
                format => format!("video coded as {format:?}"),
            };
            return Err(VideoError::content(&self.name, "recording", found, FORMAT));
        }
        let mut first_error = None;
        for unit in parse_annex_b(&coded.data) {
            self.space = colour_space(&unit).unwrap_or(self.space);
            if may_be_interlaced(&unit) {
                first_error = first_error.or(Some("pictures that may be interlaced".to_owned()));
                continue;
            }
            match decode_unit(&mut self.decoder, &unit, coded.time_ns) {
                Ok(frames) => self.ready.extend(frames),
                Err(reason) => first_error = first_error.or(Some(reason)),
            }
        }
        let failed = |reason| Err(VideoError::frame(&self.name, number, reason));
        first_error.map_or(Ok(()), failed)
    }
}

impl Iterator for PacketFrames {
    type Item = Result<VideoFrame, VideoError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some((frame, timestamp_ns)) = self.ready.pop_front() {
                let shown = shown(frame, timestamp_ns, self.space, Turn::None);
                return Some(shown.ok_or_else(|| incomplete(&self.name, self.packet)));
            }
            if self.ended {
                return None;
            }
            match self.packets.next() {
                Some(Ok(coded)) => {
                    if let Err(error) = self.decode(&coded) {
                        return Some(Err(error));
                    }
                }
                Some(Err(error)) => {
                    self.ended = true;
                    return Some(Err(error.into()));
                }
                None => {
                    self.ended = true;
                    self.ready.extend(self.decoder.flush_with_meta());
                }
            }
        }
    }
}
