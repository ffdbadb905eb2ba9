//! H.264 in MP4, MOV and packets, decoded in this process.

mod aspect;
mod bounded;
mod packets;

pub(crate) use packets::PacketFrames;

use crate::frame::{Grey, VideoFrame};
use crate::mp4::{self, Sample, Track};
use crate::opened::{Elsewhere, Here, MIRRORED, Missing, Opened};
use crate::pixels::PixelShape;
use crate::turn::Turn;
use crate::y4m::in_bytes;
use crate::{Chroma, Colour, ColourSpace, VideoError};
use bounded::BoundedDecoder;
use monogrid_datasets::PixelBudget;
use rust_h264::decoder::{ChromaFormat, Frame};
use rust_h264::nal::{NalUnit, NalUnitType, parse_avcc, parse_sps_info};
use std::collections::BTreeSet;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

/// Longest coded frame, bytes.
const MAX_SAMPLE_BYTES: u32 = 1 << 25;

/// Opens the first video track.
pub(crate) fn open(name: &str, mut file: File, file_bytes: u64) -> Result<Here, VideoError> {
    let track = match mp4::read(name, &mut file, file_bytes)? {
        Ok(track) => track,
        Err(elsewhere) => return Ok(Err(elsewhere)),
    };
    let is_mirrored = track.is_mirrored;
    let elsewhere = |found| Ok(Err(Elsewhere { found, is_mirrored }));
    let mut pixels = track.pixels;
    let sets = [&track.config.sps_list, &track.config.pps_list];
    let sets: Vec<Vec<u8>> = sets.into_iter().flatten().map(prefixed).collect();
    let units = || sets.iter().flat_map(|set| parse_avcc(set, 4));
    let budget = PixelBudget::of_source(Path::new(name), file_bytes);
    let mut decoder = BoundedDecoder::new(units(), Some(budget));
    let mut space = ColourSpace::default();
    for unit in units() {
        space = colour_space(&unit).unwrap_or(space);
        if may_be_interlaced(&unit) {
            return elsewhere("H.264, which may be interlaced".to_owned());
        }
        pixels = pixels.or_else(|| aspect::pixel_shape(&unit));
        if let Err(reason) = decoder.decode(&unit, 0)? {
            return elsewhere(format!("H.264, {reason}"));
        }
    }
    let shown = |sample: &Sample| track.timing.shown_ns(sample.time).is_some();
    let length = track.samples.clone().filter(shown).count();
    let (turn, missing) = (track.turn, Missing::default());
    let pixels = pixels.unwrap_or(PixelShape::SQUARE);
    let frames = H264Frames {
        name: name.to_owned(),
        file,
        track,
        space,
        decoder,
        sample: 0,
        awaited: BTreeSet::new(),
        given_up: BTreeSet::new(),
        missing: missing.clone(),
        is_damaged: false,
        last: None,
        ended: false,
    };
    Ok(Ok(Opened {
        length: Some(length),
        turn,
        pixels: if turn.swaps_sides() {
            pixels.turned()
        } else {
            pixels
        },
        notes: is_mirrored
            .then(|| MIRRORED.to_owned())
            .into_iter()
            .collect(),
        missing,
        ..Opened::new("MP4, H.264", Box::new(frames))
    }))
}

/// Frames of a track in the order in which they are shown.
struct H264Frames {
    name: String,
    file: File,
    track: Track,
    space: ColourSpace,
    /// Times are in units of the track.
    decoder: BoundedDecoder,
    /// Samples read so far.
    sample: usize,
    /// Times of samples, units of the track, of which neither a frame nor an error has come.
    awaited: BTreeSet<i64>,
    /// Those that were counted as missing.
    given_up: BTreeSet<i64>,
    missing: Missing,
    /// Whether there was a sample without a picture.
    is_damaged: bool,
    /// Time of the frame that was shown last, units of the track.
    last: Option<i64>,
    ended: bool,
}

impl H264Frames {
    /// Decodes the next sample; at the end gives out what the decoder still holds.
    fn advance(&mut self) -> Result<(), VideoError> {
        let Some(sample) = self.track.samples.next() else {
            self.ended = true;
            self.decoder.finish();
            return Ok(());
        };
        let number = self.sample;
        self.sample += 1;
        if self.track.timing.shown_ns(sample.time).is_some() {
            self.awaited.insert(sample.time);
        }
        let failed = |reason: String| VideoError::frame(&self.name, number, reason);
        let bytes = read_sample(&mut self.file, sample).map_err(|e| {
            self.awaited.remove(&sample.time);
            failed(e.to_string())
        })?;
        let mut first_error = None;
        // of the length in front of each unit
        let length_bytes = usize::from(self.track.config.length_size_minus_one.get()) + 1;
        let units = parse_avcc(&bytes, length_bytes);
        self.is_damaged |= units.is_empty();
        for unit in units {
            let outcome = self.decoder.decode(&unit, sample.time)?;
            first_error = first_error.or(outcome.err());
        }
        let Some(reason) = first_error else {
            return Ok(());
        };
        self.awaited.remove(&sample.time);
        Err(failed(reason))
    }

