#!/usr/bin/env python3
"""What a second camera brings: worlds that are seen by one camera and by a stereo pair.

    scripts/stereo.py [PROGRAM [FRAMES]]      default: target/release/monogrid, 400 frames

The pair is 11 cm wide, 640x480 pixels and 65 degrees. ATE is the error of the trajectory (Sim(3), RMSE); the scale of
one camera is arbitrary. Recordings are kept in ${TMPDIR:-/tmp}/monogrid-stereo.
"""
import json
import subprocess
import sys
import tempfile
from pathlib import Path

WORLDS = ("living-room", "office", "machine-hall", "blank-walls", "stairs")
NOISES = ("demo", "harsh")
BASELINE_M = 0.11


def recording(program, work, world, noise, frames):
    """A rendered recording; its shutter is global, as that of stereo cameras."""
    folder = work / f"{world}-{noise}-{frames}"
    if not folder.exists():
        unfinished = folder.with_name(folder.name + "-unfinished")
        command = [program, "synth", world, "--out", unfinished, "--force", "--noise", noise, "--rolling-shutter", "0",
                   "--stereo", BASELINE_M, "--depth-every", "0", "--quick-light", "--max-frames", frames]
        subprocess.run([str(word) for word in command], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        unfinished.rename(folder)
    return folder


def result(program, folder, out, options):
    """Frames with a pose of all, first of them, ATE in metres and the scale of the truth in the estimate."""
    command = [program, "run", folder, "--calibration", folder / "calibration.txt", "--out", out, "--force", "--json", *options]
    run = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    summary = json.loads(run.stdout)
    command = [program, "evaluate", "trajectory", out / "trajectory.txt", folder / "groundtruth.txt", "--json"]
    judged = subprocess.run(command, capture_output=True)
    error = json.loads(judged.stdout) if judged.returncode == 0 else None
    return summary, error


def cell(summary, error):
    share = 100 * summary["tracked"] / summary["frames"]
    if error is None:
        return f"{share:.0f} %, no map"
    scale = f", scale {error['scale']:.4f}" if summary["scale"] == "metric" else ""
    return f"{share:.0f} %, {1000 * error['ate_rmse']:.1f} mm{scale}"


def main():
    program = Path(sys.argv[1] if len(sys.argv) > 1 else "target/release/monogrid").resolve()
    frames = int(sys.argv[2]) if len(sys.argv) > 2 else 400
    work = Path(tempfile.gettempdir()) / "monogrid-stereo"
    print("| world, noise | one camera: frames, ATE | stereo: frames, ATE, scale (1 is right) |\n|---|---|---|")
    for world in WORLDS:
        for noise in NOISES:
            folder = recording(program, work, world, noise, frames)
            results = [result(program, folder, work / "run", options) for options in ([], ["--stereo"])]
            print(f"| {world}, {noise} | " + " | ".join(cell(*found) for found in results) + " |", flush=True)


if __name__ == "__main__":
    main()
