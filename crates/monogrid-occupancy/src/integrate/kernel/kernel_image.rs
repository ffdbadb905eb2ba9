//! A range image as the kernel of the rule `fused` needs it.

/// An image as the kernel needs it: with a border of one pixel without a measurement, for all that
/// lies outside.
#[derive(Clone, Debug)]
pub(crate) struct KernelImage {
    /// Pixels per row.
    pub stride: usize,
    /// Last column and row.
    pub last: [f32; 2],
    /// Pixels per unit of slope, along u and v.
    pub focal: [f32; 2],
    /// Pixel of slope 0, plus one half: truncation then finds the nearest pixel.
    pub center: [f32; 2],
    /// Range at which the table of each pixel begins, in map units; minus infinity without a
    /// measurement, which lies behind every table.
    pub near: Vec<f32>,
    /// Table of each pixel; empty if all have the first.
    pub tables: Vec<u16>,
    /// A bit for each pixel that has a measurement.
    pub measured: Bits,
}

/// Rows of bits, lowest first, each with [`Bits::SPARE_BYTES`] after its end; after the last come
/// [`Bits::SPARE_ROWS`] without any: a few bytes from anywhere in one row and in those that follow
/// can be read without a test.
#[derive(Clone, Debug)]
pub(crate) struct Bits {
    /// Bytes per row.
    pub stride: usize,
    pub bytes: Vec<u8>,
}

impl Bits {
    pub(crate) const SPARE_BYTES: usize = 4;
    pub(crate) const SPARE_ROWS: usize = 16;

    /// Bits of values in rows of so many.
    fn new(width: usize, values: &[f32], is_set: impl Fn(f32) -> bool) -> Self {
        let stride = width.div_ceil(8) + Self::SPARE_BYTES;
        let mut bytes = vec![0; stride * (values.len() / width + Self::SPARE_ROWS)];
        for (bytes, row) in bytes
            .chunks_exact_mut(stride)
            .zip(values.chunks_exact(width))
        {
            for (byte, values) in bytes.iter_mut().zip(row.chunks(8)) {
                let bits = values.iter().zip(0..);
                *byte = bits.fold(0, |byte, (&value, bit)| {
                    byte | u8::from(is_set(value)) << bit
                });
            }
        }
        Self { stride, bytes }
    }
}

impl KernelImage {
    /// The image of so many columns and rows of [`KernelImage::near`] and, unless all have the
    /// first, tables. `center` is the pixel of slope 0.
    pub(crate) fn new(
        [width, height]: [usize; 2],
        [focal, center]: [[f32; 2]; 2],
        near: &[f32],
        tables: &[u16],
    ) -> Self {
        let size = [width, height];
        let near = with_border(size, near, f32::NEG_INFINITY);
        Self {
            stride: width + 2,
            last: size.map(|edge| (edge + 1) as f32),
            focal,
            center: center.map(|c| c + 1.5),
            measured: Bits::new(width + 2, &near, |near| near > f32::NEG_INFINITY),
            near,
            tables: match tables {
                [] => Vec::new(),
                tables => with_border(size, tables, 0),
            },
        }
    }
}

/// The rows with one pixel more on each side.
fn with_border<T: Copy>([width, height]: [usize; 2], pixels: &[T], border: T) -> Vec<T> {
    let mut all = vec![border; (width + 2) * (height + 2)];
    let rows = all.chunks_exact_mut(width + 2).skip(1);
    for (row, pixels) in rows.zip(pixels.chunks_exact(width)) {
        row[1..=width].copy_from_slice(pixels);
    }
    all
}
