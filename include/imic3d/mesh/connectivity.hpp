#pragma once
// What holds a mesh together.

#include <utility>
#include <vector>

#include "imic3d/mesh/mesh.hpp"

namespace imic3d::mesh {

/// Pairs of nodes (the lower number first, ascending) that lie at one place, nearer than a millionth of the mesh's
/// extent: it is open there, like a crack.
[[nodiscard]] std::vector<std::pair<int, int>> nodes_at_one_place(const Mesh& mesh);

/// Whether all corners of some facet of a cell (edge of a quadrilateral, face of a hexahedron) are among the `nodes`.
[[nodiscard]] bool has_a_facet(const Mesh& mesh, const std::vector<int>& nodes);

/// For each cell the number of its part, from 0 in the order of the cells; cells that share a node are of one part.
[[nodiscard]] std::vector<int> parts_of(const Mesh& mesh);

}  // namespace imic3d::mesh
