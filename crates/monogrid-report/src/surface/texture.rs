//! A surface as it was filmed: a picture with a block of pixels for each of its faces, taken from
//! the keyframes that see the face, the best ones most.

use super::ColouredMesh;
use crate::colours::{ColourImage, Colours};
use crate::explorer::Look;
use crate::picture::over_triangle;
use monogrid_datasets::encode_jpeg_rgb;
use monogrid_geometry::{Pinhole, Sim3, Vec2, Vec3};
use monogrid_image::luma_of_rgb;
use monogrid_mapping::ImageOf;
use rayon::prelude::*;

/// Faces at most; a larger surface has the colours of its vertices alone.
const MAX_FACES: usize = 1 << 16;
/// Pixels along the picture at most: what every graphics card takes.
const MAX_SIDE: usize = 4096;
/// Sides of blocks, px: the largest that fits. Blocks of JPEG are as large, so that faces do not
/// run into each other.
const BLOCKS: [usize; 2] = [16, 8];
/// Quality of the picture as JPEG.
const QUALITY: u8 = 85;
/// Keyframes at most; of more, some are taken evenly.
const MAX_VIEWS: usize = 240;
/// Pixels of an image per pixel of its depths.
const DEPTH_STEP: f64 = 2.0;
/// How far behind the nearest surface a corner may be and is still seen, relative to its depth.
const BEHIND: f64 = 0.02;
/// Pixels at the border of an image over which a keyframe counts less.
const BORDER: f64 = 40.0;
/// Rounds in which brightness is balanced, and how far it may be changed.
const ROUNDS: usize = 8;
const MAX_GAIN: f32 = 1.6;

/// A picture of a surface, with a block of pixels for each pair of triangles, row by row. The
/// corners of a face are in the middle of the corners of its block.
#[derive(Clone, Debug, PartialEq)]
pub struct Texture {
    /// The blocks.
    pub image: ColourImage,
    /// Side of a block, px.
    pub block: usize,
    /// Blocks in a row.
    pub columns: usize,
}

/// A keyframe that sees a surface.
#[derive(Clone, Copy, Debug)]
pub struct SurfaceView<'a> {
    /// Identity of the keyframe.
    pub id: u32,
    /// Its grey image.
    pub image: Option<ImageOf<'a>>,
    /// Intrinsics of its images.
    pub pinhole: Pinhole,
    /// Pose in the frame of the surface.
    pub map_from_keyframe: Sim3,
}

/// A corner of a face, in a camera.
type Corner = Vec3;

/// A face that a keyframe sees.
#[derive(Clone, Copy, Debug)]
struct Seen {
    face: u32,
    weight: f32,
    /// Grey level in its middle.
    grey: f32,
}

impl Texture {
    /// What the keyframes show of a surface; `None` where it is too large, or no keyframe has an
    /// image.
    pub fn new(mesh: &ColouredMesh, views: &[SurfaceView], colours: &Colours) -> Option<Self> {
        let faces = faces(mesh)?;
        let side = faces.len().isqrt() + usize::from(faces.len().isqrt().pow(2) < faces.len());
        let block = BLOCKS.into_iter().find(|block| side * block <= MAX_SIDE)?;
        let every = views.len().div_ceil(MAX_VIEWS).max(1);
        let views: Vec<_> = views.iter().step_by(every).collect();
        let seen = views
            .par_iter()
            .map(|view| view.sees(mesh, &faces, colours));
        let seen: Vec<Vec<Seen>> = seen.collect();
        if seen.iter().all(Vec::is_empty) {
            return None;
        }
        let gains = gains(&seen, faces.len());
        let mut sums = vec![[0.0f32; 4]; faces.len() * block * block];
        for ((view, seen), gain) in views.into_iter().zip(&seen).zip(gains) {
            view.add(mesh, &faces, (seen, gain), (&mut sums, block), colours);
        }
        let rows = faces.len().div_ceil(side);
        let image = ColourImage::from_fn(side * block, rows * block, |x, y| {
            let face = y / block * side + x / block;
            let pixel = [x % block, y % block];
            let Some(corners) = faces.get(face) else {
                return [128; 3];
            };
            match sums[(face * block + pixel[1]) * block + pixel[0]] {
                [r, g, b, weight] if weight > 0.0 => {
                    [r, g, b].map(|sum| (sum / weight).round().clamp(0.0, 255.0) as u8)
                }
                // nobody saw it: the colours around
                _ => {
                    let colours = corners.map(|i| mesh.colours[i as usize].map(f64::from));
                    between(colours.map(Vec3::from), shares(pixel, block))
                        .map(|value| value.round() as u8)
                        .into()
                }
            }
        });
        Some(Self {
            image,
            block,
            columns: side,
        })
    }

