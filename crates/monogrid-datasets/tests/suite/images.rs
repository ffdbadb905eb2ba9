//! Decoded pixels against the numbers that were encoded.

use monogrid_datasets::{
    FrameEntry, Levels, decode_depth, decode_gray, decode_jpeg_rgb, encode_jpeg, encode_jpeg_rgb,
    encode_png, encode_png_16, encode_png_rgb, read_gray_in, read_rgb,
};
use monogrid_image::Image;
use std::path::Path;
use tiff::encoder::{TiffEncoder, colortype};

const NAME: &str = "picture";

fn path() -> &'static Path {
    Path::new(NAME)
}

/// A smooth colour picture with some structure.
pub fn colour(width: usize, height: usize) -> Image<[u8; 3]> {
    Image::from_fn(width, height, |x, y| {
        [
            (x * 5 % 256) as u8,
            (y * 3 + x) as u8,
            (128.0 + 100.0 * ((x * y) as f32 / 300.0).sin()) as u8,
        ]
    })
}

pub fn gray(width: usize, height: usize) -> Image<u8> {
    Image::from_fn(width, height, |x, y| {
        (128.0 + 60.0 * (x as f32 / 7.0).sin() + 60.0 * (y as f32 / 5.0).cos()) as u8
    })
}

fn luma([r, g, b]: [u8; 3]) -> f32 {
    0.299 * f32::from(r) + 0.587 * f32::from(g) + 0.114 * f32::from(b)
}

#[test]
fn gray_png_and_pgm_are_exact() {
    let image = gray(37, 23);
    let mut ascii = format!("P2\n# a comment\n{} {}\n255\n", 37, 23);
    for v in image.as_slice() {
        ascii.push_str(&format!("{v}\n"));
    }
    let mut binary = b"P5\n37 23\n255\n".to_vec();
    binary.extend_from_slice(image.as_slice());
    for bytes in [encode_png(&image), ascii.into_bytes(), binary] {
        let decoded = decode_gray(&bytes, path()).expect("decodes");
        assert_eq!(decoded, image.map(f32::from));
    }
}

#[test]
fn colour_becomes_itu_601_luma() {
    let image = colour(31, 20);
    let mut ppm = b"P6 31 20 255\n".to_vec();
    ppm.extend_from_slice(image.as_slice().as_flattened());
    let rgba: Vec<u8> = image
        .as_slice()
        .iter()
        .flat_map(|&[r, g, b]| [r, g, b, 7])
        .collect();
    let mut rgba_png = Vec::new();
    let mut encoder = png::Encoder::new(&mut rgba_png, 31, 20);
    encoder.set_color(png::ColorType::Rgba);
    encoder
        .write_header()
        .and_then(|mut writer| writer.write_image_data(&rgba))
        .expect("encodes");
    for bytes in [encode_png_rgb(&image), ppm, rgba_png] {
        let decoded = decode_gray(&bytes, path()).expect("decodes");
        for (value, rgb) in decoded.as_slice().iter().zip(image.as_slice()) {
            assert!((value - luma(*rgb)).abs() < 1e-3);
        }
    }
}

#[test]
fn colour_is_read_where_there_is_any() {
    let image = colour(31, 20);
    let folder = tempfile::tempdir().expect("folder");
    let read = |bytes: &[u8]| {
        let file = folder.path().join(NAME);
        std::fs::write(&file, bytes).expect("writable");
        read_rgb(&file).expect("an image")
    };
    assert_eq!(read(&encode_png_rgb(&image)), Some(image.clone()));
    let lossy = read(&encode_jpeg_rgb(&image, 95)).expect("has colour");
    let differences = lossy
        .as_slice()
        .iter()
        .zip(image.as_slice())
        .map(|(a, b)| (luma(*a) - luma(*b)).abs());
    assert!(differences.sum::<f32>() / 620.0 < 3.0);
    let grey = gray(31, 20);
    let as_colour = grey.map(|v| [v; 3]);
    for bytes in [
        encode_png(&grey),
        encode_jpeg(&grey, 90),
        encode_png_rgb(&as_colour),
        encode_jpeg_rgb(&as_colour, 90),
    ] {
        assert_eq!(read(&bytes), None, "grey in any coding");
    }
    assert!(decode_jpeg_rgb(&encode_jpeg_rgb(&image, 90), 600, path()).is_err());
}

