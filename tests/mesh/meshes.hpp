#pragma once
// Small meshes for the tests of this room.

#include <unistd.h>

#include <Eigen/LU>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <string>

#include "imic3d/mesh/mesh.hpp"

namespace imic3d::mesh {

/// nx x ny squares of unit size with the groups left, right, bottom and top (nodes and facets).
inline Mesh grid(int nx, int ny) {
  Mesh mesh;
  mesh.nodes.resize((nx + 1) * (ny + 1), 3);
  const auto node = [&](int i, int j) { return j * (nx + 1) + i; };
  for (int j = 0; j <= ny; ++j)
    for (int i = 0; i <= nx; ++i) {
      mesh.nodes.row(node(i, j)) << i, j, 0.0;
      if (i == 0) mesh.node_groups["left"].push_back(node(i, j));
      if (i == nx) mesh.node_groups["right"].push_back(node(i, j));
      if (j == 0) mesh.node_groups["bottom"].push_back(node(i, j));
      if (j == ny) mesh.node_groups["top"].push_back(node(i, j));
    }
  mesh.cells.resize(nx * ny, 4);
  for (int j = 0; j < ny; ++j)
    for (int i = 0; i < nx; ++i) {
      mesh.cells.row(j * nx + i) << node(i, j), node(i + 1, j), node(i + 1, j + 1), node(i, j + 1);
      mesh.cell_groups["specimen"].push_back(j * nx + i);
    }
  mesh.facet_groups["top"].resize(nx, 2);
  for (int i = 0; i < nx; ++i) mesh.facet_groups["top"].row(i) << node(i + 1, ny), node(i, ny);
  return mesh;
}

/// Area of a quad mesh or volume of a hex mesh (2 x 2 x 2 Gauss points).
inline double measure(const Mesh& mesh) {
  double sum = 0.0;
  if (mesh.type == CellType::quad4) {
    for (Eigen::Index c = 0; c < mesh.cells.rows(); ++c)
      for (int k = 0; k < 4; ++k) {
        const auto a = mesh.nodes.row(mesh.cells(c, k)), b = mesh.nodes.row(mesh.cells(c, (k + 1) % 4));
        sum += 0.5 * (a[0] * b[1] - b[0] * a[1]);
      }
    return sum;
  }
  constexpr int place[8][3] = {{-1, -1, -1}, {1, -1, -1}, {1, 1, -1}, {-1, 1, -1},
                               {-1, -1, 1},  {1, -1, 1},  {1, 1, 1},  {-1, 1, 1}};
  for (Eigen::Index c = 0; c < mesh.cells.rows(); ++c)
    for (const auto& gauss : place) {
      Eigen::Matrix3d jacobian = Eigen::Matrix3d::Zero();
      for (int k = 0; k < 8; ++k) {
        double factor[3];
        for (int d = 0; d < 3; ++d) factor[d] = 0.5 * (1.0 + place[k][d] * gauss[d] / std::sqrt(3.0));
        const Eigen::Vector3d x = mesh.nodes.row(mesh.cells(c, k)).transpose();
        for (int d = 0; d < 3; ++d)
          jacobian.col(d) += x * 0.5 * place[k][d] * factor[(d + 1) % 3] * factor[(d + 2) % 3];
      }
      sum += jacobian.determinant();
    }
  return sum;
}

/// A file in the temporary folder (one per process) that is removed at the end of the scope.
class TemporaryFile {
 public:
  TemporaryFile(const std::string& name, const std::string& text)
      : path(std::filesystem::temp_directory_path() / ("imic3d_" + std::to_string(getpid()) + "_" + name)) {
    std::ofstream(path) << text;
  }
  ~TemporaryFile() { std::filesystem::remove(path); }
  TemporaryFile(const TemporaryFile&) = delete;
  TemporaryFile& operator=(const TemporaryFile&) = delete;
  std::filesystem::path path;
};

}  // namespace imic3d::mesh
