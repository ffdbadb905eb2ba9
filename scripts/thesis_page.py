#!/usr/bin/env python3
"""Prints the numbers of docs/thesis-comparison.md and docs/thesis/tables.md from one measurement.

    scripts/thesis_page.py                  is every number of the pages that of docs/thesis/results.json?
    scripts/thesis_page.py print            writes tables and the sentences with numbers
    scripts/thesis_page.py collect FOLDER   takes what scripts/thesis-comparison.sh left in FOLDER, and prints

A page shows what is printed between `<!-- thesis: NAME -->` and `<!-- end -->`: tables, and sentences that say what the
tables say. Outside of them a number with a decimal point or a unit must stand in one of the tables. Numbers of the
thesis are those of extra/monogrid-thesis/src/sweep/thesis.rs. `collect` needs COMMIT, the commit of the program;
MEASURED_ON says on what machine. Needs Python 3.
"""

import csv
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import textwrap
import time
from pathlib import Path
from statistics import mean

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "docs/thesis-comparison.md", ROOT / "docs/thesis/tables.md"]
RESULTS = ROOT / "docs/thesis/results.json"
OF_THESIS = ROOT / "extra/monogrid-thesis/src/sweep/thesis.rs"
BLOCK = re.compile(r"<!-- thesis: ([\w-]+) -->\n.*?<!-- end -->", re.DOTALL)
CODE = re.compile(r"```.*?```|^    [^\n]*$|`[^`\n]*`|\]\([^)]*\)|<img[^>]*>", re.DOTALL | re.MULTILINE)
# sections, figures and tables of the thesis
NAMES = re.compile(r"(?:Tables?|Figures?|sections?|chapters?|equations?|Eqs?\.)\s[\d.,\s]*(?:(?:and|to)\s[\d.]+)?")
NUMBER = re.compile(r"(?<![\w.])\d[\d,]*\.\d+|(?<![\w.])\d[\d,]*(?=\s?(?:m|mm|s|%|MB|GB|times)(?!\w))")
SIZES = [0.008, 0.016, 0.032, 0.064, 0.128]
FAMILIES = {"thrun": ("Thrun", "L", "AUC_THRUN"), "andert": ("Andert", "k", "AUC_ANDERT")}
KEPT = ["recording", "model", "parameter", "resolution", "points", "extent_x", "extent_y", "extent_z", "auc_26_known"]
KEPT += ["auc_observed", "auc_known", "mcc_observed", "precision_observed", "recall_observed"]
KEPT += ["coverage_free_in_view", "coverage_occupied_in_view", "occupied_ratio"]
SCORES = {"auc_26_known": "AUC of known cells", "auc_observed": "AUC of observed cells", "mcc_observed": "MCC"}
# beginnings of the names of figures, and what they are
FIGURES = {
    "figure-6.8-distribution": "Distribution of probabilities, mean of all maps (Figure 6.8)",
    "figure-6.13-roc-thrun": "ROC curves of known cells, Thrun (Figure 6.13)",
    "figure-6.14-roc-andert": "The same, Andert (Figure 6.14)",
    "figure-6.16-roc-equal-area": "Two values of L with nearly the same area (Figure 6.16)",
    "figure-6.17-roc-best": "The best of each model (Figure 6.17)",
    "figure-memory-growth": "Memory while the map grows; dashed: maximum likelihood (6.1.3)",
}


def mm(edge):
    return f"{1000 * edge:g} mm"


def listed(words):
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def between(values, form="{:.3f}"):
    low, high = form.format(min(values)), form.format(max(values))
    return low if low == high else f"{low} to {high}"


def thesis_areas(name):
    """Rows of a table of the thesis: values of L or k; columns: 8 to 128 mm."""
    text = OF_THESIS.read_text()
    table = re.search(rf"const {name}: \[\[f64; 5\]; 10\] = \[(.*?)\n\];", text, re.DOTALL).group(1)
    return [[float(cell) for cell in row.split(",")] for row in re.findall(r"\[([^\]]+)\]", table)]


def table(columns, rows):
    lines = ["| " + " | ".join(row) + " |" for row in [columns, *rows]]
    return "\n".join([lines[0], "|---" * len(columns) + "|", *lines[1:]])


