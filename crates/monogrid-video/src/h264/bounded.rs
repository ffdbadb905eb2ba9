//! A decoder that takes no more memory and time than what its stream stores is worth.

use crate::VideoError;
use crate::frame::MIN_FRAME_PIXELS;
use monogrid_datasets::PixelBudget;
use rust_h264::decoder::{Frame, OrderedDecoder};
use rust_h264::nal::{NalUnit, NalUnitType, SpsInfo, parse_sps_info};
use std::collections::VecDeque;

/// Most pixels of a picture that is decoded here: those of level 5.2 (4096x2304). Larger ones go to
/// ffmpeg; sixteen reference pictures of this size stay below half a gigabyte.
const MAX_PICTURE_PIXELS: u64 = 36_864 * 256;

/// Bytes of all pictures that a decoder must hold, as references or until their turn: those of
/// level 5.2 (184,320 macroblocks: ITU-T H.264, table A-1) in 4:2:0 and 8 bits. A stream may ask
/// for any number, and one of 4:2:2 and 10 bits has nearly three times the bytes.
const MAX_HELD_BYTES: u64 = 184_320 * 384;
/// Pictures that a decoder must hold, whatever their size.
const MAX_HELD: u64 = 16;

/// The part of its picture that a slice counts for, however little of it there is: the decoder
/// copies what it knows of the picture for each.
const PART_OF_SLICE: usize = 4;

/// Decodes units, and holds the pictures that are complete.
pub(super) struct BoundedDecoder {
    /// Carries the time of each sample, in the caller's unit, to its picture.
    decoder: OrderedDecoder<i64>,
    ready: VecDeque<(Frame, i64)>,
    /// Bytes of the largest picture of a parameter set, each of which any slice may name.
    picture_bytes: u64,
    /// What a slice takes out of the budget at most.
    slice_cost: usize,
    /// Pictures that may wait to be taken.
    most_ready: usize,
    /// What the slices may cover together, shown or not; `None` for what comes as it happens.
    budget: Option<PixelBudget>,
}

impl BoundedDecoder {
    /// A decoder for the pictures that these parameter sets announce, which keeps no more of them
    /// until their turn than it must.
    pub(super) fn new<'a>(
        sets: impl Iterator<Item = NalUnit<'a>>,
        budget: Option<PixelBudget>,
    ) -> Self {
        let infos = sets.filter_map(|unit| parse_sps_info(&unit).ok());
        let most = infos.map(|info| max_held(plane_bytes(&info))).min();
        let most = most.unwrap_or(MAX_HELD) as usize;
        Self {
            decoder: OrderedDecoder::with_max_depth(most),
            ready: VecDeque::new(),
            picture_bytes: 0,
            slice_cost: MIN_FRAME_PIXELS / PART_OF_SLICE,
            most_ready: 1 + most,
            budget,
        }
    }

    /// Decodes one unit. A sample is one picture: what makes many of them is refused, before they
    /// fill the memory.
    ///
    /// # Errors
    /// When nothing more may be decoded; inside, why this unit was not.
    pub(super) fn decode(
        &mut self,
        unit: &NalUnit<'_>,
        time: i64,
    ) -> Result<Result<(), String>, VideoError> {
        match unit.nal_unit_type {
            NalUnitType::Sps => match announced(unit, self.picture_bytes) {
                Ok(info) => {
                    self.picture_bytes = self.picture_bytes.max(plane_bytes(&info));
                    self.slice_cost = self.slice_cost.max(slice_cost(&info));
                    self.most_ready = 1 + max_held(self.picture_bytes) as usize;
                }
                Err(reason) => return Ok(Err(reason)),
            },
            NalUnitType::Slice | NalUnitType::SliceIdr | NalUnitType::SliceDataA => {
                self.spend()?;
                if self.ready.len() > self.most_ready {
                    return Ok(Err("more than one picture in a sample".to_owned()));
                }
            }
            _ => {}
        }
        let frames = self.decoder.decode_nal_with_meta(unit, time);
        Ok(frames
            .map(|frames| self.ready.extend(frames))
            .map_err(|e| e.to_string()))
    }

    /// Takes a slice out of the budget.
    fn spend(&mut self) -> Result<(), VideoError> {
        if let Some(budget) = &mut self.budget {
            budget.spend(self.slice_cost, 1)?;
        }
        Ok(())
    }

    /// The next picture that is complete.
    pub(super) fn take_ready(&mut self) -> Option<(Frame, i64)> {
        self.ready.pop_front()
    }

    /// Completes what is still held, at the end.
    pub(super) fn finish(&mut self) {
        self.ready.extend(self.decoder.flush_with_meta());
    }
}

/// Pixels of a picture with its macroblocks at the edges.
fn coded_pixels(info: &SpsInfo) -> u64 {
    u64::from(info.coded_width) * u64::from(info.coded_height)
}

