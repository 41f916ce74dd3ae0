#!/usr/bin/env bash
# The paper's Sec. 4 again: studies, tables (CSV), plots and one page, runs/reproduce_paper/index.html.
# Small images and coarse meshes, under 20 minutes on 2 cores; --full: the images' size and meshes of tools/virtual_study.sh.
# Runs that are done are kept: the same command goes on where it was stopped. Other arguments go to studies.py.
set -euo pipefail
cd "$(dirname "$0")/.."
output=runs/reproduce_paper
arguments=("$@")
for ((i = 0; i < $#; ++i)); do
  case "${arguments[i]}" in
    --full) [ "$output" = runs/reproduce_paper ] && output=runs/reproduce_paper_full ;;
    --output) output=${arguments[i + 1]} ;;
  esac
done
tools/reproduce_paper/studies.py --output "$output" "$@"
[ -x tools/table1.sh ] && [ ! -e "$output/table1.txt" ] && { tools/table1.sh > "$output/table1.txt.part" 2>&1 && mv "$output/table1.txt.part" "$output/table1.txt"; } || true
if [ -x build/release/tests/test_identification ] && [ ! -e "$output/covariance.txt" ]; then
  OMP_NUM_THREADS=1 build/release/tests/test_identification --gtest_filter='CovarianceNightly*' > "$output/covariance.txt.part" 2>&1 || true
  mv "$output/covariance.txt.part" "$output/covariance.txt"
fi
data=${IMIC3D_DATA:-../shared/data}
for name in stereo_chessboard gt4_stereo; do
  if [ -d "$data/$name" ] && [ ! -e "$output/$name.txt" ]; then
    tools/run_measured.sh "$name" > "$output/$name.txt.part" 2>&1 && mv "$output/$name.txt.part" "$output/$name.txt" || true
  fi
done
tools/reproduce_paper/page.py "$output"
