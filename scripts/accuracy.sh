#!/usr/bin/env bash
# Accuracy on the sequences of ../shared/data: five runs with `--seed i --start i`, median and worst.
#
#   scripts/accuracy.sh [PROFILE] [SEQUENCE...]       PROFILE: default or thesis; BIN: another binary
#
# Prints one row per sequence: ATE (m), scale drift, coverage, rotation error per frame (degrees).
set -euo pipefail
cd "$(dirname "$0")/.."
bin=${BIN:-target/release/monogrid}
profile=${1:-default}
shift || true
sequences=("$@")
[ ${#sequences[@]} -gt 0 ] || sequences=(red-kitchen tsukuba icl-office kitti-forward)
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT

value() { sed -n "s/.*\"$1\": *\([-0-9.e]*\).*/\1/p" "$2" | head -1; }
# the median and the largest (or, with -r, the smallest) of the lines on standard input
median_worst() { sort -g "$@" | awk '{v[NR]=$1} END {printf "%.4g (%.4g)", v[int((NR+1)/2)], v[NR]}'; }

printf '| sequence (%s) | ATE, m | scale drift | coverage | rotation per frame, degrees |\n|---|---|---|---|---|\n' "$profile"
for sequence in "${sequences[@]}"; do
  source=../shared/data/$sequence
  for i in 0 1 2 3 4; do
    "$bin" run "$source" --profile "$profile" --seed "$i" --start "$i" --out "$out/run" --force >/dev/null 2>&1 || true
    "$bin" evaluate trajectory "$out/run/trajectory.txt" "$source/groundtruth.txt" --json >"$out/result.json" 2>/dev/null || {
      echo inf >>"$out/$sequence.ate"
      continue
    }
    value ate_rmse "$out/result.json" >>"$out/$sequence.ate"
    value scale_drift "$out/result.json" >>"$out/$sequence.drift"
    value coverage "$out/result.json" >>"$out/$sequence.coverage"
    value rpe_rot_rmse_deg "$out/result.json" >>"$out/$sequence.rotation"
  done
  printf '| %s | %s | %s | %s | %s |\n' "$sequence" \
    "$(median_worst <"$out/$sequence.ate")" "$(median_worst <"$out/$sequence.drift")" \
    "$(median_worst -r <"$out/$sequence.coverage")" "$(median_worst <"$out/$sequence.rotation")"
done
