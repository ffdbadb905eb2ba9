"""Text from outside, as a terminal may have it."""

import unicodedata


def printable(text: str) -> str:
    """Text as a terminal may have it: names come from outside, and what it would obey is shown instead."""
    turns = "\u061c\u200e\u200f\u2028\u2029\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"
    is_obeyed = lambda c: c in turns or unicodedata.category(c) == "Cc" and c not in "\n\t"
    return "".join(f"\\u{ord(c):04x}" if is_obeyed(c) else c for c in text)
