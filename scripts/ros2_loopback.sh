#!/usr/bin/env bash
# The ROS 2 node beside a camera of 30 Hz in another process, for 60 s: what became of the images, whether grid and map arrive as they are in
# the files, latency, and what the node costs. The sequence (red-kitchen, 640x480) is sent forth and back.
set -euo pipefail
cd "$(dirname "$0")/.."

sequence=$(realpath "${1:-${MONOGRID_DATA:-${SHARED:-../shared}/data}/red-kitchen}")
LOOPBACK_SEQUENCE=$sequence cargo test -p monogrid-ros2 --test loopback -- --ignored --nocapture
