#!/usr/bin/env bash
# Blind trials of `imic3d loop` on all three kinds of data: stress-strain curves (tools/blind_suite.py), images and displacement fields (tools/blind_plate.py; CalculiX
# pulls the plate). Tables: runs/blind_{suite,images,fields}/table.md. Whole: about 8 hours of one core; what is done is not done again.
# Arguments go to all three: --reduced (a quarter of an hour), --seeds N, --nulls N, --imic3d PROGRAM
set -euo pipefail
cd "$(dirname "$0")/.."
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 HWLOC_HIDE_ERRORS=2
status=0
tools/blind_suite.py "$@" || status=1
tools/blind_plate.py images "$@" || status=1
tools/blind_plate.py fields "$@" || status=1
exit $status