#[test]
fn sixteen_bits_are_scaled_to_255() {
    let image = Image::from_fn(16, 16, |x, y| (x * 4096 + y * 255) as u16);
    let mut pgm = b"P5 16 16 65535\n".to_vec();
    pgm.extend(image.as_slice().iter().flat_map(|v| v.to_be_bytes()));
    for bytes in [encode_png_16(&image), pgm] {
        let decoded = decode_gray(&bytes, path()).expect("decodes");
        for (value, raw) in decoded.as_slice().iter().zip(image.as_slice()) {
            assert!((value - f32::from(*raw) / 65535.0 * 255.0).abs() < 1e-3);
        }
    }
}

#[test]
fn pgm_with_another_maximum_is_scaled_to_255() {
    let bytes = b"P5 4 1 100\n\x00\x32\x64\x19";
    let decoded = decode_gray(bytes, path()).expect("decodes");
    let expected = [0.0, 127.5, 255.0, 63.75];
    for (value, expected) in decoded.as_slice().iter().zip(expected) {
        assert!(
            (value - expected).abs() <= 0.75,
            "{value} instead of {expected}"
        );
    }
}

#[test]
fn jpeg_luma_agrees_with_an_rgb_decode() {
    for (width, height) in [(64, 48), (61, 47), (8, 8), (1, 1), (17, 33)] {
        let bytes = encode_jpeg_rgb(&colour(width, height), 92);
        let decoded = decode_gray(&bytes, path()).expect("decodes");
        let rgb = decode_jpeg_rgb(&bytes, width * height, path()).expect("decodes");
        let rgb = rgb.expect("has colour");
        assert_eq!((decoded.width(), decoded.height()), (width, height));
        let mut sum = 0.0;
        for (value, pixel) in decoded.as_slice().iter().zip(rgb.as_slice()) {
            // where colours are clipped the two differ a little more
            let difference = (value - luma(*pixel)).abs();
            assert!(difference < 12.0, "{width}x{height}: {difference}");
            sum += difference;
        }
        assert!(sum / ((width * height) as f32) < 1.0);
    }
}

#[test]
fn a_truncated_image_is_an_error_at_every_length() {
    let full_gray = gray(40, 32);
    let mut pgm = b"P5\n40 32\n255\n".to_vec();
    pgm.extend_from_slice(full_gray.as_slice());
    for bytes in [
        encode_jpeg_rgb(&colour(40, 32), 80),
        encode_png(&full_gray),
        pgm,
    ] {
        let whole = decode_gray(&bytes, path()).expect("the whole file decodes");
        for length in 0..bytes.len() {
            if let Ok(image) = decode_gray(&bytes[..length], path()) {
                // only what carries no pixels (PNG's end chunk) may be missing
                assert_eq!(image, whole, "cut to {length} of {}", bytes.len());
                assert!(length + 32 > bytes.len() && bytes.starts_with(b"\x89PNG"));
            }
        }
    }
}

#[test]
fn a_jpeg_cut_in_the_middle_is_not_rescued_by_a_thumbnail_end_marker() {
    let whole = encode_jpeg_rgb(&colour(64, 64), 85);
    // an APP1 segment that holds a whole JPEG, as cameras store their thumbnails
    let thumbnail = encode_jpeg_rgb(&colour(8, 8), 50);
    let mut bytes = whole[..2].to_vec();
    bytes.extend_from_slice(&[0xff, 0xe1]);
    bytes.extend_from_slice(&((thumbnail.len() + 2) as u16).to_be_bytes());
    bytes.extend_from_slice(&thumbnail);
    bytes.extend_from_slice(&whole[2..]);
    assert_eq!(
        decode_gray(&bytes, path()).expect("thumbnails are skipped"),
        decode_gray(&whole, path()).expect("decodes")
    );
    let cut = bytes.len() - whole.len() / 3;
    let error = decode_gray(&bytes[..cut], path()).expect_err("truncated");
    assert!(error.to_string().contains(NAME), "{error}");
}

