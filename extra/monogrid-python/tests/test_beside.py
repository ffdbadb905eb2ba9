"""What the package gives is what evo, Open3D and Rerun take, in one environment (pip install 'monogrid[test,beside]')."""

import numpy as np
import pytest

import monogrid


def test_evo_says_the_same_of_a_trajectory():
    metrics = pytest.importorskip("evo.core.metrics")
    from evo.core.trajectory import PoseTrajectory3D

    times = np.arange(50) * 0.1
    poses = np.tile(np.eye(4), (50, 1, 1))
    poses[:, :3, 3] = np.stack([times, np.sin(times), 0.1 * times**2], axis=1)
    found = poses.copy()
    found[:, :3, 3] = 0.4 * poses[:, :3, 3] + 0.002 * np.random.default_rng(0).normal(size=(50, 3))
    ours = monogrid.evaluate_trajectory(times, found, times, poses)["ate_rmse"]
    truth, estimate = (PoseTrajectory3D(poses_se3=list(p), timestamps=times) for p in (poses, found))
    estimate.align(truth, correct_scale=True)
    error = metrics.APE(metrics.PoseRelation.translation_part)
    error.process_data((truth, estimate))
    assert ours == pytest.approx(error.get_statistic(metrics.StatisticsType.rmse), rel=1e-6)


def test_open3d_and_rerun_take_the_cells_of_a_map(tmp_path):
    open3d = pytest.importorskip("open3d")
    rerun = pytest.importorskip("rerun")
    grid = monogrid.OccupancyMap(0.1)
    grid.insert(np.random.default_rng(1).normal(size=(500, 3)).astype(np.float32) + [5, 0, 0])
    cells, _ = grid.cells(1)
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(cells))
    assert len(cloud.points) == grid.counts["occupied"] > 100
    recording = rerun.RecordingStream("monogrid")
    recording.save(tmp_path / "map.rrd")
    recording.log("map", rerun.Points3D(cells, radii=0.05))
    recording.flush()
    assert (tmp_path / "map.rrd").stat().st_size > 1000
