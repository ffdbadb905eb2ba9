//! A keyframe as pictures: its image, its depth and its uncertainty.

use super::{Picture, colour};
use monogrid_image::Image;

/// One measured pixel.
#[derive(Debug, Clone, Copy)]
pub struct Measured {
    /// Column, px.
    pub x: usize,
    /// Row, px.
    pub y: usize,
    /// Inverse depth.
    pub idepth: f64,
    /// Standard deviation of the inverse depth over the inverse depth.
    pub relative_sigma: f64,
}

/// Relative uncertainty that is drawn in the last colour.
const WORST_RELATIVE_SIGMA: f64 = 0.1;

/// Inverse depth over the darkened image: red is near, blue is far, between the 2 % and 98 %
/// quantiles.
pub fn depth_picture(image: &Image<u8>, measured: &[Measured]) -> Picture {
    let mut idepths: Vec<f64> = measured.iter().map(|m| m.idepth).collect();
    let far = colour::quantile(&mut idepths, 0.02);
    let near = colour::quantile(&mut idepths, 0.98);
    let span = (near - far).max(f64::MIN_POSITIVE);
    overlay(image, measured, |m| {
        colour::rainbow((m.idepth - far) / span)
    })
}

/// Relative uncertainty of the inverse depth over the darkened image: green is certain, red is 10 %
/// or more.
pub fn uncertainty_picture(image: &Image<u8>, measured: &[Measured]) -> Picture {
    overlay(image, measured, |m| {
        colour::certainty(m.relative_sigma / WORST_RELATIVE_SIGMA)
    })
}

fn overlay(
    image: &Image<u8>,
    measured: &[Measured],
    colour_of: impl Fn(&Measured) -> [u8; 3],
) -> Picture {
    let mut picture = image.map(|grey| [(u16::from(grey) * 3 / 5) as u8; 3]);
    for m in measured {
        if m.x < picture.width() && m.y < picture.height() {
            picture.set(m.x, m.y, colour_of(m));
        }
    }
    picture
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn near_is_red_far_is_blue_unmeasured_is_grey() {
        let image = Image::filled(3, 1, 100u8);
        let measured = [(0, 2.0), (1, 0.5)].map(|(x, idepth)| Measured {
            x,
            y: 0,
            idepth,
            relative_sigma: 0.0,
        });
        let picture = depth_picture(&image, &measured);
        assert_eq!(picture.at(0, 0), colour::rainbow(1.0));
        assert_eq!(picture.at(1, 0), colour::rainbow(0.0));
        assert_eq!(picture.at(2, 0), [60, 60, 60]);
    }
}