#[test]
fn a_damaged_png_is_an_error() {
    let image = gray(64, 48);
    let bytes = encode_png(&image);
    let original = image.map(f32::from);
    for position in (8..bytes.len()).step_by(7) {
        let mut damaged = bytes.clone();
        damaged[position] ^= 0x10;
        if let Ok(decoded) = decode_gray(&damaged, path()) {
            assert_eq!(decoded, original, "byte {position} of {}", bytes.len());
        }
    }
}

#[test]
fn what_is_no_image_is_refused_with_its_name() {
    for bytes in [
        &b""[..],
        b"hello",
        b"GIF89a",
        b"\xff\xd8",
        b"\xff\xd8\xff\xd9",
        b"\x89PNG\r\n\x1a\n",
        b"P5 0 0 255\n",
        b"P5 99999999 99999999 255\n",
        b"P5 -3 4 255\n",
    ] {
        let error = decode_gray(bytes, path()).expect_err("refused").to_string();
        assert!(error.contains(NAME), "{error}");
    }
}

#[test]
fn depth_is_in_metres_and_unknown_where_the_sensor_saw_nothing() {
    let image = Image::from_fn(5, 1, |x, _| [0u16, 1, 5000, 65534, 65535][x]);
    let depth = decode_depth(&encode_png_16(&image), 5000.0, path()).expect("decodes");
    let expected = [f32::NAN, 0.0002, 1.0, 13.1068, f32::NAN];
    for (value, expected) in depth.as_slice().iter().zip(expected) {
        assert!(
            (value.is_nan() && expected.is_nan()) || (value - expected).abs() < 1e-6,
            "{value} instead of {expected}"
        );
    }
    for bytes in [
        encode_png(&gray(5, 5)),
        encode_jpeg_rgb(&colour(16, 16), 90),
    ] {
        let error = decode_depth(&bytes, 5000.0, path()).expect_err("8 bits");
        assert!(error.to_string().contains("16"), "{error}");
    }
}

/// A progressive JPEG of 16x16 pixels of the pattern of [`gray`], written by libjpeg.
const PROGRESSIVE: &str = "\
    ffd8ffe000104a46494600010100000100010000ffdb0043000503040404030504040405050506070c08070707070f\
    0b0b090c110f1212110f111113161c1713141a1511111821181a1d1d1f1f1f13172224221e241c1e1f1effc2000b08\
    0010001001011100ffc400160001010100000000000000000000000000050607ffda0008010100000001b6632963ff\
    c4001810000203000000000000000000000000000104000211ffda0008010100010502518ac2c571464c2c9cffc400\
    14100100000000000000000000000000000020ffda0008010100063f021fffc4001810000203000000000000000000\
    000000000001112141ffda0008010100013f2180acd121ab35cfffda0008010100000010bfffc40018100003010100\
    00000000000000000000000031415191ffda0008010100013f104a916866f4a75a7fffd9";

#[test]
fn progressive_jpeg_is_read_whole_or_not_at_all() {
    let digits: Vec<u32> = PROGRESSIVE.chars().filter_map(|c| c.to_digit(16)).collect();
    let bytes: Vec<u8> = digits.chunks(2).map(|d| (16 * d[0] + d[1]) as u8).collect();
    let decoded = decode_gray(&bytes, path()).expect("decodes");
    for (value, expected) in decoded.as_slice().iter().zip(gray(16, 16).as_slice()) {
        assert!(
            (value - f32::from(*expected)).abs() < 10.0,
            "{value} {expected}"
        );
    }
    for length in 0..bytes.len() {
        assert!(
            decode_gray(&bytes[..length], path()).is_err(),
            "cut to {length}"
        );
    }
}

/// A plain PNG or JPEG of this size.
fn plain(width: usize, height: usize) -> [Vec<u8>; 2] {
    let image = Image::from_fn(width, height, |_, _| 90);
    [encode_png(&image), encode_jpeg(&image, 50)]
}

