#!/usr/bin/env python3
"""Checks documents: links and paths that exist, commands that exist, and sizes.

    scripts/links.py

In every tracked Markdown file

* a relative link leads to a file, and its `#anchor` to a heading of that file,
* a path in code that begins with a folder of this repository exists,
* `monogrid COMMAND` in code is a command of the program,
* nothing stands about folders outside of the repository (`../shared`, `/tmp`).

REFERENCES.md has an entry for every key, such as `[SDVO13]`, in comments of the code, and no other.

README.md has at most 110 lines, BENCHMARKS.md 300, and no document more than 25 kB but tables to look things up.
The contents of the book (docs/SUMMARY.md) list every page of docs/. Needs Python 3 and git.
"""
import posixpath
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
MAX_LINES = {"README.md": 110, "BENCHMARKS.md": 300}
MAX_BYTES = 25_000
REFERENCE = {"docs/formats.md", "docs/configuration.md"}
# how things were
HISTORY = {"CHANGELOG.md"}
FENCE = re.compile(r"^```.*?^```", re.DOTALL | re.MULTILINE)
BLOCK = re.compile(r"^ {4}\S[^\n]*$", re.MULTILINE)
CODE = re.compile(r"`([^`\n]+)`")
LINK = re.compile(r"\]\(([^)\s]+)\)|<img src=\"([^\"]+)\"")
HEADING = re.compile(r"^#{1,6} +(.+?) *$", re.MULTILINE)
FOLDERS = r"(?:\.ci|\.github|benchmarks|crates|docs|extra|fuzz|scripts)"
# names with braces or stars are patterns; in `slam::x` x stands for others
PATH = re.compile(rf"(?<![\w/.-])({FOLDERS}/[\w./-]+\w/?)(?![\w{{*<$])")
COMMAND = re.compile(r"(?<![\w/.-])monogrid ([a-z][a-z-]+)(?= |$|`)", re.MULTILINE)
OUTSIDE = re.compile(r"\.\./shared|(?<![\w.])/tmp/")

# a work that comments of the code cite, and its entry
CITED = re.compile(r"\[([A-Z][A-Z0-9]+[0-9]{2}|EVO)\]")
ENTRY = re.compile(r"^\| ([A-Z0-9]+) \|", re.MULTILINE)


def anchors(text):
    """Anchors of headings as GitHub makes them."""
    seen = {}
    for heading in HEADING.findall(FENCE.sub("", text)):
        plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).replace("`", "").replace("*", "").lower()
        name = re.sub(r"[^\w\- ]", "", plain).replace(" ", "-")
        count = seen[name] = seen.get(name, -1) + 1
        yield name if count == 0 else f"{name}-{count}"


def commands():
    """Commands of the program, as its enumeration has them."""
    source = (ROOT / "crates/monogrid-cli/src/cli.rs").read_text()
    body = source.split("enum Command", 1)[1].split("\n}", 1)[0]
    names = re.findall(r"^    ([A-Z]\w*)[,({ ]", body, re.MULTILINE)
    names += re.findall(r'alias(?:es)? = "([^"]+)"', body)
    return {re.sub(r"(?<!^)([A-Z])", r"-\1", name).lower() for name in names} | {"help"}


def faults(path, text, known):
    line_of = lambda place: text.count("\n", 0, place) + 1
    prose = FENCE.sub(lambda found: re.sub(r"[^\n]", " ", found.group()), text)
    for found in LINK.finditer(prose):
        target = found[1] or found[2]
        if re.match(r"[a-z]+:", target):
            continue
        name, _, anchor = target.partition("#")
        file = posixpath.normpath(posixpath.join(posixpath.dirname(path), name)) if name else path
        if not (ROOT / file).exists():
            yield line_of(found.start()), f"{target} leads to {file}, which is not there"
        elif anchor and file.endswith(".md") and anchor not in set(anchors((ROOT / file).read_text())):
            yield line_of(found.start()), f"{file} has no heading #{anchor}"
    for found in OUTSIDE.finditer(text):
        yield line_of(found.start()), f"{found.group()} is outside of the repository"
    codes = [(found.start(1), found[1]) for found in CODE.finditer(prose)]
    codes += [(found.start(), found.group()) for found in [*FENCE.finditer(text), *BLOCK.finditer(prose)]]
    for start, code in codes:
        for found in PATH.finditer(code):
            name = found[1].rstrip("/")
            stands_for_others = name.endswith("/x") or code.startswith("git show ")
            if not stands_for_others and not (ROOT / name).exists() and not (ROOT / f"{name}.rs").exists():
                yield line_of(start + found.start()), f"{name} is not there"
        for found in COMMAND.finditer(code):
            if found[1] not in known and not code.lstrip().startswith(("git ", "docker ")):
                yield line_of(start + found.start()), f"monogrid has no command {found[1]!r}"


def unknown_works():
    """Keys without an entry in REFERENCES.md, with where they are cited, and entries that nothing cites."""
    entries = set(ENTRY.findall((ROOT / "REFERENCES.md").read_text()))
    listed = subprocess.run(["git", "-C", ROOT, "ls-files", "*.rs"], check=True, capture_output=True, text=True)
    cited = set()
    for path in listed.stdout.split():
        comments = re.findall(r"//.*", (ROOT / path).read_text())
        keys = set(CITED.findall("\n".join(comments)))
        cited |= keys
        yield from (f"{path}: {key} is not in REFERENCES.md" for key in sorted(keys - entries))
    yield from (f"REFERENCES.md: nothing cites {key}" for key in sorted(entries - cited))


def main():
    listed = subprocess.run(["git", "-C", ROOT, "ls-files", "*.md"], check=True, capture_output=True, text=True)
    known = commands()
    contents = (ROOT / "docs/SUMMARY.md").read_text()
    count = 0

    def say(message):
        nonlocal count
        count += 1
        print(message, file=sys.stderr)

    for fault in unknown_works():
        say(fault)
    if len(known) < 10:
        say(f"found the commands {sorted(known)}, expected more: is the pattern right?")
    for path in listed.stdout.split():
        file = ROOT / path
        if path in HISTORY or not file.is_file():
            continue
        text = file.read_text()
        for line, fault in faults(path, text, known):
            say(f"{path}:{line}: {fault}")
        lines = text.count("\n")
        if lines > MAX_LINES.get(path, lines):
            say(f"{path}: {lines} lines, expected at most {MAX_LINES[path]}")
        size = len(text.encode())
        if size > MAX_BYTES and path not in REFERENCE:
            say(f"{path}: {size} bytes, expected at most {MAX_BYTES}")
        if path.startswith("docs/") and path != "docs/SUMMARY.md" and f"]({path[5:]})" not in contents:
            say(f"docs/SUMMARY.md does not list {path}")
    return 1 if count else 0


if __name__ == "__main__":
    sys.exit(main())
