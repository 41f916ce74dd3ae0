#include "imic3d/mesh/connectivity.hpp"

#include <algorithm>
#include <map>
#include <numeric>

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
