#include "kept_factors.hpp"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <array>
#include <string>

#include "imic3d/mechanics/solver_choice.hpp"

namespace imic3d::mechanics {

namespace {
/// The preconditioner that the options ask for; empty: none.
std::string asked_preconditioner(const std::string& prefix) {
  std::array<char, 64> name{};
  IMIC3D_PETSC(PetscOptionsGetString(nullptr, prefix.c_str(), "-pc_type", name.data(), name.size(), nullptr));
  return name.data();
}
}  // namespace

KeptFactors::KeptFactors(Mat tangent, const mesh::Partition& partition, const mesh::Mesh& mesh,
                         const std::vector<int>& constrained, const material::FiniteStrainLaw& law,
                         const EquilibriumOptions& options, Work& work)
    : tangent_(tangent),
      symmetric_(law.symmetric_tangent()),
      one_point_(mesh.integration == mesh::Integration::one_point),
      communicator_(partition.communicator),
      options_(options),
      work_(work) {
  IMIC3D_PETSC(MatGetSize(tangent_, &unknowns_, nullptr));
  const double available = options_.memory_of_solver;
  const bool two_grids = CornerGrid::exists(mesh);
  const std::string asked = asked_preconditioner(options_.prefix);
  direct_by_default_ =
      asked != PCMG && solves_directly(static_cast<double>(unknowns_), symmetric_,
                                       two_grids && mesh::dimension(mesh.type) == 3 && options_.once, available);
  if (two_grids && !direct_by_default_ && (asked.empty() || asked == PCMG)) {
    PetscInt axes = 0;
    IMIC3D_PETSC(MatGetBlockSize(tangent_, &axes));
    corners_ = std::make_unique<CornerGrid>(partition, mesh, constrained, axes);
    corners_directly_ =
        solves_corners_directly(static_cast<double>(unknowns_), corners_->unknowns(), symmetric_, available);
  }
  factors_.push_back(make_solver());
  make_refiner();
  tell_choice(available);
}

/// Where it matters: from a gigabyte on.
void KeptFactors::tell_choice(double available) const {
  KSPType method = nullptr;
  IMIC3D_PETSC(KSPGetType(factors_.front().solver, &method));
  const double needed = memory_of_direct_solver(static_cast<double>(unknowns_), symmetric_);
  spdlog::log(
      needed > 1e9 ? spdlog::level::info : spdlog::level::debug,
      "{} unknowns: MUMPS takes about {:.1f} GB, there are {:.1f} GB; solved {} (-{}ksp_type, -{}pc_type change it)",
      unknowns_, 1e-9 * needed, 1e-9 * available,
      direct_ ? "directly" : fmt::format("by {}{}", method, corners_ ? " with two grids" : ""), options_.prefix,
      options_.prefix);
}

KeptFactors::Factor KeptFactors::make_solver() {
  Solver solver;
  IMIC3D_PETSC(KSPCreate(communicator_.handle, solver.put()));
  IMIC3D_PETSC(KSPSetOptionsPrefix(solver, options_.prefix.c_str()));
  PC preconditioner = nullptr;
  IMIC3D_PETSC(KSPGetPC(solver, &preconditioner));
  if (direct_by_default_) {
    IMIC3D_PETSC(KSPSetType(solver, KSPPREONLY));
    IMIC3D_PETSC(PCSetType(preconditioner, symmetric_ ? PCCHOLESKY : PCLU));
    IMIC3D_PETSC(PCFactorSetMatSolverType(preconditioner, MATSOLVERMUMPS));
  } else {
    IMIC3D_PETSC(KSPSetType(solver, KSPGMRES));  // away from equilibrium a tangent may be indefinite
    IMIC3D_PETSC(KSPGMRESSetRestart(solver, 50));
    IMIC3D_PETSC(KSPSetPCSide(solver, PC_RIGHT));
    if (corners_)
      corners_->use(solver, corners_directly_, symmetric_);
    else
      IMIC3D_PETSC(PCSetType(preconditioner, PCGAMG));
    IMIC3D_PETSC(KSPSetTolerances(solver, least_remaining_, PETSC_DEFAULT, PETSC_DEFAULT, 200));
  }
  if (KSPSetFromOptions(solver) != 0)
    throw InputError("command line", "options of PETSc (-mechanics_ksp_…, -mechanics_pc_…) that make no solver",
                     "those of PETSc's KSP and PC");
  IMIC3D_PETSC(KSPSetOperators(solver, tangent_, tangent_));
  PetscBool is_factor = PETSC_FALSE;
  IMIC3D_PETSC(
      PetscObjectTypeCompareAny(reinterpret_cast<PetscObject>(preconditioner), &is_factor, PCCHOLESKY, PCLU, ""));
  direct_ = is_factor == PETSC_TRUE;
  IMIC3D_PETSC(KSPGetTolerances(solver, &least_remaining_, nullptr, nullptr, nullptr));
  tell_mumps(preconditioner);
  return {std::move(solver), {}};
}

/// On the converged tangent, with the factor at hand as preconditioner.
void KeptFactors::make_refiner() {
  IMIC3D_PETSC(KSPCreate(communicator_.handle, refiner_.put()));
  IMIC3D_PETSC(KSPSetOptionsPrefix(refiner_, (options_.prefix + "derivative_").c_str()));
  IMIC3D_PETSC(KSPSetType(refiner_, KSPGMRES));
  IMIC3D_PETSC(KSPSetOperators(refiner_, tangent_, tangent_));
  IMIC3D_PETSC(KSPSetTolerances(refiner_, least_refined_, PETSC_DEFAULT, PETSC_DEFAULT, 200));
  IMIC3D_PETSC(KSPSetSkipPCSetFromOptions(refiner_, PETSC_TRUE));
  IMIC3D_PETSC(KSPSetFromOptions(refiner_));
  IMIC3D_PETSC(KSPGetTolerances(refiner_, &least_refined_, nullptr, nullptr, nullptr));
}

/// No scaling: all unknowns are displacements, and it takes a quarter of the factorisation of some thousand of them.
/// Hourglass modes that neither the law nor the images resist make the tangent singular, but the right-hand side has no
/// part in them: MUMPS leaves out the pivots that are zero and solves for the rest.
void KeptFactors::tell_mumps(PC preconditioner) const {
  MatSolverType type = nullptr;
  PetscBool by_mumps = PETSC_FALSE;
  IMIC3D_PETSC(PCFactorGetMatSolverType(preconditioner, &type));
  if (type != nullptr) IMIC3D_PETSC(PetscStrcmp(type, MATSOLVERMUMPS, &by_mumps));
  if (by_mumps != PETSC_TRUE) return;
  Mat factor = nullptr;
  IMIC3D_PETSC(PCFactorSetUpMatSolverType(preconditioner));
  IMIC3D_PETSC(PCFactorGetMatrix(preconditioner, &factor));
  if (one_point_)
    IMIC3D_PETSC(MatMumpsSetIcntl(factor, 24, 1));
  else if (direct_)
    IMIC3D_PETSC(MatMumpsSetIcntl(factor, 8, 0));
}

void KeptFactors::take(int of_frame, bool repeatedly) {
  at_hand_ =
      repeatedly && may_be_kept() && any_made() ? std::min(static_cast<std::size_t>(of_frame) + 1, most_ - 1) : 0;
  while (factors_.size() <= at_hand_) factors_.push_back(make_solver());
}

/// As many factors as there is room for.
void KeptFactors::count() {
  Mat factor = mumps_factor();
  if (factor == nullptr) return;
  PetscInt megabytes = 0;
  IMIC3D_PETSC(MatMumpsGetInfog(factor, 21, &megabytes));
  // every rank takes up the same factors
  const double largest = communicator_.max(static_cast<double>(std::max<PetscInt>(1, megabytes)));
  most_ = static_cast<std::size_t>(std::max(1.0, options_.memory_of_factors / largest));
}

/// The factor at hand if MUMPS made it, else null.
Mat KeptFactors::mumps_factor() const {
  if (!direct_) return nullptr;
  PC preconditioner = nullptr;
  Mat factor = nullptr;
  IMIC3D_PETSC(KSPGetPC(factors_[at_hand_].solver, &preconditioner));
  IMIC3D_PETSC(PCFactorGetMatrix(preconditioner, &factor));
  MatSolverType type = nullptr;
  IMIC3D_PETSC(MatFactorGetSolverType(factor, &type));
  return std::string(type) == MATSOLVERMUMPS ? factor : nullptr;
}

/// Number of negative pivots of the factor at hand, -1 if the solver does not tell (of an unsymmetric tangent INFOG(12)
/// is another number).
PetscInt KeptFactors::negative_pivots() const {
  Mat factor = mumps_factor();
  PetscInt pivots = -1;
  if (factor != nullptr && symmetric_) IMIC3D_PETSC(MatMumpsGetInfog(factor, 12, &pivots));
  return pivots;
}

bool KeptFactors::solve(Vec right, Vec solution, bool kept, double remaining) {
  ++work_.solutions;
  if (!direct_) return iterate(right, solution, remaining);
  if (!kept) ++work_.factorisations;
  auto& [solver, state] = factors_[at_hand_];
  const bool first = !state.made;
  IMIC3D_PETSC(KSPSetReusePreconditioner(solver, kept ? PETSC_TRUE : PETSC_FALSE));
  IMIC3D_PETSC(KSPSolve(solver, right, solution));
  KSPConvergedReason reason = KSP_CONVERGED_ITERATING;
  IMIC3D_PETSC(KSPGetConvergedReason(solver, &reason));
  state.made = reason >= 0 || reason == KSP_DIVERGED_ITS;
  if (!kept) state.indefinite = negative_pivots() > 0;
  if (first && at_hand_ == 0) count();
  return state.made;
}

/// The preconditioner of an earlier tangent serves until it takes half as many iterations again as when it was new.
bool KeptFactors::iterate(Vec right, Vec solution, double remaining) {
  auto& [solver, state] = factors_.front();
  const double left = std::max(least_remaining_, remaining);
  IMIC3D_PETSC(KSPSetTolerances(solver, left, PETSC_DEFAULT, PETSC_DEFAULT, PETSC_DEFAULT));
  for (bool renewed = !state.made || iterations_ > 1.5 * of_a_new_one_;; renewed = true) {
    if (renewed) {
      ++work_.factorisations;
      if (corners_) corners_->update(tangent_);
    }
    IMIC3D_PETSC(KSPSetReusePreconditioner(solver, renewed ? PETSC_FALSE : PETSC_TRUE));
    IMIC3D_PETSC(KSPSolve(solver, right, solution));
    KSPConvergedReason reason = KSP_CONVERGED_ITERATING;
    PetscInt count = 0;
    IMIC3D_PETSC(KSPGetConvergedReason(solver, &reason));
    IMIC3D_PETSC(KSPGetIterationNumber(solver, &count));
    iterations_ = static_cast<double>(count) / -std::log(left);
    if (renewed) of_a_new_one_ = iterations_;
    state.made = reason >= 0 || (renewed && reason == KSP_DIVERGED_ITS);
    if (state.made || renewed) return state.made;
  }
}

void KeptFactors::begin_derivatives() {
  PC preconditioner = nullptr;
  IMIC3D_PETSC(KSPGetPC(factors_[at_hand_].solver, &preconditioner));
  IMIC3D_PETSC(KSPSetPC(refiner_, preconditioner));
  IMIC3D_PETSC(KSPSetReusePreconditioner(refiner_, PETSC_TRUE));  // of both solvers
}

bool KeptFactors::renew() {
  ++work_.factorisations;
  auto& [solver, state] = factors_[at_hand_];
  PC preconditioner = nullptr;
  PCFailedReason failed = PC_NOERROR;
  IMIC3D_PETSC(KSPGetPC(solver, &preconditioner));
  IMIC3D_PETSC(PCSetReusePreconditioner(preconditioner, PETSC_FALSE));
  IMIC3D_PETSC(PCSetUp(preconditioner));  // KSPSetUp does nothing the second time
  IMIC3D_PETSC(PCSetReusePreconditioner(preconditioner, PETSC_TRUE));
  IMIC3D_PETSC(PCGetFailedReason(preconditioner, &failed));
  state.made = communicator_.all(failed == PC_NOERROR);
  state.indefinite = negative_pivots() > 0;
  return state.made;
}

void KeptFactors::substitute(std::span<const Vec> right, std::span<const Vec> solution) {
  const auto count = static_cast<PetscInt>(right.size());
  work_.derivative_solutions += static_cast<int>(count);
  if (count == 1) {
    IMIC3D_PETSC(KSPSolve(factors_[at_hand_].solver, right.front(), solution.front()));
    return;
  }
  PetscInt own = 0;
  IMIC3D_PETSC(MatGetLocalSize(tangent_, &own, nullptr));
  PetscOwner<Mat, MatDestroy> rights, solutions;
  for (Mat* made : {rights.put(), solutions.put()})
    IMIC3D_PETSC(MatCreateDense(communicator_.handle, own, PETSC_DECIDE, unknowns_, count, nullptr, made));
  for (PetscInt k = 0; k < count; ++k) {
    Vec column = nullptr;
    IMIC3D_PETSC(MatDenseGetColumnVecWrite(rights, k, &column));
    IMIC3D_PETSC(VecCopy(right[static_cast<std::size_t>(k)], column));
    IMIC3D_PETSC(MatDenseRestoreColumnVecWrite(rights, k, &column));
  }
  for (Mat made : {rights.get(), solutions.get()}) {
    IMIC3D_PETSC(MatAssemblyBegin(made, MAT_FINAL_ASSEMBLY));
    IMIC3D_PETSC(MatAssemblyEnd(made, MAT_FINAL_ASSEMBLY));
  }
  IMIC3D_PETSC(KSPMatSolve(factors_[at_hand_].solver, rights, solutions));
  for (PetscInt k = 0; k < count; ++k) {
    Vec column = nullptr;
    IMIC3D_PETSC(MatDenseGetColumnVecRead(solutions, k, &column));
    IMIC3D_PETSC(VecCopy(column, solution[static_cast<std::size_t>(k)]));
    IMIC3D_PETSC(MatDenseRestoreColumnVecRead(solutions, k, &column));
  }
}

void KeptFactors::refine(Vec right, Vec solution, double remaining) {
  ++work_.derivative_solutions;
  IMIC3D_PETSC(
      KSPSetTolerances(refiner_, std::max(least_refined_, remaining), PETSC_DEFAULT, PETSC_DEFAULT, PETSC_DEFAULT));
  IMIC3D_PETSC(KSPSolve(refiner_, right, solution));
}

void KeptFactors::end_derivatives() { IMIC3D_PETSC(KSPSetReusePreconditioner(refiner_, PETSC_FALSE)); }

}  // namespace imic3d::mechanics
