#pragma once
// Natural vectors and PETSc's.

#include <petscvec.h>

#include <Eigen/Core>
#include <cstddef>
#include <span>

#include "imic3d/mesh/partition.hpp"
#include "imic3d/mesh/petsc.hpp"

namespace imic3d::mechanics {

/// Between natural vectors (3 * node + component, replicated on every rank; the third component is 0 in a plane mesh)
/// and distributed ones (axes * node + component in the partition's global order).
class Numbering {
 public:
  /// `axes`: degrees of freedom of a node.
  Numbering(const mesh::Partition& partition, int axes) : partition_(partition), axes_(axes) {}

  [[nodiscard]] int axes() const { return axes_; }
  [[nodiscard]] Eigen::Index natural_size() const {
    return 3 * static_cast<Eigen::Index>(partition_.natural_of_global.size());
  }
  [[nodiscard]] int owned() const { return axes_ * partition_.owned_nodes(); }
  /// Row of this rank's first degree of freedom.
  [[nodiscard]] PetscInt first_owned() const { return axes_ * partition_.first_owned(); }
  /// Of the i-th degree of freedom that this rank owns.
  [[nodiscard]] int natural_of_owned(int i) const { return 3 * natural_node_of_owned(i / axes_) + i % axes_; }
  [[nodiscard]] PetscInt global_of_natural(Eigen::Index natural) const {
    return axes_ * partition_.global_of_natural[static_cast<std::size_t>(natural / 3)] + natural % 3;
  }

  /// Natural, replicated -> global, distributed.
  void to_global(const Eigen::Ref<const Eigen::VectorXd>& natural, Vec global) const {
    PetscScalar* values = nullptr;
    IMIC3D_PETSC(VecGetArray(global, &values));
    for (int i = 0; i < partition_.owned_nodes(); ++i)
      for (int k = 0; k < axes_; ++k) values[axes_ * i + k] = natural[3 * natural_node_of_owned(i) + k];
    IMIC3D_PETSC(VecRestoreArray(global, &values));
  }

  /// Global, distributed -> natural on every rank.
  [[nodiscard]] Eigen::VectorXd to_natural(Vec global) const {
    Eigen::VectorXd natural = Eigen::VectorXd::Zero(natural_size());
    const PetscScalar* values = nullptr;
    IMIC3D_PETSC(VecGetArrayRead(global, &values));
    for (int i = 0; i < partition_.owned_nodes(); ++i)
      for (int k = 0; k < axes_; ++k) natural[3 * natural_node_of_owned(i) + k] = values[axes_ * i + k];
    IMIC3D_PETSC(VecRestoreArrayRead(global, &values));
    partition_.communicator.sum(std::span(natural.data(), static_cast<std::size_t>(natural.size())));
    return natural;
  }

 private:
  [[nodiscard]] int natural_node_of_owned(int i) const {
    return partition_.natural_of_global[static_cast<std::size_t>(partition_.first_owned() + i)];
  }

  const mesh::Partition& partition_;
  int axes_;
};

}  // namespace imic3d::mechanics
