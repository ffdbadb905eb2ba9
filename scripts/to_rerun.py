#!/usr/bin/env python3
"""Shows the folder of a run in Rerun, or writes it as a recording for it: pip install rerun-sdk numpy

    scripts/to_rerun.py RUN              # opens the viewer
    scripts/to_rerun.py RUN --rrd FILE   # for the viewer of the same version of rerun-sdk

Time runs as it did in the video: the camera with its path, the pictures and depths of the keyframes as they were made, tracking per frame.
The cloud, the occupied cells and the mesh are those of the end.
"""

import argparse
import csv
import json
import sys
from pathlib import Path

import numpy as np
import rerun as rr


def rows(path):
    """The numbers of a text file with a comment in its first line."""
    table = np.loadtxt(path, comments="#", ndmin=2)
    if table.size == 0:
        sys.exit(f"{path} has no rows")
    return table


def points_of_ply(path):
    """The vertices of a binary PLY file as a structured array."""
    types = {"float": "<f4", "uchar": "u1", "double": "<f8"}
    content = path.read_bytes()
    header, body = content.split(b"end_header\n", 1)
    count, fields = 0, []
    for line in header.decode().splitlines():
        words = line.split()
        if words[:2] == ["element", "vertex"]:
            count = int(words[2])
        elif words[0] == "property":
            fields.append((words[2], types[words[1]]))
    return np.frombuffer(body, dtype=np.dtype(fields), count=count)


def log_cloud(entity, path, radius):
    if not path.exists():
        return
    points = points_of_ply(path)
    positions = np.stack([points[axis] for axis in "xyz"], axis=1)
    colours = None
    if "red" in points.dtype.names:
        colours = np.stack([points[name] for name in ("red", "green", "blue")], axis=1)
    rr.log(entity, rr.Points3D(positions, colors=colours, radii=radius), static=True)


def log_map(run, summary):
    rr.log("map", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    cell = summary["map"]["resolution"]
    log_cloud("map/cloud", run / "cloud.ply", 0.1 * cell)
    log_cloud("map/cells", run / "cells.ply", 0.5 * cell)
    mesh = run / "mesh.glb"
    if mesh.exists():
        rr.log("map/mesh", rr.Asset3D(path=mesh), static=True)


def log_camera(run, summary):
    """The camera over time, with its path until then."""
    poses = rows(run / "trajectory.txt")
    rr.log("map/camera", rr.TransformAxes3D(4 * summary["map"]["resolution"]), static=True)
    for number, (seconds, *pose) in enumerate(poses):
        rr.set_time("video", duration=seconds)
        camera = rr.Transform3D(translation=pose[:3], quaternion=rr.Quaternion(xyzw=pose[3:]))
        rr.log("map/camera", camera)
        if number % 10 == 0 or number + 1 == len(poses):
            rr.log("map/path", rr.LineStrips3D([poses[: number + 1, 1:4]]))


def log_keyframes(run, summary):
    cell = summary["map"]["resolution"]
    for keyframe in rows(run / "keyframes.txt"):
        name = f"{int(keyframe[0]):05}"
        rr.set_time("video", duration=keyframe[2])
        place = rr.Transform3D(translation=keyframe[4:7], quaternion=rr.Quaternion(xyzw=keyframe[7:11]))
        rr.log(f"map/keyframes/{name}", place, rr.TransformAxes3D(2 * cell))
        for picture in ("image", "depth", "uncertainty"):
            path = run / "keyframes" / f"{name}_{picture}.png"
            if path.exists():
                rr.log(f"keyframe/{picture}", rr.EncodedImage(path=path))


def log_tracking(run):
    with open(run / "frames.csv", newline="") as file:
        for frame in csv.DictReader(file):
            rr.set_time("video", duration=float(frame["timestamp"]))
            for key in ("residual", "good_share", "usage", "tracking_ms"):
                if frame[key]:
                    rr.log(f"tracking/{key}", rr.Scalars(float(frame[key])))
            said = frame["state"] + (f": {frame['reason']}" if frame["reason"] else "")
            rr.log("tracking/state", rr.TextLog(said))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path, help="folder that monogrid run wrote")
    parser.add_argument("--rrd", type=Path, help="file to write instead of opening the viewer")
    args = parser.parse_args()
    if not (args.run / "summary.json").exists():
        sys.exit(f"{args.run} is no folder of a run: there is no summary.json")
    if args.rrd and args.rrd.exists():
        sys.exit(f"{args.rrd} exists")
    summary = json.loads((args.run / "summary.json").read_text())
    rr.init("monogrid", spawn=args.rrd is None)
    if args.rrd:
        rr.save(args.rrd)
    log_map(args.run, summary)
    log_keyframes(args.run, summary)
    log_camera(args.run, summary)
    log_tracking(args.run)


if __name__ == "__main__":
    main()
