#!/usr/bin/env python3
"""The tables of scripts/maps.sh.

Reads lines of scene, variant, report of the trajectory and report of the map.

    scripts/maps.py REPORT      says by its exit code whether the recording of this trajectory can be judged
"""

import json
import math
import statistics
import sys
from pathlib import Path

# Recordings that can be judged: share of the frames with a pose, error as a share of the way.
MIN_COVERAGE, MAX_ERROR = 0.9, 0.01
# A stage stays that brings so much MCC of known cells on average, or so much of the surface at no
# loss of MCC, and costs no scene more than this.
MIN_MCC, MIN_SURFACE, MAX_HARM = 0.01, 0.03, 0.02

METRICS = {
    "AUC observed": lambda r: r["policies"]["observed"]["auc"],
    "MCC observed": lambda r: r["policies"]["observed"]["mcc"],
    "with cells beyond": lambda r: r["mcc_with_beyond"],
    "AUC known": lambda r: r["known_in_view"]["auc"],
    "MCC known": lambda r: r["known_in_view"]["mcc"],
    "surface": lambda r: r["completeness"],
    "cells observed": lambda r: r["coverage_occupied_in_view"],
    "thickness": lambda r: r["thickness_cells"],
    "Brier": lambda r: r["brier"],
}


def read(path):
    return json.loads(Path(path).read_text()) if Path(path).exists() else None


def is_judged(trajectory):
    """Whether the poses of a recording are good enough to say something about maps."""
    return (
        trajectory is not None
        and trajectory["coverage"] >= MIN_COVERAGE
        and trajectory["ate_rmse"] <= MAX_ERROR * trajectory["path_length"]
    )


def value(report, metric):
    try:
        found = METRICS[metric](report)
    except (KeyError, TypeError):  # a program that does not say it
        found = None
    return math.nan if found is None else found


def row(*cells):
    print("| " + " | ".join(cells) + " |")


def table_of(variant, reports):
    """A variant scene by scene, and the mean."""
    print(f"\n{variant}, {len(reports)} scenes:\n")
    row("scene", *METRICS)
    print("|---" * (1 + len(METRICS)) + "|")
    for scene, report in reports.items():
        row(scene, *(f"{value(report, metric):.3f}" for metric in METRICS))
    means = {m: statistics.fmean(value(r, m) for r in reports.values()) for m in METRICS}
    row("mean", *(f"{mean:.3f}" for mean in means.values()))


def verdict(without):
    """What the first variant has over one, by the rule."""
    gains = {metric: [-d for d in differences] for metric, differences in without.items()}
    mean = {metric: statistics.fmean(gain) for metric, gain in gains.items()}
    is_harmless = min(gains["MCC known"]) >= -MAX_HARM
    brings_mcc = mean["MCC known"] >= MIN_MCC
    brings_surface = mean["surface"] >= MIN_SURFACE and min(mean["MCC known"], mean["MCC observed"]) >= 0
    return "yes" if is_harmless and (brings_mcc or brings_surface) else "no"


def main():
    if sys.argv[1:]:
        sys.exit(not is_judged(read(sys.argv[1])))
    results, trajectories = {}, {}
    for line in sys.stdin:
        scene, variant, trajectory, report = line.rstrip("\n").split("\t")
        trajectories[scene] = read(trajectory)
        results.setdefault(variant, {})[scene] = read(report)
    judged = [scene for scene, trajectory in trajectories.items() if is_judged(trajectory)]
    for scene, trajectory in trajectories.items():
        if scene not in judged:
            why = "no trajectory"
            if trajectory is not None:
                error = trajectory["ate_rmse"] / trajectory["path_length"]
                why = f"{trajectory['coverage']:.0%} of the frames, error {error:.1%} of the way"
            print(f"not judged: {scene}: {why}")
    measured = {v: {s: r[s] for s in judged if r[s] is not None} for v, r in results.items()}
    for variant, reports in measured.items():
        if reports:
            table_of(variant, reports)
    first, *others = measured
    if not others:
        return
    print(f"\nMinus {first}: mean ± standard deviation over scenes [smallest, largest]; whether {first} is worth it by the rule.\n")
    row("variant", "scenes", *METRICS, "worth it")
    print("|---" * (3 + len(METRICS)) + "|")
    for variant in others:
        scenes = [scene for scene in measured[variant] if scene in measured[first]]
        if len(scenes) < 2:
            continue
        pairs = [(measured[variant][scene], measured[first][scene]) for scene in scenes]
        differences = {m: [value(a, m) - value(b, m) for a, b in pairs] for m in METRICS}
        cells = (
            f"{statistics.fmean(d):+.4f} ± {statistics.stdev(d):.4f} [{min(d):+.3f}, {max(d):+.3f}]"
            for d in differences.values()
        )
        row(variant, str(len(scenes)), *cells, verdict(differences))


main()
