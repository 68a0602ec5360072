#!/usr/bin/env bash
# Makes the README's picture from the bundled sample: seen, guessed, touched, mesh.
set -euo pipefail
cd "$(dirname "$0")/.."
palpate() { cargo run --release --quiet -- "$@"; }

mkdir -p docs/pictures
parts=$(mktemp -d)
trap 'rm -rf "$parts"' EXIT
palpate reconstruct samples/mustard_bottle --output "$parts/bottle.ply" --keep "$parts"
palpate render \
    "$parts/visible.ply" \
    "$parts/visible.ply+$parts/moved.ply" \
    "$parts/visible.ply+$parts/moved.ply+$parts/felt.ply" \
    "$parts/bottle.ply" \
    --caption "seen,+ guessed,+ touched,mesh" \
    --view 205,15 --size 300x440 --output docs/pictures/steps.png
