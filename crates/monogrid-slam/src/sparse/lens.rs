//! What a calibration has left of the distortion of a lens.

use monogrid_geometry::{Pinhole, Vec2, Vec3};

/// The pinhole of images out of which not all of the radial distortion was taken: a ray at `x` from
/// the axis, in focal lengths, is seen at `x (1 + radial |x|^2)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct LeftLens {
    pub pinhole: Pinhole,
    radial: f64,
}

/// Rounds in which the distance from the axis is found: what is left is small.
const ROUNDS: usize = 8;

impl LeftLens {
    /// Nothing is left.
    pub fn of_pinhole(pinhole: &Pinhole) -> Self {
        Self::new(pinhole, 0.0)
    }

    /// With a term of radial distortion left.
    pub fn new(pinhole: &Pinhole, radial: f64) -> Self {
        Self {
            pinhole: *pinhole,
            radial,
        }
    }

    /// Where the pinhole sees what is seen at a pixel.
    pub fn ideal(&self, pixel: Vec2) -> Vec2 {
        if self.radial == 0.0 {
            return pixel;
        }
        let seen = self.pinhole.unproject(&pixel).xy();
        let mut ideal = seen;
        for _ in 0..ROUNDS {
            ideal = seen / (1.0 + self.radial * ideal.norm_squared());
        }
        self.pinhole.project(&Vec3::new(ideal.x, ideal.y, 1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::LeftLens;
    use monogrid_geometry::{Pinhole, Vec2, Vec3};

    #[test]
    fn the_ideal_pixel_is_seen_where_the_lens_bends_it_to() {
        let pinhole = Pinhole::new(500.0, 510.0, 319.5, 239.5);
        for radial in [0.012, -0.03] {
            let lens = LeftLens::new(&pinhole, radial);
            for pixel in [
                Vec2::new(5.0, 470.0),
                Vec2::new(319.5, 239.5),
                Vec2::new(600.0, 12.0),
            ] {
                let ideal = pinhole.unproject(&lens.ideal(pixel)).xy();
                let bent = ideal * (1.0 + radial * ideal.norm_squared());
                let seen = pinhole.project(&Vec3::new(bent.x, bent.y, 1.0));
                assert!((seen - pixel).norm() < 1e-6, "{pixel} {seen}");
            }
        }
        let pixel = Vec2::new(3.0, 4.0);
        assert_eq!(LeftLens::of_pinhole(&pinhole).ideal(pixel), pixel);
    }
}
