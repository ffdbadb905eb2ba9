"""The command line as functions. Each call is a process of its own, so that it can be interrupted, and leaves nothing behind."""

from __future__ import annotations

import functools
import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ._monogrid import OccupancyMap
from ._trajectory import read_trajectory

_Argument = str | int | float | os.PathLike[str]


class CommandError(RuntimeError):
    """A command that did not do its job: 1 failed, 2 bad input, 3 not tracked, 4 interrupted."""

    def __init__(self, arguments: list[str], exit_code: int, text: str, result: Any) -> None:
        reason = text.strip().rsplit("error: ", 1)[-1] if text.strip() else "no reason was given"
        super().__init__(f"monogrid {' '.join(arguments)} ended with {exit_code}: {reason}")
        self.exit_code = exit_code
        self.text = text
        self.result = result


def _options(options: Mapping[str, Any]) -> list[str]:
    """`max_frames=100, continue_=folder, set={"mapping.resolution": 0.02}` as the command line has them."""
    arguments: list[str] = []
    for name, value in options.items():
        option = "--" + name.rstrip("_").replace("_", "-")
        if value is None or value is False:
            continue
        if value is True:
            arguments.append(option)
        elif isinstance(value, Mapping):
            for key, each in value.items():
                text = str(each).lower() if isinstance(each, bool) else str(each)
                arguments.append(f"{option}={key}={text}")
        else:
            arguments.append(f"{option}={value}")
    return arguments


def command(*arguments: _Argument, quiet: bool = False, **options: Any) -> Any:
    """Does what `monogrid ARGUMENTS --OPTIONS --json` does and returns what it prints as JSON.

    Options are those of the command with `_` for `-` (and a `_` behind words of Python: `continue_`). What the command says
    while it works goes to standard error, unless it is `quiet`. Raises `CommandError` if it fails.
    """
    words = [os.fspath(a) if isinstance(a, os.PathLike) else str(a) for a in arguments]
    words += _options(options)
    call = [sys.executable, "-m", "monogrid", *words, "--json"]
    with subprocess.Popen(call, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stderr is not None
        lines = []
        try:
            # the JSON comes at the very end: what is said before it is read first
            for line in process.stderr:
                lines.append(line)
                if not quiet:
                    print(line, end="", file=sys.stderr, flush=True)
            output = process.stdout.read()
        except BaseException:
            process.terminate()
            raise
    result = json.loads(output) if output.strip() else None
    if process.returncode != 0:
        raise CommandError(words, process.returncode, "".join(lines), result)
    return result


class Run:
    """The folder that `monogrid run` has written."""

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.folder = Path(folder)

    @functools.cached_property
    def summary(self) -> dict[str, Any]:
        """`summary.json`: every number of the run."""
        return json.loads((self.folder / "summary.json").read_text())

    @functools.cached_property
    def map(self) -> OccupancyMap:
        """The global map."""
        return OccupancyMap.read(self.folder / "global.ot")

    @functools.cached_property
    def trajectory(self) -> tuple[np.ndarray, np.ndarray]:
        """Times in seconds and poses `map_from_camera`, shapes (n,) and (n, 4, 4)."""
        return read_trajectory(self.folder / "trajectory.txt")

    @property
    def report(self) -> Path:
        """The page that shows everything."""
        return self.folder / "report.html"

    def __repr__(self) -> str:
        return f"<monogrid.Run: {self.folder}>"


def run(
    source: _Argument,
    *,
    out: str | os.PathLike[str],
    set: Mapping[str, Any] | None = None,
    quiet: bool = False,
    **options: Any,
) -> Run:
    """Maps a video, camera, stream or folder of images: the whole of `monogrid run SOURCE --out OUT`.

    `set` changes settings (`{"mapping.resolution": 0.02}`), `options` are those of the command (`max_frames=100`,
    `calibration="camera.txt"`, `align="gt:groundtruth.txt"`). Raises `CommandError` if it fails; with `exit_code` 3 if tracking
    never started or was lost for good.
    """
    command("run", source, out=out, set=set, quiet=quiet, **options)
    return Run(out)
