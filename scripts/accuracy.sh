#!/usr/bin/env bash
# Accuracy on the recordings of scripts/data.sh: five runs with `--seed i --start i`, median and worst.
#
#   scripts/accuracy.sh [PROFILE] [SEQUENCE...]       PROFILE: default, fast or thesis
#
# BIN: another binary; RUNS: other than 5; MAX_FRAMES: of each run; RESULTS: a folder in which finished runs are found again when
# the script is started a second time. Prints one row per sequence: ATE (m), scale drift, coverage, rotation error per frame.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/common.sh
bin=${BIN:-target/release/monogrid}
profile=${1:-default}
shift || true
sequences=("$@")
[ ${#sequences[@]} -gt 0 ] || sequences=(red-kitchen tsukuba icl-office icl-office-kt3 kitti-forward kitti-07 fr1-desk)
results=${RESULTS:-}
if [ -z "$results" ]; then
  results=$(mktemp -d)
  trap 'rm -rf "$results"' EXIT
fi

# the median and the largest (or, with -r, the smallest) of the lines on standard input
median_worst() { sort -g "$@" | awk '{v[NR]=$1} END {printf "%.4g (%.4g)", v[int((NR+1)/2)], v[NR]}'; }
# one value of all runs of a sequence; a run without a trajectory counts as $2
all() {
  for i in $(seq 0 $((${RUNS:-5} - 1))); do
    value "$results/$sequence-$profile-$i.ate" "$1" 2>/dev/null || echo "$2"
  done
}

printf '| sequence (%s) | ORB-SLAM3 | COLMAP | C++ LSD-SLAM | DSO | ATE, m | scale drift | coverage | rotation per frame, degrees |\n|---|---|---|---|---|---|---|---|---|\n' "$profile"
for sequence in "${sequences[@]}"; do
  source=$data/$sequence
  for i in $(seq 0 $((${RUNS:-5} - 1))); do
    run=$results/$sequence-$profile-$i
    kept_run "$run" run "$source" --profile "$profile" --seed "$i" --start "$i" ${MAX_FRAMES:+--max-frames "$MAX_FRAMES"}
    evaluated "$run" "$source" || true
  done
  printf '| %s | %s | %s | %s | %s | %s |\n' "$sequence" "$(others "$sequence")" \
    "$(all ate_rmse inf | median_worst)" "$(all scale_drift inf | median_worst)" \
    "$(all coverage 0 | median_worst -r)" "$(all rpe_rot_rmse_deg inf | median_worst)"
done
