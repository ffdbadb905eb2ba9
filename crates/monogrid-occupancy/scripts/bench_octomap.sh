#!/bin/sh
# Speed against OctoMap (mode=gauss, L = 0.08 m, the thesis' way) on the same scans, in one run:
# CPU seconds per 100k points and their ratios. Needs: apt-get install -y liboctomap-dev g++ python3-numpy
# usage: scripts/bench_octomap.sh [WORK_FOLDER] [SCANS, default 2]
set -eu
here=$(cd "$(dirname "$0")" && pwd); bench=$here/../../../../shared/bench
[ -d "$bench" ] || { echo "SKIPPED: $bench is absent"; exit 0; }
work=${1:-$(mktemp -d)}; scans=${2:-2}; mkdir -p "$work"
[ -x "$work/octomap_baseline" ] || g++ -O3 -o "$work/octomap_baseline" "$bench/octomap_baseline.cpp" -loctomap -loctomath
[ -f "$work/office.scans" ] || python3 "$bench/generate_scans.py" "$work/office.scans" office
cargo build -q --release --manifest-path "$here/../Cargo.toml" --example map_scans
ours=${CARGO_TARGET_DIR:-$here/../../../target}/release/examples/map_scans
cpu() { grep -o ' cpu_per_100k=[0-9.e+-]*' | cut -d= -f2; }
# The best of three: the others measure what else the machine was doing.
best() { for _ in 1 2 3; do "$ours" "$work/office.scans" "$@" scans="$scans" | cpu; done | sort -g | head -1; }
echo "cell     OctoMap  rays (ratio)  fused L=0.08 (ratio)  fused default (ratio)"
for cell in 0.128 0.064 0.032 0.016 0.008; do
  octomap=$("$work/octomap_baseline" "$work/office.scans" $cell 100 mode=gauss L=0.08 quiet=1 scans="$scans" | cpu)
  echo "$cell $octomap $(best $cell rule=rays L=0.08) $(best $cell L=0.08) $(best $cell)" |
    awk '{ printf "%s  %.4f  %.5f (%.1fx)  %.6f (%.0fx)  %.6f (%.0fx)\n", $1, $2, $3, $2/$3, $4, $2/$4, $5, $2/$5 }'
done
