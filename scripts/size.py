#!/usr/bin/env python3
"""How large the program is: crates of a release build, lines of Rust outside of tests, and lengths of functions.

    scripts/size.py [FOLDER]      a checkout; default: this one

Lines are all those of `crates/*/src` and `extra/*/src` but for modules of tests. A function goes from its signature to its closing
brace, as rustfmt sets them.
"""

import pathlib
import re
import subprocess
import sys

ROOT = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else pathlib.Path(__file__).parent.parent)
FUNCTION = re.compile(r"(\s*)(pub(\([^)]*\))? )?((const|async|unsafe) )*fn ")
TESTS = re.compile(r"(pub(\(crate\))? )?mod \w+ \{")


def sources():
    """Files that are no tests."""
    for part in ("crates", "extra"):
        for path in sorted(ROOT.glob(f"{part}/*/src/**/*.rs")):
            if path.name != "tests.rs" and not path.name.startswith("test_") and "tests" not in path.parts:
                yield path


def without_tests(lines):
    """The lines before a module of tests, which comes last."""
    for index, line in enumerate(lines[:-1]):
        if line.strip() == "#[cfg(test)]" and TESTS.match(lines[index + 1].strip()):
            return lines[:index]
    return lines


def function_lengths(lines):
    """Lines of each function that has a body."""
    for first, line in enumerate(lines):
        if match := FUNCTION.match(line):
            for last in range(first, len(lines)):
                text = lines[last].rstrip()
                if text == match[1] + "}" or (last == first and text.endswith("}")):
                    yield last - first + 1
                    break
                if text.endswith(";") and not any("{" in body for body in lines[first : last + 1]):
                    break


def num_crates():
    """Crates that a release build compiles on Linux, its own included."""
    command = ["cargo", "tree", "-p", "monogrid-cli", "-e", "normal,build", "--prefix", "none"]
    command += ["--target", "x86_64-unknown-linux-gnu"]
    lines = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout.splitlines()
    return len({tuple(line.split()[:2]) for line in lines if line})


texts = [without_tests(path.read_text().split("\n")) for path in sources()]
lengths = sorted(length for lines in texts for length in function_lengths(lines))
print("| crates (bar 130) | lines outside tests | functions | median (bar 9) | 90 % (bar 32) |")
print("|---|---|---|---|---|")
print(
    f"| {num_crates()} | {sum(map(len, texts)):,} | {len(lengths):,} "
    f"| {lengths[len(lengths) // 2]} | {lengths[len(lengths) * 9 // 10]} |"
)
