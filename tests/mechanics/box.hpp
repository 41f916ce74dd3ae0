#pragma once
// Small hexahedral meshes for the tests.

#include <cmath>
#include <random>

#include "imic3d/mesh/mesh.hpp"

namespace imic3d::mechanics::testing {

/// n[0] x n[1] x n[2] cells on the box [0, size]; interior nodes moved at random by `distortion` of the cell size.
inline mesh::Mesh box(std::array<int, 3> n, Eigen::Vector3d size, double distortion = 0.0) {
  mesh::Mesh mesh;
  mesh.type = mesh::CellType::hex8;
  const int nx = n[0] + 1, ny = n[1] + 1, nz = n[2] + 1;
  mesh.nodes.resize(nx * ny * nz, 3);
  mesh.cells.resize(n[0] * n[1] * n[2], 8);
  std::mt19937 random(7);
  std::uniform_real_distribution<double> shift(-distortion, distortion);
  const auto id = [&](int i, int j, int k) { return (k * ny + j) * nx + i; };
  for (int k = 0; k < nz; ++k)
    for (int j = 0; j < ny; ++j)
      for (int i = 0; i < nx; ++i) {
        const Eigen::Vector3d step(size[0] / n[0], size[1] / n[1], size[2] / n[2]);
        Eigen::Vector3d x(i * step[0], j * step[1], k * step[2]);
        const bool boundary = i == 0 || j == 0 || k == 0 || i == n[0] || j == n[1] || k == n[2];
        if (!boundary) x += Eigen::Vector3d(shift(random), shift(random), shift(random)).cwiseProduct(step);
        mesh.nodes.row(id(i, j, k)) = x.transpose();
        if (boundary) mesh.node_groups["boundary"].push_back(id(i, j, k));
        if (i == 0) mesh.node_groups["left"].push_back(id(i, j, k));
        if (i == n[0]) mesh.node_groups["right"].push_back(id(i, j, k));
      }
  int cell = 0;
  for (int k = 0; k < n[2]; ++k)
    for (int j = 0; j < n[1]; ++j)
      for (int i = 0; i < n[0]; ++i)
        mesh.cells.row(cell++) << id(i, j, k), id(i + 1, j, k), id(i + 1, j + 1, k), id(i, j + 1, k), id(i, j, k + 1),
            id(i + 1, j, k + 1), id(i + 1, j + 1, k + 1), id(i, j + 1, k + 1);
  return mesh;
}

}  // namespace imic3d::mechanics::testing
