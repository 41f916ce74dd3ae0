#include "check.hpp"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>

#include "facets.hpp"

namespace imic3d::mesh {

namespace {

constexpr std::size_t listed = 20;   // mistakes that are listed one by one
constexpr double degenerate = 1e-6;  // Jacobian relative to the cell's size below which a corner is flat

/// For each corner of a hexahedron its three neighbours, a right-handed triple.
constexpr std::array<std::array<int, 3>, 8> hex_neighbours{
    {{1, 3, 4}, {2, 0, 5}, {3, 1, 6}, {0, 2, 7}, {7, 5, 0}, {4, 6, 1}, {5, 7, 2}, {6, 4, 3}}};

/// Jacobian determinants at the corners, divided by the longest edge to the power of the dimension.
Eigen::VectorXd corner_jacobians(const Mesh& mesh, Eigen::Index cell) {
  const auto at = [&](int k) -> Eigen::Vector3d { return mesh.nodes.row(mesh.cells(cell, k)).transpose(); };
  const int corners = corners_per_cell(mesh.type);
  Eigen::VectorXd jacobians(corners);
  double longest = 0.0;
  for (int k = 0; k < corners; ++k) {
    if (mesh.type == CellType::quad4) {
      const Eigen::Vector3d a = at((k + 1) % 4) - at(k), b = at((k + 3) % 4) - at(k);
      jacobians[k] = a.x() * b.y() - a.y() * b.x();
      longest = std::max(longest, a.norm());
    } else {
      const auto& next = hex_neighbours[static_cast<std::size_t>(k)];
      const Eigen::Vector3d a = at(next[0]) - at(k), b = at(next[1]) - at(k), c = at(next[2]) - at(k);
      jacobians[k] = a.cross(b).dot(c);
      longest = std::max({longest, a.norm(), b.norm(), c.norm()});
    }
  }
  const double size = mesh.type == CellType::quad4 ? longest * longest : longest * longest * longest;
  return size > 0.0 ? Eigen::VectorXd(jacobians / size) : Eigen::VectorXd::Zero(corners);
}

bool has_repeated_node(const Mesh& mesh, Eigen::Index cell) {
  for (Eigen::Index i = 0; i < mesh.cells.cols(); ++i)
    for (Eigen::Index k = 0; k < i; ++k)
      if (mesh.cells(cell, i) == mesh.cells(cell, k)) return true;
  return false;
}

}  // namespace

double largest_corner_jacobian(const Mesh& mesh, Eigen::Index cell) { return corner_jacobians(mesh, cell).maxCoeff(); }

std::vector<Mistake> check_cells(const Mesh& mesh, const std::string& name, const std::string& noun,
                                 const std::vector<long>& labels) {
  std::vector<Mistake> mistakes;
  std::size_t found = 0;
  const auto label = [&](Eigen::Index c) {
    return labels.empty() ? static_cast<long>(c) : labels[static_cast<std::size_t>(c)];
  };
  const auto complain = [&](Eigen::Index c, const std::string& what, const std::string& allowed) {
    if (++found > listed) return;
    const Eigen::Vector3d centre = [&] {
      Eigen::Vector3d sum = Eigen::Vector3d::Zero();
      for (int node : mesh.cells.row(c)) sum += mesh.nodes.row(node).transpose();
      return Eigen::Vector3d(sum / static_cast<double>(mesh.cells.cols()));
    }();
    mistakes.push_back(
        {fmt::format("{} {} {} at ({:.6g}, {:.6g}, {:.6g})", name, noun, label(c), centre.x(), centre.y(), centre.z()),
         what, allowed});
  };

  const bool quads = mesh.type == CellType::quad4;
  if (mesh.type == CellType::line2) return {{name, "line cells", "quad4 or hex8 cells"}};
  if (mesh.cells.rows() == 0) return {{name, "no cells", "at least one"}};
  if (mesh.cells.minCoeff() < 0 || mesh.cells.maxCoeff() >= mesh.nodes.rows())
    return {{name, "a cell with a node that does not exist", fmt::format("0 to {}", mesh.nodes.rows() - 1)}};
  if (quads) {
    const double size = (mesh.nodes.colwise().maxCoeff() - mesh.nodes.colwise().minCoeff()).head(2).maxCoeff();
    const double depth = mesh.nodes.col(2).maxCoeff() - mesh.nodes.col(2).minCoeff();
    if (depth > 1e-6 * size) {
      const double z = mesh.nodes.col(2).minCoeff();
      return {{name, fmt::format("quadrilaterals between z = {:.6g} and {:.6g}", z, z + depth),
               "a plane mesh, z the same everywhere"}};
    }
  }

  bool shapes_are_good = true;
  for (Eigen::Index c = 0; c < mesh.cells.rows(); ++c) {
    const auto jacobians = corner_jacobians(mesh, c);
    const std::string allowed = quads ? "a convex, counter-clockwise quadrilateral" : "a hexahedron of positive volume";
    shapes_are_good = shapes_are_good && jacobians.minCoeff() >= degenerate;
    if (has_repeated_node(mesh, c))
      complain(c, "the same node twice (degenerate)", allowed);
    else if (!jacobians.allFinite())
      complain(c, "coordinates too large for its volume", allowed);
    else if (jacobians.minCoeff() < -degenerate)
      complain(c,
               fmt::format("inverted: negative Jacobian at {} of {} corners", (jacobians.array() < -degenerate).count(),
                           jacobians.size()),
               allowed);
    else if (jacobians.minCoeff() < degenerate)
      complain(c, "degenerate: zero Jacobian at a corner", allowed);
  }

  if (shapes_are_good) {
    // Neighbours on either side of a facet run round it in opposite directions.
    struct Seen {
      Eigen::Index cell;
      std::array<int, 4> nodes;
      int times;
    };
    FacetMap<Seen> facets;
    const int size = facet_size(mesh.type);
    const auto same_direction = [&](const std::array<int, 4>& a, const std::array<int, 4>& b) {
      const auto n = static_cast<std::size_t>(size);
      const auto start = static_cast<std::size_t>(std::find(b.begin(), b.end(), a[0]) - b.begin());
      return b[(start + 1) % n] == a[1] && (n == 4 || start == 0);
    };
    for (Eigen::Index c = 0; c < mesh.cells.rows(); ++c)
      for (int f = 0; f < facets_per_cell(mesh.type); ++f) {
        const auto nodes = facet_nodes(mesh, c, f);
        const auto [at, is_new] = facets.emplace(facet_key(nodes, size), Seen{c, nodes, 1});
        if (is_new) continue;
        if (++at->second.times > 2)
          complain(c, fmt::format("shares {} with more than one other cell", quads ? "an edge" : "a face"),
                   "one neighbour");
        else if (same_direction(at->second.nodes, nodes))
          complain(c, fmt::format("inverted or folded: overlaps its neighbour {}", label(at->second.cell)),
                   "cells side by side");
      }
  }
  if (found > listed) mistakes.push_back({fmt::format("{}: and {} more mistakes", name, found - listed), "", ""});
  return mistakes;
}

std::vector<Mistake> check(const Mesh& mesh, const std::string& name) { return check_cells(mesh, name, "cell", {}); }

}  // namespace imic3d::mesh
