#!/usr/bin/env bash
# Makes the meshes of the shipped inputs with Gmsh.
set -euo pipefail
cd "$(dirname "$0")/.."
mesh() { # script, output, parameters …
  local script=$1 output=$2; shift 2
  local arguments=()
  while [ $# -gt 0 ]; do arguments+=(-setnumber "$1" "$2"); shift 2; done
  gmsh -2 -v 2 "${arguments[@]}" -format msh41 "tools/meshes/$script.geo" -o "$output"
}
mesh plate_with_hole inputs/plate_with_hole/generate.msh length 40 size_hole 0.8 size_far 2.0
mesh plate_with_hole inputs/plate_with_hole/identify.msh length 24 size_hole 1.2 size_far 2.5
mesh plate_with_hole inputs/plate_independent/plate.msh length 24 size_hole 1.0 size_far 2.5
mesh dumbbell inputs/pcabs_tension/dumbbell.msh region 28 size 1.0
mesh plate_with_hole inputs/virtual_study/generate.msh length 40 size_hole 0.6 size_far 1.6
mesh plate_with_hole inputs/virtual_study/identify.msh length 24 size_hole 1.0 size_far 2.5
mesh gt4 inputs/gt4_stereo/gt4.msh size 2.0
mesh gt4_web inputs/gt4_stereo/web.msh size 1.5
mesh plate_with_hole inputs/two_faces/generate.msh length 36 size_hole 0.6 size_far 1.6
mesh plate_with_hole inputs/two_faces/coarse.msh length 22 size_hole 0.9 size_far 2.0
mesh plate_with_hole inputs/two_faces/fine.msh length 22 size_hole 0.6 size_far 1.4
tools/meshes/bar.py inputs/two_faces/bar.msh
mesh plate_with_hole inputs/oht_cfrp/oht.msh width 27 length 84 diameter 10 size_hole 2.6 size_far 4
