#!/usr/bin/env python3
"""Keeps the numbers of README.md and BENCHMARKS.md to those that a script has measured.

    scripts/results.py                           is every number of the two documents in benchmarks/results.json?
    scripts/results.py print                     writes the tables of the documents from benchmarks/results.json
    scripts/results.py collect FOLDER [PART...]  takes tables that scripts/benchmarks.sh left in FOLDER

`benchmarks/results.json` has a table for each part: the command that printed it, the data, the commit of the program,
the day, the machine, and the rows. A document shows a table between `<!-- results: NAME -->` and `<!-- end -->`.
Outside of them a number with a decimal point or a unit must be a number of one of the tables. Numbers in code are no
results. `collect` needs COMMIT, the commit of the program; MEASURED_ON says on what machine. Needs Python 3.
"""
import json
import os
import platform
import re
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "benchmarks/results.json"
DOCUMENTS = ("README.md", "BENCHMARKS.md")
BLOCK = re.compile(r"<!-- results: ([\w-]+)(, table only)? -->\n.*?<!-- end -->", re.DOTALL)
CODE = re.compile(r"```.*?```|^    [^\n]*$|`[^`\n]*`|\]\([^)]*\)|https?://\S+", re.DOTALL | re.MULTILINE)
VERSION = re.compile(r"\d+\.\d+\.\d+|\d+\.\d+ or newer|Apache-2\.0")
UNIT = r"(?:m|mm|cm|s|ms|min|minutes|seconds|%|MB|GB|kB|px|Hz|°|times|frames per second)"
NUMBER = re.compile(rf"(?<![\w.])\d[\d,]*\.\d+|(?<![\w.])\d[\d,]*(?=\s?{UNIT}(?![\w]))")
# sequences that a part reads, for those who want to repeat it
DATA = {
    "sequences": "the recordings that the table names",
    "readme": "the recordings that the table names",
    "demo": "none: the room is rendered",
    "first": "phone-desk",
    "odometry": "red-kitchen",
    "sessions": "red-kitchen",
    "size": "none",
}


def cells(line):
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


def tables_in(text):
    """Tables of a document: columns and rows."""
    lines = text.splitlines()
    for index, line in enumerate(lines[1:], 1):
        if re.fullmatch(r"\|(?:\s*:?-+:?\s*\|)+", line.strip()) and lines[index - 1].startswith("|"):
            rows = []
            for row in lines[index + 1 :]:
                if not row.startswith("|"):
                    break
                rows.append(cells(row))
            yield cells(lines[index - 1]), rows


def machine():
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return os.environ.get("MEASURED_ON") or f"{platform.machine()}, {cores} cores of a virtual machine, shared with other work"


def collect(folder, parts):
    commit = os.environ.get("COMMIT")
    if not commit:
        sys.exit("found no COMMIT, expected the commit of the program that was measured: COMMIT=... scripts/results.py")
    commit = subprocess.run(
        ["git", "-C", ROOT, "rev-parse", commit], check=True, capture_output=True, text=True
    ).stdout.strip()
    results = json.loads(RESULTS.read_text()) if RESULTS.exists() else {"tables": {}}
    found = {path.stem: path for path in sorted(Path(folder).glob("*.md"))}
    for part in parts or found:
        if part not in found:
            sys.exit(f"{folder} has no {part}.md: run scripts/benchmarks.sh full {part}")
        day = time.strftime("%Y-%m-%d", time.gmtime(found[part].stat().st_mtime))
        for number, (columns, rows) in enumerate(tables_in(found[part].read_text())):
            name = part if number == 0 else f"{part}-{number + 1}"
            results["tables"][name] = {
                "command": f"scripts/benchmarks.sh {part}",
                "data": DATA.get(part, "see the script"),
                "commit": commit,
                "day": day,
                "machine": machine(),
                "columns": columns,
                "rows": rows,
            }
    write(results)


def write(results):
    """One row in one line, so that changes can be read."""
    lines = ['{"tables": {']
    for name, table in sorted(results["tables"].items()):
        head = {key: value for key, value in table.items() if key != "rows"}
        lines.append(f"{json.dumps(name)}: {json.dumps(head, ensure_ascii=False)[:-1]}, \"rows\": [")
        lines.append(",\n".join("  " + json.dumps(row, ensure_ascii=False) for row in table["rows"]))
        lines.append("]},")
    lines[-1] = "]}"
    RESULTS.parent.mkdir(exist_ok=True)
    RESULTS.write_text("\n".join(lines) + "\n}}\n")


def shown(name, table_only, tables):
    table = tables.get(name)
    if table is None:
        sys.exit(f"benchmarks/results.json has no table {name!r}; known are: {', '.join(sorted(tables))}")
    lines = [f"<!-- results: {name}{table_only or ''} -->"]
    if not table_only:
        lines.append(f"`{table['command']}`; data: {table['data']}; commit {table['commit'][:8]}, {table['day']}.\n")
    lines.append("| " + " | ".join(table["columns"]) + " |")
    lines.append("|" + "---|" * len(table["columns"]))
    lines += ["| " + " | ".join(row) + " |" for row in table["rows"]]
    return "\n".join(lines + ["<!-- end -->"])


def printed(text, tables):
    """A document with its tables as they are in the results."""
    return BLOCK.sub(lambda found: shown(found[1], found[2], tables), text)


def unknown_numbers(text, known):
    """Numbers outside of printed tables that no table has, with their lines."""
    blank = lambda found: re.sub(r"[^\n]", " ", found.group())
    prose = VERSION.sub(blank, CODE.sub(blank, BLOCK.sub(blank, text)))
    for found in NUMBER.finditer(prose):
        if found.group().replace(",", "") not in known:
            yield prose.count("\n", 0, found.start()) + 1, found.group()


def main():
    arguments = sys.argv[1:]
    if arguments[:1] == ["collect"] and len(arguments) > 1:
        return collect(arguments[1], arguments[2:])
    if arguments not in ([], ["print"]):
        sys.exit(__doc__)
    tables = json.loads(RESULTS.read_text())["tables"]
    texts = [cell for table in tables.values() for row in [table["columns"], *table["rows"]] for cell in row]
    known = {number.replace(",", "") for text in texts for number in re.findall(r"\d[\d,]*(?:\.\d+)?", text)}
    count = 0
    for name in DOCUMENTS:
        path = ROOT / name
        text = path.read_text()
        wanted = printed(text, tables)
        if arguments:
            path.write_text(wanted)
        elif wanted != text:
            print(f"{name}: its tables are not those of benchmarks/results.json; run scripts/results.py print", file=sys.stderr)
            count += 1
        for line, number in unknown_numbers(wanted, known):
            print(f"{name}:{line}: {number} is no number of benchmarks/results.json", file=sys.stderr)
            count += 1
    return 1 if count else 0


if __name__ == "__main__":
    sys.exit(main())
