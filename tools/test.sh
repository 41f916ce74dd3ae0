#!/usr/bin/env bash
# Installs what is needed, builds and runs the tests. Arguments go to ctest; without any, the nightly label is left out.
set -euo pipefail
cd "$(dirname "$0")/.."
tools/setup.sh
cmake --preset release >build-configure.log 2>&1 || { cat build-configure.log; exit 1; }
rm -f build-configure.log
cmake --build --preset release
if [ $# -eq 0 ]; then set -- -LE nightly; fi
ctest --preset release "$@"
