#!/usr/bin/env python3
"""Prints the arrows between modules of each crate that go in circles.

A module is a file of `src`; its tests are left out. It depends on the files that its `crate::`,
`super::` and `self::` paths name. Names that `mod.rs` or `lib.rs` hands on (`pub use`) stand for
the file that they come from. A circle is a strongly connected component; what lies in none has an
order from low to high, so an arrow from a low to a high module is always part of a circle.

Exit status 1: a crate has a circle of more than two files.
"""

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
MAX_FILES = 2

TOKEN = re.compile(
    r'//[^\n]*|/\*.*?\*/|r#*".*?"#*|"(?:\\.|[^"\\])*"|\'(?:\\.|[^\'\\])\'', re.S
)
USE = re.compile(r"\b(pub(?:\([^)]*\))?\s+)?use\s+([^;]+);")
INLINE = re.compile(r"\b(?:crate|super|self)(?:::\w+)+")
MOD = re.compile(r"(?:#\[path = \"([^\"]+)\"\]\s*)?\bmod\s+(\w+)\s*;")


def without_tests(text):
    """The source without comments, literals and what is compiled for tests alone."""
    text = TOKEN.sub(lambda m: '""' if m[0][0] in "\"r'" else "", text)
    while match := re.search(r"#\[cfg\((?:all\()?test\b[^\]]*\]", text):
        end, depth = match.end(), 0
        while end < len(text):
            char = text[end]
            depth += (char == "{") - (char == "}")
            end += 1
            if depth == 0 and char in ";}":
                break
        text = text[: match.start()] + text[end:]
    return text


def leaves(tree):
    """The paths of a `use` tree, each with the name that it gets: `a::{b, c as d}`."""
    tree = tree.strip()
    brace = tree.find("{")
    if brace < 0:
        path, _, name = tree.partition(" as ")
        parts = [part.strip() for part in path.split("::") if part.strip()]
        yield parts, (name.strip() or (parts[-1] if parts else ""))
        return
    prefix = [part.strip() for part in tree[:brace].split("::") if part.strip()]
    depth, start, inner = 0, 0, tree[brace + 1 : tree.rindex("}")]
    for at, char in enumerate(inner + ","):
        depth += (char == "{") - (char == "}")
        if char == "," and depth == 0:
            if inner[start:at].strip():
                for parts, name in leaves(inner[start:at]):
                    parts = prefix + parts
                    if parts[-1] == "self":
                        parts = parts[:-1]
                        name = parts[-1] if name == "self" and parts else name
                    yield parts, name
            start = at + 1


class Crate:
    """The modules of a crate: their files, and what each names."""

    def __init__(self, src):
        self.text, self.exports, self.globs = {}, {}, {}
        root = next((src / n for n in ("lib.rs", "main.rs") if (src / n).exists()), None)
        if root:
            self.read((), root, src)
        for module in self.text:
            self.exports[module], self.globs[module] = {}, []
            for match in USE.finditer(self.text[module]):
                for path, name in leaves(match[2]):
                    if path and path[-1] == "*":
                        if match[1]:
                            self.globs[module].append(path[:-1])
                    else:
                        self.exports[module][name] = path

    def read(self, module, file, folder):
        if not file.exists():
            return
        text = without_tests(file.read_text())
        self.text[module] = text
        # masking has removed literals, so paths are read from the source as it is
        source = file.read_text()
        paths = {m[2]: m[1] for m in MOD.finditer(source) if m[1]}
        for match in MOD.finditer(text):
            name = match[2]
            if name in paths:
                child = file.parent / paths[name]
            else:
                child = folder / f"{name}.rs"
                child = child if child.exists() else folder / name / "mod.rs"
            self.read(module + (name,), child, folder / name)

    def absolute(self, module, path):
        """A path as one from the crate's root; None for other crates."""
        at = None
        for index, part in enumerate(path):
            if part == "crate" and index == 0:
                at = ()
            elif part == "self" and index == 0:
                at = module
            elif part == "super":
                at = (module if at is None else at)[:-1]
            else:
                if at is None:
                    if index == 0 and module + (part,) in self.text:
                        at = module
                    else:
                        return None
                return at + tuple(path[index:])
        return at

    def defined_in(self, path, seen=frozenset()):
        """The module in which what a path names is written."""
        if path is None or path in seen:
            return None
        if path in self.text:
            return path
        for cut in range(len(path) - 1, -1, -1):
            module, rest = path[:cut], path[cut:]
            if module not in self.text:
                continue
            target = self.exports[module].get(rest[0])
            if target is not None:
                further = self.absolute(module, target)
                if further is not None and further + rest[1:] != path:
                    return self.defined_in(further + rest[1:], seen | {path})
            if not re.search(rf"\b(?:fn|struct|enum|trait|type|const|static|union|macro_rules!)\s+{rest[0]}\b", self.text[module]):
                for glob in self.globs[module]:
                    further = self.absolute(module, glob)
                    if further is not None:
                        found = self.defined_in(further + rest, seen | {path})
                        if found is not None and found != further:
                            return found
            return module
        return None

    def arrows(self):
        """Module by module, those that it depends on."""
        arrows = {}
        for module, text in self.text.items():
            paths = []
            for match in USE.finditer(text):
                # what is only handed on is no dependency
                if not match[1]:
                    paths += [path for path, _ in leaves(match[2])]
            rest = USE.sub("", text)
            paths += [m[0].split("::") for m in INLINE.finditer(rest)]
            targets = set()
            for path in paths:
                path = path[:-1] if path and path[-1] == "*" else path
                target = self.defined_in(self.absolute(module, path))
                if target is not None and target != module:
                    targets.add(target)
            arrows[module] = targets
        return arrows


def circles(arrows):
    """Strongly connected components of more than one module (Tarjan), the largest first."""
    index, low, stack, found = {}, {}, [], []

    def visit(module):
        index[module] = low[module] = len(index)
        stack.append(module)
        for target in sorted(arrows[module]):
            if target not in index:
                visit(target)
                low[module] = min(low[module], low[target])
            elif target in stack:
                low[module] = min(low[module], index[target])
        if low[module] == index[module]:
            at = stack.index(module)
            if len(stack) - at > 1:
                found.append(sorted(stack[at:]))
            del stack[at:]

    for module in sorted(arrows):
        if module not in index:
            visit(module)
    return sorted(found, key=lambda circle: (-len(circle), circle))


def main():
    sys.setrecursionlimit(10_000)
    failed = False
    for src in sorted(ROOT.glob("crates/*/src")) + sorted(ROOT.glob("extra/*/src")):
        crate = src.parent.name
        arrows = Crate(src).arrows()
        for circle in circles(arrows):
            if len(circle) <= MAX_FILES:
                continue
            failed = True
            print(f"{crate}: a circle of {len(circle)} files, expected at most {MAX_FILES}")
            for module in circle:
                inside = sorted(arrows[module] & set(circle))
                names = ", ".join("::".join(target) or "lib" for target in inside)
                print(f"  {'::'.join(module) or 'lib'} -> {names}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
