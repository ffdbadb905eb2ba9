"""What holds for everything in the package: documentation, threads, copies, interrupts."""

import ast
import copy
import importlib.metadata
import inspect
import pickle
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import monogrid
from monogrid import Camera, Frame, Imu, OccupancyMap, Slam


def scan(seed, count=2000):
    return np.random.default_rng(seed).normal(size=(count, 3))


def stubs():
    """Name and documentation of everything in the file of signatures."""
    tree = ast.parse(Path(monogrid.__file__).with_name("_monogrid.pyi").read_text())
    for node in tree.body:
        if isinstance(node, ast.ClassDef):
            yield node.name, ast.get_docstring(node)
            names = {item.name: item for item in node.body if isinstance(item, ast.FunctionDef)}
            names.pop("__init__", None)
            yield from ((f"{node.name}.{name}", ast.get_docstring(item)) for name, item in names.items())
        elif isinstance(node, ast.FunctionDef):
            yield node.name, ast.get_docstring(node)


def test_everything_is_documented_at_run_time():
    known = dict(stubs())
    assert len(known) > 50
    for name, said in known.items():
        found = monogrid._monogrid
        for part in name.split("."):
            found = inspect.getattr_static(found, part)
        found = found.__func__ if isinstance(found, staticmethod) else found
        assert said and (found.__doc__ or "").split() == said.split(), name
    # nothing has a documentation here and none there
    for name in monogrid.__all__:
        if name.startswith("__"):
            continue
        value = getattr(monogrid, name)
        assert value.__doc__, name
        if inspect.isclass(value) and value.__module__ == "monogrid" and name in known:
            public = {f"{name}.{member}" for member in vars(value) if not member.startswith("_")}
            assert public <= known.keys(), public - known.keys()


def test_several_threads_read_at_once_and_write_in_turn():
    grid, alone, errors = OccupancyMap(0.1), OccupancyMap(0.1), []
    for seed in range(16):
        alone.insert(scan(seed), rule="rays", threads=1)
    field = alone.distance_field(0.5)

    def work(seeds):
        try:
            for seed in seeds:
                grid.insert(scan(seed), rule="rays", threads=1)
                grid.state(scan(seed))
                grid.cast_rays([[0, 0, 0]], scan(seed, 5000))
                grid.counts, repr(grid), grid.copy()
                grid.merge(OccupancyMap(0.1))
                field.update(alone)
                field.distance(scan(seed))
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=work, args=(range(k, 16, 4),)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert errors == []
    # log-odds are added, in whichever turn
    centres, values = alone.cells()
    assert grid.counts == alone.counts or np.isfinite(grid.log_odds(centres)).all()
    np.testing.assert_array_equal(np.sort(grid.cells()[0], axis=0), np.sort(centres, axis=0))


def copies(value):
    return [pickle.loads(pickle.dumps(value)), copy.copy(value), copy.deepcopy(value)]


def test_maps_are_pickled_and_copied_exactly():
    grid = OccupancyMap(0.1, memory_budget=10**8)
    grid.insert(scan(1), rule="rays")
    centres, values = grid.cells()
    for same in copies(grid):
        np.testing.assert_array_equal(same.log_odds(centres), values)
        assert (same.counts, same.resolution, same.bounds) == (grid.counts, grid.resolution, grid.bounds)
        # another one from now on, which goes on in the same way
        same.insert(scan(2), rule="rays")
        again = grid.copy()
        again.insert(scan(2), rule="rays")
        np.testing.assert_array_equal(same.log_odds(centres), again.log_odds(centres))
        assert not np.array_equal(same.log_odds(centres), grid.log_odds(centres))
    assert OccupancyMap(0.1).bounds == pickle.loads(pickle.dumps(OccupancyMap(0.1))).bounds


@pytest.mark.parametrize(
    ("model", "lens"),
    [
        ("radial-tangential", []),
        ("radial-tangential", [0.1, -0.02, 0.001, 0.002, 0.003]),
        ("rational", [0.1, -0.02, 0.001, 0.002, 0.003, 0.1, 0.01, 0.001]),
        ("equidistant", [0.1, 0.02, 0.003, 0.004]),
        ("fov", [0.9]),
        ("double-sphere", [0.1, 0.5]),
        ("extended-unified", [0.5, 1.1]),
        ("omnidirectional", [0.8, 0.1, 0.02, 0.001, 0.002]),
    ],
)
def test_cameras_are_pickled_and_copied(model, lens):
    camera = Camera(80, 60, 60.5, 61.0, 39.5, 29.25, lens, model=model, rolling_shutter_ms=12.5)
    for same in copies(camera):
        args, keywords = same.__getnewargs_ex__()
        assert (args, keywords) == camera.__getnewargs_ex__()
        assert args == (80, 60, 60.5, 61.0, 39.5, 29.25, lens)
        assert keywords["rolling_shutter_ms"] == 12.5 and repr(same) == repr(camera)


