#!/usr/bin/env python3
"""Recordings that show no depth, and ordinary ones: which end with a map, and what is said of them.

    scripts/honesty.py PROGRAM [KIND ...]      kinds: pan, still, screen, ordinary, tilted, askew, judge

Twenty pans (five focal lengths, tripod and hand, with and without a calibration), ten still cameras before which
something moves, five recordings of a screen with a border, forty ordinary recordings of 320x240, sixty with a camera
that is held askew (on which what is said of up was fitted), sixty more so, sixty like the first (which only judge). No
pan and no still camera may end with exit code 0; every other recording must. Where there is a map, up is wrong when it is
called certain and is off by more than 5 degrees, the floor when it lies more than a twentieth of the camera's height off
(not judged on stairs). Rendered into ${TMPDIR:-/tmp}/honesty, where they stay. Needs numpy, pillow and ffmpeg.
"""
import json
import math
import os
import subprocess
import sys
import tempfile
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from PIL import Image

from population import SETTINGS

SIZE = (320, 240)
WORLDS = ("living-room", "office", "machine-hall", "stairs", "street", "corridor-loop")
WORK = Path(tempfile.gettempdir()) / "honesty"


def synth(program, name, *options):
    """Renders once."""
    folder = WORK / name
    if not folder.exists():
        unfinished = folder.with_name(folder.name + "-unfinished")
        command = [program, "synth", *options, "--out", unfinished, "--force", "--depth-every", "0", "--quick-light", "--truth-resolution", "0.2"]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        unfinished.rename(folder)
    return folder


def poses(folder):
    lines = (line.split() for line in open(folder / "groundtruth.txt") if not line.startswith("#"))
    return np.array([[float(number) for number in line] for line in lines])


def times_quaternion(a, b):
    """Product of two rotations, each x y z w."""
    (ax, ay, az, aw), (bx, by, bz, bw) = a, b
    return (aw * bx + ax * bw + ay * bz - az * by, aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw, aw * bw - ax * bx - ay * by - az * bz)


def turning(place, pose, degrees, frames, hand, seed):
    """A pan: the camera turns about the vertical and back, by so many degrees; by hand it also shakes, by a centimetre
    and half a degree."""
    random = np.random.default_rng(seed)
    phases, lines = random.uniform(0, 2 * math.pi, (6, 2)), []
    for frame in range(frames):
        t = frame / 30
        shake = [sum(math.sin(2 * math.pi * f * t + p) for f, p in zip((0.7, 1.9), phase)) / 2 for phase in phases]
        yaw = math.radians(degrees) * (1 - math.cos(math.pi * frame / (frames - 1))) / 2 + math.radians(0.5) * hand * shake[3]
        pitch = math.radians(0.5) * hand * shake[4]
        rotation = times_quaternion((0, 0, math.sin(yaw / 2), math.cos(yaw / 2)), pose)
        rotation = times_quaternion(rotation, (math.sin(pitch / 2), 0, 0, math.cos(pitch / 2)))
        moved = [x + 0.01 * hand * s for x, s in zip(place, shake)]
        lines.append(" ".join(f"{number:.9f}" for number in (t, *moved, *rotation)))
    path = WORK / f"path-{seed}.txt"
    path.write_text("\n".join(lines) + "\n")
    return path


def places(program, world):
    """Poses of the built-in motion of a world."""
    return poses(synth(program, f"places-{world}", world, "--size", "80x60"))


