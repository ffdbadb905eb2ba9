#!/usr/bin/env python3
"""Keeps words that only we would understand out of names and documents.

    scripts/words.py

The last table of docs/glossary.md has the words, what to say instead, and the packages that still have them. A word must
not be part of a name: of an identifier, a file or a folder. Those documents must not have it that say how things are;
those that say how they were (changelog, survey) may. A package that is listed and does not have its word
any more is named, so that the list gets shorter. Needs Python 3 and nothing else.
"""
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
GLOSSARY = "docs/glossary.md"
# how things were
HISTORY = {"CHANGELOG.md", "docs/survey.md", "docs/thesis-comparison.md"}
# comments, raw strings, strings, characters: what is no name; a quote that is left begins a lifetime
NO_NAME = re.compile(
    r"""//[^\n]*|/\*.*?\*/|\bb?r(#*)".*?"\1|b?"(?:\\.|[^"\\])*"|b?'(?:\\.[^']*|[^'\\\n])'""", re.DOTALL
)
IDENTIFIER = re.compile(r"[A-Za-z_]\w*")
# `SpaceIsSettled2`, `space_is_settled`, `SPACE`: their words
WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")


def forbidden(glossary):
    """The words of the last section, each with what to say instead and the packages that still have it."""
    rows = re.findall(r"^\| (\w+) \| ([^|]+) \|([^|]*)\|$", glossary.split("## Words that are not used")[1], re.MULTILINE)
    return {
        word: (instead.strip(), {name.strip() for name in still.split(",") if name.strip()})
        for word, instead, still in rows
        if word != "word"
    }


def words_of(name):
    return {word.lower() for word in WORD.findall(name)}


def package_of(path):
    parts = Path(path).parts
    return parts[1] if len(parts) > 2 and parts[0] in ("crates", "extra") else ""


def names_in(source):
    """Identifiers of a Rust file with their lines."""
    code = NO_NAME.sub(lambda found: "\n" * found.group().count("\n"), source)
    for number, line in enumerate(code.splitlines(), 1):
        for name in IDENTIFIER.findall(line):
            yield number, name


def findings(path, words):
    """Forbidden words of a file: place, and the word."""
    for part in Path(path).parts:
        for word in words_of(part) & words.keys():
            yield path, word
    content = (ROOT / path).read_text(errors="replace")
    if path.endswith(".rs"):
        for number, name in names_in(content):
            for word in words_of(name) & words.keys():
                yield f"{path}:{number}: {name}", word
    elif path.endswith(".md") and path not in HISTORY and path != GLOSSARY:
        for number, line in enumerate(content.splitlines(), 1):
            for word in words_of(line.replace("line of sight", "")) & words.keys():
                yield f"{path}:{number}", word


def main():
    listed = subprocess.run(
        ["git", "-C", ROOT, "ls-files", "*.rs", "*.md"], check=True, capture_output=True, text=True
    )
    words = forbidden((ROOT / GLOSSARY).read_text())
    if not words:
        print(f"{GLOSSARY} has no table of words that are not used", file=sys.stderr)
        return 1
    found, count = {word: set() for word in words}, 0
    for path in listed.stdout.split():
        if not (ROOT / path).is_file():
            continue
        package = package_of(path)
        for place, word in findings(path, words):
            instead, still = words[word]
            found[word].add(package)
            if package not in still:
                print(f"{place}: not {word!r}; {instead}", file=sys.stderr)
                count += 1
    for word, (_, still) in words.items():
        for package in sorted(still - found[word]):
            print(f"{GLOSSARY}: {word!r} is not in {package} any more: take {package} out of its row")
    return 1 if count else 0


if __name__ == "__main__":
    sys.exit(main())
