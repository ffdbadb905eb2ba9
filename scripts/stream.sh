#!/usr/bin/env bash
# A stream at the pace of a camera, with mapping: prints what was dropped, how long frames took to their poses, and memory, by minute.
#
#   scripts/stream.sh [SECONDS]    default 600; the machine should be at rest
#
# The images of SEQUENCE (a folder with rgb/ and calibration.txt; default red-kitchen of MONOGRID_DATA) there and back at RATE (default 30)
# frames per second through a pipe into `monogrid run - --realtime`. CORES: those of the run (default 0,1). ARGS: more arguments of the run.
# BIN, PLAYER: other binaries (PLAYER: the example `player` of monogrid-video). KEEP: a folder for the run, kept afterwards.
# Exit code 1 when after the first minute (the first half of a shorter stream) a frame is dropped, 99 % of the frames of the whole stream do not
# have their pose within 60 ms, or memory grows by 10 % or more between the middle of the stream and its end.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/common.sh
bin=${BIN:-target/release/monogrid}
player=${PLAYER:-target/release/examples/player}
seconds=${1:-600} rate=${RATE:-30}
sequence=${SEQUENCE:-$data/red-kitchen}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
out=${KEEP:-$work/run}
[ -x "$player" ] || { echo "no $player: cargo build --release -p monogrid-video --example player" >&2; exit 2; }

mkfifo "$work/pipe"
"$player" "$sequence/rgb" "$rate" "$seconds" >"$work/pipe" &
# shellcheck disable=SC2086 # several arguments
taskset -c "${CORES:-0,1}" "$bin" run - --realtime --calibration "$sequence/calibration.txt" ${ARGS:-} --json --out "$out" \
  <"$work/pipe" >"$work/summary.json" 2>"$work/log" &
pid=$!
# seconds since the start and resident memory, MB
while rss=$(awk '/^VmRSS/ { print $2 / 1024 }' "/proc/$pid/status" 2>/dev/null) && [ -n "$rss" ]; do
  echo "$SECONDS $rss" >>"$work/memory"
  sleep 2
done
wait "$pid" || { tail -5 "$work/log" >&2; exit 1; }

awk -F, -v memory="$work/memory" -v seconds="$seconds" '
  function within(n, share,   i) { i = int(n * share); return sorted[i < n * share ? i + 1 : i] }
  function sort_rows(list, n,   gap, i, j, t) {
    for (i = 1; i <= n; i++) sorted[i] = list[i]
    for (gap = int(n / 2); gap > 0; gap = int(gap / 2))
      for (i = gap + 1; i <= n; i++) { t = sorted[i]
        for (j = i - gap; j > 0 && sorted[j] > t; j -= gap) sorted[j + gap] = sorted[j]
        sorted[j + gap] = t } }
  NR == 1 { for (i = 1; i <= NF; i++) column[$i] = i; next }
  { minute = int($column["timestamp"] / 60); if (minute > last) last = minute
    frames[minute]++
    if ($column["state"] == "dropped") dropped[minute]++
    if ($column["state"] == "dropped" && $column["timestamp"] > (seconds < 120 ? seconds / 2 : 60)) late++
    if ($column["state"] == "lost") lost[minute]++
    # a reason may hold commas: latency is the last column
    if ($column["state"] != "dropped" && $NF != "") { n[minute]++; by_minute[minute, n[minute]] = $NF; all[++total] = $NF } }
  END {
    while ((getline line < memory) > 0) { split(line, m, " "); k = int(m[1] / 60); if (m[2] > most[k]) most[k] = m[2]
      if (m[1] < seconds) { if (m[1] <= seconds / 2) half = m[2]; end = m[2] } if (m[2] > peak) peak = m[2] }
    print "| minute | frames | dropped | lost | frame to pose, ms: median | 99 % | most | memory, MB |\n|---|---|---|---|---|---|---|---|"
    for (k = 0; k <= last; k++) {
      for (i = 1; i <= n[k]; i++) one[i] = by_minute[k, i]
      sort_rows(one, n[k])
      printf "| %d | %d | %d | %d | %.0f | %.0f | %.0f | %.0f |\n", k + 1, frames[k], dropped[k], lost[k], within(n[k], 0.5), within(n[k], 0.99), sorted[n[k]], most[k] }
    sort_rows(all, total)
    printf "all: median %.0f ms, 99 %% within %.0f ms, at most %.0f ms; %d dropped after the start; memory at most %.0f MB, %+.1f %% from the middle to the end\n",
      within(total, 0.5), within(total, 0.99), sorted[total], late, peak, 100 * (end / half - 1)
    exit late > 0 || within(total, 0.99) > 60 || end >= 1.1 * half }' "$out/frames.csv" || {
  echo "the run does not keep pace" >&2; exit 1; }