class Office:
    """The maps of all starts of the thesis' experiment."""

    def __init__(self, results):
        self.results = results
        self.maps = results["office"]["maps"]
        self.starts = sorted({row["recording"] for row in self.maps})
        self.sizes = sorted({row["resolution"] for row in self.maps})

    def values(self, model, parameter, size, score):
        """Of each start; none where a map was beyond the memory limit."""
        rows = [r for r in self.maps if (r["model"], r["parameter"], r["resolution"]) == (model, parameter, size)]
        return [r[score] for r in rows if r[score] is not None]

    def mean(self, model, parameter, size, score):
        values = self.values(model, parameter, size, score)
        return mean(values) if len(values) == len(self.starts) else None

    def cell(self, model, parameter, size, score):
        values = self.values(model, parameter, size, score)
        if len(values) < len(self.starts):
            return "x"
        return f"{mean(values):.3f} ± {(max(values) - min(values)) / 2:.3f}"

    def parameters(self, model):
        return sorted({r["parameter"] for r in self.maps if r["model"] == model})

    def best(self, model, size, score="auc_26_known"):
        """The value with the largest mean, and that mean."""
        known = [(self.mean(model, p, size, score), p) for p in self.parameters(model)]
        value, parameter = max((v, p) for v, p in known if v is not None)
        return parameter, value


def areas(office, model, score):
    name, symbol, constant = FAMILIES[model]
    of_thesis = thesis_areas(constant)
    has_thesis = score == "auc_26_known"
    columns = [f"{symbol}, m"]
    for size in office.sizes:
        columns += [mm(size), "thesis"] if has_thesis else [mm(size)]
    rows = []
    for index, parameter in enumerate(office.parameters(model)):
        row = [f"{parameter:g}"]
        for size in office.sizes:
            cell = office.cell(model, parameter, size, score)
            row.append(f"**{cell}**" if office.best(model, size, score)[0] == parameter else cell)
            row += [f"{of_thesis[index][SIZES.index(size)]:.2f}"] if has_thesis else []
        rows.append(row)
    for other, label in (("ideal", "ideal"), ("automatic", "ours")):
        row = [label]
        for size in office.sizes:
            row += [office.cell(other, None, size, score)] + ([""] if has_thesis else [])
        rows.append(row)
    return table(columns, rows)


def best(office):
    columns = ["cells", "model", "AUC known", "AUC observed", "MCC", "precision", "recall", "free covered"]
    columns += ["occupied covered", "thickness"]
    rows = []
    for size in office.sizes:
        chosen = [(model, office.best(model, size)[0]) for model in FAMILIES]
        for model, parameter in [*chosen, ("ideal", None), ("automatic", None)]:
            label = {"ideal": "ideal", "automatic": "ours"}.get(model) or f"{FAMILIES[model][0]}, {FAMILIES[model][1]} = {parameter:g}"
            row = [mm(size), label]
            for score in ["auc_26_known", "auc_observed", "mcc_observed", "precision_observed", "recall_observed"]:
                row.append(f"{office.mean(model, parameter, size, score):.3f}")
            for score in ["coverage_free_in_view", "coverage_occupied_in_view"]:
                row.append(f"{100 * office.mean(model, parameter, size, score):.0f} %")
            row.append(f"{office.mean(model, parameter, size, 'occupied_ratio'):.1f}")
            rows.append(row)
    return table(columns, rows)


def points(lines):
    """A list, in lines of at most 100 characters."""
    return "\n".join(textwrap.fill(line, 100, subsequent_indent="  ", break_on_hyphens=False) for line in lines)


def said_of_areas(office):
    sizes = office.sizes
    thrun = {size: office.best("thrun", size) for size in sizes}
    andert = {size: office.best("andert", size) for size in sizes}
    ours = {size: office.mean("automatic", None, size, "auc_26_known") for size in sizes}
    ahead = [size for size in sizes if thrun[size][1] > andert[size][1]]
    behind = [size for size in sizes if size not in ahead]
    tables = [thesis_areas(FAMILIES[model][2]) for model in FAMILIES]
    columns = [[max(row[SIZES.index(size)] for row in rows) for size in sizes] for rows in tables]
    lines = []
    if ahead:
        by = [thrun[size][1] - andert[size][1] for size in ahead]
        lines.append(f"* **Thrun's best area is ahead of Andert's** with cells of {listed([mm(s) for s in ahead])}, by {between(by)}.")
    if behind:
        by = [andert[size][1] - thrun[size][1] for size in behind]
        lines.append(f"* **Andert's best area is ahead of Thrun's** with cells of {listed([mm(s) for s in behind])}, by {between(by)}.")
    pairs = [f"{a:.2f} and {b:.2f} ({mm(size)})" for a, b, size in zip(*columns, sizes)]
    lines.append(f"* The thesis has {listed(pairs)}, Thrun's first.")
    values = [f"{thrun[size][0]:g} m ({mm(size)})" for size in sizes]
    lines.append(f"* Thrun's best L is {listed(values)}; the thesis' is 0.4 to 0.5 m.")
    above = [size for size in sizes if ours[size] > max(thrun[size][1], andert[size][1])]
    by = [ours[size] - max(thrun[size][1], andert[size][1]) for size in sizes]
    if len(above) == len(sizes):
        lines.append(f"* **Our default settings are ahead of both** at every size, by {between(by)}, on the same depth of the same keyframes.")
    else:
        lines.append(f"* Our default settings are ahead of both at {len(above)} of {len(sizes)} sizes; ours less the larger of theirs is {between(by)}.")
    spread = [(max(v) - min(v)) / 2 for v in (office.values(m, p, s, "auc_26_known") for m in FAMILIES for p in office.parameters(m) for s in sizes) if v]
    lines.append(f"* A start changes an area by up to {max(spread):.3f}: differences below that say nothing.")
    return points(lines)


