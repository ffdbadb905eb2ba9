#!/usr/bin/env python3
"""Recomputes cells of the tables of docs/thesis-comparison.md from the maps themselves, with numpy.

    scripts/thesis_cells.py FOLDER [MODEL:VALUE:CELLS ...]

FOLDER is that of scripts/thesis-comparison.sh. For each cell of the tables (by default four of the first start) the
program builds the map from the recording again; this script reads map and truth as OctoMap's files, counts cells, and
compares the AUC of known and of observed cells and the MCC with the sweep's maps.csv, digit by digit. Nothing of the
program's evaluation is used. MONOGRID names the program. Needs Python 3 and numpy.
"""

import csv
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

USUAL = ["thrun:0.5:0.128", "andert:0.05:0.128", "thrun:0.3:0.064", "andert:0.09:0.064"]
SETTING = {"thrun": "buffer", "andert": "significance"}
DEPTH = 16
# half of the cells that a tree of this depth has along an axis
CENTRE = 1 << (DEPTH - 1)
CHILDREN = np.array([[bits & 1, bits >> 1 & 1, bits >> 2 & 1] for bits in range(8)])


def read_ot(path):
    """The known cells of an .ot file: edge, keys of all cells, log-odds."""
    content = Path(path).read_bytes()
    head, _, data = content.partition(b"\ndata\n")
    words = dict(line.split(maxsplit=1) for line in head.decode().splitlines() if line and not line.startswith("#"))
    nodes = np.frombuffer(data, dtype=[("value", "<f4"), ("children", "u1")])
    leaves, stack = [], [(0, np.zeros(3, int))]
    # depth first, as they are written
    for value, children in nodes.tolist():
        depth, first = stack.pop()
        if children == 0:
            leaves.append((*first, 1 << (DEPTH - depth), value))
            continue
        half = 1 << (DEPTH - depth - 1)
        stack += [(depth + 1, first + half * CHILDREN[k]) for k in range(7, -1, -1) if children >> k & 1]
    assert not stack, f"{path} ends in the middle of its tree"
    leaves = np.array(leaves)
    first, edges = leaves[:, :3].astype(int) - CENTRE, leaves[:, 3].astype(int)
    keys, values = [], []
    for edge in np.unique(edges):
        chosen = edges == edge
        inside = np.stack(np.meshgrid(*[np.arange(edge)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        keys.append((first[chosen][:, None, :] + inside[None]).reshape(-1, 3))
        values.append(np.repeat(leaves[chosen, 4], edge**3))
    return float(words["res"]), np.concatenate(keys), np.concatenate(values)


def code(keys):
    """One number for each cell."""
    shifted = keys.astype(np.int64) + (1 << 20)
    return (shifted[:, 0] << 42) | (shifted[:, 1] << 21) | shifted[:, 2]


def coarse_truth(truth, edge):
    """Codes of the free and of the occupied cells of a truth with larger cells: what is both is occupied."""
    resolution, keys, log_odds = truth
    factor = round(edge / resolution)
    assert abs(factor * resolution / edge - 1) < 1e-6, f"{edge} is no multiple of {resolution}"
    codes = code(np.floor_divide(keys, factor))
    occupied = np.unique(codes[log_odds > 0])
    return np.setdiff1d(codes, occupied), occupied


def scores(estimate, truth):
    """AUC of known cells by 26 thresholds, exact AUC of observed cells, MCC of observed cells."""
    edge, keys, log_odds = estimate
    free, occupied = coarse_truth(truth, edge)
    codes = code(keys)
    probability = 1 / (1 + np.exp(-log_odds))
    of_occupied = probability[np.isin(codes, occupied)]
    of_free = probability[np.isin(codes, free)]

    unobserved = [len(occupied) - len(of_occupied), len(free) - len(of_free)]
    known = [np.append(seen, np.full(more, 0.5)) for seen, more in zip((of_occupied, of_free), unobserved)]
    thresholds = np.arange(26) / 25
    rates = [[1.0, *(np.mean(p > t) for t in thresholds), 0.0] for p in known]
    true_rate, false_rate = map(np.array, rates)
    auc_known = np.sum(-np.diff(false_rate) * (true_rate[1:] + true_rate[:-1]) / 2)

    ordered = np.sort(of_free)
    below = np.searchsorted(ordered, of_occupied, "left")
    not_above = np.searchsorted(ordered, of_occupied, "right")
    auc_observed = np.sum((below + not_above) / 2) / len(of_occupied) / len(of_free)

    tp, fp = float(np.sum(of_occupied > 0.5)), float(np.sum(of_free > 0.5))
    fn, tn = len(of_occupied) - tp, len(of_free) - fp
    mcc = (tp * tn - fp * fn) / np.sqrt((tp + fp) * (tn + fn) * (tp + fn) * (tn + fp))
    return {"auc_26_known": auc_known, "auc_observed": auc_observed, "mcc_observed": mcc}


def build(program, recording, reference, cell, out):
    model, value, edge = cell.split(":")
    subprocess.run(
        [program, "map", recording, "--profile", "thesis", "--sensor-model", model, "--resolution", edge, "--align"]
        + [f"gt:{reference}", "--set", f"mapping.{SETTING[model]}={value}", "--out", out],
        check=True,
        stdout=subprocess.DEVNULL,
    )
    return read_ot(out)


def main():
    if len(sys.argv) < 2 or sys.argv[1].startswith("-"):
        sys.exit(__doc__.strip())
    folder, cells = Path(sys.argv[1]), sys.argv[2:] or USUAL
    program = os.environ.get("MONOGRID", "target/release/monogrid")
    reference = (folder / "reference").read_text().strip()
    with open(folder / "sweep/maps.csv") as file:
        rows = list(csv.DictReader(file))
    name, truth = rows[0]["recording"], read_ot(folder / "truth.ot")
    differing = 0
    for cell in cells:
        model, value, edge = cell.split(":")
        of_cell = (name, model, float(value), float(edge))
        listed = [r for r in rows if r["parameter"] and (r["recording"], r["model"], float(r["parameter"]), float(r["resolution"])) == of_cell]
        if not listed:
            sys.exit(f"{cell} is no map of {folder}/sweep, expected MODEL:VALUE:CELLS such as {USUAL[0]}")
        with tempfile.TemporaryDirectory() as work:
            recording = folder / name / "recording.mgk"
            found = scores(build(program, recording, reference, cell, f"{work}/map.ot"), truth)
        for score, ours in found.items():
            theirs = listed[0][score]
            is_same = f"{ours:.6f}" == theirs
            differing += not is_same
            print(f"{cell} {score}: numpy {ours:.6f}, sweep {theirs}{'' if is_same else ' DIFFERENT'}")
    sys.exit(f"{differing} scores differ" if differing else 0)


if __name__ == "__main__":
    main()