#[test]
fn a_small_file_of_a_huge_image_is_refused() {
    for bytes in plain(16384, 4000) {
        assert!(bytes.len() < 4_000_000, "{}", bytes.len());
        let error = decode_gray(&bytes, path()).expect_err("a bomb").to_string();
        assert!(error.contains("16384x4000 pixels"), "{error}");
        assert!(
            error.contains(&format!("of {} bytes", bytes.len())),
            "{error}"
        );
    }
    // a black frame of 4K is a usual one
    for bytes in plain(3840, 2160) {
        assert!(decode_gray(&bytes, path()).is_ok());
    }
}

/// A TIFF and a WebP of an image in colour.
pub fn tiff_and_webp(image: &Image<[u8; 3]>) -> [Vec<u8>; 2] {
    let (width, height) = (image.width() as u32, image.height() as u32);
    let samples = image.as_slice().as_flattened();
    let mut tiff = std::io::Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut tiff).expect("a file");
    let written = encoder.write_image::<colortype::RGB8>(width, height, samples);
    written.expect("encodes");
    let mut webp = Vec::new();
    let encoder = image_webp::WebPEncoder::new(&mut webp);
    let written = encoder.encode(samples, width, height, image_webp::ColorType::Rgb8);
    written.expect("encodes");
    [tiff.into_inner(), webp]
}

/// A grey TIFF of 16 bits.
pub fn wide_tiff(width: u32, height: u32, samples: &[u16]) -> Vec<u8> {
    let mut file = std::io::Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut file).expect("a file");
    let written = encoder.write_image::<colortype::Gray16>(width, height, samples);
    written.expect("encodes");
    file.into_inner()
}

#[test]
fn tiff_and_webp_are_read_whole_or_not_at_all() {
    let tinted = colour(31, 20);
    for bytes in tiff_and_webp(&tinted) {
        let decoded = decode_gray(&bytes, path()).expect("decodes");
        for (value, pixel) in decoded.as_slice().iter().zip(tinted.as_slice()) {
            assert!((value - luma(*pixel)).abs() < 1e-3);
        }
        let folder = tempfile::tempdir().expect("folder");
        let file = folder.path().join("image");
        std::fs::write(&file, &bytes).expect("writable");
        let again = read_rgb(&file).expect("decodes").expect("has colour");
        assert_eq!(again, tinted);
        for length in 0..bytes.len() {
            if let Ok(cut) = decode_gray(&bytes[..length], path()) {
                assert_eq!(cut, decoded, "cut to {length} of {}", bytes.len());
            }
        }
    }
}

/// A BMP of this many bits: 24 or 32 are colours, 8 an image in grey with its palette, rows from
/// the bottom up or, with a negative height, from the top down.
pub fn bmp(image: &Image<[u8; 3]>, bits: usize, is_upright: bool) -> Vec<u8> {
    let (width, height) = (image.width(), image.height());
    let palette: Vec<u8> = match bits {
        8 => (0..=255).flat_map(|k| [k, k, k, 0]).collect(),
        _ => Vec::new(),
    };
    let begin = 54 + palette.len();
    let mut rows = Vec::new();
    for row in 0..height {
        let y = if is_upright { row } else { height - 1 - row };
        for [r, g, b] in image.row(y) {
            rows.extend_from_slice(&match bits {
                8 => vec![*g],
                24 => vec![*b, *g, *r],
                _ => vec![*b, *g, *r, 255],
            });
        }
        while rows.len() % 4 > 0 {
            rows.push(0);
        }
    }
    let mut bytes = b"BM".to_vec();
    let signed = if is_upright {
        -(height as i32)
    } else {
        height as i32
    };
    let word = |value: usize| (value as u32).to_le_bytes();
    for field in [begin + rows.len(), 0, begin, 40, width] {
        bytes.extend(word(field));
    }
    bytes.extend(signed.to_le_bytes());
    bytes.extend(word(1 | bits << 16));
    for field in [0, rows.len(), 0, 0, palette.len() / 4, 0] {
        bytes.extend(word(field));
    }
    [bytes, palette, rows].concat()
}

