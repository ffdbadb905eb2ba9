//! Radial profiles of lenses: the distorted radius, where it grows, and its inverse.

/// Largest ideal radius that is inverted: 89.7 degrees off the axis.
pub(super) const RADIUS_LIMIT: f64 = 200.0;

/// The distorted radius as a function of the angle off the axis, or of the ideal radius.
pub(super) trait Profile {
    /// The distorted radius at `x` and its derivative.
    fn value_and_slope(&self, x: f64) -> (f64, f64);

    /// Whether it grows all the way from the axis to `x`; where it does not, two angles share one
    /// pixel.
    fn is_one_to_one(&self, x: f64) -> bool;

    /// Argument in `[0, x_max]` at which it reaches `r` for the first time, by Newton's method kept
    /// inside a bracket: without, it jumps over the fold of strongly curved models.
    fn invert(&self, r: f64, x_max: f64) -> Option<f64> {
        let (mut low, mut high) = (0.0, x_max);
        let mut x = r.min(high);
        for _ in 0..100 {
            let (value, slope) = self.value_and_slope(x);
            if (value - r).abs() <= 4.0 * f64::EPSILON * r {
                // Going on would leave the bracket by rounding and start to bisect.
                break;
            }
            if value > r || !self.is_one_to_one(x) {
                high = x;
            } else {
                low = x;
            }
            let newton = x - (value - r) / slope;
            let next = if newton > low && newton < high {
                newton
            } else {
                0.5 * (low + high)
            };
            let step = next - x;
            x = next;
            if step.abs() < 1e-15 * x.max(1.0) {
                break;
            }
        }
        let (value, _) = self.value_and_slope(x);
        ((value - r).abs() < 1e-12 * r.max(1.0) && self.is_one_to_one(x)).then_some(x)
    }
}

/// `x (1 + k0 x^2 + k1 x^4 + k2 x^6 + k3 x^8)`.
pub(super) struct Polynomial(pub [f64; 4]);

impl Profile for Polynomial {
    fn value_and_slope(&self, x: f64) -> (f64, f64) {
        let (k, x2) = (&self.0, x * x);
        let value = x * (1.0 + x2 * (k[0] + x2 * (k[1] + x2 * (k[2] + x2 * k[3]))));
        let slope =
            1.0 + x2 * (3.0 * k[0] + x2 * (5.0 * k[1] + x2 * (7.0 * k[2] + x2 * 9.0 * k[3])));
        (value, slope)
    }

    fn is_one_to_one(&self, x: f64) -> bool {
        let k = &self.0;
        let slope = [1.0, 3.0 * k[0], 5.0 * k[1], 7.0 * k[2], 9.0 * k[3]];
        is_positive_up_to(x * x, slope)
    }
}

/// `x (1 + k0 x^2 + k1 x^4 + k2 x^6) / (1 + k3 x^2 + k4 x^4 + k5 x^6)`.
pub(super) struct Ratio {
    above: [f64; 4],
    below: [f64; 4],
}

impl Ratio {
    pub(super) fn new([k1, k2, k3, k4, k5, k6]: [f64; 6]) -> Self {
        Self {
            above: [1.0, k1, k2, k3],
            below: [1.0, k4, k5, k6],
        }
    }

    /// Distorted over ideal radius, of the square of the latter.
    pub(super) fn factor(&self, x2: f64) -> f64 {
        at(&self.above, x2) / at(&self.below, x2)
    }

    /// The slope times the square of what is below, as a polynomial of the square of the radius.
    fn slope_above(&self) -> [f64; 7] {
        let mut slope = [0.0; 7];
        for (i, above) in self.above.iter().enumerate() {
            for (j, below) in self.below.iter().enumerate() {
                slope[i + j] += above * below * (1.0 + 2.0 * (i as f64 - j as f64));
            }
        }
        slope
    }
}

impl Profile for Ratio {
    fn value_and_slope(&self, x: f64) -> (f64, f64) {
        let x2 = x * x;
        let below = at(&self.below, x2);
        let slope = at(&self.slope_above(), x2) / (below * below);
        (x * self.factor(x2), slope)
    }

    fn is_one_to_one(&self, x: f64) -> bool {
        is_positive_up_to(x * x, self.below) && is_positive_up_to(x * x, self.slope_above())
    }
}

/// The polynomial `sum c_i x^i`.
fn at(c: &[f64], x: f64) -> f64 {
    c.iter().rev().fold(0.0, |sum, c| sum * x + c)
}

/// Whether the polynomial `sum c_i x^i` is positive on all of `[0, x_max]`.
///
/// Exact but for polynomials that touch zero: the Bernstein coefficients bound the values, and the
/// interval is halved until they decide.
fn is_positive_up_to<const N: usize>(x_max: f64, c: [f64; N]) -> bool {
    // Power basis on [0, x_max] to Bernstein basis.
    let mut power = 1.0;
    let scaled = c.map(|x| {
        let y = x * power;
        power *= x_max;
        y
    });
    let of_degree = binomials::<N>(N - 1);
    let bernstein: [f64; N] = std::array::from_fn(|i| {
        let row = binomials::<N>(i);
        (0..=i)
            .map(|j| row[j] * (1.0 / of_degree[j]) * scaled[j])
            .sum()
    });
    bernstein_is_positive(&bernstein, 24)
}

/// A row of Pascal's triangle, with zeros behind it.
fn binomials<const N: usize>(row: usize) -> [f64; N] {
    let mut values = [0.0; N];
    values[0] = 1.0;
    for _ in 0..row {
        for j in (1..N).rev() {
            values[j] += values[j - 1];
        }
    }
    values
}

/// Positivity of a polynomial on its interval, by de Casteljau's subdivision.
fn bernstein_is_positive<const N: usize>(b: &[f64; N], depth: u32) -> bool {
    if b.iter().all(|&x| x > 0.0) {
        return true;
    }
    // The ends are values of the polynomial. NaN ends here as well.
    if !(b[0] > 0.0 && b[N - 1] > 0.0) || depth == 0 {
        return false;
    }
    let (mut left, mut right, mut row) = ([0.0; N], [0.0; N], *b);
    for level in 0..N {
        left[level] = row[0];
        right[N - 1 - level] = row[N - 1 - level];
        for i in 0..N - 1 - level {
            row[i] = 0.5 * (row[i] + row[i + 1]);
        }
    }
    bernstein_is_positive(&left, depth - 1) && bernstein_is_positive(&right, depth - 1)
}
