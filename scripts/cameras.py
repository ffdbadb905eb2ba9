#!/usr/bin/env python3
"""Focal lengths that are found without a calibration: how often the truth lies in the interval that is said.

    scripts/cameras.py PROGRAM [FIRST [LAST]]      recordings drawn by chance [default: 0 to 99]

Each recording is of 320x240, of a built-in world, 60 to 300 frames long, by hand or drone, through a lens of 35 to 100
degrees, two of five with radial distortion; every third is a video that was encoded again. A run says a focal length with
an interval, calls it assumed, or makes no map. Rendered into ${TMPDIR:-/tmp}/cameras, where they stay. Needs numpy and
ffmpeg.
"""
import json
import math
import re
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from population import SETTINGS

SIZE = (320, 240)
WORLDS = ("living-room", "office", "machine-hall", "stairs", "street", "corridor-loop")
WORK = Path(tempfile.gettempdir()) / "cameras"


def recording(program, number):
    """Its source, the true focal length and what it is, in words; rendered once."""
    random = np.random.default_rng(number)
    world = WORLDS[number % len(WORLDS)]
    fov, frames = random.uniform(35, 100), int(random.uniform(60, 300))
    k1 = random.uniform(-0.3, 0.1) if random.random() < 0.4 else 0.0
    motion = str(random.choice(["hand", "drone"]))
    focal = SIZE[0] / 2 / math.tan(math.radians(fov) / 2)
    folder = WORK / f"{number:03}"
    if not folder.exists():
        camera = WORK / f"{number:03}.txt"
        camera.write_text(f"{focal} {focal} {SIZE[0] / 2 - 0.5} {SIZE[1] / 2 - 0.5} {k1} 0 0 0 {SIZE[0]} {SIZE[1]}\n")
        unfinished = WORK / f"{number:03}-unfinished"
        command = [program, "synth", world, "--motion", motion, "--calibration", camera, "--max-frames", str(frames), "--seed", str(number),
                   "--noise", "demo", "--out", unfinished, "--force", "--depth-every", "0", "--quick-light", "--truth-resolution", "0.2"]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        (unfinished / "calibration.txt").rename(unfinished / "true.txt")
        unfinished.rename(folder)
    is_video = number % 3 == 2
    source = WORK / f"{number:03}.mp4" if is_video else folder
    if is_video and not source.exists():
        command = ["ffmpeg", "-v", "error", "-y", "-framerate", "30", "-pattern_type", "glob", "-i", folder / "rgb" / "*.png", "-pix_fmt", "yuv420p",
                   "-crf", "30", source]
        subprocess.run(command, check=True)
    return source, focal, f"{world}, {motion}, {frames} frames, {fov:.0f} degrees, k1 {k1:.2f}{', video' if is_video else ''}"


def said(program, source):
    """Exit code, focal length, interval; `None` where none is said."""
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "run"
        code = subprocess.run([program, "run", source, "--out", out, *SETTINGS], capture_output=True).returncode
        files = list(out.glob("calibration.*"))
        text = files[0].read_text() if files else ""
        tracked = json.loads((out / "summary.json").read_text())["tracked"] if (out / "summary.json").exists() else 0
    found = re.search(r"focal length ([\d.]+) px \(95 %: ([\d.]+) to ([\d.]+)\)", text)
    return code, tracked, tuple(map(float, found.groups())) if found else None


def main():
    if len(sys.argv) < 2 or sys.argv[1].startswith("-"):
        sys.exit(__doc__)
    program = Path(sys.argv[1]).resolve()
    first, last = (list(map(int, sys.argv[2:])) + [0, 99][len(sys.argv) - 2 :])[:2]
    WORK.mkdir(exist_ok=True)

    def judged(number):
        source, focal, what = recording(program, number)
        return number, what, focal, *said(program, source)

    print("| | recording | exit | frames | focal length, px | said | 95 % | off | inside |\n|---|---|---|---|---|---|---|---|---|")
    inside, widths, assumed, none = 0, [], 0, 0
    with ThreadPoolExecutor(2) as pool:
        for number, what, focal, code, tracked, found in pool.map(judged, range(first, last + 1)):
            if found is None:
                none, assumed = none + (code != 0), assumed + (code == 0)
                print(f"| {number} | {what} | {code} | {tracked} | {focal:.1f} | {'assumed' if code == 0 else 'no map'} | | | |", flush=True)
                continue
            estimate, low, high = found
            inside += low <= focal <= high
            widths.append((high - low) / estimate)
            print(f"| {number} | {what} | {code} | {tracked} | {focal:.1f} | {estimate:.1f} | {low:.1f} to {high:.1f} | "
                  f"{100 * (estimate / focal - 1):+.1f} % | {'yes' if low <= focal <= high else 'no'} |", flush=True)
    print(f"\n{inside} of {len(widths)} inside, median width {100 * np.median(widths):.1f} %; {assumed} assumed, {none} without a map")


if __name__ == "__main__":
    main()
