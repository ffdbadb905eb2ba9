#!/usr/bin/env bash
# An archive for those who have neither Rust nor a network: the program for a target, its manual, completions of shells, licences.
#
#   scripts/release.sh [TARGET]    default: this computer's. x86_64-unknown-linux-musl gives a program that needs nothing of the system;
#                                  aarch64-unknown-linux-musl is tried out with qemu-aarch64 where that is installed
#
# A target is installed by `rustup target add`. Nothing of the program is C, so that musl targets are linked by the linker that comes with
# Rust; another is asked for by CARGO_TARGET_<TARGET>_LINKER. OUT: where the archive goes; PROFILE: release (default) or dev.
set -euo pipefail
cd "$(dirname "$0")/.."
host=$(rustc -vV | sed -n 's/^host: //p')
target=${1:-$host}
profile=${PROFILE:-release}
out=${OUT:-target/archives}
case $target in
  *-musl)
    linker=CARGO_TARGET_$(tr 'a-z-' 'A-Z_' <<<"$target")_LINKER
    export "$linker=${!linker:-rust-lld}"
    ;;
esac

cargo build --locked --profile "$profile" --target "$target" -p monogrid-cli --bin monogrid
built=$([ "$profile" = dev ] && echo debug || echo "$profile")
program=${CARGO_TARGET_DIR:-target}/$target/$built/monogrid

# what the program says about itself is the same for every target
frames=60
case $target in
  "$host" | "${host%-gnu}-musl") run=("$program") ;;
  # an emulated computer is fifty times slower: it begins, and the map is left out
  aarch64-*) run=(qemu-aarch64 "$program") frames=12 ;;
  *) run=() ;;
esac
version=$(sed -n 's/^version = "\(.*\)"/\1/p' Cargo.toml | head -1)
name=monogrid-$version-$target
staged=$(mktemp -d)
trap 'rm -rf "$staged"' EXIT
mkdir "$staged/$name"
cp "$program" README.md CHANGELOG.md LICENSE-MIT LICENSE-APACHE "$staged/$name/"
if [ ${#run[@]} -gt 0 ] && command -v "${run[0]}" >/dev/null; then
  "${run[@]}" --version
  "${run[@]}" demo --max-frames "$frames" --out "$staged/demo" >/dev/null 2>&1 || [ $? -eq 3 ]
  test -s "$staged/demo/summary.json"
  "${run[@]}" man --out "$staged/$name/man" >/dev/null
  rm -f "$staged/$name"/man/monogrid-manifest.txt
  mkdir "$staged/$name/completions"
  for shell in bash zsh fish powershell elvish; do
    "${run[@]}" completions "$shell" >"$staged/$name/completions/monogrid.$shell"
  done
else
  echo "NOT TRIED OUT: this computer cannot run programs for $target; the archive is without manual and completions" >&2
fi
mkdir -p "$out"
# the same bytes for the same program
tar --sort=name --mtime=@0 --owner=0 --group=0 --numeric-owner -C "$staged" -cf - "$name" | gzip -n >"$out/$name.tar.gz"
(cd "$out" && sha256sum "$name.tar.gz" >"$name.tar.gz.sha256")
echo "$out/$name.tar.gz"
