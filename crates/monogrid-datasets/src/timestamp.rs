//! Time stamps as integer nanoseconds, parsed exactly from their decimal text.

const NANOS_PER_SECOND: i128 = 1_000_000_000;

/// Nanoseconds of a decimal number of seconds (`12.5`, `-0.25`, `1.036224e-01`), exact to the
/// nanosecond and rounded half away from zero beyond; `None` when it is not a number or does not fit.
///
/// A bare integer of 16 or more digits is taken as nanoseconds, as EuRoC's tools write them: as
/// seconds it would lie 30 million years ahead.
///
/// ```
/// use monogrid_datasets::parse_seconds;
/// assert_eq!(parse_seconds("1403715273.262142976"), Some(1_403_715_273_262_142_976));
/// ```
#[must_use]
pub fn parse_seconds(text: &str) -> Option<i64> {
    let text = text.trim();
    let (negative, unsigned) = match text.as_bytes().first()? {
        b'-' => (true, &text[1..]),
        b'+' => (false, &text[1..]),
        _ => (false, text),
    };
    if unsigned.len() >= 16 && unsigned.bytes().all(|b| b.is_ascii_digit()) {
        return text.parse().ok();
    }
    let (mantissa, exponent) = match unsigned.split_once(['e', 'E']) {
        Some((mantissa, exponent)) => (mantissa, exponent.parse::<i32>().ok()?),
        None => (unsigned, 0),
    };
    let (whole, fraction) = mantissa.split_once('.').unwrap_or((mantissa, ""));
    if whole.is_empty() && fraction.is_empty() {
        return None;
    }
    // value = digits * 10^(exponent - fraction.len()) seconds
    let shift = exponent
        .checked_add(9)?
        .checked_sub(fraction.len() as i32)?;
    let nanos = scaled_digits(whole.bytes().chain(fraction.bytes()), shift)?;
    i64::try_from(if negative { -nanos } else { nanos }).ok()
}

/// The decimal digits times `10^shift`, rounded half up.
fn scaled_digits(digits: impl Iterator<Item = u8>, shift: i32) -> Option<i128> {
    let mut digits: Vec<u8> = digits.collect();
    if !digits.iter().all(u8::is_ascii_digit) || !(-400..=40).contains(&shift) {
        return None;
    }
    let mut round_up = false;
    for _ in shift..0 {
        round_up = digits.pop().unwrap_or(b'0') >= b'5';
    }
    digits.extend(std::iter::repeat_n(b'0', shift.max(0) as usize));
    let mut value = 0i128;
    for digit in digits {
        value = value * 10 + i128::from(digit - b'0');
        if value > i128::from(i64::MAX) + NANOS_PER_SECOND {
            return None;
        }
    }
    Some(value + i128::from(round_up))
}

/// Seconds with nine decimals; [`parse_seconds`] gives the same nanoseconds back.
#[must_use]
pub fn format_seconds(timestamp_ns: i64) -> String {
    let sign = if timestamp_ns < 0 { "-" } else { "" };
    let magnitude = i128::from(timestamp_ns).abs();
    let (whole, rest) = (magnitude / NANOS_PER_SECOND, magnitude % NANOS_PER_SECOND);
    format!("{sign}{whole}.{rest:09}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decimal_text_is_exact_to_the_nanosecond() {
        for (text, nanos) in [
            ("0", 0),
            ("0.000000", 0),
            ("0.033333", 33_333_000),
            (".5", 500_000_000),
            ("5.", 5_000_000_000),
            ("-0.25", -250_000_000),
            ("+1.5", 1_500_000_000),
            ("1403715273.262142976", 1_403_715_273_262_142_976),
            ("1403715273262142976", 1_403_715_273_262_142_976),
            ("1311868170.000100", 1_311_868_170_000_100_000),
            ("1.036224e-01", 103_622_400),
            ("0.000000e+00", 0),
            ("1.5E3", 1_500_000_000_000),
            ("0.0000000005", 1),
            ("0.00000000049", 0),
            ("1e-12", 0),
        ] {
            assert_eq!(parse_seconds(text), Some(nanos), "{text}");
        }
    }

    #[test]
    fn what_is_not_a_time_is_refused() {
        for text in [
            "",
            "-",
            ".",
            "nan",
            "inf",
            "1.2.3",
            "12a",
            "1e",
            "1e99",
            "--1",
            "٣",
            "1,5",
            "99999999999999999999",
            "10000000000.0e3",
        ] {
            assert_eq!(parse_seconds(text), None, "{text}");
        }
    }

    #[test]
    fn formatting_round_trips() {
        for nanos in [
            0,
            1,
            -1,
            999_999_999,
            -1_500_000_000,
            i64::MAX / 3,
            1_403_715_273_262_142_976,
        ] {
            assert_eq!(
                parse_seconds(&format_seconds(nanos)),
                Some(nanos),
                "{nanos}"
            );
        }
    }
}
