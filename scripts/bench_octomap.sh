#!/bin/sh
# Speed, quality and memory of occupancy maps against OctoMap on the same scans, in one run.
# Needs: apt-get install -y liboctomap-dev g++ python3-numpy
# usage: scripts/bench_octomap.sh [WORK_FOLDER] [SCANS, default 45: the whole room; 12 in a tenth of the time]
# Over the whole room OctoMap alone takes 13 minutes at 8 mm and 3 at 16 mm; CELLS="0.128 0.064 0.032" leaves them out.
# 1. CPU seconds per 100k points with Thrun's model, L = 0.08 m (OctoMap: mode=gauss, the thesis' way), one thread, and
#    the ratios; the best of three runs, at 8 mm one run
# 2. two threads: wall seconds of one thread over those of two, and, as what the machine can give, over those of two
#    processes of one thread for the same work twice, in turns; medians of five
# 3. AUC and MCC over the observed cells of the whole room, against OctoMap's mode=cloudd
# 4. memory of the finished default maps, of the large hall as well with MACHINE=1 (a minute and 1.6 GB at 16 mm)
set -eu
here=$(cd "$(dirname "$0")/.." && pwd); bench=${SHARED:-$here/../shared}/bench
[ -d "$bench" ] || { echo "SKIPPED: $bench is absent"; exit 0; }
work=${1:-$(mktemp -d)}; scans=${2:-45}; mkdir -p "$work"
[ -x "$work/octomap_baseline" ] || g++ -O3 -o "$work/octomap_baseline" "$bench/octomap_baseline.cpp" -loctomap -loctomath
[ -f "$work/office.scans" ] || python3 "$bench/generate_scans.py" "$work/office.scans" office
cargo build -q --release --manifest-path "$here/Cargo.toml" -p monogrid-occupancy --examples
examples=${CARGO_TARGET_DIR:-$here/target}/release/examples
field() { grep -o " $1=[0-9.e+-]*" | cut -d= -f2; }
map_scans() { "$examples/map_scans" "$work/office.scans" "$@"; }
# The others measure what else the machine was doing.
best() {
  name=$1; shift; runs="1 2 3"; [ "$1" != 0.008 ] || runs=1
  for _ in $runs; do map_scans "$@" scans="$scans" | field "$name"; done | sort -g | head -1
}

echo "cell     OctoMap  rays (ratio)  fused L=0.08 (ratio)  fused default (ratio)"
for cell in ${CELLS:-0.128 0.064 0.032 0.016 0.008}; do
  octomap=$("$work/octomap_baseline" "$work/office.scans" "$cell" 100 mode=gauss L=0.08 quiet=1 scans="$scans" | field cpu_per_100k)
  echo "$cell $octomap $(best cpu_per_100k "$cell" rule=rays L=0.08) $(best cpu_per_100k "$cell" L=0.08) $(best cpu_per_100k "$cell")" |
    awk '{ printf "%s  %.4f  %.5f (%.1fx)  %.6f (%.0fx)  %.6f (%.0fx)\n", $1, $2, $3, $2/$3, $4, $2/$4, $5, $2/$5 }'
done

wall() { map_scans "$@" L=0.08 scans="$scans" | field wall_per_100k; }
median() { sort -g | awk '{ x[NR] = $1 } END { printf "%.2f", x[int((NR + 1) / 2)] }'; }
spin() { awk 'BEGIN { for (i = 0; i < 3e7; i++) x += i % 7 }'; }
now() { date +%s.%N; }
for _ in 1 2 3 4 5; do
  start=$(now); spin; middle=$(now); spin & spin; wait; end=$(now)
  awk -v a="$start" -v b="$middle" -v c="$end" 'BEGIN { print 2 * (b - a) / (c - b) }'
done | median | sed 's/^/two processes of a pure computation: /; s/$/x/'
echo "cell rule  two threads  two processes"
for cell in ${THREAD_CELLS:-0.128 0.064 0.032}; do for rule in fused rays; do
  for _ in 1 2 3 4 5; do
    one=$(wall "$cell" rule=$rule); two=$(wall "$cell" rule=$rule threads=2)
    both=$( (wall "$cell" rule=$rule & wall "$cell" rule=$rule; wait) | sort -g | tail -1)
    echo "$one $two $both"
  done > "$work/walls"
  echo "$cell $rule $(awk '{ print $1 / $2 }' "$work/walls" | median)x $(awk '{ print 2 * $1 / $3 }' "$work/walls" | median)x"
done; done

echo "quality of the whole room, observed cells"
for cell in ${QUALITY_CELLS:-0.128 0.064 0.032 0.016}; do
  "$work/octomap_baseline" "$work/office.scans" "$cell" 100 mode=cloudd quiet=1 out="$work/cloudd.ot" > /dev/null 2>&1
  for rule in rays fused; do
    "$examples/map_scans" "$work/office.scans" "$cell" rule=$rule threads=2 out="$work/$rule.ot" > /dev/null
  done
  "$examples/box_room_quality" "$work/office.obj" "$work/cloudd.ot" "$work/rays.ot" "$work/fused.ot"
done

echo "memory of finished default maps (packed; unpacked)"
rooms=office; [ -z "${MACHINE:-}" ] || rooms="office machine"
for room in $rooms; do
  [ -f "$work/$room.scans" ] || python3 "$bench/generate_scans.py" "$work/$room.scans" "$room"
  for cell in ${MEMORY_CELLS:-0.032 0.016}; do
    echo "$room $cell $("$examples/map_scans" "$work/$room.scans" "$cell" threads=2 | grep -o ' mem_mb=.*')"
  done
done