    /// One whose corners of the first face are these, in the order of [`Texture::corners`]; `None`
    /// where they are those of no block.
    pub fn with_first(image: ColourImage, corners: [[f64; 2]; 2]) -> Option<Self> {
        let width = image.width();
        let block = ((corners[1][0] - corners[0][0]) * width as f64).round() as usize + 1;
        let is_known = BLOCKS.contains(&block) && width.is_multiple_of(block);
        is_known.then_some(Self {
            columns: width / block,
            image,
            block,
        })
    }

    /// The picture as JPEG.
    pub fn jpeg(&self) -> Vec<u8> {
        encode_jpeg_rgb(&self.image, QUALITY)
    }

    /// Where the corners of a face are on the picture, as shares of its sides, from the upper left.
    pub fn corners(&self, face: usize) -> [[f64; 2]; 4] {
        let size = [self.image.width(), self.image.height()];
        let first = [face % self.columns, face / self.columns];
        let last = self.block - 1;
        [[0, 0], [last, 0], [last, last], [0, last]].map(|corner| {
            [0, 1].map(|axis| {
                let pixel = (first[axis] * self.block + corner[axis]) as f64 + 0.5;
                pixel / size[axis] as f64
            })
        })
    }
}

/// The corners of faces of two triangles each, around them; `None` where there are too many, or
/// triangles are not in pairs.
fn faces(mesh: &ColouredMesh) -> Option<Vec<[u32; 4]>> {
    let (pairs, rest) = mesh.surface.triangles.as_chunks::<2>();
    let face = |[first, second]: &[[u32; 3]; 2]| {
        let is_pair = second[0] == first[0] && second[1] == first[2];
        is_pair.then_some([first[0], first[1], first[2], second[2]])
    };
    if !rest.is_empty() || pairs.is_empty() || pairs.len() > MAX_FACES {
        return None;
    }
    pairs.iter().map(face).collect()
}

/// How far a pixel of a block is along its rows and columns.
fn shares([x, y]: [usize; 2], block: usize) -> [f64; 2] {
    [x, y].map(|pixel| pixel as f64 / (block - 1) as f64)
}

/// What lies between four corners, on the two triangles of a face.
fn between([a, b, c, d]: [Vec3; 4], [s, t]: [f64; 2]) -> Vec3 {
    if s >= t {
        a + (b - a) * s + (c - b) * t
    } else {
        a + (d - a) * t + (c - d) * s
    }
}

