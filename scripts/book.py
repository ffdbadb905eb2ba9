#!/usr/bin/env python3
"""A preprocessor of mdbook: links of the book that are right between files and would not be on a site.

Those that lead out of docs/ go to the repository on the network, those to a README to the first page of its folder.
Called by mdbook (book.toml).
"""
import json
import posixpath
import re
import sys

REPOSITORY = "https://github.com/monogrid/monogrid/blob/main/"
LINK = re.compile(r"\]\((?!https?://|#|mailto:)([^)\s#]+)(#[^)\s]*)?\)")


def outside(content, path):
    """The text of a page, whose path is within docs/."""

    def replaced(found):
        target = posixpath.normpath(posixpath.join("docs", posixpath.dirname(path), found[1]))
        anchor = found[2] or ""
        if not target.startswith("docs/"):
            return f"]({REPOSITORY}{target}{anchor})"
        # a README is the first page of its folder there
        return f"]({re.sub(r'README.md$', 'index.md', found[1])}{anchor})"

    return LINK.sub(replaced, content)


def walk(items):
    for item in items:
        chapter = item.get("Chapter") if isinstance(item, dict) else None
        if chapter:
            if chapter.get("path"):
                chapter["content"] = outside(chapter["content"], chapter["path"])
            walk(chapter["sub_items"])


def main():
    if sys.argv[1:2] == ["supports"]:
        return
    _, book = json.load(sys.stdin)
    walk(book.get("items", book.get("sections", [])))
    json.dump(book, sys.stdout)


if __name__ == "__main__":
    main()
