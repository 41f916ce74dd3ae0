#pragma once
// Facets of cells (edges of quads, faces of hexahedra): local numbering and look-up by their nodes. Private to the
// room.

#include <algorithm>
#include <array>
#include <cstddef>
#include <type_traits>
#include <unordered_map>

#include "imic3d/mesh/mesh.hpp"

namespace imic3d::mesh {

/// Corner numbers of the edges of a quad, counter-clockwise.
inline constexpr std::array<std::array<int, 2>, 4> quad_edges{{{0, 1}, {1, 2}, {2, 3}, {3, 0}}};

/// Corner numbers of the faces of a hexahedron, counter-clockwise seen from outside.
inline constexpr std::array<std::array<int, 4>, 6> hex_faces{
    {{0, 3, 2, 1}, {4, 5, 6, 7}, {0, 1, 5, 4}, {1, 2, 6, 5}, {2, 3, 7, 6}, {3, 0, 4, 7}}};

/// Corner numbers of the edges of a hexahedron, in the order of a hex20's middle nodes 8 ... 19.
inline constexpr std::array<std::array<int, 2>, 12> hex_edges{
    {{0, 1}, {1, 2}, {2, 3}, {3, 0}, {4, 5}, {5, 6}, {6, 7}, {7, 4}, {0, 4}, {1, 5}, {2, 6}, {3, 7}}};

/// The nodes of an edge or a face in ascending order; unused places are -1.
using FacetKey = std::array<int, 4>;

struct FacetKeyHash {
  std::size_t operator()(const FacetKey& key) const {
    std::size_t value = 0;
    for (int node : key) value = value * 0x9E3779B97F4A7C15ULL + static_cast<std::size_t>(node + 1);
    return value ^ (value >> 29U);
  }
};

template <class Value>
using FacetMap = std::unordered_map<FacetKey, Value, FacetKeyHash>;

template <class Row, class Index = std::conditional_t < requires(Row row) { row.derived(); }
, Eigen::Index, std::size_t >> FacetKey facet_key(const Row& nodes, int size) {
  FacetKey key{-1, -1, -1, -1};
  for (int i = 0; i < size; ++i) {  // by insertion
    auto place = static_cast<std::size_t>(i);
    const int node = nodes[static_cast<Index>(i)];
    for (; place > 0 && key[place - 1] > node; --place) key[place] = key[place - 1];
    key[place] = node;
  }
  return key;
}

inline FacetKey edge_key(int a, int b) { return {std::min(a, b), std::max(a, b), -1, -1}; }

/// Nodes per facet and number of facets of a cell.
inline bool is_hexahedron(CellType type) { return type == CellType::hex8 || type == CellType::hex20; }
inline int facet_size(CellType type) { return is_hexahedron(type) ? 4 : 2; }
inline int facets_per_cell(CellType type) { return is_hexahedron(type) ? 6 : 4; }

/// The corner nodes of facet `f` of cell `c`, in outward order.
inline std::array<int, 4> facet_nodes(const Mesh& mesh, Eigen::Index c, int f) {
  std::array<int, 4> nodes{-1, -1, -1, -1};
  const auto facet = static_cast<std::size_t>(f);
  for (int i = 0; i < facet_size(mesh.type); ++i) {
    const auto k = static_cast<std::size_t>(i);
    nodes[k] = mesh.cells(c, is_hexahedron(mesh.type) ? hex_faces[facet][k] : quad_edges[facet][k]);
  }
  return nodes;
}

}  // namespace imic3d::mesh