    /// Notes that a frame of this time has come: those of earlier samples come no more, unless
    /// times were swapped.
    fn arrived(&mut self, time: i64) {
        if !self.awaited.remove(&time) && self.given_up.remove(&time) {
            self.missing.take_back();
        }
        let later = self.awaited.split_off(&time);
        self.give_up();
        self.awaited = later;
    }

    /// Counts the samples that are awaited as missing.
    fn give_up(&mut self) {
        self.missing.add(self.awaited.len());
        self.given_up.append(&mut self.awaited);
    }

    /// The next frame that is shown.
    fn take_ready(&mut self) -> Option<Result<VideoFrame, VideoError>> {
        while let Some((frame, time)) = self.decoder.take_ready() {
            // behind a hole pictures come whose order nobody knows any more
            if self.is_damaged && self.last.is_some_and(|last| time <= last) {
                self.missing.add(usize::from(self.awaited.remove(&time)));
                continue;
            }
            self.last = Some(time);
            self.arrived(time);
            let Some(timestamp_ns) = self.track.timing.shown_ns(time) else {
                continue;
            };
            let shown = shown(frame, timestamp_ns, self.space, self.track.turn);
            return Some(shown.ok_or_else(|| incomplete(&self.name, self.sample)));
        }
        None
    }
}

impl Iterator for H264Frames {
    type Item = Result<VideoFrame, VideoError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(frame) = self.take_ready() {
                return Some(frame);
            }
            if self.ended {
                self.give_up();
                return None;
            }
            if let Err(error) = self.advance() {
                self.ended |= !error.is_single_frame();
                return Some(Err(error));
            }
        }
    }
}

/// A parameter set behind its length.
fn prefixed(set: impl AsRef<[u8]>) -> Vec<u8> {
    let set = set.as_ref();
    [&(set.len() as u32).to_be_bytes(), set].concat()
}

fn read_sample(file: &mut File, sample: Sample) -> std::io::Result<Vec<u8>> {
    if sample.bytes > MAX_SAMPLE_BYTES {
        let reason = format!("{} bytes for one frame", sample.bytes);
        return Err(std::io::Error::new(std::io::ErrorKind::InvalidData, reason));
    }
    file.seek(SeekFrom::Start(sample.offset))?;
    let mut bytes = Vec::new();
    file.take(u64::from(sample.bytes)).read_to_end(&mut bytes)?;
    if bytes.len() < sample.bytes as usize {
        return Err(std::io::ErrorKind::UnexpectedEof.into());
    }
    Ok(bytes)
}

/// A frame as it is shown, upright: its luma in 8 bits and its colour; `None` where it is not
/// whole.
fn shown(frame: Frame, timestamp_ns: i64, space: ColourSpace, turn: Turn) -> Option<VideoFrame> {
    let (width, height) = (frame.width as usize, frame.height as usize);
    let size = match frame.chroma_format {
        ChromaFormat::Yuv420 => (width.div_ceil(2), height.div_ceil(2)),
        ChromaFormat::Yuv422 => (width.div_ceil(2), height),
    };
    let bits = frame.bit_depth.into();
    let [y, u, v] = [frame.y, frame.u, frame.v].map(|plane| in_bytes(plane, bits));
    let chroma = Chroma::new([&u, &v], size, space, turn);
    Some(VideoFrame {
        image: turn.apply(Grey::from_vec(width, height, y)?),
        colour: chroma.map_or(Colour::Grey, Colour::Chroma),
        timestamp_ns,
    })
}

/// Why a frame is not shown that is not whole.
fn incomplete(name: &str, number: usize) -> VideoError {
    VideoError::frame(name, number, "an incomplete picture")
}

/// Whether a unit says that pictures may be fields, or of fields: only ffmpeg sees which of them
/// are, and makes whole ones of them.
fn may_be_interlaced(unit: &NalUnit<'_>) -> bool {
    unit.nal_unit_type == NalUnitType::Sps
        && parse_sps_info(unit).is_ok_and(|info| !info.progressive)
}

/// What a sequence parameter set says of colour; unknown where it is another unit.
fn colour_space(unit: &NalUnit<'_>) -> Option<ColourSpace> {
    if unit.nal_unit_type != NalUnitType::Sps {
        return None;
    }
    let info = parse_sps_info(unit).ok()?;
    // ITU-T H.264, table E-5
    let is_bt709 = match info.matrix {
        1 => true,
        2 => ColourSpace::usual(info.height as usize, false).is_bt709,
        _ => false,
    };
    Some(ColourSpace {
        has_full_range: info.full_range,
        is_bt709,
    })
}
