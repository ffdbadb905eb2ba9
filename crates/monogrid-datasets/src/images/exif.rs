//! What a camera wrote into its images about its lens, and where it was.

use super::decode::read_image_file;
use crate::places::GlobalPlace;
use exif::{Exif, In, Reader, Tag, Value};
use std::io::Cursor;
use std::path::Path;

/// Diagonal of a 35 mm film's image, mm: what the equivalent focal length refers to.
const FILM_DIAGONAL_MM: f64 = 43.267;

/// Focal length of an image of this size in pixels as the camera wrote it into the file (Exif's
/// equivalent for 35 mm film); `None` where it did not.
///
/// Such a length is of the whole sensor: a video that is cropped or stabilised sees some percent
/// less.
#[must_use]
pub fn exif_focal_px(path: &Path, (width, height): (usize, usize)) -> Option<f64> {
    let exif = exif_of(path)?;
    let field = exif.get_field(Tag::FocalLengthIn35mmFilm, In::PRIMARY)?;
    let equivalent_mm = match &field.value {
        Value::Short(values) => f64::from(*values.first()?),
        Value::Long(values) => f64::from(*values.first()?),
        _ => return None,
    };
    // zero stands for unknown
    (equivalent_mm > 0.0)
        .then(|| equivalent_mm / FILM_DIAGONAL_MM * (width as f64).hypot(height as f64))
}

/// Where a photograph was taken, as its Exif block says.
pub(crate) fn exif_place(path: &Path) -> Option<GlobalPlace> {
    let exif = exif_of(path)?;
    let rationals = |tag: Tag| -> Option<Vec<f64>> {
        match &exif.get_field(tag, In::PRIMARY)?.value {
            Value::Rational(values) => Some(values.iter().map(exif::Rational::to_f64).collect()),
            _ => None,
        }
    };
    let degrees = |tag: Tag, reference: Tag, negative: u8| -> Option<f64> {
        let [degrees, minutes, seconds] = rationals(tag)?[..] else {
            return None;
        };
        let value = degrees + minutes / 60.0 + seconds / 3600.0;
        // what has no number is 0 / 0 there
        let value = value.is_finite().then_some(value)?;
        let is_negative = letter(&exif, reference)?.eq_ignore_ascii_case(&negative);
        Some(if is_negative { -value } else { value })
    };
    let latitude = degrees(Tag::GPSLatitude, Tag::GPSLatitudeRef, b'S')?;
    let longitude = degrees(Tag::GPSLongitude, Tag::GPSLongitudeRef, b'W')?;
    let altitude = rationals(Tag::GPSAltitude).and_then(|values| values.first().copied());
    let is_below_the_sea = matches!(
        exif.get_field(Tag::GPSAltitudeRef, In::PRIMARY).map(|field| &field.value),
        Some(Value::Byte(values)) if values.first() == Some(&1)
    );
    let altitude = altitude.map(|metres| if is_below_the_sea { -metres } else { metres });
    GlobalPlace::new([latitude, longitude], altitude)
}

/// The Exif block of an image.
fn exif_of(path: &Path) -> Option<Exif> {
    let bytes = read_image_file(path).ok()?;
    let exif = Reader::new().read_from_container(&mut Cursor::new(&bytes));
    exif.ok()
}

/// The first letter of a text.
fn letter(exif: &Exif, tag: Tag) -> Option<u8> {
    match &exif.get_field(tag, In::PRIMARY)?.value {
        Value::Ascii(texts) => texts.first()?.first().copied(),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::{exif_focal_px, exif_place};
    use crate::encode_jpeg;
    use crate::places::GlobalPlace;
    use exif::experimental::Writer;
    use exif::{Field, In, Tag, Value};
    use monogrid_image::Image;
    use std::io::Cursor;

    /// A JPEG image whose Exif block says this equivalent focal length.
    fn jpeg(equivalent_mm: u16) -> Vec<u8> {
        jpeg_with(&[(
            Tag::FocalLengthIn35mmFilm,
            Value::Short(vec![equivalent_mm]),
        )])
    }

    /// A JPEG image with these fields in its Exif block.
    fn jpeg_with(fields: &[(Tag, Value)]) -> Vec<u8> {
        let field = |(tag, value): &(Tag, Value)| Field {
            tag: *tag,
            ifd_num: In::PRIMARY,
            value: value.clone(),
        };
        let fields: Vec<Field> = fields.iter().map(field).collect();
        let mut writer = Writer::new();
        fields.iter().for_each(|field| writer.push_field(field));
        let mut block = Cursor::new(b"Exif\0\0".to_vec());
        block.set_position(6);
        let mut tiff = Cursor::new(Vec::new());
        writer.write(&mut tiff, false).unwrap();
        let mut block = block.into_inner();
        block.extend(tiff.into_inner());
        let plain = encode_jpeg(&Image::filled(40, 30, 128_u8), 90);
        let length = (block.len() as u16 + 2).to_be_bytes();
        // after the start of the image
        [&plain[..2], b"\xff\xe1", &length, &block, &plain[2..]].concat()
    }

    #[test]
    fn a_place_has_its_hemispheres_and_its_height() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.jpg");
        let thirds = |values: [u32; 3]| {
            let rational = |num| exif::Rational { num, denom: 4 };
            Value::Rational(values.map(rational).to_vec())
        };
        let text = |letter: u8| Value::Ascii(vec![vec![letter]]);
        let write = |latitude: Value, south: u8| {
            let bytes = jpeg_with(&[
                (Tag::GPSLatitude, latitude),
                (Tag::GPSLatitudeRef, text(south)),
                (Tag::GPSLongitude, thirds([4 * 8, 4 * 15, 4 * 18])),
                (Tag::GPSLongitudeRef, text(b'E')),
                (
                    Tag::GPSAltitude,
                    Value::Rational(vec![exif::Rational { num: 5, denom: 2 }]),
                ),
                (Tag::GPSAltitudeRef, Value::Byte(vec![1])),
            ]);
            std::fs::write(&path, bytes).unwrap();
        };
        write(thirds([4 * 33, 4 * 30, 0]), b'S');
        let place = GlobalPlace {
            latitude: -33.5,
            longitude: 8.255,
            altitude: Some(-2.5),
        };
        assert_eq!(exif_place(&path), Some(place));
        // a receiver without a place
        let unknown = vec![exif::Rational { num: 0, denom: 0 }; 3];
        write(Value::Rational(unknown), b'N');
        assert_eq!(exif_place(&path), None);
        std::fs::write(&path, jpeg(28)).unwrap();
        assert_eq!(exif_place(&path), None);
    }

    #[test]
    fn a_focal_length_is_that_of_the_diagonal() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.jpg");
        std::fs::write(&path, jpeg(28)).unwrap();
        let focal = exif_focal_px(&path, (4000, 3000)).unwrap();
        assert!((focal - 28.0 / 43.267 * 5000.0).abs() < 1e-6, "{focal}");
        std::fs::write(&path, jpeg(0)).unwrap();
        assert_eq!(exif_focal_px(&path, (40, 30)), None, "unknown");
        let plain = encode_jpeg(&Image::filled(40, 30, 128_u8), 90);
        std::fs::write(&path, plain).unwrap();
        assert_eq!(exif_focal_px(&path, (40, 30)), None);
        assert_eq!(exif_focal_px(&folder.path().join("b.jpg"), (40, 30)), None);
    }
}
