#pragma once
// Which rank assembles which cells and owns which nodes.

#include <string>
#include <vector>

#include "imic3d/core/parallel.hpp"
#include "imic3d/mesh/mesh.hpp"

namespace imic3d::mesh {

/// A mesh shared out over the ranks of a communicator. Every cell is on one rank (overlap 0). Every node is owned by
/// one of the ranks that have a cell at it; global node numbers run through the ranks in contiguous ranges, so that
/// degree of freedom d of a node is row n * global + d of a PETSc matrix or vector with n * owned_nodes() local rows, n
/// the number of degrees of freedom of a node.
struct Partition {
  Communicator communicator;
  std::vector<int> cells;  ///< this rank's cells, natural numbers in ascending order
  Cells connectivity;      ///< [cells x nodes per cell] global node numbers, in the mesh's corner order
  /// [ranks + 1] rank r owns the global nodes first_node[r] … first_node[r + 1] - 1
  std::vector<int> first_node;
  std::vector<int> global_of_natural;  ///< [nodes] the same on every rank
  std::vector<int> natural_of_global;  ///< [nodes] the same on every rank

  [[nodiscard]] int first_owned() const { return first_node[static_cast<std::size_t>(communicator.rank())]; }
  [[nodiscard]] int owned_nodes() const {
    return first_node[static_cast<std::size_t>(communicator.rank()) + 1] - first_owned();
  }
};

/// Partitions `mesh` (the same on every rank) by PETSc's DMPlex; collective over `communicator`. The parts are found by
/// recursive coordinate bisection, which depends on the mesh and the number of ranks only; another partitioner can be
/// chosen by the option -<prefix>petscpartitioner_type (ptscotch, parmetis: these may differ from call to call).
/// Within a rank the global numbers follow the natural ones.
/// Throws std::runtime_error if PETSc fails, or if a node belongs to no cell.
[[nodiscard]] Partition partition(const Mesh& mesh, Communicator communicator, const std::string& prefix = "");

}  // namespace imic3d::mesh
