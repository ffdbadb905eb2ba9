//! Real roots of polynomials of small degree.

/// All simple real roots of `coefficients[0] + coefficients[1] x + ...`, ascending.
///
/// Roots inside [-1, 1] are isolated by the roots of the derivative (between two of them the
/// polynomial is monotonic), those outside as reciprocals of the roots of the reversed polynomial.
/// Double roots may be missed. Empty for constants and for input that is not finite.
#[must_use]
pub(crate) fn real_roots(coefficients: &[f64]) -> Vec<f64> {
    let largest = coefficients.iter().fold(0.0f64, |m, c| m.max(c.abs()));
    if !largest.is_finite() || largest == 0.0 {
        return Vec::new();
    }
    let scaled: Vec<f64> = coefficients.iter().map(|c| c / largest).collect();
    let reversed: Vec<f64> = scaled.iter().rev().copied().collect();
    let mut roots = roots_in_unit_interval(&scaled);
    for root in roots_in_unit_interval(&reversed) {
        // reciprocals of +-1 were found before; of 0 would be infinite
        if root.abs() < 1.0 && root.abs() > 1e-12 {
            roots.push(1.0 / root);
        }
    }
    roots.sort_by(f64::total_cmp);
    roots
}

/// Value of the polynomial by Horner's rule.
pub(crate) fn evaluate(coefficients: &[f64], x: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, c| sum * x + c)
}

/// Product of two polynomials.
pub(crate) fn multiply(a: &[f64], b: &[f64]) -> Vec<f64> {
    let mut product = vec![0.0; (a.len() + b.len()).saturating_sub(1)];
    for (i, x) in a.iter().enumerate() {
        for (j, y) in b.iter().enumerate() {
            product[i + j] += x * y;
        }
    }
    product
}

fn roots_in_unit_interval(coefficients: &[f64]) -> Vec<f64> {
    if coefficients.len() < 2 {
        return Vec::new();
    }
    let terms = coefficients.iter().enumerate().skip(1);
    let derivative: Vec<f64> = terms.map(|(power, c)| power as f64 * c).collect();
    let turning_points = roots_in_unit_interval(&derivative);
    let mut roots = Vec::with_capacity(coefficients.len());
    let (mut low, mut at_low) = (-1.0, evaluate(coefficients, -1.0));
    for high in turning_points.into_iter().chain([1.0]) {
        let at_high = evaluate(coefficients, high);
        if at_low == 0.0 {
            roots.push(low);
        } else if at_low * at_high < 0.0 {
            roots.push(bracketed_root(coefficients, &derivative, low, high));
        }
        (low, at_low) = (high, at_high);
    }
    if at_low == 0.0 {
        roots.push(low);
    }
    roots
}

/// Newton's method that falls back to bisection; the signs at `low` and `high` must differ.
fn bracketed_root(coefficients: &[f64], derivative: &[f64], mut low: f64, mut high: f64) -> f64 {
    let rising = evaluate(coefficients, low) < 0.0;
    let mut x = 0.5 * (low + high);
    for _ in 0..100 {
        let value = evaluate(coefficients, x);
        if (value < 0.0) == rising {
            low = x;
        } else {
            high = x;
        }
        let newton = x - value / evaluate(derivative, x);
        let next = if newton > low && newton < high {
            newton
        } else {
            0.5 * (low + high)
        };
        if (next - x).abs() <= 1e-15 {
            return next;
        }
        x = next;
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Rng;

    #[test]
    fn random_roots_are_recovered() {
        let mut rng = Rng::new(2);
        for _ in 0..200 {
            let mut roots: Vec<f64> = (0..6).map(|_| 3.0 * rng.normal()).collect();
            roots.sort_by(f64::total_cmp);
            if roots.windows(2).any(|w| w[1] - w[0] < 0.05) {
                continue;
            }
            // times a quadratic without real roots
            let mut coefficients = vec![1.3, 0.2, 0.9];
            for root in &roots {
                coefficients = multiply(&coefficients, &[-root, 1.0]);
            }
            let found = real_roots(&coefficients);
            assert_eq!(found.len(), roots.len(), "{found:?} {roots:?}");
            for (f, r) in found.iter().zip(&roots) {
                assert!((f - r).abs() < 1e-6 * (1.0 + r.abs()), "{f} {r}");
            }
        }
    }

    #[test]
    fn degenerate_polynomials_have_no_roots() {
        assert!(real_roots(&[]).is_empty());
        assert!(real_roots(&[4.0]).is_empty());
        assert!(real_roots(&[0.0, 0.0]).is_empty());
        assert!(real_roots(&[1.0, f64::NAN]).is_empty());
        assert!(real_roots(&[1.0, 0.0, 1.0]).is_empty());
        let linear = real_roots(&[-2.0, 1.0, 0.0, 0.0]);
        assert!(linear.len() == 1 && (linear[0] - 2.0).abs() < 1e-12);
    }
}
