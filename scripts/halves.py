#!/usr/bin/env python3
"""Is a run that goes on with half of a recording in the same frame as one of the whole recording?

    scripts/halves.py PROGRAM [FOLDER ...]      folders in TUM layout; default: worlds, and those of MONOGRID_DATA

Each recording is run whole, and its second half with `--continue` after its first half. Both are rescaled by the
height of the camera (1.5 m over the floor or level surface, where there is one), and seen from above. Printed are up
and floor of the first half, of both halves and of the whole, the height bands of the whole as `run`, `rescale` and
`project` write them, and by how many cells of 0.05 m those of both halves differ from them. Needs numpy.
"""
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from population import SETTINGS

CELL = 0.05
WORK = Path(tempfile.gettempdir()) / "halves"
WORLDS = {
    "demo": ["living-room", "--size", "320x240", "--max-frames", "240"],
    "office": ["office", "--motion", "hand", "--size", "320x240", "--max-frames", "240", "--seed", "1"],
    "machine-hall": ["machine-hall", "--motion", "hand", "--size", "320x240", "--max-frames", "240", "--seed", "2"],
}
RECORDED = ("tsukuba", "red-kitchen")


def worlds(program):
    for name, options in WORLDS.items():
        folder = WORK / name
        if not folder.exists():
            command = [program, "synth", *options, "--out", folder, "--force", "--depth-every", "0", "--quick-light"]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        yield folder


def call(program, *arguments):
    command = [program, *map(str, arguments)]
    called = subprocess.run(command, capture_output=True, text=True)
    if called.returncode not in (0, 3):
        print(f"{' '.join(map(str, command))}: exit {called.returncode}: {called.stderr.strip()[-300:]}", file=sys.stderr)
    return called.returncode


def summary(run):
    path = run / "summary.json"
    return json.loads(path.read_text()) if path.exists() else {}


def said(run):
    """Up and floor, in words."""
    of = summary(run)
    up = of.get("up") or {}
    ground = next((name for name in ("floor", "level_surface") if of.get(name)), "nothing")
    height = (of.get(ground) or {}).get("camera_height")
    return f"{'certain' if up.get('is_certain') else 'uncertain'}, {ground}" + (f" {height:.3f}" if height else "")


def band_of_grid(yaml):
    """Lowest and highest z that the description of a grid names."""
    words = yaml.read_text().split("# cells from z = ")[1].split() if yaml.exists() else []
    return [float(words[0]), float(words[2])] if words else None


def bands(program, run):
    """The band that `rescale` writes, in metres, and that of `project` of it; those of the run itself, times the factor."""
    metric, of = run.with_name(run.name + "-metric"), summary(run)
    height = ((of.get("floor") or of.get("level_surface")) or {}).get("camera_height")
    scale = "camera-height=1.5m" if of.get("floor") else f"factor={1.5 / height}" if height else "factor=1"
    if call(program, "rescale", run, "--scale-from", scale, "--out", metric, "--force") != 0:
        return None
    of = summary(metric)
    factor, own = of["metres_per_map_unit"], summary(run)["map"]["band"]
    call(program, "project", metric / "global.ot", metric / "plan.pgm", "--force")
    return [[factor * z for z in own], of["map"]["band"], band_of_grid(metric / "plan.yaml")]


def main():
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    program, folders = Path(sys.argv[1]).resolve(), [Path(folder) for folder in sys.argv[2:]]
    WORK.mkdir(exist_ok=True)
    if not folders:
        data = os.environ.get("MONOGRID_DATA")
        folders = [*worlds(program), *(Path(data) / name for name in RECORDED if data)]
    settings = SETTINGS[:2] + SETTINGS[-2:] + ["--resolution", "0.05"]
    print("| recording | first half | both halves | whole | bands of the whole | cells that those of both halves differ by |")
    print("|---|---|---|---|---|---|")
    for folder in folders:
        frames = sum(not line.startswith("#") for line in open(folder / "rgb.txt"))
        with tempfile.TemporaryDirectory() as scratch:
            half, both, whole = (Path(scratch) / name for name in ("half", "both", "whole"))
            camera = ["--calibration", folder / "calibration.txt"]
            call(program, "run", folder, *camera, "--out", whole, *settings)
            call(program, "run", folder, *camera, "--out", half, *settings, "--max-frames", frames // 2)
            call(program, "run", folder, *camera, "--out", both, *settings, "--start", frames // 2, "--continue", half)
            of_whole, of_both = bands(program, whole), bands(program, both)
            shown = differ = "-"
            if of_whole:
                shown = "; ".join(f"{low:.2f} to {high:.2f}" for low, high in of_whole)
            if of_whole and of_both:
                pairs = [(a, b) for w, o in zip(of_whole, of_both) for a, b in zip(w, o)]
                differ = f"{max(abs(a - b) for a, b in pairs) / CELL:.2f}"
            print(f"| {folder.name} | {said(half)} | {said(both)} | {said(whole)} | {shown} | {differ} |", flush=True)


main()
