#!/usr/bin/env bash
# How good maps are, scene by scene, and what a setting or a change of the program brings.
#
#   scripts/maps.sh [tuning|validation|FOLDER]... [-- NAME[=OPTIONS]...]
#
#   scripts/maps.sh validation -- default no-planes='--set mapping.planes.max_count=0'
#   scripts/maps.sh validation -- default before='@/tmp/before/monogrid'
#
# A scene is a folder with poses and depth images, in TUM or 7-Scenes layout. Each is tracked once, from the
# depth of its first frame, and its recording is mapped once for every variant: by the program, or
# by the one after an @, with the options of `monogrid evaluate map` behind it. Without variants it
# is `default` alone. Tables: each variant scene by scene, then the paired differences of the others
# from the first one.
#
# `tuning` scenes may choose a constant. `validation` scenes never do: they say whether what was
# chosen holds. Both are looked for by name in the folders of SCENES (separated by colons; default
# MONOGRID_DATA and ../shared/rooms); those that are missing are named. Rooms are drawn by chance:
# SEED-CONTRAST-CAMERA. The truth of a scene is its truth.ot, else what its depth images show.
#
# A scene counts where its recording can be judged: poses for 90 % of the frames, within 1 % of the
# way. A stage stays that brings on validation at least 0.01 MCC of known cells on average, or 0.03
# of the surface at no loss of MCC, and costs no scene more than 0.02 MCC of known cells; all others
# go. The table says which (scripts/maps.py has the numbers).
#
# CELL: edge of a cell (default 0.032); JOBS: scenes at once (default 1); RESULTS: a folder in which
# what is finished is found again; BIN: another program for tracking and mapping.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/common.sh
bin=${BIN:-target/release/monogrid}
cell=${CELL:-0.032}
places=${SCENES:-$data:$shared/rooms}
contrasts=(0.1 0.25 0.5 0.8)
cameras=(demo harsh)

# rooms FIRST LAST: names of rooms; eight in a row have each contrast with each camera.
rooms() {
  for seed in $(seq "$1" "$2"); do
    echo "$seed-${contrasts[seed % 4]}-${cameras[seed / 4 % 2]}"
  done
}
tuning=(red-kitchen icl-office icl-office-kt3 fr1-desk)
mapfile -t -O ${#tuning[@]} tuning < <(rooms 0 15)
validation=(box-rgbd)
mapfile -t -O ${#validation[@]} validation < <(rooms 100 115)

# found NAME...: the folders of those scenes that are there.
found() {
  local name folders place
  IFS=: read -ra folders <<<"$places"
  for name in "$@"; do
    for place in "${folders[@]}"; do
      if [ -d "$place/$name" ]; then
        echo "$place/$name"
        continue 2
      fi
    done
    echo "not found: $name" >&2
  done
}

scenes=() variants=()
while [ $# -gt 0 ]; do
  case $1 in
    tuning) mapfile -t -O ${#scenes[@]} scenes < <(found "${tuning[@]}") ;;
    validation) mapfile -t -O ${#scenes[@]} scenes < <(found "${validation[@]}") ;;
    -h | --help | help) sed -n '2,/^set -/{s/^# \{0,1\}//p}' "$0"; exit 0 ;;
    --) shift; variants=("$@"); break ;;
    *) scenes+=("$1") ;;
  esac
  shift
done
[ ${#scenes[@]} -gt 0 ] || { echo 'no scene: name folders, or set SCENES' >&2; exit 2; }
[ ${#variants[@]} -gt 0 ] || variants=(default)
command -v "$bin" >/dev/null || { echo "no program $bin: build it, or set BIN" >&2; exit 2; }

results=${RESULTS:-}
if [ -z "$results" ]; then
  results=$(mktemp -d)
  trap 'rm -rf "$results"' EXIT
fi
mkdir -p "$results"
results=$(cd "$results" && pwd)

# The program of a variant and its options, one word a line.
command_of() {
  local options=
  case $1 in *=*) options=${1#*=} ;; esac
  read -ra words <<<"$options"
  case ${words[0]:-} in
    @*) printf '%s\n' "${words[0]#@}" "${words[@]:1}" ;;
    *) printf '%s\n' "$bin" "${words[@]}" ;;
  esac
}

# report SCENE VARIANT: the file of that result, by the bytes of the program and the options.
report() {
  local words key
  mapfile -t words < <(command_of "$2")
  key=$({ sha256sum <"${words[0]}"; printf '%s\n' "$cell" "${words[@]:1}"; } | sha256sum | cut -c1-12)
  echo "$results/$(basename "$1")-$key.json"
}

# measured SCENE: tracks it and maps it for all variants, what is not there yet.
measured() {
  local name run truth=$1/truth.ot align=(--align "gt:$1") words
  name=$(basename "$1")
  run=$results/$name
  kept_run "$run" run "$1" --seed-depth dataset --threads 1
  evaluated "$run" "$1" && python3 scripts/maps.py "$run.ate" || return 0
  if [ ! -f "$truth" ]; then
    # poses of a real camera can be off by more than a cell against its depth
    truth=$results/$name-$cell.ot
    kept "$truth.json" "$bin" truth "$1" --resolution "$cell" --out "$truth" --json
    align+=(--align-points)
  fi
  for variant in "${variants[@]}"; do
    mapfile -t words < <(command_of "$variant")
    kept "$(report "$1" "$variant")" "${words[0]}" evaluate map "$run/recording.mgk" "$truth" "${align[@]}" \
      --resolution "$cell" "${words[@]:1}" --json
  done
}

failed=0
for scene in "${scenes[@]}"; do
  while [ "$(jobs -rp | wc -l)" -ge "${JOBS:-1}" ]; do wait -n || failed=1; done
  measured "$scene" &
done
while [ -n "$(jobs -p)" ]; do wait -n || failed=1; done

for variant in "${variants[@]}"; do
  for scene in "${scenes[@]}"; do
    printf '%s\t%s\t%s\t%s\n' "$(basename "$scene")" "${variant%%=*}" "$results/$(basename "$scene").ate" \
      "$(report "$scene" "$variant")"
  done
done | python3 scripts/maps.py
exit $failed