/// Whether samples have more than eight bits.
fn is_deep(info: &SpsInfo) -> bool {
    info.bit_depth_luma.max(info.bit_depth_chroma) > 8
}

/// Bytes of the planes of a picture.
fn plane_bytes(info: &SpsInfo) -> u64 {
    // of two pixels; grey ones are held as 4:2:0
    let samples = if info.chroma_format < 2 { 3 } else { 4 };
    coded_pixels(info) * samples / 2 * if is_deep(info) { 2 } else { 1 }
}

/// Pictures of so many bytes that a decoder must hold at most.
fn max_held(picture_bytes: u64) -> u64 {
    (MAX_HELD_BYTES / picture_bytes.max(1)).clamp(1, MAX_HELD)
}

/// What a slice takes out of the budget, pixels. Samples of more than eight bits are decoded ten
/// times as slowly: they count by their bytes.
fn slice_cost(info: &SpsInfo) -> usize {
    let pixels = coded_pixels(info) as usize;
    match is_deep(info) {
        true => (plane_bytes(info) as usize).max(MIN_FRAME_PIXELS),
        false => pixels.max(MIN_FRAME_PIXELS) / PART_OF_SLICE,
    }
}

/// What a parameter set announces, unless its pictures are too large, or too many of them or of
/// those that were announced before.
fn announced(unit: &NalUnit<'_>, bytes_before: u64) -> Result<SpsInfo, String> {
    let info = parse_sps_info(unit).map_err(|e| e.to_string())?;
    if coded_pixels(&info) > MAX_PICTURE_PIXELS {
        let (width, height) = (info.width, info.height);
        return Err(format!("pictures of {width}x{height} pixels"));
    }
    let most = max_held(plane_bytes(&info).max(bytes_before));
    let found = u64::from(info.reference_frames);
    if found > most {
        return Err(format!(
            "{found} reference pictures, expected at most {most}"
        ));
    }
    Ok(info)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rust_h264::nal::parse_annex_b;
    use std::path::Path;

    /// A number as the standard writes it.
    fn exp_golomb(number: u32) -> String {
        let digits = format!("{:b}", number + 1);
        "0".repeat(digits.len() - 1) + &digits
    }

    /// A unit of these bits.
    fn unit(kind: u8, bits: &str) -> Vec<u8> {
        let mut bits: Vec<u8> = bits.bytes().filter(u8::is_ascii_digit).collect();
        bits.push(b'1');
        bits.resize(bits.len().next_multiple_of(8), b'0');
        let byte = |eight: &[u8]| eight.iter().fold(0, |byte, bit| byte << 1 | (bit - b'0'));
        let start = [0, 0, 0, 1, kind].into_iter();
        start.chain(bits.chunks(8).map(byte)).collect()
    }

    /// Baseline, level 5.1; identity.
    const BASELINE: &str = "010000101100000000110011 1";
    /// High 4:2:2, level 5.1; identity, chroma format, ten bits, no bypass, no matrices.
    const TEN_BITS_422: &str = "011110100000000000110011 1 011 011 011 0 0";

    /// A sequence parameter set of so many macroblocks and references.
    fn parameters(columns: u32, rows: u32, references: u32) -> Vec<u8> {
        parameters_of(BASELINE, (columns, rows), references)
    }

    fn parameters_of(profile: &str, (columns, rows): (u32, u32), references: u32) -> Vec<u8> {
        // bits of frame numbers, order by number
        let start = format!("{profile} 1 011");
        let size = exp_golomb(columns - 1) + &exp_golomb(rows - 1);
        unit(
            0x67,
            &format!("{start} {} 0 {size} 1 1 0 0", exp_golomb(references)),
        )
    }

    /// Parameter sets and a plain picture of so many macroblocks a side, as one sample.
    fn plain_picture(side: u32) -> Vec<u8> {
        let blocks = "00100 1 1 1".repeat((side * side) as usize);
        let picture = "1 0001000 1 0000 1 00 1".to_owned() + &blocks;
        let pps = unit(0x68, "1 1 0 0 1 1 1 0 00 1 1 1 000");
        [parameters(side, side, 1), pps, unit(0x65, &picture)].concat()
    }

    /// A slice that repeats so many macroblocks of what was before, from one on.
    fn repeated(picture: usize, (first, count): (u32, u32)) -> Vec<u8> {
        let (number, first, count) = (picture % 16, exp_golomb(first), exp_golomb(count));
        unit(
            0x41,
            &format!("{first} 00110 1 {number:04b} 0 0 0 1 {count}"),
        )
    }

    fn decoder(stored_bytes: u64) -> BoundedDecoder {
        let budget = PixelBudget::of_source(Path::new("a.mp4"), stored_bytes);
        BoundedDecoder::new(std::iter::empty(), Some(budget))
    }

    fn announces(profile: &str, size: (u32, u32), references: u32) -> Result<(), String> {
        let bytes = parameters_of(profile, size, references);
        let units = parse_annex_b(&bytes);
        decoder(0).decode(&units[0], 0).expect("in the budget")
    }

    #[test]
    fn a_stream_may_not_have_any_number_of_pictures_held() {
        for (profile, size, most) in [
            (BASELINE, (256, 144), 5),
            (BASELINE, (240, 135), 5),
            (BASELINE, (120, 68), 16),
            (BASELINE, (1, 1), 16),
            // a third more samples, of two bytes each
            (TEN_BITS_422, (256, 144), 1),
            (TEN_BITS_422, (240, 135), 2),
            (TEN_BITS_422, (120, 68), 8),
        ] {
            assert_eq!(announces(profile, size, most), Ok(()), "{size:?}");
            let expected = format!("{} reference pictures, expected at most {most}", most + 1);
            assert_eq!(announces(profile, size, most + 1), Err(expected));
        }
        assert!(announces(BASELINE, (4, 4), 1 << 30).is_err());
        assert!(announces(BASELINE, (257, 144), 1).is_err(), "too large");
    }

    #[test]
    fn a_parameter_set_of_small_pictures_says_nothing_of_large_ones() {
        let mut decoder = decoder(0);
        let mut announce = |size: u32, references| {
            let bytes = parameters(size, size, references);
            let units = parse_annex_b(&bytes);
            let outcome = decoder.decode(&units[0], 0).expect("in the budget");
            (outcome.is_ok(), decoder.slice_cost)
        };
        assert_eq!(announce(4, 16), (true, 8192 / 4));
        let large = (true, 192 * 192 * 64);
        assert_eq!(announce(192, 5), large);
        assert_eq!(announce(4, 5), large, "slices may still be of large ones");
        assert!(!announce(4, 16).0, "which would be held as often");
    }

    #[test]
    fn a_sample_of_many_pictures_does_not_fill_the_memory() {
        let mut decoder = decoder(0);
        let bytes = [
            plain_picture(1),
            (1..200).flat_map(|n| repeated(n, (0, 1))).collect(),
        ]
        .concat();
        let outcomes = parse_annex_b(&bytes).into_iter().map(|unit| {
            let outcome = decoder.decode(&unit, 0).expect("in the budget");
            (outcome, decoder.ready.len())
        });
        let (outcomes, held): (Vec<_>, Vec<_>) = outcomes.unzip();
        assert_eq!(outcomes[..10], vec![Ok(()); 10], "ordinary at first");
        let refused = Err("more than one picture in a sample".to_owned());
        assert_eq!(outcomes.last(), Some(&refused));
        let most = held.into_iter().max().unwrap_or(0);
        assert!((16..40).contains(&most), "{most} pictures were held");
    }

    #[test]
    fn large_pictures_wait_for_their_turn_in_a_small_number() {
        let repeats = (1..9).flat_map(|n| repeated(n, (0, 192 * 192)));
        let bytes = [plain_picture(192), repeats.collect()].concat();
        let budget = PixelBudget::of_source(Path::new("a.mp4"), 1 << 20);
        let mut decoder = BoundedDecoder::new(parse_annex_b(&bytes).into_iter(), Some(budget));
        for unit in parse_annex_b(&bytes) {
            let outcome = decoder.decode(&unit, 0).expect("in the budget");
            assert_eq!(outcome, Ok(()));
        }
        // eight are complete, and five may be held
        assert_eq!(decoder.ready.len(), 3);
    }

    /// Slices that are decoded after a picture of a megapixel, each from this macroblock on.
    fn slices_until_refused(first: u32) -> usize {
        let mut decoder = decoder(0);
        for unit in parse_annex_b(&plain_picture(64)) {
            let outcome = decoder.decode(&unit, 0).expect("in the budget");
            assert_eq!(outcome, Ok(()));
        }
        let bytes = repeated(1, (first, 4096 - first));
        let units = parse_annex_b(&bytes);
        let is_over = |_: &usize| decoder.decode(&units[0], 0).is_err();
        (0..).find(is_over).expect("an end")
    }

    #[test]
    fn slices_of_a_picture_again_and_again_are_refused_however_little_they_cover() {
        // 2^27 pixels, of which the picture took a quarter of 2^20
        for first in [0, 2048, 4095] {
            assert_eq!(slices_until_refused(first), 512 - 1, "{first}");
        }
    }

    #[test]
    fn samples_of_ten_bits_count_by_their_bytes() {
        let cost = |profile| {
            let mut decoder = decoder(0);
            let bytes = parameters_of(profile, (120, 68), 1);
            let units = parse_annex_b(&bytes);
            let outcome = decoder.decode(&units[0], 0).expect("in the budget");
            assert_eq!(outcome, Ok(()));
            decoder.slice_cost
        };
        let pixels = 120 * 68 * 256;
        assert_eq!(cost(BASELINE), pixels / 4);
        assert_eq!(cost(TEN_BITS_422), pixels * 4);
    }
}
