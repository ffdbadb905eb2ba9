#!/usr/bin/env bash
# What TLS costs an agent of the fleet: a recording is delivered over TCP and over TLS in turn,
# without a limit of the rate, and the medians of the times of sending are compared. Then an agent
# that believes another authority tries, and must not be let in.
#
#   scripts/fleet_tls.sh [RECORDING]
#
# Without a recording (.mgk) it renders a room and runs on it. Needs openssl. BIN: another binary of
# monogrid-fleet, built otherwise; ROUNDS: how often (9).
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
  "$bin" monogrid synth office --frames 500 --max-frames 180 --depth-every 0 --truth-resolution 0.4 --quick-light --size 320x240 --out office >synth.log 2>&1
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

for ((round = 0; round < ${ROUNDS:-9}; round++)); do
  for link in tcp tls; do
    serve "$link"
    said=$(deliver "$link" ours 60)
    wait "$server" || true
    # agent: N of N packets delivered, B bytes: K kB/s over the S s of the recording, K kB/s over the S s of sending
    sed -E 's/.*, ([0-9]+) bytes.* ([0-9]+) kB\/s over the ([0-9.]+) s of sending$/\1 \2/' <<<"$said" >>"$link.times"
  done
done
median() { awk '{ print $2 }' "$1.times" | sort -n | awk '{ v[NR] = $1 } END { print v[int((NR + 1) / 2)] }'; }
echo "$(awk 'NR == 1 { print $1 }' tcp.times) bytes; TCP $(median tcp) kB/s, TLS $(median tls) kB/s (medians of ${ROUNDS:-9}); load $(cut -d' ' -f1-3 /proc/loadavg)"

serve tls
said=$(deliver tls theirs 3)
kill "$server" && wait "$server" || true
echo "another authority: $said"
[ ! -e fleet/agents/runs.txt ] || ! grep -q agent fleet/agents/runs.txt
awk -v tcp="$(median tcp)" -v tls="$(median tls)" 'BEGIN { exit !(tls >= 0.95 * tcp) }' || { echo "TLS is more than 5 % slower" >&2 && exit 1; }
