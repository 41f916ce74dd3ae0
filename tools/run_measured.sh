#!/usr/bin/env bash
# Runs a case on measured data: tools/run_measured.sh pcabs_tension | plate_independent | gt4_stereo
# The data folder is IMIC3D_DATA (default ../shared/data); it is linked, never copied. Cases without a material are correlated only.
set -euo pipefail
cd "$(dirname "$0")/.."
case=${1:?name of a folder in inputs}
data=${IMIC3D_DATA:-../shared/data}
[ -d "$data/$case" ] || { echo "no $case in $data: set IMIC3D_DATA"; exit 2; }
mkdir -p runs
ln -sfn "$(cd "$data" && pwd)" runs/data
tools/make_meshes.sh
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 HWLOC_HIDE_ERRORS=2
file="inputs/$case/${2:-case}.yaml"
command=dic
grep -q "^identify:" "$file" && command=identify
mpirun --oversubscribe -n "${RANKS:-2}" build/release/imic3d "$command" "$file"