#[test]
fn bmp_is_read_whole_or_not_at_all() {
    let tinted = colour(31, 20);
    for (bits, is_upright) in [(24, false), (24, true), (32, false), (8, false)] {
        let bytes = bmp(&tinted, bits, is_upright);
        let decoded = decode_gray(&bytes, path()).expect("decodes");
        for (value, [r, g, b]) in decoded.as_slice().iter().zip(tinted.as_slice()) {
            let expected = if bits == 8 { [*g; 3] } else { [*r, *g, *b] };
            assert!((value - luma(expected)).abs() < 1e-3, "{bits} bits");
        }
        for length in 0..bytes.len() {
            let cut = decode_gray(&bytes[..length], path());
            assert!(
                cut.is_err(),
                "{bits} bits, cut to {length} of {}",
                bytes.len()
            );
        }
    }
    let mut compressed = bmp(&tinted, 8, false);
    compressed[30] = 1;
    let error = decode_gray(&compressed, path()).expect_err("run lengths");
    assert!(error.to_string().contains("compressed"), "{error}");
}

#[test]
fn depth_of_more_pixels_than_a_camera_has_is_refused() {
    for (side, is_read) in [(3548, false), (3547, true)] {
        let mut bytes = format!("P5\n{side} {side}\n65535\n").into_bytes();
        bytes.resize(bytes.len() + 2 * side * side, 1);
        let decoded = decode_depth(&bytes, 1000.0, path());
        let said = decoded.as_ref().err().map(ToString::to_string);
        assert_eq!(decoded.is_ok(), is_read, "{side}: {said:?}");
        assert!(said.is_none_or(|said| said.contains("expected at most 12582912")));
    }
}

#[test]
fn depth_may_be_a_tiff_of_16_bits() {
    let bytes = wide_tiff(3, 2, &[0, 1, 5000, 65534, 65535, 10]);
    let depth = decode_depth(&bytes, 5000.0, path()).expect("decodes");
    assert!(depth.at(0, 0).is_nan() && (depth.at(2, 0) - 1.0).abs() < 1e-6);
}

/// Files of 16 bits with these values, one behind the other.
fn wide_frames(folder: &Path, frames: &[Image<u16>]) -> Vec<FrameEntry> {
    let write = |(index, image): (usize, &Image<u16>)| {
        let path = folder.join(format!("{index}.png"));
        std::fs::write(&path, encode_png_16(image)).expect("writable");
        FrameEntry {
            index,
            timestamp_ns: index as i64,
            path,
        }
    };
    frames.iter().enumerate().map(write).collect()
}

fn levels_of(frames: &[FrameEntry]) -> Levels {
    Levels::of_images(frames.iter().map(|frame| &*frame.path))
}

#[test]
fn sixteen_bits_of_which_a_part_is_used_are_shown_alike_in_all_frames() {
    let folder = tempfile::tempdir().expect("folder");
    let ramp = |from: u16, step: u16| Image::from_fn(64, 50, |x, y| from + step * (x + y) as u16);
    // twelve bits, then the camera looks at something darker
    let frames = wide_frames(folder.path(), &[ramp(0, 36), ramp(0, 36), ramp(0, 3)]);
    let levels = levels_of(&frames[..2]);
    assert_eq!((levels.black, levels.white), (0.0, 4095.0));
    assert!(levels.note().expect("said").contains("4095"));
    for (frame, step) in frames.iter().zip([36.0, 36.0, 3.0]) {
        let image = read_gray_in(&frame.path, levels).expect("decodes");
        let expected = 255.0 * step * 70.0 / 4095.0;
        assert!((image.at(30, 40) - expected).abs() < 1e-2, "{step}");
    }
    // a thermal camera: nothing near black
    let frames = wide_frames(folder.path(), &[ramp(7000, 10)]);
    let levels = levels_of(&frames);
    let image = read_gray_in(&frames[0].path, levels).expect("decodes");
    let (darkest, brightest) = (image.at(0, 0), image.at(63, 49));
    assert!(darkest > 10.0 && darkest < 40.0 && brightest > 210.0 && brightest < 245.0);
    // all of them, and eight bits
    let frames = wide_frames(folder.path(), &[ramp(0, 560)]);
    assert_eq!(levels_of(&frames), Levels::ALL);
    std::fs::write(&frames[0].path, encode_png(&gray(8, 6))).expect("writable");
    assert_eq!(levels_of(&frames), Levels::ALL);
    assert_eq!(levels_of(&frames).note(), None);
}
