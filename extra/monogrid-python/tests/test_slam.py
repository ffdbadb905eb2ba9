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


def inertial(sequence):
    """imu_from_camera, times and readings of the sensor beside the camera."""
    sensor = sequence / "mav0/imu0"
    numbers = (sensor / "sensor.yaml").read_text().split("data: [")[1].split("]")[0]
    camera_from_imu = np.array([float(number) for number in numbers.split(",")]).reshape(4, 4)
    table = np.loadtxt(sensor / "data.csv", delimiter=",")
    return np.linalg.inv(camera_from_imu), table[:, 0] * 1e-9, table[:, 1:4], table[:, 4:7]


def test_readings_of_an_inertial_sensor_make_the_map_metric_and_level(sequence):
    mount, times, gyroscope, accelerometer = inertial(sequence)
    slam = Slam(Camera.read(sequence / "calibration.txt"), imu=monogrid.Imu(mount), settings=["mapping.resolution=0.05"])
    told, begin = [], 0
    for time, image in pictures(sequence):
        end = max(int(np.searchsorted(times, time)) - 2, begin)
        slam.push_imu(times[begin:end], gyroscope[begin:end], accelerometer[begin:end])
        told.append(slam.push(image, time))
        # the readings that are late come one by one
        for k in range(end, end + 4):
            told.append(slam.push_imu(times[k], gyroscope[k], accelerometer[k]))
        begin = end + 4
    indices = [frame.index for frame in told if frame is not None and frame.index is not None]
    assert indices == list(range(120))
    assert any(frame is not None and "waits" in (frame.reason or "") for frame in told)
    result = slam.finish()
    assert result.is_metric and result.is_level
    scale = np.cbrt(np.linalg.det(result.map_from_world[:3, :3]))
    truth = monogrid.read_trajectory(sequence / "groundtruth.txt")
    report = monogrid.evaluate_trajectory(result.times, result.poses, *truth)
    assert abs(scale / report["scale"] - 1) < 0.05
    # up of the map is up of the truth
    when = np.searchsorted(truth[0], result.times[-1] - 1e-6)
    up = result.map_from_world[2, :3] / scale @ result.poses[-1][:3, :3]
    assert up @ truth[1][when][2, :3] > np.cos(np.radians(2))


def test_readings_that_are_none_are_refused():
    camera = Camera(80, 60, 60.0, 60.0, 39.5, 29.5)
    with pytest.raises(ValueError, match="imu=Imu"):
        Slam(camera).push_imu(0.0, [0, 0, 0], [0, 0, 9.8])
    slam = Slam(camera, imu=monogrid.Imu())
    assert slam.push_imu(0.0, [0, 0, 0], [0, 0, 9.8]) is None
    with pytest.raises(ValueError, match="2 times, 1 readings of the gyroscope"):
        slam.push_imu([0.1, 0.2], [[0, 0, 0]], [[0, 0, 9.8]])
    with pytest.raises(ValueError, match="finite"):
        slam.push_imu(float("nan"), [0, 0, 0], [0, 0, 9.8])
    with pytest.raises(ValueError, match="above 0"):
        monogrid.Imu(gyroscope_noise=-1.0)


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
        sequence, out=tmp_path / "run", imu=sequence / "mav0/imu0/data.csv", align=f"gt:{sequence}/groundtruth.txt", set={"mapping.resolution": 0.064}, quiet=True
    )
    times, poses = run.trajectory
    assert run.summary["tracked"] == len(times) and run.report.exists()
    assert run.summary["inertial"]["metres_per_unit"] > 0
    truth = monogrid.OccupancyMap.read(sequence / "truth.ot")
    report = monogrid.evaluate_map(run.map, truth)
    roc = report["roc"]["observed"]
    assert report["policies"]["observed"]["auc"] > 0.8 and len(roc) > 2
    with pytest.raises(monogrid.CommandError, match="notes.txt") as failure:
        (tmp_path / "notes.txt").write_text("hello")
        monogrid.command("info", tmp_path / "notes.txt", quiet=True)
    assert failure.value.exit_code == 2
