//! Time stamps as integer nanoseconds, parsed exactly from their decimal text.

const NANOS_PER_SECOND: i128 = 1_000_000_000;

/// Nanoseconds of a decimal number of seconds (`12.5`, `-0.25`, `1.036224e-01`), exact to the
/// nanosecond and rounded half away from zero beyond; `None` when it is not a number or does not
/// fit.
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
    let (negative, unsigned) = signed(text)?;
    if unsigned.len() >= 16 && unsigned.bytes().all(|b| b.is_ascii_digit()) {
        return text.parse().ok();
    }
    decimal(unsigned, negative, TimeUnit::Seconds)
}

/// Whether a number is negative, and what follows its sign; `None` where there is nothing.
fn signed(text: &str) -> Option<(bool, &str)> {
    Some(match text.as_bytes().first()? {
        b'-' => (true, &text[1..]),
        b'+' => (false, &text[1..]),
        _ => (false, text),
    })
}

/// Nanoseconds of an unsigned decimal number in a unit.
fn decimal(unsigned: &str, negative: bool, unit: TimeUnit) -> Option<i64> {
    let (mantissa, exponent) = match unsigned.split_once(['e', 'E']) {
        Some((mantissa, exponent)) => (mantissa, exponent.parse::<i32>().ok()?),
        None => (unsigned, 0),
    };
    let (whole, fraction) = mantissa.split_once('.').unwrap_or((mantissa, ""));
    if whole.is_empty() && fraction.is_empty() {
        return None;
    }
    // value = digits * 10^(exponent - fraction.len()) units
    let shift = exponent
        .checked_add(unit.decimals())?
        .checked_sub(fraction.len() as i32)?;
    let nanos = scaled_digits(whole.bytes().chain(fraction.bytes()), shift)?;
    i64::try_from(if negative { -nanos } else { nanos }).ok()
}

/// What times are counted in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum TimeUnit {
    Seconds,
    Milliseconds,
    Microseconds,
    Nanoseconds,
}

impl TimeUnit {
    const ALL: [Self; 4] = [
        Self::Seconds,
        Self::Milliseconds,
        Self::Microseconds,
        Self::Nanoseconds,
    ];

    /// Decimals with which it is counted in nanoseconds.
    fn decimals(self) -> i32 {
        match self {
            Self::Seconds => 9,
            Self::Milliseconds => 6,
            Self::Microseconds => 3,
            Self::Nanoseconds => 0,
        }
    }

    /// For people.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Seconds => "seconds",
            Self::Milliseconds => "milliseconds",
            Self::Microseconds => "microseconds",
            Self::Nanoseconds => "nanoseconds",
        }
    }

    fn seconds(self) -> f64 {
        10.0_f64.powi(self.decimals() - 9)
    }

    /// The time that a text says in this unit, ns.
    pub(crate) fn parse(self, text: &str) -> Option<i64> {
        let (negative, unsigned) = signed(text.trim())?;
        decimal(unsigned, negative, self)
    }

    /// The unit of a list of times, in any order: that in which they are dates of our time, else
    /// that in which the steps between them are those of a camera or of poses.
    ///
    /// Steps of 5 s or less are believed to be seconds, and any with nine decimals, as we write
    /// them; a time alone is one of our time, or seconds.
    pub(crate) fn of<'a>(texts: impl Iterator<Item = &'a str>) -> Self {
        let times = Steps::of(texts);
        let of_step = || {
            if times.have_our_decimals {
                return Self::Seconds;
            }
            let is_step = |unit: &&Self| times.step.unwrap_or(0.0) * unit.seconds() <= MAX_STEP;
            let unit = Self::ALL.iter().find(is_step).copied();
            unit.unwrap_or(Self::Nanoseconds)
        };
        times.unit_of_dates().unwrap_or_else(of_step)
    }

    /// The unit in which times are dates of our time; `None` where one of them is no time, or they
    /// are dates in none.
    pub(crate) fn of_dates<'a>(texts: impl Iterator<Item = &'a str>) -> Option<Self> {
        let times = Steps::of(texts);
        let unit = times.unit_of_dates();
        unit.filter(|_| times.are_all_numbers)
    }
}

/// Roughly, a list of times.
struct Steps {
    are_all_numbers: bool,
    have_our_decimals: bool,
    middle: f64,
    /// Median of the steps in the order of time.
    step: Option<f64>,
}

impl Steps {
    fn of<'a>(texts: impl Iterator<Item = &'a str>) -> Self {
        let (mut are_all_numbers, mut have_our_decimals) = (true, false);
        let mut values = Vec::new();
        for text in texts {
            let decimals = text
                .rsplit_once('.')
                .map_or(0, |(_, decimals)| decimals.len());
            have_our_decimals |= decimals == OWN_DECIMALS;
            let value = text.trim().parse().ok();
            match value.filter(|value: &f64| value.is_finite()) {
                Some(value) => values.push(value),
                None => are_all_numbers = false,
            }
        }
        values.sort_unstable_by(f64::total_cmp);
        let mut steps: Vec<f64> = values.windows(2).map(|pair| pair[1] - pair[0]).collect();
        steps.retain(|step| *step > 0.0);
        steps.sort_unstable_by(f64::total_cmp);
        Self {
            are_all_numbers,
            have_our_decimals,
            middle: values.get(values.len() / 2).copied().unwrap_or(0.0),
            step: steps.get(steps.len() / 2).copied(),
        }
    }

    fn unit_of_dates(&self) -> Option<TimeUnit> {
        let is_date = |unit: &TimeUnit| {
            let is_step = |step| step * unit.seconds() <= MAX_STEP_OF_DATES;
            DATES.contains(&(self.middle * unit.seconds())) && self.step.is_none_or(is_step)
        };
        TimeUnit::ALL.into_iter().find(is_date)
    }
}

