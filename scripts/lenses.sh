#!/usr/bin/env bash
# Wide lenses in the built-in worlds: the same motion filmed through a pinhole, a double sphere and OpenCV's rational model, all 120 degrees
# wide, and through the usual pinhole of 65 degrees. Prints the trajectory error of each, and how many times that of the pinholes it is.
#
#   scripts/lenses.sh [FOLDER]      FOLDER keeps worlds and runs [default: a temporary one]
#
# WORLDS, SEEDS, FRAMES (30 per second): others than three worlds, seed 0, ten seconds; BIN: another build of the program.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/common.sh
case ${1:-} in
  -*) sed -n '2,/^set -/{/^set -/d;s/^# \{0,1\}//p}' "$0"; exit 0 ;;
esac
worlds=${WORLDS:-living-room office machine-hall}
seeds=${SEEDS:-0}
frames=${FRAMES:-300}
begin "${1:-}"

# lens NAME FOCAL MODEL DISTORTION: a camera of 640x480 pixels
lens() {
  printf 'width = 640\nheight = 480\nmodel = "%s"\nfx = %s\nfy = %s\ncx = 319.5\ncy = 239.5\ndistortion = [%s]\n' \
    "$3" "$2" "$2" "$4" >"$folder/$1.toml"
}
lens pinhole-65 502.3 pinhole ''
lens pinhole-120 184.75 pinhole ''
# all three have 60 degrees 320 px from the centre
lens double-sphere-120 247.53 double-sphere '-0.2, 0.6'
# an equidistant lens, as the rational polynomial says it to 0.05 px
lens rational-120 305.58 rational '0.660036, 0.066838, 0, 0, 0.000525, 0.992721, 0.200686, 0.006037'

echo '| world | seed | lens | frames with a pose | ATE | of pinhole 65 | of pinhole 120 |'
echo '|---|---|---|---|---|---|---|'
for world in $worlds; do
  for seed in $seeds; do
    wide=
    for name in pinhole-65 pinhole-120 double-sphere-120 rational-120; do
      video=$folder/$world-$seed-$name run=$folder/run-$world-$seed-$name
      kept_run "$video" synth "$world" --seed "$seed" --calibration "$folder/$name.toml" --max-frames "$frames" \
        --depth-every 0 --quick-light
      kept_run "$run" run "$video" --seed "$seed"
      evaluated "$run" "$video" || true
      ate=$(value "$run.ate" ate_rmse) share=$(value "$run.ate" coverage)
      case $name in
        pinhole-65) narrow=$ate ;;
        pinhole-120) wide=$ate ;;
      esac
      awk -v row="$world | $seed | $name" -v ate="$ate" -v share="$share" -v narrow="$narrow" -v wide="$wide" 'BEGIN {
        of_wide = wide == "" ? "–" : sprintf("%.2f", ate / wide)
        printf "| %s | %.0f %% | %.2f mm | %.2f | %s |\n", row, 100 * share, 1000 * ate, ate / narrow, of_wide }'
    done
  done
done
