#!/usr/bin/env bash
# Sec. 5 as a virtual experiment (inputs/two_faces): images of three cameras, then Table 1 and Figs 22b and 23. Writes
# runs/two_faces/{table1,curves}.csv, fig22b.png, fig23.png. 7 to 8 minutes of one core.
set -euo pipefail
cd "$(dirname "$0")/.."
tools/make_meshes.sh
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 HWLOC_HIDE_ERRORS=2
mpirun --oversubscribe -n "${RANKS:-1}" build/release/imic3d virtual inputs/two_faces/virtual.yaml
tools/table1.py --ranks "${RANKS:-1}" "$@"
