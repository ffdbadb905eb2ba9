"""The command: `python -m monogrid run video.mp4`, or `monogrid run video.mp4`."""

import sys

from ._monogrid import main as _main


def main() -> None:
    sys.exit(_main(["monogrid", *sys.argv[1:]]))


if __name__ == "__main__":
    main()
