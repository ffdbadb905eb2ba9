#!/usr/bin/env python3
"""Writes small trajectories and what evo says about them.

    python3 -m venv /tmp/venv && /tmp/venv/bin/pip install evo==1.38.1
    /tmp/venv/bin/python tests/evo/regenerate.py

The trajectories are made here from a seed; nothing is taken from a data set.
"""

import copy
import json
import pathlib

import numpy as np
from evo import __version__
from evo.core import metrics, sync
from evo.tools import file_interface
from scipy.spatial.transform import Rotation, Slerp  # comes with evo

HERE = pathlib.Path(__file__).parent


def smooth_path(rng, duration, count=8):
    """Position and rotation over time: a sum of slow waves."""
    amplitude = rng.normal(size=(count, 3)) / np.arange(1, count + 1)[:, None]
    phase = rng.uniform(0, 2 * np.pi, size=(count, 3))
    turn = Rotation.from_rotvec(rng.normal(scale=0.6, size=(12, 3)))
    slerp = Slerp(np.linspace(-1, duration + 1, 12), turn)

    def at(time):
        order = np.arange(1, count + 1)[:, None]
        wave = amplitude * np.sin(order * time * 0.7 + phase)
        return wave.sum(axis=0), slerp(time)

    return at


def write(name, stamps, positions, rotations):
    with open(HERE / name, "w") as out:
        for t, p, r in zip(stamps, positions, rotations):
            q = r.as_quat()
            out.write(f"{t:.6f} " + " ".join(f"{v:.7f}" for v in [*p, *q]) + "\n")


def example(name, seed, truth_times, estimate_times, scale, noise_m, noise_rad):
    rng = np.random.default_rng(seed)
    at = smooth_path(rng, max(truth_times[-1], estimate_times[-1]) - truth_times[0] + 1.0)
    start = truth_times[0]
    truth = [at(t - start) for t in truth_times]
    write(f"{name}-truth.txt", truth_times, *zip(*truth))
    turn, shift = Rotation.from_rotvec(rng.normal(size=3)), rng.normal(size=3)
    positions, rotations = [], []
    for t in estimate_times:
        p, r = at(np.clip(t - start, 0, None))
        drift = 1.0 + 0.02 * (t - start)
        positions.append(turn.apply((p + rng.normal(scale=noise_m, size=3)) * scale * drift) + shift)
        rotations.append(turn * r * Rotation.from_rotvec(rng.normal(scale=noise_rad, size=3)))
    write(f"{name}-estimate.txt", estimate_times, positions, rotations)


def judge(name):
    truth = file_interface.read_tum_trajectory_file(HERE / f"{name}-truth.txt")
    estimate = file_interface.read_tum_trajectory_file(HERE / f"{name}-estimate.txt")
    truth, estimate = sync.associate_trajectories(truth, estimate, max_diff=0.01)
    result = {}
    for alignment in ["sim3", "se3", "none"]:
        aligned = copy.deepcopy(estimate)
        scale = 1.0
        if alignment != "none":
            _, _, scale = aligned.align(truth, correct_scale=alignment == "sim3")
        ape = metrics.APE(metrics.PoseRelation.translation_part)
        ape.process_data((truth, aligned))
        numbers = {"matched": truth.num_poses, "scale": scale}
        for key in ["rmse", "mean", "median", "std", "max", "min"]:
            numbers[f"ate_{key}"] = ape.get_all_statistics()[key]
        for key, relation in [
            ("rpe_trans", metrics.PoseRelation.translation_part),
            ("rpe_rot_deg", metrics.PoseRelation.rotation_angle_deg),
        ]:
            rpe = metrics.RPE(relation, 1, metrics.Unit.frames)
            rpe.process_data((truth, aligned))
            for statistic in ["rmse", "mean", "median", "std", "max", "min"]:
                numbers[f"{key}_{statistic}"] = rpe.get_all_statistics()[statistic]
        result[alignment] = numbers
    return result


def main():
    epoch = 1305031098.6659
    frames = np.arange(90) / 30.0
    jitter = np.random.default_rng(5).uniform(-0.004, 0.004, size=200)
    # A fast truth on another clock phase; the estimate has a gap.
    example("fast-truth", 1, epoch + np.arange(160) * 0.02 + jitter[:160] / 2,
            epoch + 0.003 + np.delete(frames, np.s_[40:52]), 0.4, 0.004, 0.002)
    # Fewer true poses than estimated ones, times that tie at half the interval.
    example("sparse-truth", 2, 0.1 * np.arange(40) + 0.005, 0.03 * np.arange(130), 3.0, 0.01, 0.01)
    # As many of both; part of them too far apart in time.
    example("jitter", 3, 0.05 * np.arange(60), 0.05 * np.arange(60) + 3 * jitter[:60], 1.0, 0.02, 0.03)
    names = ["fast-truth", "sparse-truth", "jitter"]
    numbers = {"evo": __version__, "examples": {name: judge(name) for name in names}}
    (HERE / "evo.json").write_text(json.dumps(numbers, indent=1) + "\n")


if __name__ == "__main__":
    main()
