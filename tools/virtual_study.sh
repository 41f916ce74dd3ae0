#!/usr/bin/env bash
# The paper's virtual test (Sec. 4, one camera): images, then every parameter from 80, 90, 110 and 120 % of its true value.
# 3D: about 30 minutes on 2 cores. --plane-stress: the test in plane stress. Other arguments go to sequential_study.py.
set -euo pipefail
cd "$(dirname "$0")/.."
study=virtual_study
if [ "${1:-}" = --plane-stress ]; then
  study=virtual_study_plane_stress
  shift
fi
tools/make_meshes.sh
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 HWLOC_HIDE_ERRORS=2
mpirun --oversubscribe -n "${RANKS:-2}" build/release/imic3d virtual inputs/$study/virtual.yaml
tools/sequential_study.py inputs/$study/case.yaml runs/$study/images/truth.json \
  --ranks "${RANKS:-2}" --output runs/$study/sequential "$@"
