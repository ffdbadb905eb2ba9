"""A million points of a lidar in a room, inserted by Python and by Rust: `insert_points.py PROGRAM` with the Rust program."""

import subprocess
import sys
import tempfile
import time

import numpy as np

import monogrid

REPETITIONS = 5
ALLOWED = 1.2


def room() -> np.ndarray:
    """1000 rings of 1000 points on the walls of a room of 8 x 6 x 3 m, from its middle."""
    azimuth, elevation = np.meshgrid(np.linspace(-np.pi, np.pi, 1000), np.linspace(-1.2, 1.2, 1000))
    along = np.stack([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)], -1)
    ranges = (np.array([4.0, 3.0, 1.5]) / np.abs(along)).min(axis=-1, keepdims=True)
    return (along * ranges).reshape(-1, 3).astype(np.float32)


def main(program: str) -> int:
    points = room()
    shortest = np.inf
    for _ in range(REPETITIONS):
        grid = monogrid.OccupancyMap(0.05)
        begin = time.perf_counter()
        grid.insert(points, sigma=0.025)
        shortest = min(shortest, time.perf_counter() - begin)
    with tempfile.NamedTemporaryFile() as file:
        points.tofile(file.name)
        output = subprocess.run([program, file.name, str(REPETITIONS)], check=True, capture_output=True, text=True).stdout
    rust, occupied, free = output.split()
    assert grid.counts == {"occupied": int(occupied), "free": int(free)}, "not the same map"
    ratio = shortest / float(rust)
    print(f"{len(points)} points: Python {shortest:.3f} s, Rust {float(rust):.3f} s, {ratio:.2f} times as long (allowed {ALLOWED})")
    return 0 if ratio <= ALLOWED else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
