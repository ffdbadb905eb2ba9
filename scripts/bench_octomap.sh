#!/bin/sh
# Speed and quality of occupancy maps against OctoMap on the same scans, in one run.
# Needs: apt-get install -y liboctomap-dev g++ python3-numpy
# usage: scripts/bench_octomap.sh [WORK_FOLDER] [SCANS, default 12; 45 for the whole room]
# 1. CPU seconds per 100k points with Thrun's model, L = 0.08 m (OctoMap: mode=gauss, the thesis' way), one thread, and
#    the ratios; two threads as wall seconds of one over wall seconds of two
# 2. AUC and MCC over the observed cells of the whole room, against OctoMap's mode=cloudd; memory of our maps
set -eu
here=$(cd "$(dirname "$0")/.." && pwd); bench=$here/../shared/bench
[ -d "$bench" ] || { echo "SKIPPED: $bench is absent"; exit 0; }
work=${1:-$(mktemp -d)}; scans=${2:-12}; mkdir -p "$work"
[ -x "$work/octomap_baseline" ] || g++ -O3 -o "$work/octomap_baseline" "$bench/octomap_baseline.cpp" -loctomap -loctomath
[ -f "$work/office.scans" ] || python3 "$bench/generate_scans.py" "$work/office.scans" office
cargo build -q --release --manifest-path "$here/Cargo.toml" -p monogrid-occupancy --examples
examples=${CARGO_TARGET_DIR:-$here/target}/release/examples
field() { grep -o " $1=[0-9.e+-]*" | cut -d= -f2; }
# The best of three: the others measure what else the machine was doing.
best() { name=$1; shift; for _ in 1 2 3; do "$examples/map_scans" "$work/office.scans" "$@" | field "$name"; done | sort -g | head -1; }

echo "cell     OctoMap  rays (ratio)  fused L=0.08 (ratio)  fused default (ratio)  rays, 2 threads (speed-up)"
for cell in ${CELLS:-0.128 0.064 0.032 0.016 0.008}; do
  octomap=$("$work/octomap_baseline" "$work/office.scans" "$cell" 100 mode=gauss L=0.08 quiet=1 scans="$scans" | field cpu_per_100k)
  echo "$cell $octomap $(best cpu_per_100k "$cell" rule=rays L=0.08 scans="$scans") $(best cpu_per_100k "$cell" L=0.08 scans="$scans")" \
    "$(best cpu_per_100k "$cell" scans="$scans") $(best wall_per_100k "$cell" rule=rays L=0.08 scans="$scans")" \
    "$(best wall_per_100k "$cell" rule=rays L=0.08 scans="$scans" threads=2)" |
    awk '{ printf "%s  %.4f  %.5f (%.1fx)  %.6f (%.0fx)  %.6f (%.0fx)  %.5f (%.2fx)\n", $1, $2, $3, $2/$3, $4, $2/$4, $5, $2/$5, $7, $6/$7 }'
done

echo "quality of the whole room, observed cells"
for cell in ${QUALITY_CELLS:-0.128 0.064 0.032}; do
  "$work/octomap_baseline" "$work/office.scans" "$cell" 100 mode=cloudd quiet=1 out="$work/cloudd.ot" > /dev/null 2>&1
  for rule in rays fused; do
    "$examples/map_scans" "$work/office.scans" "$cell" rule=$rule threads=2 out="$work/$rule.ot" | grep -o 'mem_mb=.*' | sed "s/^/$rule at $cell: /"
  done
  "$examples/box_room_quality" "$work/office.obj" "$work/cloudd.ot" "$work/rays.ot" "$work/fused.ot"
done
