#!/usr/bin/env bash
# Looks at pages in headless Chromium, drawn by the processor alone: errors, addresses that are asked for, time to load, pictures per
# second while the view turns, width on a phone; and takes pictures to be looked at.
#
#   scripts/look.sh OUT PAGE.html...       OUT: a folder for the pictures
#
# Needs chromium (apt-get install chromium) and node with npm, which fetches playwright-core once into OUT. CHROMIUM: another browser.
set -euo pipefail
out=$(realpath -m "$1")
shift
mkdir -p "$out"
[ -d "$out/node_modules/playwright-core" ] || npm install --silent --no-audit --no-fund --prefix "$out" playwright-core@1 >/dev/null
NODE_PATH=$out/node_modules CHROMIUM=${CHROMIUM:-$(command -v chromium || command -v chromium-browser)} node "$(dirname "$0")/look.cjs" "$out" "$@"
