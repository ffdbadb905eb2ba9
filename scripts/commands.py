#!/usr/bin/env python3
"""Checks that what documents and scripts tell cargo to run exists.

    scripts/commands.py

Wherever a tracked file names a target (`--example NAME`, `--test NAME`, `--bin NAME`), a package of the workspace must
have that target; if the command names a package (`-p`), that one. A test that is named by its module (`--test suite
fused::`) must have a file of that name. Variables of a script, and names in capitals, which stand for others, are left
out. Needs cargo and Python 3, no network.
"""
import json
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
KINDS = ("*.md", "*.rs", "*.sh", "*.toml", "*.html", "Dockerfile", ".ci/run")
# how things were
HISTORY = {"CHANGELOG.md"}
# what lines begin with in code and in scripts, so that a command may go on in the next line
LINE_START = re.compile(r"\\?\n[ \t]*(?:(?://[!/]?|#)[ \t]*)?")
TARGET = re.compile(r"--(example|test|bin)[ =]([a-z0-9_-]+)\b(?:\s+([a-z0-9_]+)::)?")
PACKAGE = re.compile(r"(?:-p|--package)[ =]([A-Za-z0-9_-]+)")
# where a command may begin and end
BORDER = re.compile(r"[`|;&()]")


def targets():
    """Paths of the targets of the workspace by package, kind and name."""
    metadata = subprocess.run(
        ["cargo", "metadata", "--no-deps", "--offline", "--format-version", "1"],
        cwd=ROOT, check=True, capture_output=True, text=True,
    )
    return {
        (package["name"], kind, target["name"]): Path(target["src_path"])
        for package in json.loads(metadata.stdout)["packages"]
        for target in package["targets"]
        for kind in target["kind"]
    }


def faults(text, known):
    """What commands of a text name and `known` does not have: line, and what is missing."""
    # joined lines are as long as before, so that places stay
    joined = LINE_START.sub(lambda found: " " * len(found.group()), text)
    for found in TARGET.finditer(joined):
        kind, name, module = found.groups()
        line = text.count("\n", 0, found.start()) + 1
        command = BORDER.split(joined[: found.start()])[-1].rsplit("cargo ", 1)[-1]
        package = PACKAGE.findall(command)
        having = [path for (p, k, n), path in known.items() if (k, n) == (kind, name) and p in (package or [p])]
        if not having:
            yield line, f"no {kind} {name!r}" + (f" in {package[-1]}" if package else "")
        elif module and not any((path.parent / f"{module}.rs").exists() for path in having):
            yield line, f"no module {module!r} in {kind} {name!r}"


def main():
    known = targets()
    listed = subprocess.run(["git", "-C", ROOT, "ls-files", *KINDS], check=True, capture_output=True, text=True)
    count, failed = 0, False
    for path in listed.stdout.split():
        # a workspace of its own
        if path in HISTORY or path.startswith("fuzz/") or not (ROOT / path).is_file():
            continue
        text = (ROOT / path).read_text(errors="replace")
        count += len(TARGET.findall(text))
        for line, fault in faults(text, known):
            print(f"{path}:{line}: {fault}", file=sys.stderr)
            failed = True
    if count == 0:
        print("no command that names a target: is the pattern right?", file=sys.stderr)
        return 1
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
