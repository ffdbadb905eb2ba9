"""A short rendered video of the built-in room, made by the package."""

import pytest

import monogrid


@pytest.fixture(scope="session")
def sequence(tmp_path_factory):
    folder = tmp_path_factory.mktemp("synth") / "room"
    monogrid.command(
        "synth", "living-room", out=folder, max_frames=120, size="320x240", truth_resolution=0.064, quick_light=True, imu=True, quiet=True
    )
    return folder
