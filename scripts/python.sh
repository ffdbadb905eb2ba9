#!/usr/bin/env bash
# Builds the Python package as a wheel, installs it into a fresh virtual environment and tests it there; then inserts a million
# points from Python and from Rust and says how long each took.
#
#   scripts/python.sh            PYTHON: another interpreter; PROFILE: release (default) or dev; WHEELS: where the wheel goes; BESIDE=1:
#                                evo, Open3D and Rerun (some 700 MB) in the same environment
set -euo pipefail
cd "$(dirname "$0")/.."
python=${PYTHON:-python3}
profile=${PROFILE:-release}
wheels=${WHEELS:-target/wheels}
package=extra/monogrid-python
if ! command -v "$python" >/dev/null; then
  echo "NOT TESTED: there is no $python" >&2
  exit 1
fi

env=$(mktemp -d)
trap 'rm -rf "$env"' EXIT
"$python" -m venv "$env"
"$env/bin/pip" install -q 'maturin>=1.8,<2'
rm -f "$wheels"/monogrid-*.whl
"$env/bin/maturin" build -q --locked --profile "$profile" --manifest-path $package/Cargo.toml --out "$wheels"
wheel=$(echo "$wheels"/monogrid-*.whl)
"$env/bin/pip" install -q "$wheel[test${BESIDE:+,beside}]"
(cd $package && "$env/bin/python" -m pytest -q -p no:cacheprovider tests)

cargo build -q --locked --profile "$profile" -p monogrid-python --example insert_points
folder=$([ "$profile" = dev ] && echo debug || echo "$profile")
"$env/bin/python" $package/examples/insert_points.py "${CARGO_TARGET_DIR:-target}/$folder/examples/insert_points"
echo "$wheel"