def test_what_a_run_returns_is_pickled_and_copied(sequence):
    from test_slam import pictures

    mount = np.eye(4)
    mount[:3, 3] = [0.1, 0.2, 0.3]
    for same in copies(Imu(mount, gyroscope_walk=1e-5)):
        assert "1e-5" in repr(same)
        np.testing.assert_allclose(same.__getnewargs_ex__()[0][0], mount, atol=1e-12)
    slam = Slam(Camera.read(sequence / "calibration.txt"), settings=["mapping.resolution=0.1"])
    for image, seconds in ((image, time) for time, image in pictures(sequence)):
        frame = slam.push(image, seconds)
    for same in copies(frame) + copies(Frame(None, "unused", "dark")):
        first = frame if same.index is not None else Frame(None, "unused", "dark")
        assert (same.index, same.state, same.reason) == (first.index, first.state, first.reason)
        assert (same.pose is None) == (first.pose is None)
        np.testing.assert_array_equal(same.pose if same.pose is not None else 0, first.pose if first.pose is not None else 0)
    result = slam.finish()
    for same in copies(result):
        np.testing.assert_array_equal(same.poses, result.poses)
        np.testing.assert_array_equal(same.times, result.times)
        np.testing.assert_array_equal(same.map_from_world, result.map_from_world)
        assert same.map.counts == result.map.counts and same.num_keyframes == result.num_keyframes
        assert repr(same) == repr(result)
    with pytest.raises(TypeError, match="cannot pickle"):
        pickle.dumps(slam)


@pytest.mark.parametrize(
    "work",
    [
        "grid.cast_rays([[0, 0, 0]], many)",
        "grid.state(many)",
        "grid.insert(many, rule='rays', threads=1)",
        "grid.distance_field(3.5)",
        "[grid.insert(points, rule='rays') for _ in range(10**6)]",
    ],
)
def test_ctrl_c_ends_everything_within_a_second(work):
    program = (
        "import numpy as np, monogrid, time\n"
        "grid = monogrid.OccupancyMap(0.02)\n"
        "points = np.random.default_rng(1).normal(size=(20000, 3)) * 3\n"
        "grid.insert(points, rule='rays')\n"
        "many = np.random.default_rng(2).normal(size=(4000000, 3))\n"
        "print('begun', flush=True)\n"
        "try:\n"
        "    while True:\n"
        f"        {work}\n"
        "except KeyboardInterrupt:\n"
        "    print('interrupted', flush=True)\n"
        "import os; os._exit(0)\n"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "begun\n"
        time.sleep(0.5)
        begin = time.monotonic()
        process.send_signal(signal.SIGINT)
        assert process.stdout.readline() == "interrupted\n"
        assert time.monotonic() - begin < 1.0


def test_a_map_holds_its_budget():
    grid = OccupancyMap(0.01, memory_budget=1_000_000)
    with pytest.raises(MemoryError, match="memory"):
        grid.insert(scan(1, 20_000) * 5, rule="rays")
    small = OccupancyMap(0.5, memory_budget=1_000_000)
    assert small.insert(scan(1)) == 2000


def test_everything_has_a_repr():
    camera = Camera(80, 60, 60.0, 60.0, 39.5, 29.5)
    grid = OccupancyMap(0.1)
    for value in (camera, grid, grid.distance_field(), Imu(), Slam(camera), Frame(0, "good")):
        assert repr(value).startswith(f"<monogrid.{type(value).__name__}: "), repr(value)


def test_the_wheel_has_the_texts_of_the_licences():
    texts = [file for file in importlib.metadata.files("monogrid") if file.name.startswith("LICENSE")]
    assert sorted(file.name for file in texts) == ["LICENSE-APACHE", "LICENSE-MIT"]
    assert "Permission is hereby granted" in next(f for f in texts if f.name == "LICENSE-MIT").read_text()
