#!/usr/bin/env bash
# What TLS costs an agent of the fleet: a recording is delivered over TCP and over TLS, one right
# after the other and each first in turn, without a limit of the rate. Of each pair the ratio of the
# times of sending counts, and of the CPU time of the agent; the median of all pairs is to be within
# 5 %. Then an agent that believes another authority tries, and must not be let in.
#
#   scripts/fleet_tls.sh [RECORDING]
#
# Without a recording (.mgk) it renders a room and runs on it. Needs openssl. BIN: another binary of
# monogrid-fleet, built otherwise; PAIRS: how many (9).
set -euo pipefail
cd "$(dirname "$0")/.."

if [ -z "${BIN:-}" ]; then
  cargo build --quiet --release --locked -p monogrid-fleet
  BIN=${CARGO_TARGET_DIR:-target}/release/monogrid-fleet
fi
bin=$(realpath "$BIN")
recording=${1:+$(realpath "$1")}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"

# authority NAME: a certificate that signs; certified NAME AUTHORITY: one for this computer.
authority() {
  openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 1 -subj "/CN=$1" -keyout "$1.key" -out "$1.pem" 2>/dev/null
}
certified() {
  openssl req -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -subj "/CN=$1" -addext "subjectAltName=DNS:localhost" -keyout "$1.key" \
    -out "$1.csr" 2>/dev/null
  openssl x509 -req -in "$1.csr" -CA "$2.pem" -CAkey "$2.key" -CAcreateserial -days 1 -copy_extensions copy -out "$1.pem" 2>/dev/null
}
authority ours
authority theirs
certified server ours
echo "{ transport: { link: { tls: { listen_private_key: 'server.key', listen_certificate: 'server.pem' } } } }" >server.json5
for name in ours theirs; do
  echo "{ transport: { link: { tls: { root_ca_certificate: '$name.pem' } } } }" >"$name.json5"
done

if [ -z "$recording" ]; then
  "$bin" monogrid synth office --frames 500 --depth-every 0 --truth-resolution 0.4 --quick-light --size 320x240 --out office >synth.log 2>&1
  "$bin" monogrid run office --resolution 0.2 --out run >run.log 2>&1
  recording=$work/run/recording.mgk
fi

# serve LINK: a server that ends when the recording has come.
serve() {
  rm -rf fleet
  "$bin" server --listen "$1/localhost:17447" --zenoh-config server.json5 --out fleet --until-ended 1 2>server.log &
  server=$!
  until grep -q listens server.log; do sleep 0.05; done
}
# deliver LINK AUTHORITY SECONDS: what the agent says in the end.
deliver() {
  "$bin" agent --follow "$recording" --name agent --connect "$1/localhost:17447" --zenoh-config "$2.json5" --max-rate 1000000 \
    --give-up-after "$3" 2>agent.log || true
  tail -1 agent.log
}

# seconds LINK: delivers, and writes bytes, seconds of sending and of CPU of the agent.
seconds() {
  serve "$1"
  local TIMEFORMAT='%U %S' said cpu
  { time said=$(deliver "$1" ours 120); } 2>cpu
  wait "$server" || true
  cpu=$(awk '{ print $1 + $2 }' cpu)
  # agent: N of N packets delivered, B bytes: K kB/s over the S s of the recording, K kB/s over the S s of sending
  sed -E "s/.*, ([0-9]+) bytes.* over the ([0-9.]+) s of sending\$/\\1 \\2 $cpu/" <<<"$said"
}
pairs=${PAIRS:-9}
for ((pair = 0; pair < pairs; pair++)); do
  if ((pair % 2)); then tls=$(seconds tls) tcp=$(seconds tcp); else tcp=$(seconds tcp) tls=$(seconds tls); fi
  echo "$tcp $tls" >>pairs
done
# ratio A B: the smallest, the median and the largest of all pairs, column A over column B.
ratio() {
  awk -v a="$1" -v b="$2" '{ print $a / $b }' pairs | sort -n |
    awk '{ v[NR] = $1 } END { printf "%.3f %.3f %.3f", v[1], v[int((NR + 1) / 2)], v[NR] }'
}
time=$(ratio 5 2) cpu=$(ratio 6 3)
echo "$(awk 'NR == 1 { print $1 }' pairs) bytes, $pairs pairs; TLS takes so many times as long (smallest, median, largest): $time; CPU of the agent $cpu; load $(cut -d' ' -f1-3 /proc/loadavg)"

serve tls
said=$(deliver tls theirs 3)
kill "$server" && wait "$server" || true
echo "another authority: $said"
[ ! -e fleet/agents/runs.txt ] || ! grep -q agent fleet/agents/runs.txt
awk -v time="$time" 'BEGIN { split(time, of, " "); exit !(of[2] <= 1 / 0.95) }' || { echo "TLS is more than 5 % slower" >&2 && exit 1; }
