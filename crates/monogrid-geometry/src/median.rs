//! The value in the middle.

/// Standard deviation of a normal distribution whose absolute values have the median 1.
pub const SIGMA_OF_MEDIAN: f64 = 1.4826;

/// The upper median of numbers, which are put into another order; `None` of none.
pub fn median<T: Real>(values: &mut [T]) -> Option<T> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, T::total_cmp).1)
}

/// Numbers in an order that holds NaN as well.
pub trait Real: Copy {
    /// The order.
    fn total_cmp(&self, other: &Self) -> std::cmp::Ordering;
}

impl Real for f32 {
    fn total_cmp(&self, other: &Self) -> std::cmp::Ordering {
        f32::total_cmp(self, other)
    }
}

impl Real for f64 {
    fn total_cmp(&self, other: &Self) -> std::cmp::Ordering {
        f64::total_cmp(self, other)
    }
}

#[cfg(test)]
mod tests {
    use super::median;

    #[test]
    fn of_an_even_number_it_is_the_larger_of_the_two_in_the_middle() {
        assert_eq!(median(&mut [3.0_f32, 1.0, 2.0]), Some(2.0));
        assert_eq!(median(&mut [4.0, 1.0, 3.0, 2.0]), Some(3.0));
        assert_eq!(median::<f64>(&mut []), None);
    }
}
