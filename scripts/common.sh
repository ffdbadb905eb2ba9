# Helpers of the scripts beside it, to be sourced; $bin is the program.
# shellcheck shell=bash

# shellcheck disable=SC2034 # used by the scripts that source this
# The folder of the baseline of the occupancy engine, and that of the recordings (scripts/data.sh).
shared=${SHARED:-../shared} data=${MONOGRID_DATA:-${SHARED:-../shared}/data}

# The value behind the last of the keys, within the objects that the others name: `value summary.json map_error observed auc`.
# The file is JSON as monogrid prints it, one key per line.
value() {
  local file=$1
  shift
  awk -v keys="$*" 'BEGIN { n = split(keys, key, " "); i = 1 }
    i < n { if (index($0, "\"" key[i] "\": {")) i++; next }
    index($0, "\"" key[i] "\":") {
      sub(/^[^:]*: */, ""); gsub(/[", ]/, ""); print; exit
    }' "$file"
}

# A number with so many significant digits; a dash for what is not a number.
digits() { awk -v n="$1" -v x="${2:-}" 'BEGIN { if (x ~ /^[-+.0-9e]+$/) { s = sprintf("%#." n "g", x); sub(/\.$/, "", s); printf "%s", s } else printf "–" }'; }

# What accuracy.toml says of a sequence: `promised NAME KEY`; nothing where it does not.
promised() {
  awk -F'"' -v name="$1" -v key="$2" '/^name = / { here = $2 == name } here && index($0, key " = \"") == 1 { print $2 }' \
    crates/monogrid-cli/tests/accuracy.toml
}

# Results of other programs on a sequence, a cell for each: ORB-SLAM3, COLMAP, C++ LSD-SLAM and DSO (their default
# parameters, the same calibration).
others() {
  local other cell row=
  for other in orb_slam3 colmap lsd_slam dso; do
    cell=$(promised "$1" "$other")
    row+=" | ${cell:-–}"
  done
  echo "${row# | }"
}

# kept_run FOLDER ARGUMENT...: `monogrid ARGUMENT... --out FOLDER`, once: a run that ended is found again by FOLDER.exit, which
# holds its exit code. That tracking never started or was lost (3) is a result; everything else stops the script.
kept_run() {
  local folder=$1 code=0
  shift
  [ ! -f "$folder.exit" ] || return 0
  rm -rf "$folder"
  mkdir -p "$(dirname "$folder")"
  "${bin:?}" "$@" --json --out "$folder" >"$folder.json" 2>"$folder.log" || code=$?
  if [ "$code" != 0 ] && [ "$code" != 3 ]; then
    echo "failed with exit code $code: $bin $* --out $folder" >&2
    tail -5 "$folder.log" >&2
    return 1
  fi
  echo "$code" >"$folder.exit"
}

# kept FILE COMMAND...: what the command prints, in FILE, once.
kept() {
  [ ! -f "$1" ] || return 0
  if ! "${@:2}" >"$1.part" 2>"$1.log"; then
    echo "failed: ${*:2}" >&2
    tail -5 "$1.log" >&2
    return 1
  fi
  mv "$1.part" "$1"
}

# evaluated FOLDER SOURCE: the trajectory of a kept run against the truth, in FOLDER.ate; false where there is nothing to compare.
evaluated() {
  local truth=$2/groundtruth.txt
  [ -f "$truth" ] || truth=$2
  kept "$1.ate" "$bin" evaluate trajectory "$1/trajectory.txt" "$truth" --json 2>/dev/null
}

# begin [FOLDER]: $folder, which keeps what the script makes (without a name a temporary one), and $bin, built unless BIN names one.
begin() {
  folder=${1:-}
  if [ -z "$folder" ]; then
    folder=$(mktemp -d)
    trap 'rm -rf "$folder"' EXIT
  fi
  mkdir -p "$folder"
  if [ -n "${BIN:-}" ]; then
    bin=$BIN
  else
    cargo build --quiet --release -p monogrid-cli
    bin=${CARGO_TARGET_DIR:-target}/release/monogrid
  fi
}
