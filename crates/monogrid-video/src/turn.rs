//! Quarter turns: phones store frames as the sensor lies and say how to turn them.

use crate::Grey;

/// By how much a stored frame is turned clockwise to be upright.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Turn {
    None,
    Quarter,
    Half,
    ThreeQuarters,
}

impl Turn {
    /// From the upper left 2x2 part `[a, b, c, d]` of a display matrix (ISO 14496-12, 8.3.2.3): a pixel
    /// (x, y) is shown at (a x + c y, b x + d y). `None` where it is no quarter turn.
    pub(crate) fn from_matrix(matrix: [i32; 4]) -> Option<Self> {
        match matrix.map(i32::signum) {
            [1, 0, 0, 1] => Some(Self::None),
            [0, 1, -1, 0] => Some(Self::Quarter),
            [-1, 0, 0, -1] => Some(Self::Half),
            [0, -1, 1, 0] => Some(Self::ThreeQuarters),
            _ => None,
        }
    }

    pub(crate) fn apply(self, image: Grey) -> Grey {
        let (width, height) = (image.width(), image.height());
        match self {
            Self::None => image,
            Self::Quarter => Grey::from_fn(height, width, |x, y| image.at(y, height - 1 - x)),
            Self::Half => Grey::from_fn(width, height, |x, y| {
                image.at(width - 1 - x, height - 1 - y)
            }),
            Self::ThreeQuarters => Grey::from_fn(height, width, |x, y| image.at(width - 1 - y, x)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Turn;
    use crate::Grey;

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
