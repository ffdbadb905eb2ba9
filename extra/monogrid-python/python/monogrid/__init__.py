"""From the video of one camera to a 3D occupancy map; occupancy maps for any sensor.

>>> import monogrid, numpy as np
>>> grid = monogrid.OccupancyMap(resolution=0.05)
>>> angles = np.linspace(0, 2 * np.pi, 2000)
>>> ring = np.stack([2 * np.cos(angles), 2 * np.sin(angles), 0 * angles], axis=1)
>>> grid.insert(ring, rule="rays")
2000
>>> grid.state([[1, 0, 0], [2, 0, 0], [3, 0, 0]]).tolist()  # free, occupied, unknown
[0, 1, -1]

`run` and `command` do all that the command line does; `Slam` takes images one by one.
"""

from ._monogrid import (
    Camera,
    DistanceField,
    Frame,
    Imu,
    OccupancyMap,
    Slam,
    SlamResult,
    __version__,
    evaluate_map,
    evaluate_trajectory,
)
from ._command import CommandError, Run, command, run
from ._trajectory import read_trajectory

__all__ = [
    "Camera",
    "CommandError",
    "DistanceField",
    "Frame",
    "Imu",
    "OccupancyMap",
    "Run",
    "Slam",
    "SlamResult",
    "__version__",
    "command",
    "evaluate_map",
    "evaluate_trajectory",
    "read_trajectory",
    "run",
]
