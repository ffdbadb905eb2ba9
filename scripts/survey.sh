#!/usr/bin/env bash
# Which sequences does which profile track, and if not, why? Writes the table of docs/survey.md.
#
#   scripts/survey.sh [SEQUENCE...]     a folder, or WORLD:MOTION:NOISE (office:drone:off)
#
# Without arguments: all recordings of scripts/data.sh, and 5 worlds x 4 motions, noisy and clean.
# BIN: another binary; FRAMES: frames of the worlds (default 1500); SIZE: of their images; PROFILES; ROWS: a file that rows are
# appended to, in which finished rows are found again when the script is started a second time.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/common.sh
bin=${BIN:-target/release/monogrid}
frames=${FRAMES:-1500}
size=${SIZE:-640x480}
profiles=${PROFILES:-default thesis}
rows=${ROWS:-/dev/null}
sequences=("$@")
if [ ${#sequences[@]} -eq 0 ]; then
  for name in red-kitchen tsukuba icl-office icl-office-kt3 kitti-forward kitti-07 fr1-desk euroc-static; do
    sequences+=("$data/$name")
  done
  for noise in demo off; do
    for world in living-room office machine-hall corridor-loop blank-walls; do
      for motion in hand drone hand-back drone-back; do
        sequences+=("$world:$motion:$noise")
      done
    done
  done
fi
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT

# The commonest reason among the frames without a pose, with their number.
reason() {
  awk -F, 'NR > 1 && $3 != "good" { r = $4; gsub(/"/, "", r); n[$3 (r == "" ? "" : ": " r)]++ }
    END { for (r in n) if (n[r] > best) { best = n[r]; name = r } if (best) printf "%s (%d frames)", name, best }' "$1"
}

printf '| sequence | camera | profile | frames | tracked | lost | keyframes | ATE, m | of path, m | why not |\n'
printf '|---|---|---|---|---|---|---|---|---|---|\n'
for sequence in "${sequences[@]}"; do
  case $sequence in
    *:*:*)
      IFS=: read -r world motion noise <<<"$sequence"
      name="$world, $motion"
      camera=$([ "$noise" = off ] && echo clean || echo "noise $noise")
      source=$out/source
      made=
      ;;
    *)
      name=$(basename "$sequence")
      camera=real
      case $name in tsukuba | icl-office*) camera=synthetic ;; esac
      source=$sequence
      made=1
      ;;
  esac
  for profile in $profiles; do
    key="| $name | $camera | $profile |"
    if [ -f "$rows" ] && grep -qF "$key" "$rows"; then
      grep -F "$key" "$rows"
      continue
    fi
    if [ -z "$made" ]; then
      rm -rf "$source"
      "$bin" synth "$world" --motion "$motion" --noise "$noise" --frames "$frames" --size "$size" --depth-every 0 \
        --truth-resolution 0.2 --quick-light --out "$source" >/dev/null 2>&1
      made=1
    fi
    rm -rf "$out/run"
    code=0
    "$bin" run "$source" --profile "$profile" --out "$out/run" --resolution 0.1 --json >"$out/run.json" 2>"$out/run.err" || code=$?
    ate=– path=–
    if "$bin" evaluate trajectory "$out/run/trajectory.txt" "$source/groundtruth.txt" --json >"$out/ate.json" 2>/dev/null; then
      ate=$(value "$out/ate.json" ate_rmse | xargs printf '%.4f')
      path=$(value "$out/ate.json" path_length | xargs printf '%.1f')
    fi
    why=$(reason "$out/run/frames.csv" 2>/dev/null || true)
    [ "$code" -eq 0 ] || why="exit code $code; $why"
    total=$(value "$out/run.json" frames) tracked=$(value "$out/run.json" tracked)
    share=$(awk -v t="${tracked:-0}" -v n="${total:-0}" 'BEGIN { printf "%.1f %%", n ? 100 * t / n : 0 }')
    row="$key ${total:-0} | $share | $(value "$out/run.json" lost_episodes) | $(value "$out/run.json" keyframes) | $ate | $path | $why |"
    echo "$row"
    [ "$rows" = /dev/null ] || echo "$row" >>"$rows"
  done
done