/// Decimals of the seconds in our own files.
const OWN_DECIMALS: usize = 9;
/// Dates of recordings, seconds since 1970: 1998 to 2128.
const DATES: std::ops::Range<f64> = 9e8..5e9;
/// Longest usual step between dates, seconds.
const MAX_STEP_OF_DATES: f64 = 3600.0;
/// Longest usual step between times that are no dates, seconds.
const MAX_STEP: f64 = 5.0;

/// Nanoseconds since 1970 of a date such as `2011-09-26 13:02:25.964389445`, on any clock that
/// counts days of 24 hours.
pub(crate) fn parse_date(text: &str) -> Option<i64> {
    let (date, time) = text.trim().split_once([' ', 'T'])?;
    let mut parts = date.split('-').map(|part| part.parse::<i64>().ok());
    let (year, month, day) = (parts.next()??, parts.next()??, parts.next()??);
    let mut clock = time.trim().split(':');
    let mut whole = || clock.next()?.parse::<i64>().ok();
    let (hour, minute) = (whole()?, whole()?);
    let second_ns = TimeUnit::Seconds.parse(clock.next()?)?;
    let is_date = (1..=12).contains(&month) && (1..=31).contains(&day) && parts.next().is_none();
    let is_time = (0..24).contains(&hour) && (0..60).contains(&minute) && clock.next().is_none();
    if !(is_date && is_time && (1900..=2200).contains(&year)) {
        return None;
    }
    // days of the Gregorian calendar, years beginning with March (Hinnant)
    let year = if month <= 2 { year - 1 } else { year };
    let (era, year_of_era) = (year.div_euclid(400), year.rem_euclid(400));
    let day_of_year = (153 * ((month + 9) % 12) + 2) / 5 + day - 1;
    let day_of_era = year_of_era * 365 + year_of_era / 4 - year_of_era / 100 + day_of_year;
    let days = era * 146_097 + day_of_era - 719_468;
    let seconds = (days * 24 + hour) * 3600 + minute * 60;
    seconds.checked_mul(1_000_000_000)?.checked_add(second_ns)
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
    fn the_unit_of_times_follows_from_their_dates_and_steps() {
        use TimeUnit::{Microseconds, Milliseconds, Nanoseconds, Seconds};
        for (texts, unit) in [
            (["1305031452.79", "1305031452.82", "1305031452.85"], Seconds),
            (
                ["1305031452790", "1305031452823", "1305031452856"],
                Milliseconds,
            ),
            (
                ["1305031452790000", "1305031452823333", "1305031452856666"],
                Microseconds,
            ),
            (
                [
                    "1305031452790000000",
                    "1305031452823333333",
                    "1305031452856666666",
                ],
                Nanoseconds,
            ),
            (
                [
                    "1305031452299500032.000000",
                    "1305031452339500032.000000",
                    "x",
                ],
                Nanoseconds,
            ),
            (
                ["1.305031452299500032e+18", "1.305031452339500032e+18", "x"],
                Nanoseconds,
            ),
            (["0", "0.033", "0.066"], Seconds),
            (["0", "33", "66"], Milliseconds),
            (["66.6", "0", "33.3"], Milliseconds),
            (["0", "33333", "66666"], Microseconds),
            (["0", "33333333", "66666666"], Nanoseconds),
            // a picture in two seconds, and one in a minute with dates
            (["0", "2", "4"], Seconds),
            (["1305031400", "1305031460", "1305031520"], Seconds),
            // as long since a start as dates since 1970, in another unit
            (["1305031452", "1338364785", "1371698118"], Nanoseconds),
            (["1305031452790000", "x", "x"], Microseconds),
            (["7", "x", "x"], Seconds),
            (["0.000000000", "30.000000000", "60.000000000"], Seconds),
        ] {
            assert_eq!(TimeUnit::of(texts.into_iter()), unit, "{texts:?}");
        }
        assert_eq!(
            Nanoseconds.parse("1.305031452299500032e+18"),
            Some(1_305_031_452_299_500_032)
        );
        assert_eq!(
            Microseconds.parse("-1305031452790000.5"),
            Some(-1_305_031_452_790_000_500)
        );
    }

    #[test]
    fn dates_are_nanoseconds_since_1970() {
        for (text, ns) in [
            ("1970-01-01 00:00:00", 0),
            ("2011-09-26 13:02:25.964389445", 1_317_042_145_964_389_445),
            ("2000-02-29T23:59:59.5", 951_868_799_500_000_000),
            ("2024-12-31 00:00:01", 1_735_603_201_000_000_000),
        ] {
            assert_eq!(parse_date(text), Some(ns), "{text}");
        }
        for text in [
            "2011-13-26 13:02:25",
            "2011-09-26",
            "2011-09-26 25:00:00",
            "x-y-z a:b:c",
            "",
        ] {
            assert_eq!(parse_date(text), None, "{text}");
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
