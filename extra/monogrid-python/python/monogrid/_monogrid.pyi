"""Signatures and documentation of the compiled part."""

import os
from collections.abc import Sequence
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

__version__: str

def main(arguments: Sequence[str]) -> int:
    """Does what a command line asks for, the name of the program first; the exit code. Takes the whole process."""

def evaluate_trajectory(
    times: ArrayLike,
    poses: ArrayLike,
    true_times: ArrayLike,
    true_poses: ArrayLike,
    *,
    align: str = "sim3",
    max_difference: float = 0.01,
) -> dict[str, Any]:
    """ATE and RPE as `evo` computes them, scale drift, coverage, as `monogrid evaluate trajectory --json` prints them.

    Times in seconds, shape (n,); poses `world_from_camera`, shape (n, 4, 4). `align`: "sim3", "se3" or "none".
    """

def evaluate_map(estimate: OccupancyMap, truth: OccupancyMap, *, tolerance: float | None = None) -> dict[str, Any]:
    """ROC, AUC, MCC, calibration and distances under four rules for unknown cells, as `monogrid evaluate map --json` prints them.

    The truth has cells of the same size, or of a whole fraction of it. Keys: `policies` (each with `roc`), `surface`, ...
    """

@final
class OccupancyMap:
    """Log-odds of occupancy per cell, compatible with OctoMap. Lengths are in map units (metres, if the measurements are).

    memory_budget: bytes that the map may take (default: 8 GiB); MemoryError where a scan would need more.
    Several threads may look at a map at once, and change it in turn. It can be pickled and copied.
    """

    def __init__(self, resolution: float = 0.05, *, memory_budget: int | None = None) -> None: ...
    @staticmethod
    def read(path: str | os.PathLike[str]) -> OccupancyMap:
        """Reads `.ot`, `.bt` (OctoMap) or `.mgo`, whatever the name."""
    def write(self, path: str | os.PathLike[str]) -> None:
        """Writes `.ot`, `.bt`, `.mgo`, `.ply` or `.pcd`; a file that exists is replaced whole or not at all."""
    def insert(
        self,
        points: ArrayLike,
        pose: ArrayLike | None = None,
        *,
        origin: Sequence[float] | None = None,
        sigma: ArrayLike | None = None,
        rule: str = "fused",
        max_range: float | None = None,
        threads: int | None = None,
    ) -> int:
        """Adds a scan; how many points were used.

        points: shape (n, 3), in the frame of the sensor (read without a copy if float32), or, with `origin`, in that of the map.
        pose: `map_from_sensor`, shape (4, 4). sigma: standard deviation of each range, or one for all, positive (default: half a cell).
        Points that are not finite are left out. ValueError or TypeError where anything else is not what is expected.
        rule: "fused" for scans that cover surfaces, "rays" for lone points.
        """
    def insert_depth(
        self,
        depth: ArrayLike,
        fx: float,
        fy: float,
        cx: float,
        cy: float,
        pose: ArrayLike | None = None,
        *,
        depth_scale: float | None = None,
        relative_sigma: float = 0.01,
        rule: str = "fused",
        max_range: float | None = None,
        threads: int | None = None,
    ) -> int:
        """Adds a depth image; how many pixels were used.

        depth: shape (height, width), along the optical axis, 0 or NaN where unknown; floats are metres, integers need a `depth_scale`:
        metres of a unit (0.001 for millimetres), or units of a metre (1000; 5000 for TUM RGB-D). TypeError without it. pose:
        `map_from_camera` (x right, y down, z forward), shape (4, 4). relative_sigma: standard deviation as a part of the depth.
        """
    def state(self, points: ArrayLike) -> NDArray[np.int8]:
        """Of each point, shape (n, 3): 1 occupied, 0 free, -1 unknown."""
    def log_odds(self, points: ArrayLike) -> NDArray[np.float32]:
        """Of each point, shape (n, 3); NaN where unknown."""
    def collides(self, points: ArrayLike, radius: float, *, unknown_blocks: bool = False) -> NDArray[np.bool_]:
        """Whether a ball around each point touches an occupied (or unknown) cell."""
    def cast_rays(
        self, origins: ArrayLike, directions: ArrayLike, max_range: float = 100.0, *, unknown_blocks: bool = False
    ) -> tuple[NDArray[np.float64], NDArray[np.int8]]:
        """Range of the first occupied (or unknown) cell on each ray, infinite where there is none, and its state (0: none).

        origins: shape (n, 3) or (1, 3) for all. directions: shape (n, 3), of any length.
        """
    def distance_field(self, max_distance: float = 1.0, *, unknown_blocks: bool = False) -> DistanceField:
        """Distances to the nearest obstacle, up to `max_distance`."""
    def cells(self, state: int | None = None) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """Centres, shape (n, 3), and log-odds of all known cells, or of the free (0) or occupied (1) ones."""
    def dense(
        self, low: Sequence[float] | None = None, high: Sequence[float] | None = None
    ) -> tuple[NDArray[np.float32], tuple[float, float, float]]:
        """Log-odds of a box as an array [x, y, z], NaN where unknown, and the corner of its first cell."""
    def project(self, low: float, high: float) -> tuple[NDArray[np.int8], tuple[float, float]]:
        """Seen from above between two heights, as [row from below, column] (1, 0, -1), and the lower left corner."""
    def merge(self, other: OccupancyMap) -> None:
        """Adds the log-odds of a map with cells of the same size."""
    def crop(self, low: Sequence[float], high: Sequence[float]) -> OccupancyMap:
        """The part in a box."""
    def copy(self) -> OccupancyMap:
        """A copy, at once: cells are copied when one of the two is changed."""
    @property
    def resolution(self) -> float:
        """Edge of a cell."""
    @property
    def bounds(self) -> tuple[tuple[float, float, float], tuple[float, float, float]] | None:
        """Corners of the box of all known cells."""
    @property
    def counts(self) -> dict[str, int]:
        """Number of occupied and of free cells."""

