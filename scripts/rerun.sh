#!/usr/bin/env bash
# Builds and tests the program for the Rerun viewer, then writes a short run of the built-in room as an .rrd file with it.
#
#   scripts/rerun.sh            BIN: another build of monogrid
set -euo pipefail
cd "$(dirname "$0")/.."
bin=${BIN:-target/release/monogrid}
crate=extra/monogrid-rerun
cargo fmt --manifest-path $crate/Cargo.toml --check
cargo clippy --release --locked --manifest-path $crate/Cargo.toml --all-targets -- -D warnings
cargo test --release --locked --manifest-path $crate/Cargo.toml
cargo build --release --locked --manifest-path $crate/Cargo.toml

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$bin" synth living-room --size 320x240 --max-frames 150 --depth-every 150 --truth-resolution 0.2 --out "$work/room" >"$work/log" 2>&1
PATH=$PWD/$crate/target/release:$PATH "$bin" run "$work/room" --seed-depth dataset --realtime --out "$work/run" --view rrd="$work/room.rrd" 2>"$work/log"
if grep -q '^warning: monogrid-rerun' "$work/log"; then
  cat "$work/log" >&2
  exit 1
fi
magic=$(head -c 3 "$work/room.rrd")
[ "$magic" = RRF ] || { echo "room.rrd begins with $magic, expected RRF" >&2; exit 1; }
for entity in image map/camera map/path map/keyframes/00000/points map/cells tracking/state; do
  grep -qa "$entity" "$work/room.rrd" || { echo "room.rrd lacks $entity" >&2; exit 1; }
done
echo "room.rrd: $(stat -c %s "$work/room.rrd") bytes"
