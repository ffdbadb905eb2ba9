//! The shape of pixels in a sequence parameter set (ITU-T H.264, 7.3.2.1.1 and E.1.1), which the
//! decoder passes over.

use crate::pixels::PixelShape;
use rust_h264::nal::{NalUnit, NalUnitType};

/// Width and height of a pixel by their number, from 1 (table E-1).
const SHAPES: [(u64, u64); 16] = [
    (1, 1),
    (12, 11),
    (10, 11),
    (16, 11),
    (40, 33),
    (24, 11),
    (20, 11),
    (32, 11),
    (80, 33),
    (18, 11),
    (15, 11),
    (64, 33),
    (160, 99),
    (4, 3),
    (3, 2),
    (2, 1),
];

/// Width and height follow.
const EXTENDED: u32 = 255;

/// Profiles whose parameter sets say more of colour.
const HIGH_PROFILES: [u32; 13] = [100, 110, 122, 244, 44, 83, 86, 118, 128, 138, 139, 134, 135];

/// The shape that a sequence parameter set says; `None` where it says none, or is another unit.
pub(super) fn pixel_shape(unit: &NalUnit<'_>) -> Option<PixelShape> {
    match unit.nal_unit_type {
        NalUnitType::Sps => shape_in(&mut Bits {
            bytes: &unit.rbsp,
            at: 0,
        }),
        _ => None,
    }
}

fn shape_in(bits: &mut Bits) -> Option<PixelShape> {
    let profile = bits.number(8)?;
    bits.number(16)?; // constraints and level
    bits.exp_golomb()?; // its identity
    if HIGH_PROFILES.contains(&profile) {
        skip_colour(bits)?;
    }
    bits.exp_golomb()?; // of numbers of frames
    skip_order(bits)?;
    bits.exp_golomb()?; // reference frames
    bits.number(1)?; // gaps
    bits.exp_golomb()?; // width
    bits.exp_golomb()?; // height
    if bits.number(1)? == 0 {
        bits.number(1)?; // fields
    }
    bits.number(1)?; // direct inference
    if bits.number(1)? == 1 {
        (0..4).try_for_each(|_| bits.exp_golomb().map(drop))?; // cropping
    }
    let [has_more, has_shape] = [bits.number(1)?, bits.number(1)?];
    if (has_more, has_shape) != (1, 1) {
        return None;
    }
    let number = bits.number(8)?;
    if number == EXTENDED {
        return Some(PixelShape::new(
            bits.number(16)?.into(),
            bits.number(16)?.into(),
        ));
    }
    let (width, height) = *SHAPES.get((number as usize).checked_sub(1)?)?;
    Some(PixelShape::new(width, height))
}

fn skip_colour(bits: &mut Bits) -> Option<()> {
    let chroma = bits.exp_golomb()?;
    if chroma == 3 {
        bits.number(1)?;
    }
    bits.exp_golomb()?;
    bits.exp_golomb()?; // bits of luma and chroma
    bits.number(1)?;
    if bits.number(1)? == 1 {
        let lists = if chroma == 3 { 12 } else { 8 };
        for list in 0..lists {
            if bits.number(1)? == 1 {
                skip_scaling_list(bits, if list < 6 { 16 } else { 64 })?;
            }
        }
    }
    Some(())
}

fn skip_scaling_list(bits: &mut Bits, size: usize) -> Option<()> {
    let (mut last, mut next) = (8, 8);
    for _ in 0..size {
        if next != 0 {
            next = (last + bits.signed_exp_golomb()?).rem_euclid(256);
        }
        last = if next == 0 { last } else { next };
    }
    Some(())
}

/// How pictures are put into order.
fn skip_order(bits: &mut Bits) -> Option<()> {
    match bits.exp_golomb()? {
        0 => bits.exp_golomb().map(drop),
        1 => {
            bits.number(1)?;
            bits.exp_golomb()?;
            bits.exp_golomb()?;
            let count = bits.exp_golomb()?.min(255);
            (0..count).try_for_each(|_| bits.exp_golomb().map(drop))
        }
        _ => Some(()),
    }
}

