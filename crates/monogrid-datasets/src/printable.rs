//! Text from outside, as a terminal may have it.

use std::borrow::Cow;
use std::fmt::Write as _;

/// Text without what a terminal would obey: control characters but for line feed and tab, and
/// characters that turn the direction of writing, each as `\u` and four hexadecimal digits. JSON
/// stays the same JSON.
#[must_use]
pub fn printable(text: &str) -> Cow<'_, str> {
    if !text.contains(is_obeyed) {
        return Cow::Borrowed(text);
    }
    let mut safe = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        if is_obeyed(c) {
            // a string takes everything
            let _ = write!(safe, "\\u{:04x}", u32::from(c));
        } else {
            safe.push(c);
        }
    }
    Cow::Owned(safe)
}

/// Whether a terminal does something else with a character than showing it.
#[must_use]
pub fn is_obeyed(c: char) -> bool {
    let turns = matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}'
        | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    turns || c.is_control() && !matches!(c, '\n' | '\t')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_terminal_obeys_is_shown() {
        for (text, shown) in [
            ("\x1b[2Jname", "\\u001b[2Jname"),
            ("a\rb\x08\x7f\u{9b}31m", "a\\u000db\\u0008\\u007f\\u009b31m"),
            ("left\u{202e}thgir\u{2066}", "left\\u202ethgir\\u2066"),
            (
                "two\nlines\tand Küche 📷 日本\n",
                "two\nlines\tand Küche 📷 日本\n",
            ),
            ("\\u001b", "\\u001b"),
        ] {
            assert_eq!(printable(text), shown);
        }
        // those that turn the direction of writing or end a line, each with what lies around it
        for range in [
            0x61c..=0x61c,
            0x200e..=0x200f,
            0x2028..=0x202e,
            0x2066..=0x2069,
        ] {
            let around = [range.start() - 1, range.end() + 1];
            let is_obeyed = |c: u32| is_obeyed(char::from_u32(c).unwrap());
            assert!(range.clone().all(is_obeyed), "{range:x?}");
            assert!(!around.into_iter().any(is_obeyed), "{range:x?}");
        }
    }
}
