#pragma once
// Two grids for quadratic elements: all nodes, and their corners.

#include <petscksp.h>

#include <vector>

#include "imic3d/mesh/mesh.hpp"
#include "imic3d/mesh/partition.hpp"
#include "imic3d/mesh/petsc.hpp"

namespace imic3d::mechanics {

/// Displacements of the corner nodes of a quadratic mesh, linear along its edges, and the stiffness A_c = P^T A P that
/// the tangent A has for them: a quarter of the unknowns in space. What is linear at the scale of an element is found
/// there, the rest by a smoother on all nodes (p-multigrid). Constrained degrees move in neither. Collective.
class CornerGrid {
 public:
  /// `constrained`: natural degrees of freedom (3 * node + component), ascending; `axes`: degrees of freedom of a node.
  CornerGrid(const mesh::Partition& partition, const mesh::Mesh& mesh, const std::vector<int>& constrained, int axes);

  /// Whether the mesh has nodes between its corners.
  [[nodiscard]] static bool exists(const mesh::Mesh& mesh) {
    return mesh::corners_per_cell(mesh.type) < mesh::nodes_per_cell(mesh.type);
  }

  /// P [degrees of freedom x those of the corners], in the partition's order.
  [[nodiscard]] Mat interpolation() const { return interpolation_; }
  /// Of the corners' degrees of freedom, all ranks'.
  [[nodiscard]] PetscInt unknowns() const;

  /// Makes of a solver's preconditioner a cycle of two levels; what is not set here is PETSc's default: Chebyshev's
  /// polynomial with SOR on all nodes, on the corners a direct solution or, unless that is `direct`, a cycle of GAMG
  /// with the near-null space of rigid motions.
  void use(KSP solver, bool direct, bool symmetric);
  /// A_c of the tangent as it is now.
  void update(Mat tangent);

 private:
  KSP corners_ = nullptr;                                  // of the solver that uses this
  PetscOwner<Mat, MatDestroy> interpolation_, stiffness_;  // P and A_c
  PetscOwner<MatNullSpace, MatNullSpaceDestroy> rigid_;
};

}  // namespace imic3d::mechanics
