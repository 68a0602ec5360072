# Recipes; `.ci/run` is the same list as plain shell. The package set is always the whole workspace, to keep one cache warm.

# What exists
default:
    @just --list

# Fast feedback while editing
check:
    cargo check --workspace --all-targets

# The whole default suite, under a minute once built
test:
    cargo test --workspace --features palpate_cli/nn

# Style
lint:
    cargo fmt --all --check
    cargo clippy --workspace --all-targets --features palpate_cli/nn -- -D warnings

# The library's documentation, links checked
doc:
    RUSTDOCFLAGS=-Dwarnings cargo doc --workspace --no-deps

# Everything that must hold before a merge
ci:
    .ci/run

# Time each stage
bench:
    cargo bench --workspace

# The results table of the README (hours for the full run; QUICK=--quick for minutes)
eval DATASET OUT QUICK="":
    cargo run --release -- benchmark shape {{DATASET}} --output {{OUT}} {{QUICK}}

# The README's picture and those of the docs
figures:
    docs/figures.sh
