//! Which way a rolling shutter runs over an image.

use crate::Vec2;

/// Which way over an upright image the rows of the sensor are read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ReadoutDirection {
    /// From the top to the bottom: the camera was held level.
    #[default]
    Down,
    /// From the bottom to the top: upside down.
    Up,
    /// From the left to the right: the rows of the sensor are columns of the image, since the
    /// camera was held upright.
    Right,
    /// From the right to the left: held upright the other way.
    Left,
}

impl ReadoutDirection {
    /// What is to be expected of images of this size of which nothing else is known: sensors are
    /// wider than high, so an image that is higher than wide was turned, nobody knows which way (a
    /// negative readout says the other one).
    #[must_use]
    pub fn of_size((width, height): (usize, usize)) -> Self {
        match height > width {
            true => Self::Right,
            false => Self::Down,
        }
    }

    /// When a pixel is read, as a share of the time from the first row to the last; 0 in the middle
    /// of an image of this size.
    #[must_use]
    pub fn phase(self, pixel: &Vec2, size: (usize, usize)) -> f64 {
        let size = Vec2::new(size.0 as f64, size.1 as f64);
        let from_middle = pixel - (size - Vec2::repeat(1.0)) / 2.0;
        from_middle.component_div(&size).dot(&self.vector())
    }

    /// How the [phase](Self::phase) changes along x and along y, per pixel.
    #[must_use]
    pub fn gradient(self, (width, height): (usize, usize)) -> Vec2 {
        let size = Vec2::new(width as f64, height as f64);
        self.vector().component_div(&size)
    }

    fn vector(self) -> Vec2 {
        match self {
            Self::Down => Vec2::new(0.0, 1.0),
            Self::Up => Vec2::new(0.0, -1.0),
            Self::Right => Vec2::new(1.0, 0.0),
            Self::Left => Vec2::new(-1.0, 0.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::ReadoutDirection::{self, Down, Left, Right, Up};
    use crate::Vec2;

    #[test]
    fn the_middle_is_at_zero_and_the_first_row_is_read_half_of_the_time_before() {
        let size = (40, 30);
        for (direction, first) in [
            (Down, Vec2::new(7.0, -0.5)),
            (Up, Vec2::new(7.0, 29.5)),
            (Right, Vec2::new(-0.5, 3.0)),
            (Left, Vec2::new(39.5, 3.0)),
        ] {
            assert_eq!(direction.phase(&Vec2::new(19.5, 14.5), size), 0.0);
            assert_eq!(direction.phase(&first, size), -0.5, "{direction:?}");
            let step = Vec2::new(2.0, 3.0);
            let changed = direction.phase(&(first + step), size) + 0.5;
            let expected = direction.gradient(size).dot(&step);
            assert!((changed - expected).abs() < 1e-12, "{direction:?}");
        }
        assert_eq!(ReadoutDirection::of_size((640, 480)), Down);
        assert_eq!(ReadoutDirection::of_size((480, 640)), Right);
    }
}
