#include "corner_grid.hpp"

#include <cstddef>

namespace imic3d::mechanics {

namespace {

using OwnedVec = PetscOwner<Vec, VecDestroy>;

/// The corner nodes of a quadratic mesh in the partition's order.
struct Corners {
  std::vector<int> of_global;  // [nodes + 1] corners among the global nodes before this one
  std::vector<char> is_one;    // [nodes] natural
  int first, owned;

  Corners(const mesh::Partition& partition, const mesh::Mesh& mesh, const mesh::Cells& middles)
      : of_global(static_cast<std::size_t>(mesh.nodes.rows()) + 1, 0),
        is_one(static_cast<std::size_t>(mesh.nodes.rows()), 1) {
    for (Eigen::Index k = 0; k < middles.rows(); ++k) is_one[static_cast<std::size_t>(middles(k, 0))] = 0;
    for (std::size_t g = 0; g + 1 < of_global.size(); ++g)
      of_global[g + 1] = of_global[g] + is_one[static_cast<std::size_t>(partition.natural_of_global[g])];
    first = of_global[static_cast<std::size_t>(partition.first_owned())];
    owned = of_global[static_cast<std::size_t>(partition.first_owned() + partition.owned_nodes())] - first;
  }
};

}  // namespace

CornerGrid::CornerGrid(const mesh::Partition& partition, const mesh::Mesh& mesh, const std::vector<int>& constrained,
                       int axes) {
  const mesh::Cells middles = mesh::edge_middles(mesh);
  const Corners corners(partition, mesh, middles);
  std::vector<char> held(static_cast<std::size_t>(3 * mesh.nodes.rows()), 0);
  for (int dof : constrained) held[static_cast<std::size_t>(dof)] = 1;

  // A constrained degree of a corner has an equation of its own; nothing else goes with it.
  IMIC3D_PETSC(MatCreate(partition.communicator.handle, interpolation_.put()));
  IMIC3D_PETSC(MatSetSizes(interpolation_, axes * partition.owned_nodes(), axes * corners.owned, PETSC_DETERMINE,
                           PETSC_DETERMINE));
  IMIC3D_PETSC(MatSetBlockSizes(interpolation_, axes, axes));
  IMIC3D_PETSC(MatSetType(interpolation_, MATAIJ));
  IMIC3D_PETSC(MatSeqAIJSetPreallocation(interpolation_, 2, nullptr));
  IMIC3D_PETSC(MatMPIAIJSetPreallocation(interpolation_, 2, nullptr, 2, nullptr));
  const auto put = [&](int node, int corner, int component, double value) {
    const auto global = [&](int natural) { return partition.global_of_natural[static_cast<std::size_t>(natural)]; };
    IMIC3D_PETSC(MatSetValue(interpolation_, axes * global(node) + component,
                             axes * corners.of_global[static_cast<std::size_t>(global(corner))] + component, value,
                             INSERT_VALUES));
  };
  const auto is_owned = [&](int node) {
    const int global = partition.global_of_natural[static_cast<std::size_t>(node)] - partition.first_owned();
    return global >= 0 && global < partition.owned_nodes();
  };
  const auto is_held = [&](int node, int component) {
    return held[static_cast<std::size_t>(3 * node + component)] != 0;
  };
  for (int node = 0; node < static_cast<int>(mesh.nodes.rows()); ++node)
    if (corners.is_one[static_cast<std::size_t>(node)] != 0 && is_owned(node))
      for (int i = 0; i < axes; ++i) put(node, node, i, 1.0);
  for (Eigen::Index k = 0; k < middles.rows(); ++k)
    if (is_owned(middles(k, 0)))
      for (int i = 0; i < axes; ++i)
        for (const int end : {middles(k, 1), middles(k, 2)})
          if (!is_held(middles(k, 0), i) && !is_held(end, i)) put(middles(k, 0), end, i, 0.5);
  IMIC3D_PETSC(MatAssemblyBegin(interpolation_, MAT_FINAL_ASSEMBLY));
  IMIC3D_PETSC(MatAssemblyEnd(interpolation_, MAT_FINAL_ASSEMBLY));

  OwnedVec coordinates;
  IMIC3D_PETSC(MatCreateVecs(interpolation_, coordinates.put(), nullptr));
  IMIC3D_PETSC(VecSetBlockSize(coordinates, axes));
  PetscScalar* values = nullptr;
  IMIC3D_PETSC(VecGetArray(coordinates, &values));
  for (int global = partition.first_owned(); global < partition.first_owned() + partition.owned_nodes(); ++global) {
    const int natural = partition.natural_of_global[static_cast<std::size_t>(global)],
              corner = corners.of_global[static_cast<std::size_t>(global)] - corners.first;
    if (corners.is_one[static_cast<std::size_t>(natural)] != 0)
      for (int i = 0; i < axes; ++i) values[axes * corner + i] = mesh.nodes(natural, i);
  }
  IMIC3D_PETSC(VecRestoreArray(coordinates, &values));
  IMIC3D_PETSC(MatNullSpaceCreateRigidBody(coordinates, rigid_.put()));
}

PetscInt CornerGrid::unknowns() const {
  PetscInt count = 0;
  IMIC3D_PETSC(MatGetSize(interpolation_, nullptr, &count));
  return count;
}

void CornerGrid::use(KSP solver, bool direct, bool symmetric) {
  PC cycle = nullptr, of_corners = nullptr;
  KSP smoother = nullptr;
  IMIC3D_PETSC(KSPGetPC(solver, &cycle));
  IMIC3D_PETSC(PCSetType(cycle, PCMG));
  IMIC3D_PETSC(PCMGSetLevels(cycle, 2, nullptr));
  IMIC3D_PETSC(PCMGSetGalerkin(cycle, PC_MG_GALERKIN_NONE));
  IMIC3D_PETSC(PCMGSetInterpolation(cycle, 1, interpolation_));
  IMIC3D_PETSC(PCMGGetSmoother(cycle, 1, &smoother));
  IMIC3D_PETSC(KSPSetTolerances(smoother, PETSC_DEFAULT, PETSC_DEFAULT, PETSC_DEFAULT, 1));
  IMIC3D_PETSC(PCMGGetCoarseSolve(cycle, &corners_));
  IMIC3D_PETSC(KSPSetType(corners_, KSPPREONLY));
  IMIC3D_PETSC(KSPGetPC(corners_, &of_corners));
  if (direct) {
    IMIC3D_PETSC(PCSetType(of_corners, symmetric ? PCCHOLESKY : PCLU));
    IMIC3D_PETSC(PCFactorSetMatSolverType(of_corners, MATSOLVERMUMPS));
  } else {
    IMIC3D_PETSC(PCSetType(of_corners, PCGAMG));
  }
}

void CornerGrid::update(Mat tangent) {
  const bool first = stiffness_.get() == nullptr;
  Mat stiffness = stiffness_.get();
  IMIC3D_PETSC(MatPtAP(tangent, interpolation_, first ? MAT_INITIAL_MATRIX : MAT_REUSE_MATRIX, PETSC_DEFAULT,
                       first ? stiffness_.put() : &stiffness));
  if (!first) return;
  PetscBool known = PETSC_FALSE, symmetric = PETSC_FALSE;
  IMIC3D_PETSC(MatIsSymmetricKnown(tangent, &known, &symmetric));
  for (const MatOption option : {MAT_SYMMETRIC, MAT_SYMMETRY_ETERNAL})
    IMIC3D_PETSC(MatSetOption(stiffness_, option, symmetric));
  IMIC3D_PETSC(MatSetNearNullSpace(stiffness_, rigid_));
  IMIC3D_PETSC(KSPSetOperators(corners_, stiffness_, stiffness_));
}

}  // namespace imic3d::mechanics
