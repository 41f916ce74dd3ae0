#!/usr/bin/env bash
# Installs what is needed, builds, makes a virtual test of a plate with a hole and identifies its material from the images.
# RANKS (default 2) is the number of MPI ranks.
set -euo pipefail
cd "$(dirname "$0")/.."
tools/setup.sh
tools/build.sh --target imic3d

ranks=${RANKS:-2}
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 HWLOC_HIDE_ERRORS=2
run() { mpirun --oversubscribe -n "$ranks" build/release/imic3d "$@"; }

tools/make_meshes.sh
mkdir -p runs
start=$SECONDS
run virtual inputs/plate_with_hole/virtual.yaml
run identify inputs/plate_with_hole/case.yaml
echo
echo "The true values: $(tr -d '\n' < runs/plate_with_hole/virtual/truth.json)"
echo "The run took $((SECONDS - start)) s on $ranks ranks."
echo "Report:  $PWD/runs/plate_with_hole/identified/report.html"
echo "Results: $PWD/runs/plate_with_hole/identified/results.h5 (results.xdmf opens in ParaView)"