/// Factors by which the brightness of keyframes agrees where they see the same.
fn gains(seen: &[Vec<Seen>], num_faces: usize) -> Vec<f32> {
    let mut gains = vec![1.0f32; seen.len()];
    for _ in 0..ROUNDS {
        let mut means = vec![[0.0f32; 2]; num_faces];
        for (seen, gain) in seen.iter().zip(&gains) {
            for seen in seen {
                let mean = &mut means[seen.face as usize];
                *mean = [mean[0] + gain * seen.grey, mean[1] + 1.0];
            }
        }
        for (seen, gain) in seen.iter().zip(&mut gains) {
            let (mut product, mut square) = (0.0f64, 0.0f64);
            for seen in seen {
                let [sum, count] = means[seen.face as usize];
                product += f64::from(sum / count * seen.grey);
                square += f64::from(seen.grey * seen.grey);
            }
            if square > 0.0 {
                *gain = ((product / square) as f32).clamp(MAX_GAIN.recip(), MAX_GAIN);
            }
        }
        // together they change nothing
        let mean = gains.iter().sum::<f32>() / gains.len() as f32;
        gains.iter_mut().for_each(|gain| *gain /= mean);
    }
    gains
}

impl SurfaceView<'_> {
    /// The vertices of a surface in its camera.
    fn vertices(&self, mesh: &ColouredMesh) -> Vec<Corner> {
        let keyframe_from_map = self.map_from_keyframe.inverse();
        let vertices = mesh.surface.vertices.iter();
        let place = |vertex: &[f32; 3]| keyframe_from_map * Vec3::from(vertex.map(f64::from));
        vertices.map(place).collect()
    }

    /// The faces that it sees whole, from in front and with nothing before them.
    fn sees(&self, mesh: &ColouredMesh, faces: &[[u32; 4]], colours: &Colours) -> Vec<Seen> {
        let look = Look::of(self.id, self.image, colours);
        let Some(size) = look.size() else {
            return Vec::new();
        };
        let vertices = self.vertices(mesh);
        let depths = Depths::of(&self.pinhole, size, &vertices, &mesh.surface.triangles);
        let seen = faces.iter().enumerate().filter_map(|(face, corners)| {
            let corners = corners.map(|i| vertices[i as usize]);
            let [a, b, c, d] = self.pixels(&corners)?;
            // seen from in front, corners go around against the clock, and y is down
            let area = (c - a).perp(&(b - d)) / 2.0;
            let far = (corners[2] - corners[0]).norm();
            let is_seen = corners.iter().zip([a, b, c, d]);
            let is_seen = area > 0.0
                && is_seen
                    .into_iter()
                    .all(|(corner, pixel)| depths.shows(pixel, corner.z, far));
            let middle = (a + b + c + d) / 4.0;
            let border = border(middle, size);
            (is_seen && border > 0.0).then(|| Seen {
                face: face as u32,
                // pixels of the face, squared: one that sees it twice as large counts much more
                weight: (area * area * (border / BORDER).min(1.0)) as f32,
                grey: f32::from(luma_of_rgb(sample(&look, middle, size).map(|v| v as u8))),
            })
        });
        seen.collect()
    }

    /// Pixels of corners; `None` where one is behind the camera.
    fn pixels(&self, corners: &[Corner; 4]) -> Option<[Vec2; 4]> {
        let is_before = corners.iter().all(|corner| corner.z > 1e-6);
        is_before.then(|| corners.map(|corner| self.pinhole.project(&corner)))
    }

    /// Adds what it shows of faces to the sums of pixels.
    fn add(
        &self,
        mesh: &ColouredMesh,
        faces: &[[u32; 4]],
        (seen, gain): (&[Seen], f32),
        (sums, block): (&mut [[f32; 4]], usize),
        colours: &Colours,
    ) {
        let look = Look::of(self.id, self.image, colours);
        let Some(size) = look.size() else {
            return;
        };
        let vertices = self.vertices(mesh);
        let mut weights = vec![0.0; faces.len()];
        for seen in seen {
            weights[seen.face as usize] = seen.weight;
        }
        let blocks = sums.par_chunks_mut(block * block).zip(faces).zip(&weights);
        let blocks = blocks.filter(|(_, weight)| **weight > 0.0);
        blocks.for_each(|((pixels, corners), weight)| {
            let corners = corners.map(|i| vertices[i as usize]);
            for (k, sum) in pixels.iter_mut().enumerate() {
                let place = between(corners, shares([k % block, k / block], block));
                let colour = sample(&look, self.pinhole.project(&place), size);
                for (sum, value) in sum.iter_mut().zip(colour) {
                    *sum += weight * gain * value as f32;
                }
                sum[3] += weight;
            }
        });
    }
}

