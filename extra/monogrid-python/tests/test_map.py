"""Occupancy maps against numpy."""

import threading

import numpy as np
import pytest

import monogrid
from monogrid import OccupancyMap


def wall():
    """A wall at z = 2 seen from the origin, as points in float32."""
    x, y = np.meshgrid(np.arange(-1, 1, 0.01), np.arange(-1, 1, 0.01))
    return np.stack([x, y, np.full_like(x, 2.0)], axis=-1).reshape(-1, 3).astype(np.float32)


@pytest.fixture
def grid():
    grid = OccupancyMap(0.05)
    assert grid.insert(wall()) == 40_000
    return grid


def test_points_make_occupied_free_and_unknown_cells(grid):
    questions = np.array([[0, 0, 2.0], [0, 0, 1.0], [0, 0, 3.0]])
    assert grid.state(questions).tolist() == [1, 0, -1]
    log_odds = grid.log_odds(questions)
    assert log_odds[0] > 0 > log_odds[1] and np.isnan(log_odds[2])
    centres, values = grid.cells()
    np.testing.assert_array_equal(grid.log_odds(centres), values)
    assert grid.counts == {"occupied": (values > 0).sum(), "free": (values < 0).sum()}
    occupied, _ = grid.cells(1)
    assert np.abs(occupied[:, 2] - 2).max() < 0.15
    assert "occupied" in repr(grid)


def test_a_dense_array_has_every_cell_where_it_is(grid):
    values, origin = grid.dense()
    index = np.argwhere(~np.isnan(values))
    centres = np.array(origin) + (index + 0.5) * grid.resolution
    np.testing.assert_array_equal(grid.log_odds(centres), values[tuple(index.T)])
    assert len(index) == sum(grid.counts.values())
    low, high = grid.bounds
    np.testing.assert_allclose(low, origin)
    np.testing.assert_allclose(np.array(high) - low, np.array(values.shape) * grid.resolution)
    part, _ = grid.dense([0, 0, 0], [0.5, 0.5, 1])
    assert part.shape == (11, 11, 21)


@pytest.mark.parametrize("name", ["a.ot", "a.mgo", "a.bt"])
def test_files_hold_what_was_written(grid, tmp_path, name):
    grid.write(tmp_path / name)
    again = OccupancyMap.read(tmp_path / name)
    centres, values = grid.cells()
    if name == "a.bt":
        np.testing.assert_array_equal(again.state(centres), grid.state(centres))
    else:
        np.testing.assert_allclose(again.log_odds(centres), values, atol=1e-3)
    assert again.counts == grid.counts


