#!/usr/bin/env bash
# Configures and builds the release preset; arguments go to the build (--target imic3d).
set -euo pipefail
cd "$(dirname "$0")/.."
log=$(mktemp)
cmake --preset release >"$log" 2>&1 || { cat "$log"; exit 1; }
rm -f "$log"
cmake --build --preset release --parallel "$(nproc)" "$@"  # a source of a room takes up to 1.4 GB