/// Pixels from a place to the border of an image; negative outside.
fn border(pixel: Vec2, [width, height]: [usize; 2]) -> f64 {
    let [right, bottom] = [width, height].map(|side| side as f64 - 1.0);
    let sides = [pixel.x, pixel.y, right - pixel.x, bottom - pixel.y];
    sides.into_iter().fold(f64::INFINITY, f64::min)
}

/// The colour between pixels; that of the border outside.
fn sample(look: &Look, pixel: Vec2, [width, height]: [usize; 2]) -> [f64; 3] {
    let inside = |value: f64, side: usize| value.clamp(0.0, side as f64 - 1.0);
    let (x, y) = (inside(pixel.x, width), inside(pixel.y, height));
    let (left, top) = (x as usize, y as usize);
    let (right, bottom) = ((left + 1).min(width - 1), (top + 1).min(height - 1));
    let (u, v) = (x - left as f64, y - top as f64);
    let mix = |a: [u8; 3], b: [u8; 3]| {
        [0, 1, 2].map(|k| (1.0 - u) * f64::from(a[k]) + u * f64::from(b[k]))
    };
    let above = mix(look.at(left, top), look.at(right, top));
    let below = mix(look.at(left, bottom), look.at(right, bottom));
    [0, 1, 2].map(|k| (1.0 - v) * above[k] + v * below[k])
}

/// Depth of the nearest surface in the pixels of a small image.
struct Depths {
    size: [usize; 2],
    nearest: Vec<f32>,
}

impl Depths {
    fn of(
        pinhole: &Pinhole,
        size: [usize; 2],
        vertices: &[Corner],
        triangles: &[[u32; 3]],
    ) -> Self {
        let size = size.map(|side| (side as f64 / DEPTH_STEP).ceil() as usize);
        let mut depths = Self {
            size,
            nearest: vec![f32::INFINITY; size[0] * size[1]],
        };
        for triangle in triangles {
            let corners = triangle.map(|i| vertices[i as usize]);
            if corners.iter().all(|corner| corner.z > 1e-6) {
                let pixels = corners.map(|corner| {
                    let pixel = pinhole.project(&corner) / DEPTH_STEP;
                    [pixel.x, pixel.y, 1.0 / corner.z]
                });
                depths.fill(pixels);
            }
        }
        depths
    }

    /// Fills a triangle of columns, rows and inverse depths.
    fn fill(&mut self, [a, b, c]: [[f64; 3]; 3]) {
        let (size, pixels) = (self.size, [a, b, c].map(|[x, y, _]| [x, y]));
        over_triangle(pixels, size, |x, y, shares| {
            let inverse = shares[0] * a[2] + shares[1] * b[2] + shares[2] * c[2];
            let nearest = &mut self.nearest[y * size[0] + x];
            *nearest = nearest.min((1.0 / inverse) as f32);
        });
    }

