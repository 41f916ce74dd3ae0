#include "force_balance.hpp"

#include <cmath>
#include <utility>

namespace imic3d::mechanics {

namespace {
std::vector<char> flags(std::size_t dofs, const std::vector<int>& constrained) {
  std::vector<char> flag(dofs, 0);
  for (int dof : constrained) flag[static_cast<std::size_t>(dof)] = 1;
  return flag;
}
}  // namespace

ForceBalance::ForceBalance(const mesh::Partition& partition, const mesh::Mesh& mesh,
                           const std::shared_ptr<const material::FiniteStrainLaw>& law, std::vector<int> constrained,
                           Work& work)
    : mesh_(mesh),
      constrained_(std::move(constrained)),
      work_(work),
      assembler_(partition, mesh, law, flags(static_cast<std::size_t>(3 * mesh.nodes.rows()), constrained_)),
      numbering_(partition, assembler_.axes()) {
  IMIC3D_PETSC(MatCreateVecs(assembler_.tangent(), u_.put(), nullptr));
  for (OwnedVec* vector : {&optical_force_, &force_, &external_, &residual_, &missing_, &lifting_, &prescribed_})
    IMIC3D_PETSC(VecDuplicate(u_, vector->put()));
  attach_near_null_space();  // for GAMG, the default or an option
}

void ForceBalance::attach_near_null_space() {
  OwnedVec coordinates;
  IMIC3D_PETSC(VecDuplicate(u_, coordinates.put()));
  IMIC3D_PETSC(VecSetBlockSize(coordinates, numbering_.axes()));
  const Eigen::Map<const Eigen::VectorXd> positions(mesh_.nodes.data(), mesh_.nodes.size());
  numbering_.to_global(positions, coordinates);
  PetscOwner<MatNullSpace, MatNullSpaceDestroy> rigid;
  IMIC3D_PETSC(MatNullSpaceCreateRigidBody(coordinates, rigid.put()));
  IMIC3D_PETSC(MatSetNearNullSpace(assembler_.tangent(), rigid));
}

void ForceBalance::start(std::span<const double> parameters, const OpticalTerm* optical, int directions,
                         const Eigen::MatrixXd& d_section) {
  parameters_ = parameters;
  optical_ = optical;
  optical_stiffness_.reset();
  assembler_.start(directions, d_section);
  IMIC3D_PETSC(VecSet(u_, 0.0));
}

/// On the pattern of the tangent, which has been assembled (a duplicate of one that has not does not know the other
/// ranks' columns), each rank its own rows; 0 where a degree is constrained, which keeps its identity.
void ForceBalance::assemble_optical_stiffness() {
  const auto& constrained = assembler_.constrained_owned();
  const auto held = flags(static_cast<std::size_t>(numbering_.natural_size()), constrained_);
  IMIC3D_PETSC(MatDuplicate(assembler_.tangent(), MAT_DO_NOT_COPY_VALUES, optical_stiffness_.put()));
  for (int i = 0; i < static_cast<int>(constrained.size()); ++i) {
    if (constrained[static_cast<std::size_t>(i)] != 0) continue;
    // Symmetric: the column of the natural degree is its row.
    for (Eigen::SparseMatrix<double>::InnerIterator entry(optical_->stiffness, numbering_.natural_of_owned(i)); entry;
         ++entry) {
      if (held[static_cast<std::size_t>(entry.row())] != 0) continue;
      IMIC3D_PETSC(MatSetValue(optical_stiffness_, numbering_.first_owned() + i,
                               numbering_.global_of_natural(entry.row()), entry.value(), INSERT_VALUES));
    }
  }
  IMIC3D_PETSC(MatAssemblyBegin(optical_stiffness_, MAT_FINAL_ASSEMBLY));
  IMIC3D_PETSC(MatAssemblyEnd(optical_stiffness_, MAT_FINAL_ASSEMBLY));
}

void ForceBalance::apply(const Load& load) {
  numbering_.to_global(load.prescribed, prescribed_);
  numbering_.to_global(load.force, external_);
  time_increment_ = load.time_increment;
  frame_ = load.frame;
  fraction_ = load.fraction;
}

void ForceBalance::impose() {
  PetscScalar* values = nullptr;
  const PetscScalar* wanted = nullptr;
  IMIC3D_PETSC(VecGetArray(u_, &values));
  IMIC3D_PETSC(VecGetArrayRead(prescribed_, &wanted));
  const auto& constrained = assembler_.constrained_owned();
  for (std::size_t i = 0; i < constrained.size(); ++i)
    if (constrained[i] != 0) values[i] = wanted[i];
  IMIC3D_PETSC(VecRestoreArrayRead(prescribed_, &wanted));
  IMIC3D_PETSC(VecRestoreArray(u_, &values));
}

void ForceBalance::settle_prescribed() {
  double missing = 0.0, largest = 0.0;
  find_missing();
  IMIC3D_PETSC(VecNorm(missing_, NORM_INFINITY, &missing));
  IMIC3D_PETSC(VecNorm(u_, NORM_INFINITY, &largest));
  if (missing <= 1e-12 * largest) impose();
}

/// missing <- prescribed - u at constrained degrees, 0 elsewhere.
void ForceBalance::find_missing() {
  IMIC3D_PETSC(VecWAXPY(missing_, -1.0, u_, prescribed_));
  PetscScalar* values = nullptr;
  IMIC3D_PETSC(VecGetArray(missing_, &values));
  const auto& constrained = assembler_.constrained_owned();
  for (std::size_t i = 0; i < constrained.size(); ++i)
    if (constrained[i] == 0) values[i] = 0.0;
  IMIC3D_PETSC(VecRestoreArray(missing_, &values));
}

double ForceBalance::evaluate(bool with_tangent) {
  find_missing();
  ++work_.passes;
  work_.tangents += with_tangent ? 1 : 0;
  if (!assembler_.assemble(u_, time_increment_, parameters_, force_, with_tangent ? missing_.get() : nullptr, lifting_))
    return INFINITY;
  IMIC3D_PETSC(VecWAXPY(residual_, -1.0, force_, external_));
  if (optical_ != nullptr) {
    numbering_.to_global(optical_->force(frame_, fraction_, numbering_.to_natural(u_)), optical_force_);
    IMIC3D_PETSC(VecAXPY(residual_, 1.0, optical_force_));
  }
  return norm_at_free_degrees();
}

/// Norm of `residual` at free degrees; it is set to 0 elsewhere.
double ForceBalance::norm_at_free_degrees() {
  PetscScalar* values = nullptr;
  IMIC3D_PETSC(VecGetArray(residual_, &values));
  const auto& constrained = assembler_.constrained_owned();
  for (std::size_t i = 0; i < constrained.size(); ++i)
    if (constrained[i] != 0) values[i] = 0.0;
  IMIC3D_PETSC(VecRestoreArray(residual_, &values));
  double norm = 0.0;
  IMIC3D_PETSC(VecNorm(residual_, NORM_2, &norm));
  return norm;
}

double ForceBalance::work_along(Vec displacement) const {
  double done = 0.0;
  IMIC3D_PETSC(VecDot(displacement, residual_, &done));
  return done;
}

void ForceBalance::linearise() {
  if (optical_ != nullptr) add_optical_stiffness();
  IMIC3D_PETSC(VecAXPY(residual_, -1.0, lifting_));
  PetscScalar* right = nullptr;
  const PetscScalar* wanted = nullptr;
  IMIC3D_PETSC(VecGetArray(residual_, &right));
  IMIC3D_PETSC(VecGetArrayRead(missing_, &wanted));
  const auto& constrained = assembler_.constrained_owned();
  for (std::size_t i = 0; i < constrained.size(); ++i)
    if (constrained[i] != 0) right[i] = wanted[i];
  IMIC3D_PETSC(VecRestoreArrayRead(missing_, &wanted));
  IMIC3D_PETSC(VecRestoreArray(residual_, &right));
}

bool ForceBalance::differentiate(const std::vector<Vec>& du, std::span<const double> d_parameters,
                                 const std::vector<Vec>& d_force) {
  return assembler_.differentiate(du, time_increment_, parameters_, d_parameters, d_force);
}

double ForceBalance::unbalanced_derivative(Vec du, Vec d_force, Vec d_external) {
  IMIC3D_PETSC(VecCopy(d_force, residual_));
  IMIC3D_PETSC(VecScale(residual_, -1.0));
  if (d_external != nullptr) IMIC3D_PETSC(VecAXPY(residual_, 1.0, d_external));
  if (optical_ != nullptr) {
    numbering_.to_global(optical_->d_force(frame_, fraction_, numbering_.to_natural(u_), numbering_.to_natural(du)),
                         optical_force_);
    IMIC3D_PETSC(VecAXPY(residual_, 1.0, optical_force_));
  }
  return norm_at_free_degrees();
}

bool ForceBalance::assemble_tangent() {
  ++work_.passes, ++work_.tangents;
  IMIC3D_PETSC(VecZeroEntries(missing_));
  return assembler_.assemble(u_, time_increment_, parameters_, force_, missing_, lifting_);
}

void ForceBalance::add_optical_stiffness() {
  if (optical_stiffness_.get() == nullptr) assemble_optical_stiffness();
  IMIC3D_PETSC(MatAXPY(assembler_.tangent(), 1.0, optical_stiffness_, SAME_NONZERO_PATTERN));
}

bool ForceBalance::evaluate_virgin(const Eigen::VectorXd& U, std::span<const double> parameters, bool with_tangent) {
  assembler_.start();
  numbering_.to_global(U, u_);
  if (with_tangent) IMIC3D_PETSC(VecZeroEntries(missing_));
  return assembler_.assemble(u_, 1.0, parameters, force_, with_tangent ? missing_.get() : nullptr, lifting_);
}

}  // namespace imic3d::mechanics
