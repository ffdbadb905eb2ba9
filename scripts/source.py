#!/usr/bin/env python3
"""Checks what rustfmt and clippy leave alone in Rust sources.

    scripts/source.py

No line is longer than 100 characters: rustfmt does not break comments, strings and the arguments of macros. A package
whose manifest says `doctest = false` has no code in its documentation, which would never be compiled. Needs Python
3.11 and nothing else.
"""
import re
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
COLUMNS = 100
# fences of documentation and what is in them; those in another language say which
FENCE = re.compile(r"^\s*//[/!] ?```(.*)$")
NO_CODE = {"text", "toml", "json", "sh", "csv", "python"}


def long_lines(lines):
    for number, line in enumerate(lines, 1):
        if len(line) > COLUMNS:
            yield number, f"{len(line)} characters, expected at most {COLUMNS}"


def documented_code(lines):
    """Lines at which code begins in documentation."""
    is_inside = False
    for number, line in enumerate(lines, 1):
        if found := FENCE.match(line):
            if not is_inside and found.group(1).strip() not in NO_CODE:
                yield number, "code in the documentation of a package that says `doctest = false`"
            is_inside = not is_inside


def main():
    listed = subprocess.run(
        ["git", "-C", ROOT, "ls-files", "*.rs", "**/Cargo.toml"], check=True, capture_output=True, text=True
    )
    paths = [Path(name) for name in listed.stdout.split() if (ROOT / name).is_file()]
    untested = {
        path.parent
        for path in paths
        if path.name == "Cargo.toml"
        and tomllib.loads((ROOT / path).read_text()).get("lib", {}).get("doctest") is False
    }
    count = 0
    for path in paths:
        if path.suffix != ".rs":
            continue
        lines = (ROOT / path).read_text().splitlines()
        faults = list(long_lines(lines))
        if untested.intersection(path.parents):
            faults += documented_code(lines)
        for number, fault in faults:
            print(f"{path}:{number}: {fault}", file=sys.stderr)
        count += len(faults)
    return 1 if count else 0


if __name__ == "__main__":
    sys.exit(main())
