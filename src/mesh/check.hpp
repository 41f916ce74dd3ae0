#pragma once
// Checks of cells with the numbers that the user knows them by. Private to the room.

#include <string>
#include <vector>

#include "imic3d/mesh/mesh.hpp"

namespace imic3d::mesh {

/// As `check`; cell c is called `<name> <noun> <labels[c]>` (or c if there are no labels).
[[nodiscard]] std::vector<Mistake> check_cells(const Mesh& mesh, const std::string& name, const std::string& noun,
                                               const std::vector<long>& labels);

/// The largest Jacobian determinant over the corners of a cell, relative to its size (edge length to the power 2 or 3).
[[nodiscard]] double largest_corner_jacobian(const Mesh& mesh, Eigen::Index cell);

}  // namespace imic3d::mesh
