//! What a camera wrote into its images about its lens.

use super::decode::read_image_file;
use exif::{In, Reader, Tag, Value};
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
    let bytes = read_image_file(path).ok()?;
    let exif = Reader::new().read_from_container(&mut Cursor::new(&bytes));
    let exif = exif.ok()?;
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

#[cfg(test)]
mod tests {
    use super::exif_focal_px;
    use crate::encode_jpeg;
    use exif::experimental::Writer;
    use exif::{Field, In, Tag, Value};
    use monogrid_image::Image;
    use std::io::Cursor;

    /// A JPEG image whose Exif block says this equivalent focal length.
    fn jpeg(equivalent_mm: u16) -> Vec<u8> {
        let field = Field {
            tag: Tag::FocalLengthIn35mmFilm,
            ifd_num: In::PRIMARY,
            value: Value::Short(vec![equivalent_mm]),
        };
        let mut writer = Writer::new();
        writer.push_field(&field);
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
