#!/usr/bin/env bash
# Three agents and a server, each a process in a network namespace of its own, and the link of one agent cut for 20 s. Prints the table of BENCHMARKS.md:
# is there one map, what did agents cost beside runs without one, and how many bytes went over each link?
#
#   scripts/fleet.sh
#
# The sources are thirds of red-kitchen (of scripts/data.sh); where there is none, parts of a room that it renders. Needs root and `ip` (iproute2) for
# namespaces, veth pairs and a bridge, which are in a namespace of their own and gone at the end. BIN: another binary of monogrid-fleet, built otherwise;
# CUT: seconds of the cut; WORK: a folder where the results are kept.
set -euo pipefail
cd "$(dirname "$0")/.."

if [ -z "${BIN:-}" ]; then
  # there is no network for it inside
  cargo build --quiet --release --locked -p monogrid-fleet
  export BIN=${CARGO_TARGET_DIR:-target}/release/monogrid-fleet
fi

# Everything below runs in a network namespace that ends with this script.
if [ "${1:-}" != inside ]; then
  exec unshare --net --mount bash scripts/fleet.sh inside
fi
# named namespaces are files: on a file system that only this script sees
mount -t tmpfs tmpfs /run
mkdir -p /run/netns

. scripts/common.sh
bin=$(realpath "$BIN")
work=${WORK:-}
if [ -z "$work" ]; then
  work=$(mktemp -d)
  trap 'rm -rf "$work"' EXIT
fi
mkdir -p "$work"
work=$(realpath "$work")
cut=${CUT:-20}
# frames of an agent, and from one agent to the next
length=211 step=211 coarse=
source=$data/red-kitchen
if [ ! -d "$source" ]; then
  source=$work/office length=180 step=120 coarse='--resolution 0.1'
  [ -d "$source" ] || "$bin" monogrid synth office --frames 500 --max-frames $((length + 2 * step)) --depth-every 0 --truth-resolution 0.4 \
    --quick-light --size 320x240 --out "$source"
fi
source=$(realpath "$source")

# timed FILE COMMAND...: its seconds of CPU, user and system, children included, in FILE; what it says in FILE.log.
timed() {
  local file=$1 TIMEFORMAT='%U %S'
  shift
  { time "$@" >/dev/null 2>"$file.log"; } 2>"$file" || { tail -5 "$file.log" >&2 && return 1; }
}

# part K: the options of a run on a part of the source.
part() { echo "--start $(($1 * step)) --max-frames $length $coarse"; }

ip link add hub type bridge
ip link set hub up
for name in server a b c; do
  ip netns add "$name"
  ip link add "hub-$name" type veth peer name veth0 netns "$name"
  ip link set "hub-$name" master hub up
  ip -n "$name" link set lo up
  ip -n "$name" link set veth0 up
done
ip -n server address add 10.0.0.1/24 dev veth0
number=2
for name in a b c; do
  ip -n "$name" address add "10.0.0.$number/24" dev veth0
  number=$((number + 1))
done

names=(a b c)
rm -rf "$work"/agent-* "$work/server"
# shellcheck disable=SC2046 # options are words
for k in 0 1 2; do
  [ -s "$work/alone-$k" ] || timed "$work/alone-$k" "$bin" monogrid run "$source" $(part $k) --out "$work/alone-$k-run"
done
ip netns exec server "$bin" server --listen tcp/10.0.0.1:7447 --out "$work/server" --until-ended 3 2>"$work/server.log" &
server=$!
sleep 1
agents=()
# shellcheck disable=SC2046
for k in 0 1 2; do
  timed "$work/agent-$k" ip netns exec "${names[k]}" "$bin" agent "$source" --name "${names[k]}" --connect tcp/10.0.0.1:7447 \
    --out "$work/agent-$k-run" -- $(part $k) &
  agents+=($!)
done

trap 'kill "$server" "${agents[@]}" 2>/dev/null || true; [ -n "${WORK:-}" ] || rm -rf "$work"' EXIT

# The link of b: down when it has said where a keyframe is, up after the cut.
until grep -sq 'keyframe [0-9]* at' "$work/agent-1.log"; do
  kill -0 "${agents[1]}"
  sleep 0.2
done
ip link set hub-b down
sleep "$cut"
ip link set hub-b up
wait "${agents[@]}"
code=0
wait "$server" || code=$?

echo "The link of b was down for $cut s. Exit code of the server: $code."
grep -h 'wait$\|lost\|delivered' "$work"/agent-?.log | sed 's/^/    /'
tail -1 "$work/server.log"
"$bin" monogrid evaluate trajectory "$work/server/map/trajectory.txt" "$source/groundtruth.txt" | grep '^ATE'
printf '\n| agent | frames | alone: CPU per frame, ms | as agent | ratio | kB over its link | kB/s, of recorded time |\n'
printf '|---|---|---|---|---|---|---|\n'
for k in 0 1 2; do
  frames=$(value "$work/agent-$k-run/summary.json" frames)
  bytes=$(ip netns exec "${names[k]}" cat /sys/class/net/veth0/statistics/tx_bytes)
  # 30 frames per second
  cat "$work/alone-$k" "$work/agent-$k" | awk -v name="${names[k]}" -v n="$frames" -v b="$bytes" \
    '{ ms[NR] = 1e3 * ($1 + $2) / n }
     END { printf "| %s | %d | %.1f | %.1f | %.3f | %.0f | %.0f |\n", name, n, ms[1], ms[2], ms[2] / ms[1], b / 1e3, b / 1e3 / (n / 30) }'
done
