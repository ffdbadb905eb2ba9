#!/usr/bin/env python3
"""A preprocessor of mdbook: links of the book that lead out of docs/ go to the repository on the network.

As files the pages link the files beside them, which a site of its own does not have. Called by mdbook (book.toml).
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
        return found.group() if target.startswith("docs/") else f"]({REPOSITORY}{target}{found[2] or ''})"

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
