#!/usr/bin/env bash
# Are recordings of different cameras joined where they show the same place, and never elsewhere? Prints the tables of BENCHMARKS.md.
#
#   scripts/merge.sh
#
# Four pieces of red-kitchen (of scripts/data.sh; its images cropped and scaled) and of the office (rendered by cameras of four fields of
# view), each run alone and merged in another order than they were filmed, beside the run of the whole; then SEEDS (default 20) times a piece of
# another world with the first piece of the office. Needs python3 with Pillow. BIN: another binary; FRAMES: of the office (default 600); WORK: a
# folder where finished runs are kept, so that the script can be started a second time.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/common.sh
bin=${BIN:-target/release/monogrid}
work=${WORK:-$(mktemp -d)}
frames=${FRAMES:-600}
seeds=${SEEDS:-20}
mkdir -p "$work"

# Cameras of the office, 320x240: fx fy cx cy width height; 65, 58, 75 and 65 degrees wide, the last not centred.
cameras=('251.2 251.2 159.5 119.5 320 240' '288.6 288.6 159.5 119.5 320 240' '208.5 208.5 159.5 119.5 320 240'
  '251.2 251.2 150.5 125.5 320 240')

# rendered WORLD CAMERA FOLDER OPTION...
rendered() {
  [ ! -f "$3/groundtruth.txt" ] || return 0
  echo "$2" >"$3.txt"
  "$bin" synth "$1" --calibration "$3.txt" --depth-every 0 --truth-resolution 0.2 --quick-light --out "$3" "${@:4}" >"$3.log" 2>&1
}

# The pieces of red-kitchen: every piece with images of its own size, cropped and scaled.
kitchen_pieces() {
  [ ! -f "$work/kitchen-3/calibration.txt" ] || return 0
  python3 - "$data/red-kitchen" "$work" <<'PYTHON'
import os, sys
from PIL import Image
source, work = sys.argv[1:]
words = [line.split() for line in open(source + "/calibration.txt") if not line.startswith("#")][0]
fx, fy, cx, cy = map(float, words[:4])
lines = [line.split() for line in open(source + "/rgb.txt") if not line.startswith("#")]
count = len(lines) // 4
# left, top, width and height of what is kept, and by how much it is made smaller
crops = [(0, 0, 640, 480, 1.0), (40, 24, 560, 432, 1.0), (0, 0, 640, 480, 0.8), (16, 8, 600, 456, 0.9)]
for k, (left, top, width, height, factor) in enumerate(crops):
    folder = f"{work}/kitchen-{k}"
    os.makedirs(folder + "/rgb", exist_ok=True)
    size = round(width * factor), round(height * factor)
    sx, sy = size[0] / width, size[1] / height
    with open(folder + "/rgb.txt", "w") as out:
        for time, name in lines[k * count:(k + 1) * count]:
            image = Image.open(f"{source}/{name}").convert("L").crop((left, top, left + width, top + height))
            name = os.path.splitext(name)[0] + ".png"
            (image if factor == 1.0 else image.resize(size, Image.LANCZOS)).save(f"{folder}/{name}", compress_level=1)
            out.write(f"{time} {name}\n")
    camera = [fx * sx, fy * sy, (cx - left + 0.5) * sx - 0.5, (cy - top + 0.5) * sy - 0.5]
    with open(folder + "/calibration.txt", "w") as out:
        out.write(" ".join(map(str, camera + words[4:8] + list(size))) + "\n")
PYTHON
}

# ate TRAJECTORY SOURCE: m.
ate() {
  "$bin" evaluate trajectory "$1" "$2/groundtruth.txt" --json >"$work/ate.json"
  value "$work/ate.json" ate_rmse
}

# components FOLDER: of a merge.
components() { grep -c '"recording":' "$1/summary.json"; }

# row NAME SOURCE: of the pieces $work/NAME-run-0 to 3 and the whole $work/NAME-run.
row() {
  kept_run "$work/$1-merged" merge-runs "$work/$1-run-2" "$work/$1-run-0" "$work/$1-run-3" "$work/$1-run-1"
  local merged whole
  merged=$(ate "$work/$1-merged/trajectory.txt" "$2")
  whole=$(ate "$work/$1-run/trajectory.txt" "$2")
  echo "| $1 | $(components "$work/$1-merged") | $(wc -l <"$work/$1-merged/trajectory.txt") | $(digits 3 "$merged") | $(digits 3 "$whole") |" \
    "$(awk -v a="$merged" -v b="$whole" 'BEGIN { printf "%.2f", a / b }') |"
}

printf '| four pieces of | maps | frames in the largest | ATE, m | of the whole, m | ratio |\n|---|---|---|---|---|---|\n'
kitchen_pieces
for k in 0 1 2 3; do kept_run "$work/kitchen-run-$k" run "$work/kitchen-$k"; done
kept_run "$work/kitchen-run" run "$data/red-kitchen"
row kitchen "$data/red-kitchen"

for k in 0 1 2 3; do
  rendered office "${cameras[k]}" "$work/office-$k" --frames "$frames"
  kept_run "$work/office-run-$k" run "$work/office-$k" --start "$((k * frames / 4))" --max-frames "$((frames / 4))" --rolling-shutter 0
done
kept_run "$work/office-run" run "$work/office-0" --rolling-shutter 0
row office "$work/office-0"

worlds=(living-room machine-hall corridor-loop blank-walls)
joined=0 tried=0
for ((seed = 0; seed < seeds; seed++)); do
  world=${worlds[seed % 4]} other=$work/other-$seed
  rendered "$world" "${cameras[seed % 3]}" "$other" --max-frames 160 --seed "$seed"
  kept_run "$other-run" run "$other" --seed "$seed" --rolling-shutter 0
  [ -f "$other-run/recording.mgk" ] && [ "$(value "$other-run/summary.json" keyframes)" -gt 0 ] || continue
  kept_run "$other-merged" merge-runs "$work/office-merged" "$work/kitchen-merged" "$other-run"
  tried=$((tried + 1))
  [ "$(components "$other-merged")" -ge 3 ] || joined=$((joined + 1))
done
printf '\n%d pieces of other worlds, each with the maps of both: %d were joined to one of them.\n' "$tried" "$joined"
