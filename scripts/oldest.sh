#!/usr/bin/env bash
# Does everything compile with the oldest Rust that Cargo.toml promises? Needs rustup, and a network the first time.
set -euo pipefail
cd "$(dirname "$0")/.."
version=$(sed -n 's/^rust-version = "\(.*\)"/\1/p' Cargo.toml)
rustup toolchain install "$version" --profile minimal --no-self-update
cargo "+$version" check --workspace --locked
