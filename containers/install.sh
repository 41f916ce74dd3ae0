#!/usr/bin/env bash
# What the recipes of the containers do in a Debian 12 that holds the project: packages, a build for any x86-64 processor, the program
# on the PATH. Root. CMAKE_BUILD_PARALLEL_LEVEL says how many compilers run at once.
set -euo pipefail
cd "$(dirname "$0")/.."
tools/setup.sh
rm -rf build
cmake --preset release -DIMIC3D_NATIVE=OFF -DBUILD_TESTING=OFF >/dev/null
cmake --build --preset release --target imic3d
install -m 755 build/release/imic3d /usr/local/bin/imic3d
rm -rf build
