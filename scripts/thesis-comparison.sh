#!/usr/bin/env bash
# Everything behind docs/thesis-comparison.md: the thesis' experiment in its own scene from three starts, every way of
# mapping at every resolution, its large scene, and the curves of its models; then the pages are printed.
#
#     scripts/thesis-comparison.sh [folder for the results]
#
# Two to three hours on two free cores with all resolutions; what was interrupted goes on where it was. RESOLUTIONS
# (metres, with commas) names fewer, STARTS more or fewer starts. MACHINE= leaves the large scene out, PAGES= the pages
# as they are. Needs the recording icl-office-kt3 (scripts/data.sh), in the folder that MONOGRID_DATA names, and Python 3.
set -euo pipefail
out=${1:-thesis-comparison} monogrid=${MONOGRID:-target/release/monogrid}
here=$(dirname "$0")
office=${MONOGRID_DATA:-../shared/data}/icl-office-kt3
resolutions=${RESOLUTIONS:-0.008,0.016,0.032,0.064,0.128}
starts=${STARTS:-3} finest=${resolutions%%,*}
mkdir -p "$out"

# run FOLDER SOURCE OPTION...: unless it is there
run() {
  local folder=$1 source=$2
  shift 2
  [ -f "$folder/summary.json" ] || "$monogrid" run "$source" --profile thesis --out "$folder" "$@"
}

echo "$office/groundtruth.txt" >"$out/reference"
recordings=()
for ((start = 1; start <= starts; start++)); do
  run "$out/start-$start" "$office" --seed "$start" --align "gt:$office/groundtruth.txt"
  recordings+=("$out/start-$start/recording.mgk")
done
[ -f "$out/truth.ot" ] || "$monogrid" truth "$office" --resolution "$finest" --out "$out/truth.ot"
"$monogrid" thesis sweep "${recordings[@]}" --truth "$out/truth.ot" --align "gt:$office/groundtruth.txt" \
  --resolutions "$resolutions" --memory 6 --out "$out/sweep"

# what lies far away in the thesis' maps, and what rules of LSD-SLAM's viewer or of ours leave of it
far=()
mapped() {
  local name=$1 cut=$2
  shift 2
  [ -f "$out/far-$name.ot" ] || "$monogrid" map "${recordings[0]}" --profile thesis --resolution 0.064 \
    --align "gt:$office/groundtruth.txt" --out "$out/far-$name.ot" "$@"
  far+=("$cut" "$out/far-$name.ot")
}
mapped all 'every measurement'
mapped sigma 'relative standard deviation at most 0.03' --set mapping.filter.max_relative_sigma=0.03
mapped range 'at most 5 m from the camera' --max-range 5
python3 - "$monogrid" "${far[@]}" >"$out/far.json" <<'END'
import json, os, subprocess, sys
program, *far = sys.argv[1:]
rows = []
for cut, path in zip(far[::2], far[1::2]):
    known = json.loads(subprocess.run([program, "info", path, "--json"], check=True, capture_output=True).stdout)
    extent = [high - low for low, high in zip(known["bounds_min"], known["bounds_max"])]
    rows.append({"cut": cut, "extent": extent, "bytes": os.path.getsize(path)})
print(json.dumps(rows))
END

# the large scene
if [ "${MACHINE-yes}" ]; then
  [ -f "$out/machine-hall/rgb.txt" ] || "$monogrid" synth machine-hall --frames 1000 --depth-every 20 --out "$out/machine-hall"
  run "$out/machine" "$out/machine-hall" --align "gt:$out/machine-hall/groundtruth.txt"
  "$monogrid" thesis sweep "$out/machine/recording.mgk" --align "gt:$out/machine-hall/groundtruth.txt" \
    --resolutions "$resolutions" --memory 6 --out "$out/machine-sweep"
fi

"$monogrid" thesis sensor-model --plot "$out/sensor-models"
if [ "${PAGES-yes}" ]; then
  COMMIT=${COMMIT:-$(git -C "$here" rev-parse HEAD)} python3 "$here/thesis_page.py" collect "$out"
  echo "docs/thesis-comparison.md and docs/thesis/tables.md are printed"
fi
echo "$out/sweep/sweep.html has all figures"