    /// Whether nothing is before what is so deep at a pixel, and of a face as wide as `far`.
    fn shows(&self, pixel: Vec2, depth: f64, far: f64) -> bool {
        let [x, y] = [pixel.x, pixel.y].map(|value| (value / DEPTH_STEP).round());
        let inside = x >= 0.0 && y >= 0.0 && x < self.size[0] as f64 && y < self.size[1] as f64;
        inside && {
            let nearest = self.nearest[y as usize * self.size[0] + x as usize];
            depth <= f64::from(nearest) * (1.0 + BEHIND) + far
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_image::Image;
    use monogrid_occupancy::SurfaceMesh;

    /// A square of faces at z = 2 that faces a camera at the origin, from -1 to 1, and a small one
    /// before it at z = 1.
    fn wall(has_front: bool) -> ColouredMesh {
        const N: u32 = 8;
        let at = |i: u32| f64::from(i) as f32 / N as f32 * 2.0 - 1.0;
        let grid = (0..=N).flat_map(|y| (0..=N).map(move |x| [at(x), at(y), 2.0]));
        let mut vertices: Vec<[f32; 3]> = grid.collect();
        let face = |x: u32, y: u32| {
            let a = y * (N + 1) + x;
            // seen from the origin, against the clock with y down
            let [a, b, c, d] = [a, a + N + 1, a + N + 2, a + 1];
            [[a, b, c], [a, c, d]]
        };
        let faces = (0..N).flat_map(|y| (0..N).flat_map(move |x| face(x, y)));
        let mut triangles: Vec<[u32; 3]> = faces.collect();
        if has_front {
            let first = vertices.len() as u32;
            vertices.extend([
                [-0.2, -0.2, 1.0],
                [-0.2, 0.2, 1.0],
                [0.2, 0.2, 1.0],
                [0.2, -0.2, 1.0],
            ]);
            triangles.extend([[0, 1, 2], [0, 2, 3]].map(|t| t.map(|i: u32| first + i)));
        }
        ColouredMesh {
            colours: vec![[9, 9, 9]; vertices.len()],
            surface: SurfaceMesh {
                vertices,
                triangles,
                ..SurfaceMesh::default()
            },
            texture: None,
        }
    }

    fn view(image: &Image<u8>) -> SurfaceView<'_> {
        SurfaceView {
            id: 0,
            image: Some(ImageOf::Held(image)),
            pinhole: Pinhole::new(100.0, 100.0, 79.5, 79.5),
            map_from_keyframe: Sim3::identity(),
        }
    }

    #[test]
    fn a_face_looks_as_it_was_filmed_but_for_what_is_hidden() {
        let image = Image::from_fn(160, 160, |x, _| if x < 80 { 50 } else { 200u8 });
        let views = [view(&image)];
        let plain = Texture::new(&wall(false), &views, &Colours::default()).unwrap();
        assert_eq!((plain.block, plain.columns), (16, 8));
        let pixel = |texture: &Texture, face: usize, share: f64| {
            let corners = texture.corners(face);
            let at = |axis: usize, size: usize| {
                let place = corners[0][axis] + share * (corners[2][axis] - corners[0][axis]);
                (place * size as f64) as usize
            };
            let image = &texture.image;
            image.at(at(0, image.width()), at(1, image.height()))
        };
        let middle = |face| pixel(&plain, face, 0.5);
        assert_eq!([middle(27), middle(28)], [[50; 3], [200; 3]]);
        let hidden = Texture::new(&wall(true), &views, &Colours::default()).unwrap();
        // the four in the middle are behind the small one, which is seen
        let shown = [9, 27, 28, 36, 64].map(|face| pixel(&hidden, face, 0.5)[0]);
        assert_eq!(shown[1..4], [9, 9, 9]);
        assert_eq!(shown[0], 50);
        assert!(shown[4] > 9);
        // from behind nothing is seen
        let mut turned = wall(false);
        for [_, b, c] in &mut turned.surface.triangles {
            std::mem::swap(b, c);
        }
        assert!(faces(&turned).is_none(), "no pairs");
    }

    #[test]
    fn keyframes_of_another_exposure_are_balanced() {
        let seen = |grey: f32, faces: std::ops::Range<u32>| -> Vec<Seen> {
            let weight = 1.0;
            faces.map(|face| Seen { face, weight, grey }).collect()
        };
        let gains = gains(&[seen(100.0, 0..10), seen(130.0, 5..15)], 15);
        let ratio = gains[0] / gains[1];
        assert!((1.2..1.31).contains(&ratio), "{gains:?}");
        assert!((gains[0] + gains[1] - 2.0).abs() < 1e-4);
    }
}
