#include "imic3d/mesh/connectivity.hpp"

#include <algorithm>
#include <map>
#include <numeric>

#include "facets.hpp"

namespace imic3d::mesh {

std::vector<std::pair<int, int>> nodes_at_one_place(const Mesh& mesh) {
  std::vector<std::pair<int, int>> pairs;
  if (mesh.nodes.rows() == 0) return pairs;
  const double near = 1e-6 * (mesh.nodes.colwise().maxCoeff() - mesh.nodes.colwise().minCoeff()).norm();
  std::vector<int> order(static_cast<std::size_t>(mesh.nodes.rows()));
  std::iota(order.begin(), order.end(), 0);
  // Along a direction in which hardly two nodes of a regular mesh lie beside each other.
  const Eigen::VectorXd along = mesh.nodes * Eigen::Vector3d(1.0, 0.7548776662466927, 0.5698402909980532).normalized();
  std::sort(order.begin(), order.end(), [&](int a, int b) { return along[a] < along[b]; });
  for (auto i = order.begin(); i != order.end(); ++i)
    for (auto j = i + 1; j != order.end() && along[*j] - along[*i] < near; ++j)
      if ((mesh.nodes.row(*i) - mesh.nodes.row(*j)).norm() < near)
        pairs.emplace_back(std::min(*i, *j), std::max(*i, *j));
  std::sort(pairs.begin(), pairs.end());
  return pairs;
}

bool has_a_facet(const Mesh& mesh, const std::vector<int>& nodes) {
  std::vector<char> chosen(static_cast<std::size_t>(mesh.nodes.rows()), 0);
  for (const int node : nodes) chosen[static_cast<std::size_t>(node)] = 1;
  const auto all_chosen = [&](Eigen::Index cell, const auto& corners) {
    return std::all_of(corners.begin(), corners.end(),
                       [&](int corner) { return chosen[static_cast<std::size_t>(mesh.cells(cell, corner))] != 0; });
  };
  const auto any_of_cell = [&](const auto& facets) {
    for (Eigen::Index cell = 0; cell < mesh.cells.rows(); ++cell)
      if (std::any_of(facets.begin(), facets.end(), [&](const auto& facet) { return all_chosen(cell, facet); }))
        return true;
    return false;
  };
  return is_hexahedron(mesh.type) ? any_of_cell(hex_faces) : any_of_cell(quad_edges);
}

std::vector<int> parts_of(const Mesh& mesh) {
  // a node of the same part; the part's own name where it is itself
  std::vector<int> first(static_cast<std::size_t>(mesh.nodes.rows()));
  std::iota(first.begin(), first.end(), 0);
  const auto name_of = [&](int node) {
    while (first[static_cast<std::size_t>(node)] != node)
      node = first[static_cast<std::size_t>(node)] =
          first[static_cast<std::size_t>(first[static_cast<std::size_t>(node)])];
    return node;
  };
  for (const auto& cell : mesh.cells.rowwise())
    for (const int node : cell) first[static_cast<std::size_t>(name_of(node))] = name_of(cell[0]);
  std::map<int, int> number;
  std::vector<int> parts;
  for (const auto& cell : mesh.cells.rowwise())
    parts.push_back(number.try_emplace(name_of(cell[0]), static_cast<int>(number.size())).first->second);
  return parts;
}

}  // namespace imic3d::mesh
