#!/usr/bin/env bash
# Runs fuzz targets without cargo-fuzz and without a nightly compiler: coverage by the stable one, and no sanitizer; what is looked for is
# panics, overflows, time and memory.
#
#   scripts/fuzz.sh SECONDS TARGET...      e.g. scripts/fuzz.sh 600 video images calibration
#
# Seeds: fuzz/seeds and the small files of the tests. Each input may take 10 s and the process 1 GB. WORK: a
# folder for what is built and found (default target/fuzz); the inputs that were found to matter stay there, and are begun with the next time.
# BUILD_ONLY=1 stops before. Needs a C++ compiler (the engine is C++). Exit code 1 when something was found: the input lies in WORK/found-TARGET.
set -euo pipefail
cd "$(dirname "$0")/.."
seconds=$1
shift
work=$(realpath -m "${WORK:-target/fuzz}")
host=$(rustc -vV | sed -n 's/^host: //p')

# Inputs to begin with.
seeds() {
  [ ! -d "fuzz/seeds/$1" ] || cp "fuzz/seeds/$1"/* "$2"
  case $1 in
    video) cp crates/monogrid-video/tests/data/*.mp4 crates/monogrid-video/tests/data/*.avi "$2" ;;
    bag) cp crates/monogrid-bags/tests/data/*.bag crates/monogrid-bags/tests/data/*.db3 crates/monogrid-bags/tests/data/*.mcap "$2" ;;
    map_ot | map_bt) cp crates/monogrid-occupancy/tests/golden/*."${1#map_}" "$2" ;;
  esac
}

# coverage as cargo-fuzz asks for it; with --target build scripts and macros stay without
flags="-Cpasses=sancov-module -Ccodegen-units=1 -Cdebug-assertions=on -Coverflow-checks=on --cfg fuzzing"
for option in level=4 inline-8bit-counters pc-table trace-compares; do
  flags+=" -Cllvm-args=-sanitizer-coverage-$option"
done
bins=()
for target in "$@"; do bins+=(--bin "$target"); done
RUSTFLAGS=$flags cargo build --release --manifest-path fuzz/Cargo.toml --target-dir "$work/target" --target "$host" "${bins[@]}"

[ -z "${BUILD_ONLY:-}" ] || exit 0
code=0
for target in "$@"; do
  mkdir -p "$work/seeds-$target" "$work/corpus-$target" "$work/found-$target"
  seeds "$target" "$work/seeds-$target"
  "$work/target/$host/release/$target" "$work/corpus-$target" "$work/seeds-$target" -max_total_time="$seconds" -timeout=10 \
    -rss_limit_mb=1024 -malloc_limit_mb=1024 -max_len=65536 -print_final_stats=1 -artifact_prefix="$work/found-$target/" >"$work/$target.log" 2>&1 || code=1
  printf '%s: %s runs, %s MB at most, found %s\n' "$target" "$(awk '/number_of_executed_units/ { print $2 }' "$work/$target.log")" \
    "$(awk '/peak_rss_mb/ { print $2 }' "$work/$target.log")" "$(find "$work/found-$target" -type f | wc -l)"
done
exit "$code"
