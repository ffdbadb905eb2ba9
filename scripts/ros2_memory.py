#!/usr/bin/env python3
"""Memory of the ROS 2 node while nobody listens.

    scripts/ros2_memory.py PROGRAM SEQUENCE [MINUTES [HZ]]

Sends the first 60 images of a sequence (a folder with rgb/ and calibration.txt) forth and back to
the node for so many minutes, as many in a second as HZ says, with times 1/30 s apart. No client
listens to anything. Says how much memory the node holds, and how much it has grown since the first
third; fails where that is 2 % or more. Needs `pip install cyclonedds pillow`.
"""

import os
import signal
import subprocess
import sys
import time
from itertools import chain, cycle
from pathlib import Path

from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic
from PIL import Image as Picture
from ros2_peers import DOMAIN, STREAM, Header, Image, Time, wait_for

MOST_GROWTH = 0.02


def memory_mb(pid):
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def grown(pid, folder, minutes, hz):
    """Sends images; the memory of the node every 20 s, MB."""
    participant = DomainParticipant(DOMAIN)
    topic = Topic(participant, "rt/camera/image_raw", Image, qos=STREAM)
    writer = DataWriter(participant, topic, qos=STREAM)
    wait_for("the camera", writer.get_matched_subscriptions)
    files = sorted((folder / "rgb").iterdir())[:60]
    pictures = [Picture.open(file).convert("L") for file in files]
    begin, told, samples = time.monotonic(), 0, []
    for index, picture in enumerate(cycle(chain(pictures, pictures[-2:0:-1]))):
        seconds = time.monotonic() - begin
        if seconds > 60 * minutes:
            break
        time.sleep(max(0, index / hz - seconds))
        ns = 10**18 + index * 10**9 // 30
        header = Header(Time(ns // 10**9, ns % 10**9), "camera")
        width, height = picture.size
        writer.write(Image(header, height, width, "mono8", 0, width, picture.tobytes()))
        if seconds >= told:
            told += 20
            samples.append(memory_mb(pid))
            print(f"{seconds:.0f} s, {index} images, {samples[-1]:.1f} MB", flush=True)
    return samples


def main():
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    program, folder = sys.argv[1], Path(sys.argv[2])
    minutes, hz = (float(sys.argv[k]) if len(sys.argv) > k else d for k, d in ((3, 10), (4, 30)))
    command = [program, "--calibration", folder / "calibration.txt"]
    node = subprocess.Popen(command, env={**os.environ, "ROS_DOMAIN_ID": str(DOMAIN)})
    try:
        samples = grown(node.pid, folder, minutes, hz)
    finally:
        node.send_signal(signal.SIGINT)
        node.wait(60)
    first, last = max(samples[: len(samples) // 3 + 1]), max(samples[-3:])
    print(f"grown from {first:.1f} to {last:.1f} MB: {100 * (last / first - 1):.1f} %")
    if last > first * (1 + MOST_GROWTH):
        sys.exit(f"more than {100 * MOST_GROWTH:.0f} %")


if __name__ == "__main__":
    main()
