//! H.264 in packets of a picture each, with start codes, as recordings of robots have it.

use super::bounded::BoundedDecoder;
use super::{colour_space, incomplete, may_be_interlaced, shown};
use crate::frame::VideoFrame;
use crate::turn::Turn;
use crate::{ColourSpace, VideoError};
use monogrid_bags::{Coded, Packets};
use monogrid_datasets::PixelBudget;
use rust_h264::nal::parse_annex_b;

/// What the codec is called.
const FORMAT: &str = "h264";

/// Frames of packets.
pub(crate) struct PacketFrames {
    name: String,
    packets: Packets,
    space: ColourSpace,
    /// Times are in nanoseconds. Begun with the first packet, which says what there is to hold.
    decoder: Option<BoundedDecoder>,
    /// That of the decoder, until it is begun.
    budget: Option<PixelBudget>,
    /// Packets read so far.
    packet: usize,
    ended: bool,
}

impl PacketFrames {
    /// Frames of a recording; what they may show together is in `budget`.
    pub(crate) fn new(name: &str, packets: Packets, budget: Option<PixelBudget>) -> Self {
        Self {
            name: name.to_owned(),
            packets,
            space: ColourSpace::default(),
            decoder: None,
            budget,
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
        let units = || parse_annex_b(&coded.data).into_iter();
        let budget = &mut self.budget;
        let decoder = self
            .decoder
            .get_or_insert_with(|| BoundedDecoder::new(units(), budget.take()));
        for unit in units() {
            self.space = colour_space(&unit).unwrap_or(self.space);
            if may_be_interlaced(&unit) {
                first_error = first_error.or(Some("pictures that may be interlaced".to_owned()));
                continue;
            }
            let outcome = decoder.decode(&unit, coded.time_ns)?;
            first_error = first_error.or(outcome.err());
        }
        let failed = |reason| Err(VideoError::frame(&self.name, number, reason));
        first_error.map_or(Ok(()), failed)
    }
}

impl Iterator for PacketFrames {
    type Item = Result<VideoFrame, VideoError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            let ready = self.decoder.as_mut().and_then(BoundedDecoder::take_ready);
            if let Some((frame, timestamp_ns)) = ready {
                let shown = shown(frame, timestamp_ns, self.space, Turn::None);
                return Some(shown.ok_or_else(|| incomplete(&self.name, self.packet)));
            }
            if self.ended {
                return None;
            }
            match self.packets.next() {
                Some(Ok(coded)) => {
                    if let Err(error) = self.decode(&coded) {
                        self.ended |= !error.is_single_frame();
                        return Some(Err(error));
                    }
                }
                Some(Err(error)) => {
                    self.ended = true;
                    return Some(Err(error.into()));
                }
                None => {
                    self.ended = true;
                    if let Some(decoder) = &mut self.decoder {
                        decoder.finish();
                    }
                }
            }
        }
    }
}
