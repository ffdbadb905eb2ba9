"""Images in, a map out: one by one, and by the whole program."""

import numpy as np
import pytest

import monogrid
from monogrid import Camera, Slam


def pictures(folder):
    """Time and grey values of each frame; PNG files are decoded by matplotlib."""
    from matplotlib import image

    for line in (folder / "rgb.txt").read_text().splitlines():
        if not line.startswith("#"):
            time, name = line.split()
            yield float(time), np.round(image.imread(folder / name) * 255).astype(np.uint8)


def test_pushed_images_find_the_true_path_and_a_map(sequence):
    camera = Camera.read(sequence / "calibration.txt")
    assert camera.size == (320, 240)
    slam = Slam(camera, settings=["mapping.resolution=0.05"])
    frames = [slam.push(image, time) for time, image in pictures(sequence)]
    assert [frame.index for frame in frames] == list(range(len(frames)))
    assert frames[-1].state == "good" and frames[-1].pose.shape == (4, 4)
    assert frames[0].state == "initialising" and frames[0].pose is None and frames[0].reason
    assert slam.map().counts["occupied"] > 0
    result = slam.finish()
    assert result.num_keyframes >= 2 and result.map.counts["free"] > 1000
    truth = monogrid.read_trajectory(sequence / "groundtruth.txt")
    report = monogrid.evaluate_trajectory(result.times, result.poses, *truth)
    assert report["ate_rmse"] < 0.02 and report["coverage"] > 0.9
    with pytest.raises(RuntimeError, match="finished"):
        slam.map()


def test_images_that_do_not_fit_are_refused():
    slam = Slam(Camera(80, 60, 60.0, 60.0, 39.5, 29.5))
    for image in (np.zeros((60, 80)), np.zeros((80, 60), np.uint8), np.zeros((60, 80, 4), np.uint8)):
        with pytest.raises(ValueError, match="expected uint8 of shape"):
            slam.push(image, 0.0)
    with pytest.raises(ValueError, match="finite"):
        slam.push(np.zeros((60, 80), np.uint8), float("nan"))
    assert slam.push(np.zeros((60, 80), np.uint8), 0.0).state == "initialising"
    again = slam.push(np.zeros((60, 80), np.uint8), 0.1)
    assert again.state == "unused" and "repeats" in again.reason
    with pytest.raises(ValueError, match="mapping.resolutoin"):
        Slam(Camera(80, 60, 60.0, 60.0, 39.5, 29.5), settings=["mapping.resolutoin=1"])
    with pytest.raises(ValueError, match="radial-tangential"):
        Camera(80, 60, 60.0, 60.0, 39.5, 29.5, [0.1])


def test_the_whole_program_runs_from_python(sequence, tmp_path):
    run = monogrid.run(
        sequence, out=tmp_path / "run", align=f"gt:{sequence}/groundtruth.txt", set={"mapping.resolution": 0.064}, quiet=True
    )
    times, poses = run.trajectory
    assert run.summary["tracked"] == len(times) and run.report.exists()
    truth = monogrid.OccupancyMap.read(sequence / "truth.ot")
    report = monogrid.evaluate_map(run.map, truth)
    roc = report["roc"]["observed"]
    assert report["policies"]["observed"]["auc"] > 0.8 and len(roc) > 2
    with pytest.raises(monogrid.CommandError, match="notes.txt") as failure:
        (tmp_path / "notes.txt").write_text("hello")
        monogrid.command("info", tmp_path / "notes.txt", quiet=True)
    assert failure.value.exit_code == 2
