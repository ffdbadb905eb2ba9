#!/usr/bin/env bash
# Whether every crate can be published as it is, and whether the interfaces since the last release allow its version number.
# Builds every crate from its package; --no-verify leaves that out.
set -euo pipefail
cd "$(dirname "$0")/.."

cargo publish --workspace --dry-run "$@"

if ! cargo semver-checks --version >/dev/null 2>&1; then
    echo "interfaces not compared: cargo install cargo-semver-checks --locked" >&2
elif ! last=$(git describe --tags --abbrev=0 2>/dev/null); then
    echo "interfaces not compared: there is no release yet" >&2
else
    cargo semver-checks --workspace --baseline-rev "$last"
fi
