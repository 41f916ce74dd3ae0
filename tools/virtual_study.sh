#!/usr/bin/env bash
# The paper's virtual test (Sec. 4, 3D, one camera): images, then every parameter from 80, 90, 110 and 120 % of its true
# value. About 30 minutes on 2 cores. Arguments go to sequential_study.py.
set -euo pipefail
cd "$(dirname "$0")/.."
tools/make_meshes.sh
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 HWLOC_HIDE_ERRORS=2
mpirun --oversubscribe -n "${RANKS:-2}" build/release/imic3d virtual inputs/virtual_study/virtual.yaml
tools/sequential_study.py inputs/virtual_study/case.yaml runs/virtual_study/images/truth.json \
  --ranks "${RANKS:-2}" --output runs/virtual_study/sequential "$@"
