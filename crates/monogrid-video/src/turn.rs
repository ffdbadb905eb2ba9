//! Quarter turns: phones store frames as the sensor lies and say how to turn them.

use monogrid_geometry::ReadoutDirection;
use monogrid_image::Image;

/// By how much a stored frame is turned clockwise to be upright.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Turn {
    #[default]
    None,
    Quarter,
    Half,
    ThreeQuarters,
}

impl Turn {
    /// From the upper left 2x2 part `[a, b, c, d]` of a display matrix (ISO 14496-12, 8.3.2.3): a
    /// pixel (x, y) is shown at (a x + c y, b x + d y). `None` where it is no quarter turn.
    pub(crate) fn from_matrix(matrix: [i32; 4]) -> Option<Self> {
        match matrix.map(i32::signum) {
            [1, 0, 0, 1] => Some(Self::None),
            [0, 1, -1, 0] => Some(Self::Quarter),
            [-1, 0, 0, -1] => Some(Self::Half),
            [0, -1, 1, 0] => Some(Self::ThreeQuarters),
            _ => None,
        }
    }

    /// From the turn that ffmpeg tells, degrees anticlockwise. `None` where it is no quarter turn.
    pub(crate) fn from_degrees(degrees: f64) -> Option<Self> {
        match (degrees / 90.0).round() as i32 {
            _ if (degrees / 90.0).fract().abs() > 0.01 => None,
            0 => Some(Self::None),
            -1 | 3 => Some(Self::Quarter),
            2 | -2 => Some(Self::Half),
            1 | -3 => Some(Self::ThreeQuarters),
            _ => None,
        }
    }

    /// Whether width becomes height.
    pub(crate) fn swaps_sides(self) -> bool {
        matches!(self, Self::Quarter | Self::ThreeQuarters)
    }

    /// Which way the rows of the sensor lie in the upright image, of this size.
    pub(crate) fn readout_direction(self, size: (usize, usize)) -> ReadoutDirection {
        match self {
            Self::None => ReadoutDirection::of_size(size),
            Self::Quarter => ReadoutDirection::Left,
            Self::Half => ReadoutDirection::Up,
            Self::ThreeQuarters => ReadoutDirection::Right,
        }
    }

    pub(crate) fn apply<T: Copy>(self, image: Image<T>) -> Image<T> {
        let (width, height) = (image.width(), image.height());
        match self {
            Self::None => image,
            Self::Quarter => Image::from_fn(height, width, |x, y| image.at(y, height - 1 - x)),
            Self::Half => Image::from_fn(width, height, |x, y| {
                image.at(width - 1 - x, height - 1 - y)
            }),
            Self::ThreeQuarters => Image::from_fn(height, width, |x, y| image.at(width - 1 - y, x)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Turn;
    use crate::frame::Grey;
    use monogrid_geometry::Vec2;
    use monogrid_image::Image;

    #[test]
    fn a_quarter_turn_brings_the_left_column_up() {
        let image = Grey::from_vec(3, 2, b"abcdef".to_vec()).unwrap();
        let turned = Turn::Quarter.apply(image.clone());
        assert_eq!((turned.width(), turned.height()), (2, 3));
        assert_eq!(turned.as_slice(), b"daebfc");
        assert_eq!(Turn::Half.apply(image.clone()).as_slice(), b"fedcba");
        let three = Turn::Quarter.apply(Turn::Half.apply(image.clone()));
        assert_eq!(Turn::ThreeQuarters.apply(image), three);
    }

    #[test]
    fn the_first_row_of_the_sensor_is_read_first_wherever_it_lies() {
        for turn in [Turn::None, Turn::Quarter, Turn::Half, Turn::ThreeQuarters] {
            // numbers of rows of the sensor
            let rows = turn.apply(Image::from_fn(4, 3, |_, y| y));
            let size = (rows.width(), rows.height());
            let direction = turn.readout_direction(size);
            for (x, y) in (0..size.0).flat_map(|x| (0..size.1).map(move |y| (x, y))) {
                let phase = direction.phase(&Vec2::new(x as f64, y as f64), size);
                let row = rows.at(x, y) as f64;
                assert!((phase - (row - 1.0) / 3.0).abs() < 1e-12, "{turn:?}");
            }
        }
        assert_eq!(Turn::from_degrees(-90.0), Some(Turn::Quarter));
        assert_eq!(Turn::from_degrees(90.0), Some(Turn::ThreeQuarters));
        assert_eq!(Turn::from_degrees(-180.0), Some(Turn::Half));
        assert_eq!(Turn::from_degrees(-0.0), Some(Turn::None));
        assert_eq!(Turn::from_degrees(45.0), None);
    }

    #[test]
    fn matrices() {
        let one = 0x10000;
        assert_eq!(Turn::from_matrix([one, 0, 0, one]), Some(Turn::None));
        assert_eq!(Turn::from_matrix([0, one, -one, 0]), Some(Turn::Quarter));
        assert_eq!(
            Turn::from_matrix([0, -one, one, 0]),
            Some(Turn::ThreeQuarters)
        );
        assert_eq!(Turn::from_matrix([one, 5, 0, one]), None);
    }
}
