#!/usr/bin/env bash
# An inertial sensor beside the camera: scale, gravity and accuracy in the built-in worlds, with and without its readings, which have the
# errors of a phone's; then two seconds of black images, with and without the readings. Prints a row per world and seed, and what holds.
#
#   scripts/imu.sh [FOLDER]      FOLDER keeps videos, runs and rows [default: a temporary one]
#
# WORLDS, SEEDS, FRAMES (30 per second), SIZE: others than the five worlds, seeds 0 to 2, ten seconds, 640x480 (or 320x240); BIN, BLACKOUT: other builds of
# the program and of the example `blackout`.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/common.sh
case ${1:-} in
  -*) sed -n '2,/^set -/{/^set -/d;s/^# \{0,1\}//p}' "$0"; exit 0 ;;
esac
worlds=${WORLDS:-living-room office machine-hall corridor-loop blank-walls}
seeds=${SEEDS:-0 1 2}
frames=${FRAMES:-300}
size=${SIZE:-640x480}
begin "${1:-}"
rows=$folder/rows
: >"$rows"

echo '| world | seed | error of the scale | said (σ) | gravity off by | said (σ) | ATE | ATE without |'
echo '|---|---|---|---|---|---|---|---|'
for world in $worlds; do
  for seed in $seeds; do
    video=$folder/$world-$seed
    # the motion is as slow as in the whole video, of which this is the beginning
    kept_run "$video" synth "$world" --imu --seed "$seed" --size "$size" --max-frames "$frames" --depth-every 0 --quick-light
    for kind in with without; do
      run=$folder/run-$world-$seed-$kind
      imu=()
      [ "$kind" = with ] || imu=(--imu none)
      kept_run "$run" run "$video" --seed "$seed" "${imu[@]}"
      evaluated "$run" "$video" || true
    done
    with=$folder/run-$world-$seed-with
    without=$folder/run-$world-$seed-without
    scale=$(value "$with.ate" scale)
    error=$(awk -v s="${scale:-x}" 'BEGIN { printf "%s", s ~ /^[0-9.e-]+$/ ? 100 * (1 / s - 1) : "-" }')
    [ "$(value "$with/summary.json" scale)" = metric ] || error=-
    echo "$world $seed $error $(value "$with/summary.json" inertial scale_sigma) $(value "$with.ate" tilt_deg) $(value "$with/summary.json" inertial gravity_sigma_deg) $(value "$with.ate" ate_rmse) $(value "$without.ate" ate_rmse)" >>"$rows"
    awk 'END { printf "| %s | %s | %.2f %% | %.2f %% | %.2f° | %.2f° | %.1f mm | %.1f mm |\n", $1, $2, $3, 100 * $4, $5, $6, 1000 * $7, 1000 * $8 }' "$rows"
  done
done
awk '{ n++; e = $3 < 0 ? -$3 : $3
    if ($3 != "-" && e <= 1) scale++
    if ($5 <= 0.5) gravity++
    with += $7; without += $8
    if ($7 <= 1.05 * $8) better++
  } END {
    printf "\nscale within 1 %% in %d of %d, gravity within 0.5° in %d; mean ATE %.1f mm with, %.1f mm without; no worse than without (by 5 %%) in %d\n", scale, n, gravity, 1000 * with / n, 1000 * without / n, better
  }' "$rows"

if [ -z "${BLACKOUT:-}" ]; then
  cargo build --quiet --release -p monogrid-studies --example blackout
  BLACKOUT=${CARGO_TARGET_DIR:-target}/release/examples/blackout
fi
dark=$folder/dark
touch "$dark"
echo
echo '| world | place | seed | readings | way in the dark | afterwards | frames with a pose | off by, of the way |'
echo '|---|---|---|---|---|---|---|---|'
for world in $worlds; do
  for place in known unknown; do
    for seed in $seeds; do
      for imu in 1 0; do
        key="| $world | $place | $seed | $([ "$imu" = 1 ] && echo yes || echo no) |"
        small=$([ "$size" = 320x240 ] && echo 1 || echo 0)
        grep -qF "$key" "$dark" || "$BLACKOUT" "$world" "$place" "seed=$seed" "imu=$imu" "small=$small" >>"$dark"
        grep -F "$key" "$dark"
      done
    done
  done
done
awk -F'|' '{ n[$5]++; if ($9 ~ /[0-9]/ && $9 + 0 <= 5) good[$5]++ } END {
    printf "\nbridged within 5 %% of the way: %d of %d with readings, %d of %d without\n", good[" yes "], n[" yes "], good[" no "], n[" no "]
  }' "$dark"