def said_of_best(office):
    def of(model, score, size):
        parameter = None if model == "automatic" else office.best(model, size)[0]
        return office.mean(model, parameter, size, score)

    def range_of(models, score, form="{:.3f}", factor=1):
        return between([factor * of(model, score, size) for model in models for size in office.sizes], form)

    fixed = list(FAMILIES)
    return points(
        [
            f"* **Coverage**: {range_of(fixed, 'coverage_occupied_in_view', '{:.0f}', 100)} % of the occupied cells"
            f" that a keyframe looks at are observed, ours {range_of(['automatic'], 'coverage_occupied_in_view', '{:.0f}', 100)} %."
            " What is not observed counts as 0.5.",
            f"* **Of what is observed**, the best fixed values have an MCC of {range_of(fixed, 'mcc_observed')}, ours"
            f" {range_of(['automatic'], 'mcc_observed')}; they show {range_of(fixed, 'occupied_ratio', '{:.1f}')} occupied cells for each"
            f" true one, ours {range_of(['automatic'], 'occupied_ratio', '{:.1f}')}.",
        ]
    )


def recordings(office):
    rows = []
    for start in office.results["office"]["starts"]:
        rows.append([start["name"], str(start["keyframes"]), f"{start['points'] / 1e6:.2f} million", f"{start['ate']:.3f} m", f"{start['scale_drift']:.2f}"])
    rows.append(["thesis", "45", "3.44 million", "not said", "not said"])
    return table(["start", "keyframes", "points", "path error", "scale drift"], rows)


def far(office):
    rows = [[row["cut"], " x ".join(f"{v:.1f}" for v in row["extent"]), f"{row['bytes'] / 1e6:.3g} MB"] for row in office.results["far"]]
    return table(["what is mapped", "extent, m", "file .ot"], rows)


def said_of_far(office):
    whole, *cuts = office.results["far"]
    lines = []
    for cut in cuts:
        lines.append(f"* {cut['cut']}: the file is {whole['bytes'] / cut['bytes']:.1f} times smaller.")
    return points(lines)


def sweep_table(name):
    def printed(office):
        found = office.results["tables"].get(name)
        return table(found["columns"], found["rows"]) if found else "Not measured in this run of the script."

    return printed


def panels(beginning):
    """Pictures of a figure, by the size of their cells."""
    found = RESULTS.parent.glob(f"{beginning}-*.svg")
    return sorted((p.name for p in found), key=lambda name: (int("0" + "".join(re.findall(r"-(\d+)mm", name))), name))


def figures(_):
    parts = []
    for beginning, title in FIGURES.items():
        names = panels(beginning)
        pictures = [f'<img src="thesis/{name}" width="{min(32, 96 // len(names))}%">' for name in names]
        parts += [f"{title}:", "\n".join(pictures)] if pictures else []
    return "\n\n".join(parts)


def measured(office):
    results = office.results
    sizes = listed([mm(size) for size in office.sizes])
    text = f"Measured with commit {results['commit'][:12]} on {results['day']}, cells of {sizes} ({results['machine']})."
    return textwrap.fill(text, 100, break_on_hyphens=False)


BLOCKS = {
    "measured": measured,
    "figures": figures,
    "recordings": recordings,
    "areas-thrun": lambda office: areas(office, "thrun", "auc_26_known"),
    "areas-andert": lambda office: areas(office, "andert", "auc_26_known"),
    "said-of-areas": said_of_areas,
    "best": best,
    "said-of-best": said_of_best,
    "far": far,
    "said-of-far": said_of_far,
    "memory": sweep_table("memory"),
    "time": sweep_table("speed"),
    "machine-memory": sweep_table("machine-memory"),
    "machine-time": sweep_table("machine-speed"),
    **{f"observed-{model}": (lambda m: lambda office: areas(office, m, "auc_observed"))(model) for model in FAMILIES},
    **{f"mcc-{model}": (lambda m: lambda office: areas(office, m, "mcc_observed"))(model) for model in FAMILIES},
}