@final
class DistanceField:
    """Distance from everywhere to the nearest obstacle; made by `OccupancyMap.distance_field`."""

    def distance(self, points: ArrayLike) -> NDArray[np.float64]:
        """Of each point, shape (n, 3), from the centre of its cell; infinite beyond the reach."""
    def gradient(self, points: ArrayLike) -> NDArray[np.float64]:
        """Direction in which the distance grows, shape (n, 3); NaN where there is none."""
    def update(self, map: OccupancyMap) -> int:
        """Follows the map that it was made of; how many bricks were looked at."""

@final
class Camera:
    """Size of the images, pinhole and lens. The centre of the top-left pixel is (0, 0).

    `model`: "radial-tangential" (k1, k2, p1, p2, k3 as OpenCV), "rational" (eight numbers in the order of OpenCV),
    "equidistant" (four), "fov" (one), "double-sphere" (xi, alpha), "extended-unified" (alpha, beta) or
    "omnidirectional" (xi, k1, k2, p1, p2).
    """

    def __init__(
        self,
        width: int,
        height: int,
        fx: float,
        fy: float,
        cx: float,
        cy: float,
        distortion: Sequence[float] | None = None,
        *,
        model: str = "radial-tangential",
        rolling_shutter_ms: float = 0.0,
    ) -> None: ...
    @staticmethod
    def read(path: str | os.PathLike[str], size: tuple[int, int] | None = None) -> Camera:
        """Reads any calibration file that the program understands; `size` where the file does not say it."""
    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the images, px."""
    @property
    def pinhole(self) -> tuple[float, float, float, float]:
        """fx, fy, cx and cy, px."""
    @property
    def rolling_shutter_ms(self) -> float:
        """Time from the first row of an image to the last, ms."""

@final
class Frame:
    """What became of an image."""

    def __init__(
        self,
        index: int | None,
        state: str,
        reason: str | None = None,
        is_keyframe: bool = False,
        pose: ArrayLike | None = None,
    ) -> None: ...
    @property
    def index(self) -> int | None:
        """Which image it is, from 0 on; None where it was not used."""
    @property
    def state(self) -> str:
        """"initialising", "good", "degraded", "fragment", "lost", or "unused"."""
    @property
    def reason(self) -> str | None:
        """Why it is not good."""
    @property
    def pose(self) -> NDArray[np.float64] | None:
        """`world_from_camera`, shape (4, 4), as known now; the world is the first keyframe's camera."""
    @property
    def is_keyframe(self) -> bool:
        """Whether it became a keyframe."""

