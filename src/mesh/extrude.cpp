#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "imic3d/mesh/mesh.hpp"

namespace imic3d::mesh {

Mesh extrude(const Mesh& quads, double thickness, int layers) {
  if (!(thickness > 0.0)) throw InputError("thickness", fmt::format("{}", thickness), "a positive number");
  if (layers < 1) throw InputError("layers", fmt::format("{}", layers), "1 or more");
  if (quads.type != CellType::quad4)
    throw InputError("mesh to be extruded", "not a quadrilateral mesh", "quadrilaterals");
  if (auto mistakes = check(quads, "mesh to be extruded"); !mistakes.empty()) throw InputError(std::move(mistakes));

  const auto n = static_cast<int>(quads.nodes.rows()), m = static_cast<int>(quads.cells.rows());
  Mesh hexes;
  hexes.type = CellType::hex8;
  hexes.nodes_per_layer = n;
  hexes.nodes.resize((layers + 1) * n, 3);
  hexes.cells.resize(layers * m, 8);
  for (int layer = 0; layer <= layers; ++layer) {
    auto nodes = hexes.nodes.middleRows(layer * n, n);
    nodes = quads.nodes;
    nodes.col(2).array() -= thickness * layer / layers;
  }
  for (int layer = 0; layer < layers; ++layer) {  // the deeper layer of nodes is the bottom face
    hexes.cells.block(layer * m, 0, m, 4) = quads.cells.array() + (layer + 1) * n;
    hexes.cells.block(layer * m, 4, m, 4) = quads.cells.array() + layer * n;
  }
  hexes.front = quads.cells;

  for (const auto& [name, members] : quads.node_groups) {
    auto& group = hexes.node_groups[name];
    for (int layer = 0; layer <= layers; ++layer)
      for (int node : members) group.push_back(layer * n + node);
  }
  for (const auto& [name, members] : quads.cell_groups) {
    auto& group = hexes.cell_groups[name];
    for (int layer = 0; layer < layers; ++layer)
      for (int cell : members) group.push_back(layer * m + cell);
  }
  for (const auto& [name, edges] : quads.facet_groups) {
    const Eigen::Index k = edges.rows();
    auto& group = hexes.facet_groups[name];
    group.resize(layers * k, 4);
    for (int layer = 0; layer < layers; ++layer) {
      group.block(layer * k, 0, k, 2) = edges.array() + (layer + 1) * n;
      group.block(layer * k, 2, k, 1) = edges.col(1).array() + layer * n;
      group.block(layer * k, 3, k, 1) = edges.col(0).array() + layer * n;
    }
  }
  const auto add_face = [&](const char* name, const Cells& faces, int layer) {
    hexes.facet_groups[name] = faces;
    auto& group = hexes.node_groups[name];
    group.clear();
    for (int node = 0; node < n; ++node) group.push_back(layer * n + node);
  };
  add_face("front", hexes.front, 0);
  Cells back = quads.cells.rowwise().reverse();
  back.array() += layers * n;
  add_face("back", back, layers);
  return hexes;
}

void grade_layers(Mesh& mesh, double ratio, bool one_face) {
  if (mesh.nodes_per_layer <= 0 || !(ratio > 0.0))
    throw InputError("layer_ratio", "a mesh that was not extruded, or a ratio that is not positive",
                     "a positive ratio and a 2D mesh");
  const Eigen::Index per_layer = mesh.nodes_per_layer, layers = mesh.nodes.rows() / per_layer - 1;
  std::vector<double> depth(static_cast<std::size_t>(layers) + 1, 0.0);
  for (Eigen::Index k = 0; k < layers; ++k) {
    const auto from_face = static_cast<double>(one_face ? k : std::min(k, layers - 1 - k));
    depth[static_cast<std::size_t>(k) + 1] = depth[static_cast<std::size_t>(k)] + std::pow(ratio, from_face);
  }
  for (Eigen::Index i = 0; i < per_layer; ++i) {
    const double front = mesh.nodes(i, 2), back = mesh.nodes(layers * per_layer + i, 2);
    for (Eigen::Index k = 0; k <= layers; ++k)
      mesh.nodes(k * per_layer + i, 2) = front + (back - front) * depth[static_cast<std::size_t>(k)] / depth.back();
  }
}

}  // namespace imic3d::mesh
