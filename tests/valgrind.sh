#!/usr/bin/env bash
# Runs small identifications and a loop under valgrind:  tests/valgrind.sh [PROGRAM] [FOLDER]
# Status 1 if valgrind sees an error that tests/valgrind.supp does not have, or a run fails. PROGRAM (build/valgrind/imic3d) is not built for
# this processor alone: valgrind does not know AVX-512. Logs are kept in FOLDER (build/valgrind/runs).
set -euo pipefail
cd "$(dirname "$0")/.."
program=$(realpath "${1:-build/valgrind/imic3d}")
folder=$(realpath -m "${2:-build/valgrind/runs}")
suppressions=$PWD/tests/valgrind.supp
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 HWLOC_HIDE_ERRORS=2 PYTHONPATH=$PWD/tests/cases
rm -rf "$folder" && mkdir -p "$folder" && cd "$folder"

# A bar, longer and finer for the virtual test; a strip whose displacement fields are a formula.
/usr/bin/python3 - <<'END'
import pathlib
import fields
from runs import bar
bar(pathlib.Path("made.msh"), -6, 6, 6, columns=4)
bar(pathlib.Path("bar.msh"), -4, 4, 2, columns=2)
bar(pathlib.Path("strip.msh"), -11, 11, 8, columns=2, half_width=3.5)
fields.tables(pathlib.Path("strip"), 1.0, 0.0, False, (0.0, 0.0))
pathlib.Path("fields.yaml").write_text(fields.case("strip").replace("draws: 60, modes: 40", "draws: 20, modes: 10"))
END
specimen() { echo "title: Bar
specimen: {mesh: $1.msh, element: $2, thickness: 2, layers: 1, mid_plane_symmetry: true, held: bottom, loaded: top}
material: {hardening: power_linear, tie_initial_modulus: true, parameters: {E: $3, nu: 0.25, S_y: $4, H: 1480, delta: 0.042}}"; }
camera() { echo "cameras: [{name: front, pixel_size: 0.06, place: {origin: [74.5, 114.5]}$1}]"; }
identify() { # NAME ELEMENT KEYS
  { specimen bar "$2" 185e3 270; camera ", images: 'made/images/*.png', reference: 0-1"; echo "loads: {file: made/loads.csv, noise: 5}
identify: {$3, stages: [{free: [E, S_y], frames: 2-4}]}
output: $1"; } > "$1.yaml"
}
{ specimen made hex20 198e3 284; camera ""; echo "simulate: {centred: true, value: [0, 0.012, 0.03, 0.06]}
virtual: {size: [150, 230], load_noise: 5, static_frames: 2, directory: made}
output: made"; } > made.yaml
identify force hex20 "functional: force_driven"
identify displacement hex8 "functional: displacement_driven"
identify alpha hex8 "functional: force_driven, alpha: 0.01"
"$program" virtual made.yaml > made.log 2>&1

failed=0
check() { # COMMAND CASE
  local start=$SECONDS status=0
  valgrind --error-exitcode=9 --leak-check=no --suppressions="$suppressions" --log-file="$2.valgrind" "$program" "$1" "$2.yaml" > "$2.log" 2>&1 || status=$?
  echo "$1 $2: status $status, $((SECONDS - start)) s, $(sed -n 's/.*ERROR SUMMARY: //p' "$2.valgrind")"
  [ $status = 0 ] || failed=1
}
check identify force
check identify displacement
check identify alpha
check loop fields
exit $failed