def pans(program):
    for number in range(20):
        world = WORLDS[number % 5]
        fov = (25, 40, 55, 75, 95)[number // 4]
        hand, is_calibrated = number % 2, number // 2 % 2
        focal = SIZE[0] / 2 / math.tan(math.radians(fov) / 2)
        camera = WORK / f"camera-{fov}.txt"
        camera.write_text(f"{focal} {focal} {SIZE[0] / 2 - 0.5} {SIZE[1] / 2 - 0.5} {SIZE[0]} {SIZE[1]}\n")
        all_poses = places(program, world)
        pose = all_poses[len(all_poses) * (number % 7 + 1) // 9]
        path = turning(pose[1:4], pose[4:8], min(120, 3 * fov), 180, hand, number)
        name = f"pan-{number:02}-{world}-{fov}-{'hand' if hand else 'tripod'}"
        folder = synth(program, name, world, "--trajectory", path, "--calibration", camera, "--seed", str(number))
        yield name + ("" if is_calibrated else "-uncalibrated"), folder, is_calibrated


def images(folder):
    return [np.array(Image.open(folder / line.split()[1])) for line in open(folder / "rgb.txt") if not line.startswith("#")]


def video(name, frames):
    """An MP4 of these images, made once."""
    path = WORK / f"{name}.mp4"
    if not path.exists():
        height, width = frames[0].shape[:2]
        command = ["ffmpeg", "-v", "error", "-y", "-f", "rawvideo", "-pix_fmt", "gray", "-s", f"{width}x{height}", "-r", "30", "-i", "-",
                   "-pix_fmt", "yuv420p", "-crf", "20", path]
        subprocess.run(command, check=True, input=b"".join(frame.astype(np.uint8).tobytes() for frame in frames))
    return path


def grey(image):
    return image if image.ndim == 2 else image.mean(axis=2)


def stills(program):
    """Before a camera that stands, part of another world moves: a hand with a thing, from a fifth to half of the width."""
    for number in range(10):
        name = f"still-{number:02}"
        if not (WORK / f"{name}.mp4").exists():
            world, other = WORLDS[number % 6], WORLDS[(number + 2) % 6]
            pose = places(program, world)[40 + 30 * number]
            path = turning(pose[1:4], pose[4:8], 0, 180, 0, 100 + number)
            background = images(synth(program, f"{name}-behind", world, "--trajectory", path, "--size", "320x240", "--seed", str(number)))
            thing = grey(images(synth(program, f"{name}-thing", other, "--max-frames", "1", "--size", "320x240"))[0])
            width = SIZE[0] * (20 + 3 * number) // 100
            thing, frames = thing[60 : 60 + width * 3 // 4, 80 : 80 + width], []
            for at, image in enumerate(background):
                image, t = grey(image).copy(), at / 30
                x = int((SIZE[0] - width) * (0.5 + 0.45 * math.sin(1.1 * t + number)))
                y = int((SIZE[1] - thing.shape[0]) * (0.5 + 0.4 * math.sin(0.7 * t + 2 * number)))
                image[y : y + thing.shape[0], x : x + width] = thing
                frames.append(image)
            video(name, frames)
        yield name, WORK / f"{name}.mp4", False


def screens(program):
    """A screen: a border with bars and letters stands around an ordinary recording."""
    for number in range(5):
        name = f"screen-{number}"
        if not (WORK / f"{name}.mp4").exists():
            inner = images(synth(program, f"{name}-inner", WORLDS[number], "--frames", "240", "--size", "320x240", "--seed", str(number)))
            random = np.random.default_rng(number)
            border = np.full((360, 480), 40 + 40 * number, np.uint8)
            for _ in range(120):
                y, x = random.integers(0, 350), random.integers(0, 470)
                border[y : y + random.integers(2, 10), x : x + random.integers(2, 10)] = random.integers(0, 255)
            frames = []
            for image in inner:
                frame = border.copy()
                frame[60:300, 80:400] = grey(image)
                frames.append(frame)
            video(name, frames)
        yield name, WORK / f"{name}.mp4", False


def ordinary(program):
    for number in range(40):
        world = WORLDS[number % 6]
        motion = ("hand", "drone", "hand-back")[number // 6 % 3] if world != "street" else ("car", "drone", "hand")[number // 6 % 3]
        name = f"ordinary-{number:02}-{world}-{motion}"
        noise = ("demo", "harsh")[number % 2]
        folder = synth(program, name, world, "--motion", motion, "--size", "320x240", "--max-frames", "240", "--seed", str(number), "--noise", noise)
        is_calibrated = number % 4 < 2
        yield name + ("" if is_calibrated else "-uncalibrated"), folder, is_calibrated


def held(numbers, roll_deg, down_deg, up_deg):
    """Built-in motion with a camera that is turned about its own axes, by up to these angles."""

    def recordings(program):
        for number in numbers:
            world = ("living-room", "office", "machine-hall", "stairs", "corridor-loop")[number % 5]
            random = np.random.default_rng(1000 + number)
            roll, pitch = math.radians(random.uniform(-roll_deg, roll_deg)), math.radians(random.uniform(-down_deg, up_deg))
            lines = []
            for pose in places(program, world)[number : number + 240]:
                rotation = times_quaternion(pose[4:8], (math.sin(pitch / 2), 0, 0, math.cos(pitch / 2)))
                rotation = times_quaternion(rotation, (0, 0, math.sin(roll / 2), math.cos(roll / 2)))
                lines.append(" ".join(f"{number:.9f}" for number in (*pose[:4], *rotation)))
            path = WORK / f"tilted-{number}.txt"
            path.write_text("\n".join(lines) + "\n")
            name = f"tilted-{number:02}-{world}"
            folder = synth(program, name, world, "--trajectory", path, "--size", "320x240", "--seed", str(number))
            yield name, folder, number % 2 == 0

    return recordings


def matrix(quaternion):
    x, y, z, w = quaternion
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])


def judged(out, truth):
    """Angle between up of the map and of the world, degrees; height of the map's z = 0 below the camera, as a share of the
    true height of the camera above the world's z = 0."""
    estimate, exact = np.loadtxt(out / "trajectory.txt", ndmin=2), poses(truth)
    pairs = [(e, exact[np.argmin(abs(exact[:, 0] - e[0]))]) for e in estimate]
    total = sum(matrix(t[4:8]) @ matrix(e[4:8]).T for e, t in pairs)
    u, _, v = np.linalg.svd(total)
    world_from_map = u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v
    angle = math.degrees(math.acos(min(1, (world_from_map @ [0, 0, 1])[2])))
    e, t = (np.array([pair[at][1:4] for pair in pairs]) for at in (0, 1))
    centred = [(e - e.mean(0)) @ world_from_map.T, t - t.mean(0)]
    scale = (centred[0] * centred[1]).sum() / (centred[0] ** 2).sum()
    return angle, scale * e[:, 2].mean() / t[:, 2].mean()


def bare(folder):
    """The images and their times alone."""
    alone = folder.with_name(folder.name + "-bare")
    alone.mkdir(exist_ok=True)
    for name in ("rgb", "rgb.txt"):
        if not (alone / name).exists():
            (alone / name).symlink_to(folder / name)
    return alone


def result(program, recording):
    name, source, is_calibrated = recording
    folder = source
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "run"
        calibration = ["--calibration", source / "calibration.txt"] if is_calibrated else []
        if source.is_dir() and not is_calibrated:
            source = bare(source)
        run = subprocess.run([program, "run", source, *calibration, "--out", out, "--json", *SETTINGS], capture_output=True, text=True)
        keep = os.environ.get("KEEP")
        if keep:
            (Path(keep) / f"{name}.txt").write_text(run.stdout + run.stderr)
        summary = json.loads((out / "summary.json").read_text()) if (out / "summary.json").exists() else {}
        has_truth = folder.is_dir() and summary.get("keyframes")
        truth = judged(out, folder) if has_truth else None
    return name, run.returncode, summary, truth


KINDS = {"pan": pans, "still": stills, "screen": screens, "ordinary": ordinary, "tilted": held(range(60), 40, 50, 20),
         "askew": held(range(60, 120), 60, 70, 40), "judge": held(range(120, 180), 40, 50, 20)}


def main():
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    program, kinds = Path(sys.argv[1]).resolve(), sys.argv[2:] or list(KINDS)
    WORK.mkdir(exist_ok=True)
    print("| recording | exit | motion | status | frames | keyframes | up | floor |\n|---|---|---|---|---|---|---|---|")
    counts = []
    for kind in kinds:
        recordings, count = list(KINDS[kind](program)), Counter()
        with ThreadPoolExecutor(2) as pool:
            for name, code, summary, truth in pool.map(lambda recording: result(program, recording), recordings):
                count["wrong end"] += (code == 0) == (kind in ("pan", "still"))
                up, floor = judgement(name, summary, truth, count)
                shown = (code, summary.get("motion"), summary.get("status"), f"{summary.get('tracked')} of {summary.get('frames')}")
                print(f"| {name} | {' | '.join(map(str, shown))} | {summary.get('keyframes')} | {up} | {floor} |", flush=True)
        counts.append(f"{kind}: {len(recordings)} recordings, " + ", ".join(f"{number} {what}" for what, number in count.items()))
    print("\n" + "\n".join(counts))


def judgement(name, summary, truth, count):
    """What is said of up and floor, beside the truth."""
    if truth is None:
        return "", ""
    angle, height = truth
    is_certain, has_floor = summary["up"]["is_certain"], summary["floor"] is not None
    count["up certain"] += is_certain
    count["of these wrong"] += is_certain and angle > 5
    count["floor"] += has_floor
    # in a stairwell the floor is where one stands
    count["of these wrong floor"] += has_floor and abs(height - 1) > 0.05 and "stairs" not in name
    return f"{'certain' if is_certain else 'uncertain'} {summary['up']['confidence']:.2f}, off by {angle:.1f}", f"{height:.2f} of the height" if has_floor else ""


main()
