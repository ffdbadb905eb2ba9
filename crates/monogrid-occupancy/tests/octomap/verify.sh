#!/bin/sh
# Checks against OctoMap itself (Debian: apt-get install -y liboctomap-dev octomap-tools g++):
#  1. a map written by us = the same map rebuilt cell by cell by OctoMap from our text list (KL 0, same leaves)
#  2. a map written by OctoMap, read and written by us, is the same (below 1e-6 per leaf)
#  3. OctoMap finds known cells of our files where they should be (a mirrored tree cannot pass)
# usage: tests/octomap/verify.sh [WORK_FOLDER] [OTHER.ot ...]
set -eu
here=$(cd "$(dirname "$0")" && pwd); work=${1:-$(mktemp -d)}; mkdir -p "$work"
[ $# -gt 0 ] && shift
for program in make_golden rebuild ask; do
  [ "$work/$program" -nt "$here/$program.cpp" ] || g++ -O2 -o "$work/$program" "$here/$program.cpp" -loctomap -loctomath
done
cargo build -q --release --manifest-path "$here/../../Cargo.toml" --example octomap_check
target=${CARGO_TARGET_DIR:-$here/../../../../target}
check="$target/release/examples/octomap_check"
kl() { # kl A.ot B.ot LIMIT_PER_LEAF
  compare_octrees "$1" "$2" > "$work/compare.txt" 2>&1 || true
  leaves=$("$check" leaves "$1"); other=$("$check" leaves "$2")
  sum=$(grep -i 'KL' "$work/compare.txt" | grep -o '[-0-9.e+]*$' | tail -1)
  echo "  $1: $leaves leaves, $2: $other leaves, KL divergence $sum"
  [ "$leaves" = "$other" ] || { echo "FAILED: leaves differ"; exit 1; }
  awk -v s="$sum" -v n="$leaves" -v l="$3" 'BEGIN { if (s == "" || s < 0 || s / n > l) { print "FAILED: above " l " per leaf"; exit 1 } }'
}
echo "1. our map against OctoMap's reconstruction of it, cell by cell"
"$check" make "$work"
"$work/rebuild" "$work/cells.txt" 0.05 "$work/rebuilt.ot" > /dev/null
kl "$work/ours.ot" "$work/rebuilt.ot" 0
echo "2. OctoMap's map, read and written by us"
"$work/make_golden" "$work/golden" > /dev/null
for map in "$work/golden.ot" "$@"; do
  "$check" copy "$map" "$work/copy.ot"; kl "$map" "$work/copy.ot" 1e-6
done
echo "3. known cells asked in OctoMap"
"$check" copy "$work/ours.bt" "$work/ours_from_bt.ot"
for map in ours.ot ours.bt ours_from_bt.ot; do
  cut -d' ' -f1-3 "$work/expected.txt" | "$work/ask" "$work/$map" > "$work/answers.txt"
  diff "$work/expected.txt" "$work/answers.txt" && echo "  $map: $(wc -l < "$work/expected.txt") known cells agree"
done
echo "OctoMap agrees"
