#!/usr/bin/env bash
# How well does a run do that is not told its camera? Prints the table of BENCHMARKS.md: focal length and ATE of several starts
# (`--seed i --start i`) without a calibration, beside the ATE of the same starts with it.
#
#   scripts/no_calibration.sh [SEQUENCE...]     a recording of scripts/data.sh, or WORLD:CAMERA (office:k1)
#
# Without arguments: four sequences, and two worlds through four cameras (`plain`: 65 degrees wide; `k1`: the same with k1 = -0.2; `fov50`
# and `fov90`), each for some FRAMES (default 300). BIN: another binary; STARTS: how many (default 5); WORK: a folder where finished runs are
# kept, so that the script can be started a second time; `KEEP=1` keeps whole runs and not only their numbers.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/common.sh
bin=${BIN:-target/release/monogrid}
starts=${STARTS:-5}
work=${WORK:-$(mktemp -d)}
frames=${FRAMES:-300}
sequences=("$@")
if [ ${#sequences[@]} -eq 0 ]; then
  sequences=(red-kitchen fr1-desk icl-office-kt3 tsukuba)
  for world in living-room office; do
    for camera in plain k1 fov50 fov90; do sequences+=("$world:$camera"); done
  done
fi

# One line of a calibration of 320x240: fx fy cx cy [k1 k2 p1 p2] width height.
camera_line() {
  case $1 in
    plain) echo '251.2 251.2 159.5 119.5 320 240' ;;
    k1) echo '251.2 251.2 159.5 119.5 -0.2 0 0 0 320 240' ;;
    fov50) echo '343.1 343.1 159.5 119.5 320 240' ;;
    fov90) echo '160 160 159.5 119.5 320 240' ;;
    *) echo "no camera $1" >&2 && return 1 ;;
  esac
}

# The folder of a sequence with its calibration and truth, rendered where it is a world.
source_of() {
  local world=${1%%:*} folder=$work/source-${1/:/-}
  if [ "$world" = "$1" ]; then
    echo "$data/$1"
    return
  fi
  if [ ! -f "$folder/groundtruth.txt" ]; then
    camera_line "${1#*:}" >"$folder.txt"
    "$bin" synth "$world" --calibration "$folder.txt" --max-frames "$((frames + starts))" --depth-every 0 --truth-resolution 0.2 \
      --quick-light --out "$folder" >"$folder.log" 2>&1
  fi
  echo "$folder"
}

# The same images without a calibration.
bare_of() {
  local folder=$work/bare-${1/:/-}
  mkdir -p "$folder"
  for part in rgb rgb.txt groundtruth.txt; do ln -sfn "$(realpath "$2/$part")" "$folder/$part"; done
  echo "$folder"
}

# ate FOLDER SOURCE: of a kept run, m; `lost` where there is no trajectory to compare. What else a run left goes.
ate() {
  if [ -d "$1" ] && evaluated "$1" "$2" && [ -z "${KEEP:-}" ]; then
    find "$1" -mindepth 1 ! -name 'calibration.*' ! -name summary.json -delete
  fi
  [ -f "$1.ate" ] && value "$1.ate" ate_rmse || echo lost
}

# The numbers of a run without a calibration: focal length found, px, and its interval.
focal() { sed -n 's/.*focal length \([0-9.]*\) px (95 %: \([0-9.]*\) to \([0-9.]*\)).*/\1 \2 \3/p' "$1"/calibration.* 2>/dev/null | head -1; }

# row NAME TRUE_FOCAL: of the lines `found low high ate ate_with` on standard input.
row() {
  awk -v name="$1" -v truth="$2" '
    function percent(x) { return sprintf("%+.1f", 100 * x) }
    function abs(x) { return x < 0 ? -x : x }
    $1 == "-" { errors = errors " –"; starts++; next_ate(); next }
    { e = $1 / truth - 1; errors = errors " " percent(e); starts++; v[++n] = abs(e); if ($2 <= truth && truth <= $3) inside++; next_ate() }
    function next_ate() {
      without = without " " ($4 == "lost" ? "lost" : sprintf("%.2f", 100 * $4)); with = with " " ($5 == "lost" ? "lost" : sprintf("%.2f", 100 * $5))
      if ($4 != "lost" && $5 != "lost" && $4 <= 1.3 * $5 + 0.005) holds++
    }
    END {
      for (i = 1; i <= n; i++) for (j = i + 1; j <= n; j++) if (v[j] < v[i]) { t = v[i]; v[i] = v[j]; v[j] = t }
      m = n ? (n % 2 ? v[(n + 1) / 2] : (v[n / 2] + v[n / 2 + 1]) / 2) : 0
      printf "| %s | %.0f |%s | %s, %s | %d of %d |%s |%s | %d of %d |\n", name, truth, errors,
        n ? sprintf("%.1f", 100 * m) : "–", n ? sprintf("%.1f", 100 * v[n]) : "–", inside, starts, without, with, holds, starts
    }'
}

printf '| images of | focal length, px | error, %% | median, worst [2, 5] | truth inside 95 %% | ATE, cm | with the calibration | at most 1.3 times that + 0.5 cm |\n'
printf '|---|---|---|---|---|---|---|---|\n'
for sequence in "${sequences[@]}"; do
  source=$(source_of "$sequence")
  bare=$(bare_of "$sequence" "$source")
  true_focal=$(awk '!/^#/ { print ($1 + ($2 < 0 ? -$2 : $2)) / 2; exit }' "$source/calibration.txt")
  for ((i = 0; i < starts; i++)); do
    name=$work/${sequence/:/-}-$i
    start=(--seed "$i" --start "$i" --max-frames "$frames" --resolution 0.1)
    kept_run "$name-without" run "$bare" "${start[@]}"
    kept_run "$name-with" run "$source" "${start[@]}"
    found=$(focal "$name-without")
    echo "${found:-- - -} $(ate "$name-without" "$source") $(ate "$name-with" "$source")"
  done | row "${sequence/:/, }" "$true_focal"
done
