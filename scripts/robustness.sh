#!/usr/bin/env bash
# The robustness matrix: eight disturbances in three worlds, some seeds each. Prints a row per run, then what holds.
#
#   scripts/robustness.sh [quick|full]    quick: 300 frames, one seed; full: 600 frames, five seeds (some hours on two cores)
#
# ROWS: a file that rows are appended to, in which finished rows are found again when the script is started a second time;
# WORLDS, DISTURBANCES, SEEDS, FRAMES: others than all; BIN: another build of the example `robustness`.
set -euo pipefail
cd "$(dirname "$0")/.."
case ${1:-full} in
  quick) frames=300 seeds=0 ;;
  full) frames=600 seeds='0 1 2 3 4' ;;
  *) sed -n '2,/^set -/{/^set -/d;s/^# \{0,1\}//p}' "$0"; exit 0 ;;
esac
frames=${FRAMES:-$frames}
seeds=${SEEDS:-$seeds}
worlds=${WORLDS:-living-room office corridor-loop}
disturbances=${DISTURBANCES:-none low-rate blur exposure-jumps black-frames person rolling-shutter noise fast}
rows=${ROWS:-}
if [ -z "$rows" ]; then
  rows=$(mktemp)
  trap 'rm -f "$rows"' EXIT
fi
touch "$rows"
if [ -z "${BIN:-}" ]; then
  cargo build --quiet --release -p monogrid-studies --example robustness
  BIN=${CARGO_TARGET_DIR:-target}/release/examples/robustness
fi

echo '| world | disturbance | seed | frames | coverage | ATE, % of the path | wrong by 2 % or 3° | lost frames |'
echo '|---|---|---|---|---|---|---|---|'
for world in $worlds; do
  for disturbance in $disturbances; do
    for seed in $seeds; do
      key="| $world | $disturbance | $seed |"
      grep -qF "$key" "$rows" || "$BIN" "$world" "$disturbance" "seed=$seed" "frames=$frames" >>"$rows"
      grep -F "$key" "$rows"
    done
  done
done
echo
awk -F'|' '$3 !~ / none / {
    runs++
    if ($6 + 0 > 0.95 && $7 ~ /[0-9]/ && $7 + 0 < 1) good++
    if ($8 + 0 > 0.01) wrong++
  } END {
    printf "%d of %d runs have a coverage over 0.95 and an ATE under 1 %% of the path (bar: 95 %%); in %d more than 1 %% of the poses are wrong (bar: none)\n", good, runs, wrong
  }' "$rows"
