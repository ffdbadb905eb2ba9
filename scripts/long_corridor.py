#!/usr/bin/env python3
"""A winding corridor whose every place is new: a mesh with random grey values, and the path of a camera that walks through it.

    scripts/long_corridor.py OUT METRES FRAMES        # OUT/corridor.ply, OUT/path.txt; needs numpy
    monogrid synth OUT/corridor.ply --trajectory OUT/path.txt --size 320x240 --depth-every 100000 --out WORLD
"""
import pathlib
import sys

import numpy as np

STEP, WIDTH, HEIGHT = 0.1, 2.0, 2.5


def cross_section():
    """Floor, right wall, ceiling, left wall: (y, z) around."""
    along, up = np.arange(0, WIDTH, STEP), np.arange(0, HEIGHT, STEP)
    sides = [
        np.stack([along - WIDTH / 2, 0 * along], -1),
        np.stack([0 * up + WIDTH / 2, up], -1),
        np.stack([WIDTH / 2 - along, 0 * along + HEIGHT], -1),
        np.stack([0 * up - WIDTH / 2, HEIGHT - up], -1),
    ]
    return np.concatenate(sides)


def bend(x):
    """Where the middle of the corridor lies."""
    return 0.6 * np.sin(x / 4)


def write_mesh(path, metres):
    random = np.random.default_rng(1)
    xs, ring = np.arange(-2, metres + 12, STEP), cross_section()
    n, r = len(xs), len(ring)
    centre = np.array([0, HEIGHT / 2])
    relief = 1 + 0.06 * random.standard_normal((n, r)).clip(-1, 1)
    vertices = np.zeros((n, r), dtype=[("p", "<f4", 3), ("c", "u1", 3)])
    around = (ring - centre)[None] * relief[..., None]
    vertices["p"][..., 0] = xs[:, None]
    vertices["p"][..., 1] = bend(xs)[:, None] + around[..., 0]
    vertices["p"][..., 2] = centre[1] + around[..., 1]
    vertices["c"] = random.integers(20, 236, (n, r, 1))
    here, side = np.arange(n - 1)[:, None] * r, np.arange(r)[None]
    a, b = here + side, here + (side + 1) % r
    corners = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, b + r), (a, b + r, a + r))])
    faces = np.zeros(len(corners), dtype=[("n", "u1"), ("i", "<u4", 3)])
    faces["n"], faces["i"] = 3, corners
    properties = [f"property float {k}" for k in "xyz"] + [f"property uchar {k}" for k in ("red", "green", "blue")]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {n * r}", *properties]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]
    path.write_bytes("\n".join(header).encode() + vertices.tobytes() + faces.tobytes())


def quaternion(m):
    w = np.sqrt(max(1e-12, 1 + np.trace(m))) / 2
    return [(m[2, 1] - m[1, 2]) / (4 * w), (m[0, 2] - m[2, 0]) / (4 * w), (m[1, 0] - m[0, 1]) / (4 * w), w]


def write_path(path, metres, frames):
    with path.open("w") as out:
        for k in range(frames):
            t, x = k / 30, metres * k / frames
            position = [x, bend(x) + 0.25 * np.sin(0.9 * t), 1.3 + 0.15 * np.sin(1.3 * t)]
            yaw = np.arctan2(0.15 * np.cos(x / 4), 1) + 0.35 * np.sin(0.35 * t)
            s, c = np.sin(yaw), np.cos(yaw)
            pose = position + quaternion(np.array([[s, 0, c], [-c, 0, s], [0, -1, 0]]))
            out.write(f"{t:.6f} " + " ".join(f"{v:.9f}" for v in pose) + "\n")


def main():
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    out, metres, frames = pathlib.Path(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3])
    out.mkdir(parents=True, exist_ok=True)
    write_mesh(out / "corridor.ply", metres)
    write_path(out / "path.txt", metres, frames)


if __name__ == "__main__":
    main()
