#!/usr/bin/env bash
# Speed of queries and files on the 16 mm map of the office scans, one thread, and of OctoMap's search
# and castRay on the same map, points and rays. Needs: apt-get install -y liboctomap-dev g++ python3-numpy
# usage: scripts/bench_queries.sh [WORK_FOLDER]
set -eu
here=$(cd "$(dirname "$0")/.." && pwd); bench=${SHARED:-$here/../shared}/bench
[ -d "$bench" ] || { echo "SKIPPED: $bench is absent"; exit 0; }
work=${1:-$(mktemp -d)}; mkdir -p "$work"
[ -f "$work/office.scans" ] || python3 "$bench/generate_scans.py" "$work/office.scans" office
cargo build -q --release --manifest-path "$here/Cargo.toml" -p monogrid-occupancy --examples
examples=${CARGO_TARGET_DIR:-$here/target}/release/examples
[ -f "$work/office.ot" ] || "$examples/map_scans" "$work/office.scans" 0.016 out="$work/office.ot"
query=$here/crates/monogrid-occupancy/tests/octomap/query.cpp
[ "$work/query" -nt "$query" ] || g++ -O3 -o "$work/query" "$query" -loctomap -loctomath
"$examples/query_speed" "$work/office.ot" "$work/questions.bin"
"$work/query" "$work/office.ot" "$work/questions.bin"
"$examples/file_speed" "$work/office.ot"