def printed(text, office):
    return BLOCK.sub(lambda found: f"<!-- thesis: {found[1]} -->\n{BLOCKS[found[1]](office)}\n<!-- end -->", text)


def check(office):
    wrong = []
    for page in PAGES:
        text = page.read_text()
        name = page.relative_to(ROOT)
        if printed(text, office) != text:
            wrong.append(f"{name} shows other numbers than {RESULTS.relative_to(ROOT)}: scripts/thesis_page.py print")
        tables = "\n".join(line for line in text.splitlines() if line.startswith("|"))
        known = set(re.findall(r"\d[\d,]*(?:\.\d+)?", tables))
        outside = NAMES.sub("", CODE.sub("", BLOCK.sub("", text)))
        outside = "\n".join(line for line in outside.splitlines() if not line.startswith("|"))
        for number in NUMBER.findall(outside):
            if number not in known:
                wrong.append(f"{name} says {number}, which stands in none of its tables")
    return wrong


def number(text):
    return float(text) if text not in (None, "", "x") else None


def kept(row):
    return {key: row[key] if key in ("recording", "model") else number(row.get(key)) for key in KEPT}


def read_table(path):
    if not path.exists():
        return None
    with open(path) as file:
        columns, *rows = csv.reader(file)
    return {"columns": columns, "rows": rows}


def start_of(folder, maps):
    summary = json.loads((folder / "summary.json").read_text())
    points = next(row["points"] for row in maps if row["recording"] == folder.name and row["model"] == "thrun" and row["points"])
    trajectory = summary["trajectory"]
    return {
        "name": folder.name,
        "keyframes": summary["keyframes"],
        "points": points,
        "ate": trajectory["ate_rmse"],
        "scale_drift": trajectory["scale_drift"],
    }


def collect(folder):
    commit = os.environ.get("COMMIT")
    if not commit:
        sys.exit("found no COMMIT, expected the commit of the program that was measured: COMMIT=... scripts/thesis_page.py collect FOLDER")
    commit = subprocess.run(["git", "-C", ROOT, "rev-parse", commit], check=True, capture_output=True, text=True).stdout.strip()
    with open(folder / "sweep/maps.csv") as file:
        maps = [kept(row) for row in csv.DictReader(file)]
    starts = sorted({row["recording"] for row in maps})
    first = folder / "sweep" / starts[0]
    tables = {
        "memory": read_table(first / "table-6.4-memory.csv"),
        "speed": read_table(first / "table-6.6-6.7-speed.csv"),
        "machine-memory": read_table(folder / "machine-sweep/machine/table-6.4-memory.csv"),
        "machine-speed": read_table(folder / "machine-sweep/machine/table-6.6-6.7-speed.csv"),
    }
    for old in [name for beginning in FIGURES for name in panels(beginning)]:
        (RESULTS.parent / old).unlink()
    for beginning, source in [*((beginning, first) for beginning in FIGURES), ("figure-5.", folder / "sensor-models")]:
        for figure in source.glob(f"{beginning}*.svg"):
            shutil.copy(figure, RESULTS.parent / figure.name)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    results = {
        "commit": commit,
        "day": time.strftime("%Y-%m-%d", time.gmtime((folder / "sweep/maps.csv").stat().st_mtime)),
        "machine": os.environ.get("MEASURED_ON") or f"{platform.machine()}, {cores} cores, shared with other work",
        "office": {"starts": [start_of(folder / start, maps) for start in starts], "maps": maps},
        "far": json.loads((folder / "far.json").read_text()),
        "tables": {name: found for name, found in tables.items() if found},
    }
    lines = ",\n".join(json.dumps(row) for row in maps)
    text = json.dumps({**results, "office": {**results["office"], "maps": "MAPS"}}, indent=1)
    RESULTS.write_text(text.replace('"MAPS"', f"[\n{lines}\n]") + "\n")


def main():
    match sys.argv[1:]:
        case []:
            wrong = check(Office(json.loads(RESULTS.read_text())))
            print("\n".join(wrong) or "the pages say what docs/thesis/results.json says")
            sys.exit(bool(wrong))
        case ["print"] | ["collect", _]:
            if sys.argv[1] == "collect":
                collect(Path(sys.argv[2]))
            office = Office(json.loads(RESULTS.read_text()))
            for page in PAGES:
                page.write_text(printed(page.read_text(), office))
        case _:
            sys.exit(__doc__.strip())


if __name__ == "__main__":
    main()
