#!/usr/bin/env bash
# The campaign against the program: mutated files of every kind, clients of its pages and sources that do anything, packets of a
# fleet, small files that ask for much, kills, full disks, odd names, extreme settings, each with a limit of memory (2 GB) and time
# (60 s) per run. Prints the tables of BENCHMARKS.md.
#
#   scripts/torture.sh [MINUTES]      MINUTES for each kind of mutated file (default 5; 38 kinds)
#   MUTANTS=1000 scripts/torture.sh   so many of each kind, however long they take
#   TORTURE_ONLY=bag scripts/torture.sh 1     the kinds with this in their names
#   scripts/torture.sh 1 soak         and the soaks of scripts/soak.sh, which take hours
#
# KILLS: runs that are killed (default 50). SEED: begins another sequence of mutations. KEEP: a folder for files that did harm
# (each becomes a test of its reader). Mutations are made from seeds by number, so that what was found is found again.
set -uo pipefail
cd "$(dirname "$0")/.."
export TORTURE_SECONDS=$((60 * ${1:-5})) TORTURE_KILLS=${KILLS:-50} TORTURE_SEED=${SEED:-1} TORTURE_MUTANTS=${MUTANTS:-0}
if [ -n "${KEEP:-}" ]; then mkdir -p "$KEEP" && TORTURE_KEEP=$(realpath "$KEEP") && export TORTURE_KEEP; fi
unset KEEP
failed=0
cargo test --release -p monogrid-cli --test torture -- --ignored --nocapture --test-threads 1 || failed=1
cargo test --release -p monogrid-fleet --test packets mutated -- --nocapture || failed=1
cargo build --release -p monogrid-cli && scripts/bombs.py "${CARGO_TARGET_DIR:-target}/release/monogrid" || failed=1
if [ "${2:-}" = soak ]; then
  scripts/soak.sh known || failed=1
  scripts/soak.sh new || failed=1
fi
exit "$failed"
