#!/usr/bin/env bash
# The paper's Sec. 4 again: studies, tables (CSV), plots and one page, runs/reproduce_paper/index.html.
# Small images and coarse meshes, some 20 minutes on 2 cores; --full: the images' size and meshes of tools/virtual_study.sh.
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
# once NAME COMMAND…: its output to NAME.txt, its processor time to NAME.seconds; again next time if it fails.
TIMEFORMAT="%U %S"
once() {
  local name=$1
  shift
  [ -e "$output/$name.txt" ] && return
  if { time "$@" > "$output/$name.txt.part" 2>&1; } 2> "$output/$name.seconds"; then mv "$output/$name.txt.part" "$output/$name.txt"; else echo "$name failed: $output/$name.txt.part"; fi
}
mkdir -p "$output"
others() { # beside the studies, one after the other
  once table1 tools/table1.sh
  local tests=build/release/tests/test_identification name data=${IMIC3D_DATA:-../shared/data}
  [ ! -x $tests ] || OMP_NUM_THREADS=1 once covariance $tests --gtest_filter='CovarianceNightly*'
  for name in stereo_chessboard gt4_stereo; do
    [ ! -d "$data/$name" ] || once "$name" tools/run_measured.sh "$name"
  done
}
trap 'kill $(jobs -p) 2> /dev/null || true' EXIT
others &
tools/reproduce_paper/studies.py --output "$output" "$@"
wait
tools/reproduce_paper/page.py "$output"
