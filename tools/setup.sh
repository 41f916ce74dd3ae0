#!/usr/bin/env bash
# Installs what imic3d needs, from Debian's packages by name (root or sudo).
set -euo pipefail

packages=(
  build-essential cmake ninja-build pkg-config git ccache
  libopenmpi-dev openmpi-bin libpetsc-real-dev petsc-dev libhdf5-openmpi-dev libopenblas0-serial libopenblas-dev
  libopencv-dev libeigen3-dev libyaml-cpp-dev libvalijson-dev nlohmann-json3-dev libcli11-dev libfmt-dev libspdlog-dev
  libgtest-dev libgmock-dev libbenchmark-dev
  gmsh calculix-ccx python3 python3-numpy python3-scipy python3-matplotlib python3-h5py python3-pil
)

missing=()
for package in "${packages[@]}"; do
  dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q 'ok installed' || missing+=("$package")
done
if [ ${#missing[@]} -eq 0 ]; then exit 0; fi

as_root=()
if [ "$(id -u)" -ne 0 ]; then as_root=(sudo); fi
echo "Installing ${#missing[@]} packages ..."
export DEBIAN_FRONTEND=noninteractive
"${as_root[@]}" apt-get update -qq
"${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null
