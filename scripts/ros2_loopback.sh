#!/usr/bin/env bash
# The ROS 2 node beside a camera of 30 Hz in another process, for 60 s: what became of the images, whether grid and map arrive as they are in
# the files, latency, and what the node costs.
#
#   scripts/ros2_loopback.sh [SEQUENCE]
#
# A sequence (default: red-kitchen of scripts/data.sh, 640x480) is sent forth and back; where there is none, the built-in living room.
set -euo pipefail
cd "$(dirname "$0")/.."

sequence=${1:-${MONOGRID_DATA:-${SHARED:-../shared}/data}/red-kitchen}
if [ $# -gt 0 ] || [ -d "$sequence" ]; then
  LOOPBACK_SEQUENCE=$(realpath "$sequence")
  export LOOPBACK_SEQUENCE
fi
cargo test --release -p monogrid-ros2 --test loopback -- --ignored --nocapture --test-threads 1
