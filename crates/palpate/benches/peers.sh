#!/bin/sh
# Meshes the same clouds with palpate and with Open3D and PyMeshLab, alternating, and prints the tables of docs/performance.md.
#
#   crates/palpate/benches/peers.sh TRUTH.ply [SCRATCH]      SCRATCH: default a new temporary folder; keeps the environment and the clouds
#
# Needs cargo, python3 with venv, the package registry, and what Open3D asks of the system (libusb-1.0, libgomp, libGL, libX11). REPEATS="5 3 1" are the repeats at 50k and below, 200k, 1M. POINTS="10000 50000" limits.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
truth=$(realpath "$1")
scratch=${2:-$(mktemp -d)}
mkdir -p "$scratch"
if [ ! -x "$scratch/venv/bin/python" ]; then
    python3 -m venv "$scratch/venv"
    (cd "$scratch" && venv/bin/pip install --quiet open3d pymeshlab numpy trimesh)
fi
cd "$here/../../.."
cargo build --quiet --release -p palpate --example measure_surface
exec "$scratch/venv/bin/python" "$here/peers.py" "$truth" "$scratch" "$(pwd)/target/release/examples/measure_surface"
