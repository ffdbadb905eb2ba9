#!/bin/sh
# Everything behind docs/thesis-comparison.md: the world, both recordings, the sweep, the curves.
# About an hour on two cores; what was interrupted goes on where it was.
#
#     scripts/thesis-comparison.sh [folder for the results] [world]
set -e
out=${1:-thesis-comparison}
world=${2:-living-room}
monogrid=${MONOGRID:-target/release/monogrid}
mkdir -p "$out"
data="$out/$world"
if [ ! -f "$data/rgb.txt" ]; then
    "$monogrid" synth "$world" --frames 1500 --depth-every 5 --truth-resolution 0.008 --out "$data"
fi
for profile in default thesis; do
    run="$out/$world-$profile"
    if [ ! -f "$run/summary.json" ]; then
        "$monogrid" run "$data" --profile "$profile" --seed-depth dataset \
            --align "gt:$data/groundtruth.txt" --out "$run"
    fi
done
"$monogrid" sweep "$out/$world-default/recording.mgk" "$out/$world-thesis/recording.mgk" \
    --truth "$data/truth.ot" --align "gt:$data/groundtruth.txt" \
    --slam-source "$data" --out "$out/sweep"
"$monogrid" thesis sensor-model --plot "$out/sensor-models"
echo "$out/sweep/sweep.html and $out/sensor-models/sensor-models.html"
