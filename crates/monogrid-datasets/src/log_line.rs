//! What a program says, as other programs read it.

use crate::printable;
use serde::Serialize;
use std::time::Duration;

/// A line of JSON: the time in UTC, how bad it is, who says it, and what.
#[must_use]
pub fn log_line(since_1970: Duration, level: &str, name: &str, message: &str) -> String {
    #[derive(Serialize)]
    struct Line<'a> {
        time: String,
        level: &'a str,
        name: &'a str,
        message: &'a str,
    }
    let line = Line {
        time: utc(since_1970),
        level,
        name,
        message,
    };
    // a struct of texts always has a text
    let text = serde_json::to_string(&line).unwrap_or_default();
    printable(&text).into_owned()
}

/// A time as RFC 3339 has it, to the millisecond.
fn utc(since_1970: Duration) -> String {
    let (seconds, ms) = (since_1970.as_secs(), since_1970.subsec_millis());
    let (day, second) = (seconds / 86400, seconds % 86400);
    let (hour, minute, second) = (second / 3600, second / 60 % 60, second % 60);
    // years are of 365.2425 days: the one by that is off by one at most
    let is_leap =
        |year: u64| year.is_multiple_of(4) && !year.is_multiple_of(100) || year.is_multiple_of(400);
    let days_before = |year: u64| {
        let past = year - 1;
        365 * past + past / 4 - past / 100 + past / 400
    };
    let day = day + days_before(1970);
    let mut year = day * 400 / 146_097 + 1;
    if days_before(year) > day {
        year -= 1;
    } else if days_before(year + 1) <= day {
        year += 1;
    }
    let mut day = day - days_before(year);
    let lengths = [
        31,
        28 + u64::from(is_leap(year)),
        31,
        30,
        31,
        30,
        31,
        31,
        30,
        31,
        30,
        31,
    ];
    let mut month = 1;
    for length in lengths {
        if day < length {
            break;
        }
        (day, month) = (day - length, month + 1);
    }
    let day = day + 1;
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}.{ms:03}Z")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_those_of_the_calendar() {
        for (seconds, time) in [
            (0, "1970-01-01T00:00:00.000Z"),
            (951_782_400, "2000-02-29T00:00:00.000Z"),
            (951_868_800, "2000-03-01T00:00:00.000Z"),
            (1_735_689_599, "2024-12-31T23:59:59.000Z"),
            (1_735_689_600, "2025-01-01T00:00:00.000Z"),
            (4_107_542_399, "2100-02-28T23:59:59.000Z"),
            (4_107_542_400, "2100-03-01T00:00:00.000Z"),
        ] {
            assert_eq!(utc(Duration::from_secs(seconds)), time);
        }
        assert!(utc(Duration::from_millis(86_399_999)).ends_with("01T23:59:59.999Z"));
        // each day follows the one before, over the 400 years of the calendar
        let of = |day: u64| utc(Duration::from_secs(86400 * day));
        let days: Vec<String> = (0..146_098).map(of).collect();
        assert!(days.windows(2).all(|pair| pair[0] < pair[1]));
        assert_eq!(days[146_097], "2370-01-01T00:00:00.000Z");
        let firsts = days.iter().filter(|day| day[8..].starts_with("01T"));
        assert_eq!(firsts.count(), 4801);
    }

    #[test]
    fn whatever_is_said_is_one_line_of_json() {
        let said = "two\nlines, a \"name\" and \x1b[2J\u{202e}";
        let line = log_line(Duration::ZERO, "warn", "monogrid", said);
        assert!(
            !line.contains('\n') && !line.contains(crate::is_obeyed),
            "{line}"
        );
        let read: serde_json::Value = serde_json::from_str(&line).unwrap();
        assert_eq!(
            (&read["message"], &read["level"]),
            (&said.into(), &"warn".into())
        );
        assert!(line.starts_with("{\"time\":\"1970-01-01T"), "{line}");
    }
}
