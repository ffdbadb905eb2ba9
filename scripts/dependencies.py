#!/usr/bin/env python3
"""Checks docs/dependencies.md against the manifests.

    scripts/dependencies.py

Every direct dependency of every manifest must have one row there, and every row a dependency. A dependency must also be
used: its name must occur in a source file of its package. Needs Python 3.11 and nothing else.
"""
import re
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
DOCUMENT = ROOT / "docs" / "dependencies.md"
KINDS = ("dependencies", "dev-dependencies", "build-dependencies")
# packages whose library has another name
LIBRARIES = {"kamadak-exif": "exif"}


def manifests():
    listed = subprocess.run(
        ["git", "-C", ROOT, "ls-files", "Cargo.toml", "**/Cargo.toml"], check=True, capture_output=True, text=True
    )
    return [ROOT / name for name in listed.stdout.split()]


def dependencies(manifest):
    """Names of the direct dependencies of a manifest, on any platform; crates of this repository are left out."""
    content = tomllib.loads(manifest.read_text())
    tables = [content, *content.get("target", {}).values()]
    return {
        name
        for table in tables
        for kind in KINDS
        for name, value in table.get(kind, {}).items()
        if not name.startswith("monogrid") and not (isinstance(value, dict) and "path" in value)
    }


def is_used(folder, name):
    """Whether a source file of the package names the crate."""
    library = LIBRARIES.get(name, name).replace("-", "_")
    word = re.compile(rf"\b{re.escape(library)}\b")
    return any(word.search(file.read_text()) for file in folder.rglob("*.rs"))


def documented(text):
    """Crates with a row, in the order of the document."""
    return re.findall(r"^\| `([\w-]+)` \|", text, re.MULTILINE)


def complaints():
    rows = documented(DOCUMENT.read_text())
    used = {}
    for manifest in manifests():
        for name in dependencies(manifest):
            used.setdefault(name, []).append(manifest.parent)
            if not is_used(manifest.parent, name):
                yield f"{manifest.relative_to(ROOT)} asks for {name}, which no source file there uses: take it out"
    whole = tomllib.loads((ROOT / "Cargo.toml").read_text())["workspace"]["dependencies"]
    for name in whole:
        if not name.startswith("monogrid") and name not in used:
            yield f"Cargo.toml has {name} for the workspace, and no package asks for it: take it out"
    for name in sorted(set(used) - set(rows)):
        places = ", ".join(sorted(str(folder.relative_to(ROOT)) for folder in used[name]))
        yield f"docs/dependencies.md has no row for {name} (of {places}): say why it, who keeps it, what else there is"
    for name in sorted(set(rows) - set(used)):
        yield f"docs/dependencies.md has a row for {name}, which is no dependency: take it out"
    for name in sorted({name for name in rows if rows.count(name) > 1}):
        yield f"docs/dependencies.md has several rows for {name}: keep one"


def main():
    found = list(complaints())
    for complaint in found:
        print(complaint, file=sys.stderr)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
