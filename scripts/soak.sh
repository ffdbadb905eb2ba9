#!/usr/bin/env bash
# Memory and time per frame of a very long run: prints a table by frame, and a plot of the memory.
#
#   scripts/soak.sh known [FRAMES]    the images of SEQUENCE, forth and back: known places (default 30000 frames)
#   scripts/soak.sh new [FRAMES]      one round through the corridors of a world: new places (default 1500 frames), and what
#                                     a keyframe takes in memory by owner
#
# SEQUENCE: a folder in TUM layout (default red-kitchen of MONOGRID_DATA). SIZE: working size (default 320x240; new: 640x480).
# BIN: another binary. KEEP: a folder for the run, kept afterwards.
# Exit code 1 when, in known places, memory grows by 2 % or more between frame 5,000 and the last one, or the CPU time
# per frame of the last quarter exceeds that of the quarter after frame 5,000 by 10 % or more.
set -euo pipefail
cd "$(dirname "$0")/.."
bin=${BIN:-target/release/monogrid}
kind=${1:?known or new}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
out=${KEEP:-$work/run}

# A list of all images of a folder in TUM layout, walked in the directions given by the awk rule, $frames lines.
walk() {
  local sequence=$1
  grep -v '^#' "$sequence/rgb.txt" | awk -v root="$(realpath "$sequence")" -v frames="$frames" '
    { path[NR - 1] = root "/" $2 }
    END { period = 2 * (NR - 1)
          for (i = 0; i < frames; i++) { at = i % period; if (at >= NR) at = period - at
            printf "%.6f %s\n", i / 30, path[at] } }' > "$work/list.txt"
  cp "$sequence"/calibration.* "$work/"
}

case $kind in
  known)
    size=${SIZE:-320x240} frames=${2:-30000}
    walk "${SEQUENCE:-${MONOGRID_DATA:-../shared/data}/red-kitchen}"
    source=$work/list.txt
    ;;
  new)
    size=${SIZE:-640x480} frames=${2:-1500}
    "$bin" synth corridor-loop --frames "$frames" --size "$size" --out "$work/corridor" > /dev/null
    source=$work/corridor
    ;;
  *) echo "known or new, not $kind" >&2; exit 2 ;;
esac

"$bin" run "$source" --size "$size" --out "$out" --threads "${THREADS:-1}" > "$work/log" 2>&1 &
pid=$!
# seconds, resident memory (kB), CPU time (ticks), bytes read so far: images are what is read
while [ -r "/proc/$pid/io" ]; do
  rss=$(awk '/^VmRSS/ { print $2 }' "/proc/$pid/status" 2> /dev/null || true)
  cpu=$(awk '{ print $14 + $15 }' "/proc/$pid/stat" 2> /dev/null || true)
  read=$(awk '/^rchar/ { print $2 }' "/proc/$pid/io" 2> /dev/null || true)
  [ -n "$rss" ] && [ -n "$cpu" ] && [ -n "$read" ] && echo "$SECONDS $rss $cpu $read" >> "$work/samples"
  sleep "${EVERY:-2}"
done
code=0
wait "$pid" || code=$?
tail -5 "$work/log"
[ "$code" -eq 0 ] || { echo "the run ended with exit code $code" >&2; exit 1; }

if [ "$kind" = new ]; then
  awk -F'[:,]' '/"keyframes":/ && !n { n = $2 }
    /"memory_bytes"/ { inside = 1; print "| owner | bytes per keyframe |\n|---|---|"; next }
    inside && /}/ { exit }
    inside { gsub(/[ "]/, "", $1); printf "| %s | %d |\n", $1, $2 / n }' "$out/summary.json"
fi

# the frame of a sample is where the images that were read end
if [ "$kind" = known ]; then cut -d' ' -f2- "$work/list.txt"; else
  awk -v root="$work/corridor/" '!/^#/ { print root $2 }' "$work/corridor/rgb.txt"; fi |
  tr '\n' '\0' | xargs -0 stat -L -c %s > "$work/sizes"
awk -v kind="$kind" -v ticks="$(getconf CLK_TCK)" '
  FNR == NR { n++; upto[n] = upto[n - 1] + $1; next }
  { while (frame < n && upto[frame + 1] <= $4) frame++
    at[++m] = frame; rss[m] = $2 / 1024; cpu[m] = $3 / ticks }
  # of the first sample at or behind a frame
  function sample(f,   i) { for (i = 1; i < m && at[i] < f; i++); return i }
  function ms(a, b) { a = sample(a); b = sample(b); return at[b] > at[a] ? 1000 * (cpu[b] - cpu[a]) / (at[b] - at[a]) : 0 }
  END {
    step = n / 30; for (i = 1; i <= 30; i++) { s = sample(i * step); if (rss[s] > top) top = rss[s] }
    print "| frame | memory, MB | CPU per frame, ms | |\n|---|---|---|---|"
    for (i = 1; i <= 30; i++) { s = sample(i * step); bar = ""
      for (k = 0; k < 40 * rss[s] / top; k++) bar = bar "#"
      printf "| %d | %.0f | %.1f | `%s` |\n", i * step, rss[s], ms((i - 1) * step, i * step), bar }
    first = n >= 10000 ? 5000 : n / 2; last = sample(n - step); growth = rss[last] / rss[sample(first)] - 1
    early = ms(first, first + (n - first) / 4); late = ms(n - (n - first) / 4, n - step / 2)
    printf "memory from frame %d to %d: %+.1f %%; CPU per frame %.1f, then %.1f ms\n", first, at[last], 100 * growth, early, late
    exit kind == "known" && (growth >= 0.02 || late >= 1.1 * early) }' "$work/sizes" "$work/samples" || {
  echo "the run grows" >&2; exit 1; }