@final
class Imu:
    """An inertial sensor beside the camera: how it is mounted, and its noise as densities (rad/s/√Hz, m/s²/√Hz, rad/s²/√Hz,
    m/s³/√Hz; by default those of a phone).

    imu_from_camera: shape (4, 4), metres; without it the axes of the sensor are taken to be the camera's (x right, y down, z ahead).
    """

    def __init__(
        self,
        imu_from_camera: ArrayLike | None = None,
        *,
        gyroscope_noise: float | None = None,
        accelerometer_noise: float | None = None,
        gyroscope_walk: float | None = None,
        accelerometer_walk: float | None = None,
    ) -> None: ...

@final
class Slam:
    """Images of one camera in, poses and a growing map out. The same images and settings give the same bytes.

    imu: a sensor whose readings come by `push_imu`: the map becomes level and metric when they are sure enough. mask: uint8, shape (height, width), 0 where pixels must be ignored. config: a `config.toml`,
    e.g. one that says `profile = "fast"` for a small computer. settings: changes of it, as
    `["mapping.resolution=0.02"]`.
    """

    def __init__(
        self,
        camera: Camera,
        *,
        imu: Imu | None = None,
        mask: ArrayLike | None = None,
        config: str | os.PathLike[str] | None = None,
        settings: Sequence[str] = (),
        threads: int | None = None,
    ) -> None: ...
    def push(self, image: NDArray[np.uint8], seconds: float) -> Frame:
        """Takes the next image, uint8 of shape (height, width) or (height, width, 3: red, green, blue).

        With a rolling shutter, or when readings until its time are missing, it tells what became of the image before, and of this one
        later.
        """
    def push_imu(self, seconds: ArrayLike, gyroscope: ArrayLike, accelerometer: ArrayLike) -> Frame | None:
        """Takes readings: times (n,) on the clock of the images, rad/s (n, 3), m/s² with gravity in it (n, 3); or a single one.

        Readings come before images that are later. Tells what became of the image that waited for them, if one did.
        """
    def map(self) -> OccupancyMap | None:
        """The map as it is now, z up as the first camera was held, or as an inertial sensor says; None before the first finished
        keyframe."""
    def finish(self) -> SlamResult:
        """Ends the run: final depth, poses and map. What Ctrl-C interrupts here is lost."""

@final
class SlamResult:
    """What a run has found."""

    @property
    def map(self) -> OccupancyMap | None:
        """z up as the first camera was held, or as an inertial sensor says; None if nothing was mapped."""
    @property
    def map_from_world(self) -> NDArray[np.float64]:
        """From the world of `poses` to the map: scale times rotation, and translation, shape (4, 4)."""
    @property
    def is_metric(self) -> bool:
        """Whether lengths of the map are metres."""
    @property
    def is_level(self) -> bool:
        """Whether z of the map is against gravity by an inertial sensor."""
    @property
    def times(self) -> NDArray[np.float64]:
        """Seconds of every frame with a pose."""
    @property
    def poses(self) -> NDArray[np.float64]:
        """`world_from_camera` of every frame with a pose, shape (n, 4, 4); the world is the first keyframe's camera."""
    @property
    def num_keyframes(self) -> int:
        """How many keyframes there are."""