def test_poses_move_scans_and_origins_say_where_they_come_from():
    pose = np.eye(4)
    pose[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    pose[:3, 3] = [1, 2, 3]
    by_pose, by_origin = OccupancyMap(0.05), OccupancyMap(0.05)
    by_pose.insert(wall(), pose)
    in_map = wall().astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
    by_origin.insert(in_map, origin=pose[:3, 3])
    centres, _ = by_pose.cells()
    same = by_pose.state(centres) == by_origin.state(centres)
    assert same.mean() > 0.97  # directions are sampled in the sensor's frame
    assert by_pose.state([[3, 2, 3]]) == 1


def test_depth_images_are_the_points_that_they_show(grid):
    depth = np.full((200, 200), 2.0)
    depth[:40] = np.nan
    by_depth = OccupancyMap(0.05)
    assert by_depth.insert_depth(depth, 200.0, 200.0, 99.5, 99.5) == 160 * 200
    assert by_depth.state([[0, 0, 2], [0, 0, 1], [0, -0.9, 1.9]]).tolist() == [1, 0, -1]


def test_integers_are_no_metres_unless_it_is_said():
    camera = (200.0, 200.0, 99.5, 99.5)
    metres = np.full((200, 200), 2.0, dtype=np.float32)
    metres[:40] = 0
    expected = OccupancyMap(0.05)
    assert expected.insert_depth(metres, *camera) == 160 * 200
    for dtype, units, scales in [(np.uint16, 1000, (0.001, 1000)), (np.int32, 5000, (1 / 5000, 5000)), (np.uint8, 1, (1.0,))]:
        depth = (metres * units).astype(dtype)
        grid = OccupancyMap(0.05)
        with pytest.raises(TypeError, match="array of integers, expected floats in metres, or depth_scale"):
            grid.insert_depth(depth, *camera)
        assert grid.counts == {"occupied": 0, "free": 0}
        for scale in scales:
            grid = OccupancyMap(0.05)
            assert grid.insert_depth(depth, *camera, depth_scale=scale) == 160 * 200
            assert grid.counts == expected.counts, (dtype, scale)
    by_floats = OccupancyMap(0.05)
    by_floats.insert_depth(metres * 1000, *camera, depth_scale=0.001)
    assert by_floats.counts == expected.counts
    # not contiguous, other byte order, other width
    for depth in [metres.T, metres[::-1], metres[:, ::2], metres.astype(">f4"), metres.astype(np.float16)]:
        OccupancyMap(0.05).insert_depth(depth, *camera)
    strided = np.zeros((200, 400), dtype=np.float32)
    strided[:, ::2] = metres
    grid = OccupancyMap(0.05)
    grid.insert_depth(strided[:, ::2], *camera)
    assert grid.counts == expected.counts


@pytest.mark.parametrize(
    ("change", "error", "said"),
    [
        ({"depth": [[2, 2]]}, TypeError, "integers"),
        ({"depth": np.ones((4, 4), dtype=bool)}, TypeError, "neither floats nor integers"),
        ({"depth": np.ones((4, 4), dtype=complex)}, TypeError, "neither floats nor integers"),
        ({"depth": np.array([["2.0"]])}, TypeError, "neither floats nor integers"),
        ({"depth": np.ones(16)}, ValueError, r"shape \(16,\), expected \(height, width\)"),
        ({"depth": np.ones((4, 4, 1))}, ValueError, r"shape \(4, 4, 1\), expected"),
        ({"depth_scale": 0.0}, ValueError, "depth_scale is 0"),
        ({"depth_scale": -0.001}, ValueError, "depth_scale is -0.001"),
        ({"depth_scale": np.nan}, ValueError, "depth_scale is NaN"),
        ({"relative_sigma": -0.01}, ValueError, "relative_sigma is -0.01"),
        ({"relative_sigma": 0.0}, ValueError, "relative_sigma is 0"),
        ({"relative_sigma": np.nan}, ValueError, "relative_sigma is NaN"),
        ({"fx": -200.0}, ValueError, "fx is -200"),
        ({"fy": np.inf}, ValueError, "fy is inf"),
        ({"cx": np.nan}, ValueError, "principal point"),
        ({"pose": np.full((4, 4), np.nan)}, ValueError, "pose holds NaN"),
        ({"pose": [[1, 0, 0, np.inf], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}, ValueError, "pose holds inf"),
        ({"pose": np.eye(3)}, ValueError, r"pose of shape \[3, 3\], expected \(4, 4\)"),
        ({"pose": np.zeros((2, 4, 4))}, ValueError, "expected"),
        ({"max_range": -1.0}, ValueError, "max_range is -1"),
        ({"max_range": np.nan}, ValueError, "max_range is NaN"),
        ({"threads": 0}, ValueError, "threads is 0"),
    ],
)
def test_depth_images_that_cannot_be_meant(change, error, said):
    given = {"depth": np.full((4, 4), 2.0), "fx": 2.0, "fy": 2.0, "cx": 1.5, "cy": 1.5}
    grid = OccupancyMap(0.05)
    with pytest.raises(error, match=said):
        grid.insert_depth(**(given | change))
    assert grid.counts == {"occupied": 0, "free": 0}
    assert grid.insert_depth(**given) == 16


@pytest.mark.parametrize(
    ("change", "error", "said"),
    [
        ({"sigma": -0.1}, ValueError, "sigma holds -0.1"),
        ({"sigma": 0.0}, ValueError, "sigma holds 0"),
        ({"sigma": np.nan}, ValueError, "sigma holds NaN"),
        ({"sigma": [0.1, np.inf, 0.1]}, ValueError, "sigma holds inf"),
        ({"sigma": [0.1, 0.1]}, ValueError, "2 sigmas of 3 points"),
        ({"sigma": np.ones((3, 1))}, ValueError, r"shape \(3, 1\)"),
        ({"sigma": "0.1"}, TypeError, "expected real numbers"),
        ({"pose": np.diag([1, 1, 1, np.nan])}, ValueError, "pose holds NaN"),
        ({"origin": (0, np.nan, 0)}, ValueError, "origin is"),
        ({"points": np.ones((3, 2))}, ValueError, r"shape \(3, 2\)"),
        ({"points": np.ones(3)}, ValueError, r"shape \(3,\)"),
        ({"points": np.ones((3, 3)) * 1j}, TypeError, "complex128"),
        ({"points": [["a", "b", "c"]]}, TypeError, "expected real numbers"),
        ({"max_range": 0.0}, ValueError, "max_range is 0"),
    ],
)
def test_scans_that_cannot_be_meant(change, error, said):
    grid = OccupancyMap(0.05)
    points = np.array([[0.0, 0.0, 2.0], [0.1, 0.0, 2.0], [0.0, 0.1, 2.0]])
    with pytest.raises(error, match=said):
        grid.insert(**({"points": points} | change))
    assert grid.counts == {"occupied": 0, "free": 0}
    assert grid.insert(np.asfortranarray(points), sigma=[0.1, 0.1, 0.1]) == 3


def test_rays_balls_and_distances(grid):
    directions = np.array([[0, 0, 1.0], [0, 0, -1.0]])
    ranges, states = grid.cast_rays([[0, 0, 0]], directions, 10.0)
    assert abs(ranges[0] - 2) < 0.15 and np.isinf(ranges[1]) and states.tolist() == [1, 0]
    assert grid.collides([[0, 0, 1.8], [0, 0, 1.0]], 0.3).tolist() == [True, False]
    field = grid.distance_field(1.5)
    occupied, _ = grid.cells(1)
    points = np.array([[0.025, 0.025, z] for z in (1.025, 1.525)])
    nearest = np.linalg.norm(occupied[None] - points[:, None], axis=2).min(axis=1)
    np.testing.assert_allclose(field.distance(points), nearest, atol=1e-6)
    assert field.gradient(points)[0, 2] < 0
    grid.insert(wall() * np.float32(0.5))
    field.update(grid)
    assert field.distance(points)[0] < nearest[0]


def test_seen_from_above_merged_and_cropped(grid):
    cells, origin = grid.project(1.0, 1.5)
    assert set(np.unique(cells)) <= {-1, 0, 1} and cells.shape[0] > 10 and len(origin) == 2
    other = grid.copy()
    other.merge(grid)
    assert other.log_odds([[0, 0, 1]]) < grid.log_odds([[0, 0, 1]])
    part = grid.crop([-0.2, -0.2, 1.5], [0.2, 0.2, 2.5])
    assert 0 < part.counts["occupied"] < grid.counts["occupied"]


def test_wrong_input_is_said_in_words(grid, tmp_path):
    with pytest.raises(ValueError, match=r"expected \(n, 3\)"):
        grid.state([[1.0, 2.0]])
    with pytest.raises(ValueError, match="resolution is -1"):
        OccupancyMap(-1)
    with pytest.raises(ValueError, match="fused"):
        grid.insert(wall(), rule="other")
    squeezed = np.diag([1.0, 1.0, 0.5, 1.0])
    with pytest.raises(ValueError, match="rotation"):
        monogrid.evaluate_trajectory([0.0], [squeezed], [0.0], [np.eye(4)])
    with pytest.raises(ValueError, match="not a finite similarity"):
        grid.copy().insert(wall(), squeezed)
    with pytest.raises(FileNotFoundError):
        OccupancyMap.read(tmp_path / "none.ot")
    (tmp_path / "bad.ot").write_text("hello")
    with pytest.raises(ValueError, match="begins neither"):
        OccupancyMap.read(tmp_path / "bad.ot")
    with pytest.raises(ValueError, match="name that ends in"):
        grid.write(tmp_path / "map.xyz")


def test_other_threads_run_while_scans_are_inserted():
    counted, done = [0], threading.Event()

    def count():
        while not done.is_set():
            counted[0] += 1

    thread = threading.Thread(target=count)
    thread.start()
    before = counted[0]
    OccupancyMap(0.02).insert(np.repeat(wall(), 10, axis=0), rule="rays", threads=1)
    during = counted[0] - before
    done.set()
    thread.join()
    assert during > 1000
