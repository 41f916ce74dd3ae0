#!/usr/bin/env bash
# Whole runs as ratios of processor time, medians of several, taking turns: a direct simulation against CalculiX on the same mesh,
# the identification against a direct simulation, and a loop of scipy's least_squares and CalculiX against it. Writes TABLE.md and
# benchmark.json into runs/benchmark. Options: tools/benchmark.py --help
set -euo pipefail
cd "$(dirname "$0")/.."
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 HWLOC_HIDE_ERRORS=2
exec /usr/bin/python3 tools/benchmark.py "$@"
