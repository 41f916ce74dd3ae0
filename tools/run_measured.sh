#!/usr/bin/env bash
# Runs a case on measured data: tools/run_measured.sh pcabs_tension | plate_independent | gt4_stereo | stereo_chessboard |
# steel304L_rates | steel_cyclic (curves: every case file of the folder, one after the other, and a picture of all);
# with `loop` as the second word (pcabs_tension, oht_cfrp, gt4_stereo, steel304L_rates, steel_cyclic, plate_independent): what the declared model lacks (loop.yaml, or the file that the third word names)
# The data folder is IMIC3D_DATA (default ../shared/data); it is linked, never copied. A case without a section identify is
# correlated only.
set -euo pipefail
cd "$(dirname "$0")/.."
case=${1:?name of a folder in inputs}
data=${IMIC3D_DATA:-../shared/data}
[ -d "$data/$case" ] || { echo "no $case in $data: set IMIC3D_DATA"; exit 2; }
mkdir -p runs
ln -sfn "$(cd "$data" && pwd)" runs/data
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 HWLOC_HIDE_ERRORS=2
if [ "$case" = stereo_chessboard ]; then exec build/release/imic3d calibrate "inputs/$case/${2:-calibration}.yaml"; fi
if [ "${2:-}" = loop ]; then
  tools/make_meshes.sh
  name=${3:-loop}
  mpirun --oversubscribe -n "${RANKS:-2}" build/release/imic3d loop "inputs/$case/$name.yaml"
  [ ! -e "runs/$case/$name/results.h5" ] || tools/plot_loop.py "runs/$case/$name/results.h5"
  exit
fi
if [ "$case" = steel304L_rates ] || [ "$case" = steel_cyclic ]; then
  runs=()
  for name in ${2:-case $([ "$case" = steel_cyclic ] && echo kinematic kinematic_2 || echo rate rate_heating viscosity)}; do
    build/release/imic3d identify "inputs/$case/${name%.yaml}.yaml"
    runs+=("runs/$case/${name%.yaml}")
  done
  exec tools/plot_curves.py "runs/$case/curves.png" "${runs[@]}"
fi
tools/make_meshes.sh
file="inputs/$case/${2:-case}.yaml"
command=dic
if grep -q "^identify:" "$file"; then command=identify; fi
mpirun --oversubscribe -n "${RANKS:-2}" build/release/imic3d "$command" "$file"
