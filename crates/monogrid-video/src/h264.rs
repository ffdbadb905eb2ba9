//! H.264 in MP4, MOV and packets, decoded in this process.

mod aspect;
mod packets;

pub(crate) use packets::PacketFrames;

use crate::mp4::{self, Sample, Track};
use crate::pixels::PixelShape;
use crate::turn::Turn;
use crate::y4m::in_bytes;
use crate::{
    Chroma, Colour, ColourSpace, Elsewhere, Grey, Here, MIRRORED, Missing, Opened, VideoError,
    VideoFrame,
};
use rust_h264::decoder::{ChromaFormat, Frame, OrderedDecoder};
use rust_h264::nal::{NalUnit, NalUnitType, SpsInfo, parse_avcc, parse_sps_info};
use std::collections::{BTreeSet, VecDeque};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};

/// Most pixels of a picture that is decoded here: those of level 5.2 (4096x2304). Larger ones go to
/// ffmpeg; sixteen reference pictures of this size stay below half a gigabyte.
const MAX_PICTURE_PIXELS: u64 = 36_864 * 256;

/// Macroblocks of all pictures that a decoder must hold, as references or until their turn: those
/// of level 5.2 (ITU-T H.264, table A-1). A stream may ask for any number.
const MAX_HELD_MACROBLOCKS: u64 = 184_320;
/// Pictures that a decoder must hold, whatever their size.
const MAX_HELD: u64 = 16;

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
    let mut decoder = decoder_of(&sets);
    let mut space = ColourSpace::default();
    for set in &sets {
        for unit in parse_avcc(set, 4) {
            space = colour_space(&unit).unwrap_or(space);
            if may_be_interlaced(&unit) {
                return elsewhere("H.264, which may be interlaced".to_owned());
            }
            pixels = pixels.or_else(|| aspect::pixel_shape(&unit));
            if let Err(reason) = decode_unit(&mut decoder, &unit, 0) {
                return elsewhere(format!("H.264, {reason}"));
            }
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
        ready: VecDeque::new(),
        sample: 0,
        awaited: BTreeSet::new(),
        given_up: BTreeSet::new(),
        missing: missing.clone(),
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
    /// Carries the time of each sample, units of the track, to its frame.
    decoder: OrderedDecoder<i64>,
    ready: VecDeque<(Frame, i64)>,
    /// Samples read so far.
    sample: usize,
    /// Times of samples, units of the track, of which neither a frame nor an error has come.
    awaited: BTreeSet<i64>,
    /// Those that were counted as missing.
    given_up: BTreeSet<i64>,
    missing: Missing,
    ended: bool,
}

impl H264Frames {
    /// Decodes the next sample; at the end gives out what the decoder still holds.
    fn advance(&mut self) -> Result<(), VideoError> {
        let Some(sample) = self.track.samples.next() else {
            self.ended = true;
            self.ready.extend(self.decoder.flush_with_meta());
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
        for unit in parse_avcc(&bytes, length_bytes) {
            match decode_unit(&mut self.decoder, &unit, sample.time) {
                Ok(frames) => self.ready.extend(frames),
                Err(reason) => first_error = first_error.or(Some(reason)),
            }
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
        while let Some((frame, time)) = self.ready.pop_front() {
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

/// A decoder for the pictures that these parameter sets announce, which keeps no more of them until
/// their turn than it must.
fn decoder_of(sets: &[Vec<u8>]) -> OrderedDecoder<i64> {
    let units = sets.iter().flat_map(|set| parse_avcc(set, 4));
    let infos = units.filter_map(|unit| parse_sps_info(&unit).ok());
    let most = infos.map(|info| max_held(&info)).min();
    OrderedDecoder::with_max_depth(most.unwrap_or(MAX_HELD) as usize)
}

/// Pictures of this size that a decoder must hold at most.
fn max_held(info: &SpsInfo) -> u64 {
    let macroblocks = u64::from(info.coded_width) * u64::from(info.coded_height) / 256;
    (MAX_HELD_MACROBLOCKS / macroblocks.max(1)).clamp(1, MAX_HELD)
}

/// Hands one unit to the decoder, unless it announces pictures that are too large or too many.
fn decode_unit(
    decoder: &mut OrderedDecoder<i64>,
    unit: &NalUnit<'_>,
    time: i64,
) -> Result<Vec<(Frame, i64)>, String> {
    if unit.nal_unit_type == NalUnitType::Sps {
        let info = parse_sps_info(unit).map_err(|e| e.to_string())?;
        if u64::from(info.coded_width) * u64::from(info.coded_height) > MAX_PICTURE_PIXELS {
            let (width, height) = (info.width, info.height);
            return Err(format!("pictures of {width}x{height} pixels"));
        }
        let (found, most) = (u64::from(info.reference_frames), max_held(&info));
        if found > most {
            return Err(format!(
                "{found} reference pictures, expected at most {most}"
            ));
        }
    }
    decoder
        .decode_nal_with_meta(unit, time)
        .map_err(|e| e.to_string())
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A number as the standard writes it.
    fn exp_golomb(number: u32) -> String {
        let digits = format!("{:b}", number + 1);
        "0".repeat(digits.len() - 1) + &digits
    }

    /// A sequence parameter set of so many macroblocks and references, behind its length.
    fn parameters(columns: u32, rows: u32, references: u32) -> Vec<u8> {
        // baseline, level 5.1; identity, bits of frame numbers, order by number
        let start = "010000101100000000110011 1 1 011";
        let size = exp_golomb(columns - 1) + &exp_golomb(rows - 1);
        let bits = format!("{start} {} 0 {size} 1 1 0 0 1", exp_golomb(references));
        let mut bits: Vec<u8> = bits.bytes().filter(u8::is_ascii_digit).collect();
        bits.resize(bits.len().next_multiple_of(8), b'0');
        let byte = |eight: &[u8]| eight.iter().fold(0, |byte, bit| byte << 1 | (bit - b'0'));
        let unit: Vec<u8> = [0x67].into_iter().chain(bits.chunks(8).map(byte)).collect();
        [&(unit.len() as u32).to_be_bytes(), unit.as_slice()].concat()
    }

    fn decoded(columns: u32, rows: u32, references: u32) -> Result<usize, String> {
        let bytes = parameters(columns, rows, references);
        let units: Vec<NalUnit> = parse_avcc(&bytes, 4).into_iter().collect();
        let frames = decode_unit(&mut OrderedDecoder::new(), &units[0], 0);
        frames.map(|frames| frames.len())
    }

    #[test]
    fn a_stream_may_not_have_any_number_of_pictures_held() {
        for (columns, rows, most) in [(256, 144, 5), (240, 135, 5), (120, 68, 16), (1, 1, 16)] {
            assert_eq!(decoded(columns, rows, most), Ok(0), "{columns}x{rows}");
            let expected = format!("{} reference pictures, expected at most {most}", most + 1);
            assert_eq!(decoded(columns, rows, most + 1), Err(expected));
        }
        assert!(decoded(4, 4, 1 << 30).is_err());
        assert!(decoded(257, 144, 1).is_err(), "too large");
    }
}