/// Bits from the front of bytes, the highest of each first; none beyond their end.
struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Bits<'_> {
    fn number(&mut self, count: u32) -> Option<u32> {
        (0..count).try_fold(0, |number, _| {
            let byte = self.bytes.get(self.at / 8)?;
            let bit = byte >> (7 - self.at % 8) & 1;
            self.at += 1;
            Some(number << 1 | u32::from(bit))
        })
    }

    /// As many zeros as bits behind a one (9.1).
    fn exp_golomb(&mut self) -> Option<u32> {
        let mut zeros = 0;
        while self.number(1)? == 0 {
            zeros += 1;
        }
        match zeros {
            0..=31 => Some((1 << zeros) - 1 + self.number(zeros)?),
            _ => None,
        }
    }

    fn signed_exp_golomb(&mut self) -> Option<i64> {
        let number = i64::from(self.exp_golomb()?);
        Some(if number % 2 == 1 {
            (number + 1) / 2
        } else {
            -number / 2
        })
    }
}

#[cfg(test)]
mod tests {
    use super::{Bits, shape_in};
    use crate::pixels::PixelShape;

    /// Bits as they are written in the standard, and their bytes.
    fn bytes(bits: &str) -> Vec<u8> {
        let digits: Vec<u8> = bits.bytes().filter(u8::is_ascii_digit).collect();
        let byte = |eight: &[u8]| {
            eight
                .iter()
                .enumerate()
                .fold(0, |b, (k, d)| b | (d - b'0') << (7 - k))
        };
        digits.chunks(8).map(byte).collect()
    }

    fn shape(bits: &str) -> Option<PixelShape> {
        shape_in(&mut Bits {
            bytes: &bytes(bits),
            at: 0,
        })
    }

    /// Baseline, 16x16: profile 66, level, identity 0, 1, order 2 (011), 1 reference, no gaps, 1x1
    /// blocks, frames, inference.
    const BASELINE: &str = "01000010 0000000000011110 1 1 011 010 0 1 1 1 1";

    #[test]
    fn shapes_by_number_and_as_numbers() {
        let with = |rest: &str| shape(&format!("{BASELINE} {rest}"));
        assert_eq!(with("0 1 1 00001110"), Some(PixelShape::new(4, 3)));
        assert_eq!(with("0 1 1 00000001"), Some(PixelShape::SQUARE));
        // cropped, then 3:4 as it is
        let extended = "1 1 1 1 010 1 1 11111111 0000000000000011 0000000000000100";
        assert_eq!(with(extended), Some(PixelShape::new(3, 4)));
        for none in [
            "0 0 0",
            "0 1 0",
            "0 1 1 00000000",
            "0 1 1 00010001",
            "0 1 1 11111111 0000",
        ] {
            assert_eq!(with(none), None, "{none}");
        }
    }

    #[test]
    fn a_high_profile_with_lists_and_fields() {
        // 4:2:0, 8 bits, the first list with one step that ends it, seven without
        let high =
            "01100100 0000000000011110 1 010 1 1 0 1 1 000010001 0000000 1 1 1 1 0 1 1 0 1 1 0";
        let found = shape(&format!("{high} 1 1 00001110"));
        assert_eq!(found, Some(PixelShape::new(4, 3)));
    }

    #[test]
    fn numbers_end_with_their_bytes() {
        let mut bits = Bits {
            bytes: &bytes("00101 010 1 011 0000"),
            at: 0,
        };
        assert_eq!(
            (bits.exp_golomb(), bits.signed_exp_golomb()),
            (Some(4), Some(1))
        );
        assert_eq!(
            (bits.exp_golomb(), bits.signed_exp_golomb()),
            (Some(0), Some(-1))
        );
        assert_eq!(bits.exp_golomb(), None);
        assert_eq!(
            Bits {
                bytes: &[0; 9],
                at: 0
            }
            .exp_golomb(),
            None
        );
    }
}
