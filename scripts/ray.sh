#!/usr/bin/env bash
# Tests of one recording on one computer; then recordings under Ray with an object store on this computer, in a fresh virtual environment: one worker, two, and two of which one is
# killed three times; every result must be what a plain run writes, byte for byte, and two workers at least 1.6 times as fast as one.
#
#   scripts/ray.sh            RECORDINGS: how many (40); FRAMES: of each (60); PROFILE: release (default) or dev; PROGRAM: one that is built already
set -euo pipefail
cd "$(dirname "$0")/.."
python=${PYTHON:-python3}
profile=${PROFILE:-release}
if ! command -v "$python" >/dev/null; then
  echo "NOT TESTED: there is no $python" >&2
  exit 1
fi
if [ -z "${PROGRAM:-}" ]; then
  cargo build -q --locked --profile "$profile" -p monogrid-cli
  folder=$([ "$profile" = dev ] && echo debug || echo "$profile")
  PROGRAM=${CARGO_TARGET_DIR:-target}/$folder/monogrid
fi

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$python" -m venv "$work/env"
# building leaves files beside the sources
cp -r extra/monogrid-ray "$work/package"
if ! "$work/env/bin/pip" install -q "$work/package[test]"; then
  echo "NOT TESTED: ray, obstore and moto cannot be installed" >&2
  exit 1
fi
(cd extra/monogrid-ray && "$work/env/bin/python" -m pytest -q -p no:cacheprovider tests/test_task.py)
shared=()
recordings=${MONOGRID_DATA:-../shared/data}
[ -d "$recordings" ] && shared=(--shared "$recordings")
"$work/env/bin/python" extra/monogrid-ray/tests/bar.py "$PROGRAM" "$work/bar" --recordings "${RECORDINGS:-40}" --frames "${FRAMES:-60}" "${shared[@]}"
