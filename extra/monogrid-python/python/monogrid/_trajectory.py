"""Trajectory files as arrays."""

from __future__ import annotations

import os

import numpy as np


def read_trajectory(path: str | os.PathLike[str]) -> tuple[np.ndarray, np.ndarray]:
    """Times in seconds, shape (n,), and poses `world_from_camera`, shape (n, 4, 4), of a file in TUM format."""
    rows = np.loadtxt(path, comments="#", ndmin=2, dtype=np.float64)
    if rows.size == 0:
        return np.empty(0), np.empty((0, 4, 4))
    if rows.shape[1] != 8:
        raise ValueError(f"{path} has {rows.shape[1]} columns, expected 8: time x y z qx qy qz qw")
    quaternions = rows[:, 4:] / np.linalg.norm(rows[:, 4:], axis=1, keepdims=True)
    x, y, z, w = quaternions.T
    poses = np.zeros((len(rows), 4, 4))
    poses[:, 0, :3] = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)], axis=1)
    poses[:, 1, :3] = np.stack([2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)], axis=1)
    poses[:, 2, :3] = np.stack([2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)], axis=1)
    poses[:, :3, 3] = rows[:, 1:4]
    poses[:, 3, 3] = 1
    return rows[:, 0], poses
