//! What is accepted as an image: endings of names, sizes.

/// File names that are taken for images; their content decides about the format.
pub(crate) const IMAGE_ENDINGS: [&str; 10] = [
    "png", "jpg", "jpeg", "pgm", "ppm", "pnm", "tif", "tiff", "webp", "bmp",
];

/// Longest side that is decoded, px: a header that claims more is taken for corruption.
pub(super) const MAX_SIDE: usize = 16384;

/// Most pixels that are decoded: twice those of an 8K video.
pub(super) const MAX_PIXELS: usize = 1 << 26;

/// Pixels that any image file may hold, and how many more for each of its bytes. Photographs have
/// five or fewer per byte; only plain ones are smaller, and a small file of such must not fill the
/// memory.
pub(super) const SMALL_FILE_PIXELS: usize = 3 << 22;
const PIXELS_PER_BYTE: usize = 8;

/// Most pixels that an image file of so many bytes is believed to hold.
pub(super) fn max_pixels_of(num_bytes: usize) -> usize {
    let for_bytes = num_bytes.saturating_mul(PIXELS_PER_BYTE);
    SMALL_FILE_PIXELS.saturating_add(for_bytes).min(MAX_PIXELS)
}

/// Most memory that a decoder may ask for, bytes.
pub(super) const MAX_DECODE_BYTES: usize = 4 * MAX_PIXELS;
