#!/usr/bin/env python3
"""How many recordings with known poses are tracked, by one program or by several.

    scripts/population.py PROGRAM[,PROGRAM...] FOLDER... [-- run options]

Each folder is in TUM layout with `calibration.txt` and `groundtruth.txt`, such as `monogrid synth` writes. A
recording is good when at least 95 % of its frames have a pose and the error (Sim(3), RMSE) is at most 1 % of the
way; it is wrong when the run ends with exit code 0 and an error above 3 %. Two runs at a time, a thread each.
"""
import json
import math
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

MIN_COVERAGE, MAX_ERROR, WRONG_ERROR = 0.95, 0.01, 0.03
# poses alone are judged: no map is finer than it must be
SETTINGS = ["--set", "mapping.quality=fast", "--sensor-model", "none", "--resolution", "0.2", "--threads", "1"]


def way(groundtruth):
    """Length of the true path."""
    lines = (line.split() for line in open(groundtruth) if line.strip() and not line.startswith("#"))
    places = [tuple(map(float, line[1:4])) for line in lines]
    return sum(math.dist(a, b) for a, b in zip(places, places[1:]))


def result(program, folder, options):
    """Share of the frames with a pose, error as a share of the way (or None), and exit code."""
    truth = folder / "groundtruth.txt"
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "run"
        command = [program, "run", folder, "--calibration", folder / "calibration.txt", "--out", out, "--json"]
        code = subprocess.run([*command, *SETTINGS, *options], capture_output=True).returncode
        summary = json.loads((out / "summary.json").read_text())
        coverage = summary["tracked"] / summary["frames"]
        command = [program, "evaluate", "trajectory", out / "trajectory.txt", truth, "--json"]
        judged = subprocess.run(command, capture_output=True)
        error = json.loads(judged.stdout)["ate_rmse"] / way(truth) if judged.returncode == 0 else None
    return coverage, error, code


def main():
    arguments, options = sys.argv[1:], []
    if "--" in arguments:
        at = arguments.index("--")
        arguments, options = arguments[:at], arguments[at + 1 :]
    if len(arguments) < 2:
        sys.exit(__doc__)
    programs, folders = arguments[0].split(","), [Path(folder) for folder in arguments[1:]]
    print("| recording |" + "".join(f" {Path(program).name}: frames, error |" for program in programs))
    print("|---|" + "---|" * len(programs))
    pairs = [(program, folder) for folder in folders for program in programs]
    with ThreadPoolExecutor(2) as pool:
        results = list(pool.map(lambda pair: result(*pair, options), pairs))
    for at, folder in enumerate(folders):
        row = results[at * len(programs) : (at + 1) * len(programs)]
        shown = (f" {100 * c:.0f} %, {'-' if e is None else f'{100 * e:.2f} %'} |" for c, e, _ in row)
        print(f"| {folder.name} |" + "".join(shown))
    for at, program in enumerate(programs):
        mine = results[at :: len(programs)]
        good = sum(c >= MIN_COVERAGE and e is not None and e <= MAX_ERROR for c, e, _ in mine)
        never = sum(c == 0 for c, _, _ in mine)
        wrong = sum(code == 0 and e is not None and e > WRONG_ERROR for _, e, code in mine)
        print(f"\n{Path(program).name}: {good} of {len(mine)} good, {never} never start, {wrong} wrong with exit code 0")


if __name__ == "__main__":
    main()
