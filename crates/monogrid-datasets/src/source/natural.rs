//! Natural order of file names: `frame2` before `frame10`.

use std::cmp::Ordering;

/// Compares runs of digits by value and everything else byte by byte; total and deterministic.
#[must_use]
pub fn natural_order(a: &str, b: &str) -> Ordering {
    let (mut left, mut right) = (a.as_bytes(), b.as_bytes());
    loop {
        let (Some(&x), Some(&y)) = (left.first(), right.first()) else {
            // equal up to zeros in front: the plain order decides
            return left.len().cmp(&right.len()).then_with(|| a.cmp(b));
        };
        if x.is_ascii_digit() && y.is_ascii_digit() {
            let (run_a, rest_a) = digit_run(left);
            let (run_b, rest_b) = digit_run(right);
            // without zeros in front the longer number is the larger one
            let order = run_a.len().cmp(&run_b.len()).then_with(|| run_a.cmp(run_b));
            if order != Ordering::Equal {
                return order;
            }
            (left, right) = (rest_a, rest_b);
        } else {
            if x != y {
                return x.cmp(&y);
            }
            (left, right) = (&left[1..], &right[1..]);
        }
    }
}

/// The digits at the start, without zeros in front, and what follows them.
fn digit_run(text: &[u8]) -> (&[u8], &[u8]) {
    let end = text.iter().position(|b| !b.is_ascii_digit());
    let end = end.unwrap_or(text.len());
    let start = text[..end].iter().position(|&b| b != b'0').unwrap_or(end);
    (&text[start..end], &text[end..])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_compared_by_value() {
        let mut names = vec![
            "img10.png",
            "img2.png",
            "img1.png",
            "img02.png",
            "a",
            "img",
            "img2b",
            "img10a1",
            "img9",
        ];
        names.sort_by(|a, b| natural_order(a, b));
        assert_eq!(
            names,
            [
                "a",
                "img",
                "img1.png",
                "img02.png",
                "img2.png",
                "img2b",
                "img9",
                "img10.png",
                "img10a1"
            ]
        );
    }

    #[test]
    fn it_is_a_total_order() {
        let names = [
            "",
            "0",
            "00",
            "1",
            "01",
            "a1",
            "a01",
            "a001b",
            "a1b",
            "12345678901234567890123",
        ];
        for a in names {
            for b in names {
                assert_eq!(
                    natural_order(a, b),
                    natural_order(b, a).reverse(),
                    "{a} {b}"
                );
                assert_eq!(natural_order(a, b) == Ordering::Equal, a == b);
                for c in names {
                    if natural_order(a, b).is_lt() && natural_order(b, c).is_lt() {
                        assert!(natural_order(a, c).is_lt(), "{a} {b} {c}");
                    }
                }
            }
        }
    }
}
