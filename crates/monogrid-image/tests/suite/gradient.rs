//! Gradients against pixel-by-pixel definitions.

use monogrid_image::{GradientImage, GrayImage, max_gradient};

/// A picture without symmetry.
fn picture(width: usize, height: usize) -> GrayImage {
    GrayImage::from_fn(width, height, |x, y| {
        ((x * 37 + y * 91 + x * y * 13) % 256) as f32
    })
}

#[test]
fn gradients_are_halved_central_differences_and_zero_on_the_border() {
    for (width, height) in [(9, 7), (3, 3), (2, 5), (5, 2), (1, 1)] {
        let image = picture(width, height);
        let gradient = GradientImage::new(&image);
        for y in 0..height {
            for x in 0..width {
                let inside = x > 0 && y > 0 && x + 1 < width && y + 1 < height;
                let (gx, gy) = if inside {
                    (
                        (image.at(x + 1, y) - image.at(x - 1, y)) / 2.0,
                        (image.at(x, y + 1) - image.at(x, y - 1)) / 2.0,
                    )
                } else {
                    (0.0, 0.0)
                };
                assert_eq!((gradient.gx.at(x, y), gradient.gy.at(x, y)), (gx, gy));
                let magnitude = gradient.magnitude().at(x, y);
                assert!((magnitude - gx.hypot(gy)).abs() < 1e-3);
            }
        }
    }
}

#[test]
fn max_gradient_is_the_largest_of_nine() {
    for (width, height) in [(12, 9), (5, 5), (4, 4), (2, 3)] {
        let gradient = GradientImage::new(&picture(width, height));
        let magnitude = gradient.magnitude();
        let largest = max_gradient(&gradient);
        for y in 0..height {
            for x in 0..width {
                let inside = x > 1 && y > 1 && x + 2 < width && y + 2 < height;
                let mut expected = 0.0f32;
                if inside {
                    for yy in y - 1..=y + 1 {
                        for xx in x - 1..=x + 1 {
                            expected = expected.max(magnitude.at(xx, yy));
                        }
                    }
                }
                assert_eq!(largest.at(x, y), expected, "({x}, {y}) of {width}x{height}");
            }
        }
    }
}
