#!/usr/bin/env bash
# Installs what is needed, builds and runs the tests. Arguments go to ctest; without any, the labels nightly and slurm are left out.
# `-L slurm` needs Debian's slurmctld, slurmd, slurm-client and munge, and root.
set -euo pipefail
cd "$(dirname "$0")/.."
tools/setup.sh
tools/build.sh
tools/make_meshes.sh
export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 HWLOC_HIDE_ERRORS=2
if [ $# -eq 0 ]; then set -- -LE 'nightly|slurm'; fi
ctest --preset release -j "$(nproc)" "$@"
