#!/usr/bin/env bash
# A run with all keyframes in memory and one that must stay within a third of what that took, in two worlds: ATE, files that differ,
# largest memory and user time, as a table.
#
#   scripts/memory.sh [WORLD...]      default: corridor-loop machine-hall
#
# FRAMES: of each world (default 1000). SIZE: of the images (default 320x240). LIMIT: instead of a third, e.g. 150MB. BIN: another binary.
# KEEP: a folder for worlds and runs, kept afterwards; worlds that are there are used.
# Exit code 1 when the ATE differs by more than 5 %, the maps differ, more than 1.1 times the limit is taken, or 15 % more user time.
set -euo pipefail
cd "$(dirname "$0")/.."
bin=${BIN:-target/release/monogrid}
frames=${FRAMES:-1000} size=${SIZE:-320x240}
worlds=("${@:-corridor-loop}")
[ $# -gt 0 ] || worlds=(corridor-loop machine-hall)
work=${KEEP:-$(mktemp -d)}
[ -n "${KEEP:-}" ] || trap 'rm -rf "$work"' EXIT
mkdir -p "$work"

# Runs a world with a limit; prints: memory, MB; ATE, m; keyframes in memory, pyramids, file, MB; user time, s.
measure() {
  local out=$1 world=$2 limit=$3
  local TIMEFORMAT=%U
  { time "$bin" run "$work/$world" --resolution 0.1 --memory-limit "$limit" --out "$out" --force > "$out.log" 2>&1; } 2> "$out.time"
  awk -v user="$(tail -1 "$out.time")" -F'[:,]' '
    { gsub(/[ "]/, "") }
    $1 == "peak_rss_bytes" { peak = $2 / 1e6 } $1 == "ate_rmse" && !ate { ate = $2 }
    $1 == "prepared" { prepared = $2 / 1e6 } $1 == "in_file" { file = $2 / 1e6 }
    $1 == "memory_bytes" { inside = 1 } inside && $1 == "keyframes" { kept = $2 / 1e6; inside = 0 }
    END { printf "%.0f %s %.0f %.0f %.0f %.1f\n", peak, ate, kept, prepared, file, user }' "$out/summary.json"
}

# Files of two runs that differ, but for those that hold times.
differing() {
  (cd "$1" && find . -type f ! -name summary.json ! -name report.html ! -name frames.csv ! -name monogrid-manifest.txt | sort) |
    while read -r file; do cmp -s "$1/$file" "$2/$file" || echo "${file#./}"; done | paste -sd ' '
}

code=0
echo "| world | limit, MB | at most, MB | ATE, m | images and depth in memory, MB | pyramids, MB | file, MB | user time, s | files that differ |"
echo "|---|---|---|---|---|---|---|---|---|"
for world in "${worlds[@]}"; do
  [ -d "$work/$world" ] || "$bin" synth "$world" --frames "$frames" --size "$size" --depth-every "$frames" --out "$work/$world" > /dev/null
  read -r peak ate kept prepared file user <<< "$(measure "$work/$world-all" "$world" 1000GB)"
  echo "| $world | – | $peak | $ate | $kept | $prepared | $file | $user | |"
  limit=${LIMIT:-$((peak / 3))MB}
  read -r peak2 ate2 kept2 prepared2 file2 user2 <<< "$(measure "$work/$world-limited" "$world" "$limit")"
  differ=$(differing "$work/$world-all" "$work/$world-limited")
  echo "| $world | ${limit%MB} | $peak2 | $ate2 | $kept2 | $prepared2 | $file2 | $user2 | ${differ:-none} |"
  awk -v a="$ate" -v b="$ate2" -v peak="$peak2" -v limit="${limit%MB}" -v u="$user" -v v="$user2" -v differ="$differ" 'BEGIN {
    exit (b > 1.05 * a || b < 0.95 * a || peak > 1.1 * limit || v > 1.15 * u || differ ~ /global\./) }' || code=1
done
exit $code
