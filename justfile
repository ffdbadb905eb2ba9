# The tasks of daily work. `just` lists them; each is a line that can be typed as well.

_:
    @just --list

# everything that must hold before a change is accepted
check:
    .ci/run

# checks that take seconds: format, documents, sources
quick:
    cargo fmt --all --check
    python3 scripts/links.py
    python3 scripts/words.py
    python3 scripts/results.py
    python3 scripts/thesis_page.py
    python3 scripts/source.py
    python3 scripts/arrows.py
    python3 scripts/commands.py
    python3 scripts/dependencies.py

# format, and clippy of one package
lint package:
    cargo fmt --all
    cargo clippy -p {{package}} --all-targets -- -D warnings

# the tests of one package
test package *arguments:
    cargo test -p {{package}} {{arguments}}

# a release build, as target/release/monogrid
build:
    cargo build --release --locked -p monogrid-cli

# the first 300 frames of the built-in room
demo:
    cargo run --release --locked -p monogrid-cli -- demo --max-frames 300

# what accuracy.toml promises, on the recordings below MONOGRID_DATA
accuracy:
    cargo test --test accuracy -- --ignored --nocapture

# one part of the tables of BENCHMARKS.md
bench part:
    scripts/benchmarks.sh full {{part}}

# documents that are printed: settings, tables of results
print:
    UPDATE_DOCS=1 cargo test -p monogrid-app --lib manual
    python3 scripts/results.py print

# the book as target/book, and the documentation of the libraries
book:
    mdbook build
    cargo doc --no-deps --workspace
