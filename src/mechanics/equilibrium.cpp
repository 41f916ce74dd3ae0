#include "imic3d/mechanics/equilibrium.hpp"

#include <fmt/format.h>
#include <petscksp.h>

#include <algorithm>
#include <cmath>
#include <deque>
#include <stdexcept>

#include "imic3d/core/error.hpp"
#include "imic3d/mechanics/assembler.hpp"
#include "imic3d/mesh/petsc.hpp"
#include "anderson.hpp"

namespace imic3d::mechanics {

namespace {
/// Up to this number of unknowns a direct factorisation is the default, above it CG with GAMG.
constexpr PetscInt direct_limit = 150'000;

/// Change of an element's G_t/G or G_s/G (one_point.hpp) above which a step is solved again, and how many times at most.
constexpr double renewed_modulus = 1e-3;
constexpr int renewals = 4;

/// A factorisation with its tangent, counted in corrections with the factor at hand and their passes over the elements.
constexpr double corrections_of_a_factor = 7.0;

/// So many solutions with the factor at hand an unbalanced derivative may still need before the tangent is assembled.
constexpr double solutions_of_a_tangent = 7.0;
/// Derivatives in more directions are not accelerated: 16 vectors each.
constexpr std::size_t most_accelerated = 16;

/// An increment goes on like the last one up to so many times its length.
constexpr double farthest_continued = 20.0;

std::vector<char> flags(std::size_t dofs, const std::vector<int>& constrained) {
  std::vector<char> flag(dofs, 0);
  for (int dof : constrained) flag[static_cast<std::size_t>(dof)] = 1;
  return flag;
}
}  // namespace

struct Equilibrium::Implementation {
  const mesh::Partition& partition;
  const mesh::Mesh& mesh;
  std::shared_ptr<const material::FiniteStrainLaw> law;
  std::vector<int> dofs;  // constrained, natural
  EquilibriumOptions options;
  Assembler assembler;
  int axes;  // degrees of freedom of a node; natural vectors always hold 3, the third is 0 in a plane mesh
  Vec u = nullptr, optical_force = nullptr, force = nullptr, external = nullptr, residual = nullptr, increment = nullptr,
      lifting = nullptr, correction = nullptr;
  /// A solver and whether it holds the factor of some tangent, and one with negative pivots.
  struct Factor {
    KSP solver = nullptr;
    bool made = false, indefinite = false;
  };
  std::vector<Factor> factors;  // the first for frames that nothing is known of, the others each for a frame that is simulated again
  std::size_t at_hand = 0, most_factors = 1;
  KSP refiner = nullptr;
  double least_refined = 1e-10;  // what it leaves at least of a right-hand side
  bool direct = true;
  Work work;                                  // of the run at hand
  Anderson acceleration;
  std::vector<Vec> du, d_force;  // of each free parameter and direction
  std::deque<Anderson> derivative_acceleration;
  std::vector<double> d_parameters;  // unit vectors [free x number of parameters], then 0
  double least_norm = 0.0;           // round-off of the forces; 0: not known yet
  Eigen::MatrixXd d_prescribed;      // of the increment [constrained degrees x directions]
  std::vector<double> last_residuals;
  const OpticalTerm* optical = nullptr;  // of the run at hand
  Accuracy accuracy;
  int frame = 0;
  double fraction = 1.0;

  Implementation(const mesh::Partition& partition_, const mesh::Mesh& mesh_,
                 std::shared_ptr<const material::FiniteStrainLaw> law_, std::vector<int> dofs_, EquilibriumOptions options_)
      : partition(partition_),
        mesh(mesh_),
        law(std::move(law_)),
        dofs(std::move(dofs_)),
        options(std::move(options_)),
        assembler(partition, mesh, law, flags(static_cast<std::size_t>(3 * mesh.nodes.rows()), dofs)),
        axes(assembler.axes()) {
    IMIC3D_PETSC(MatCreateVecs(assembler.tangent(), &u, nullptr));
    for (Vec* vector : {&optical_force, &force, &external, &residual, &increment, &lifting, &correction}) IMIC3D_PETSC(VecDuplicate(u, vector));
    attach_near_null_space();  // for GAMG, the default or an option
    factors.push_back(make_solver());
    make_refiner();
  }

  ~Implementation() {
    for (Factor& factor : factors) KSPDestroy(&factor.solver);
    KSPDestroy(&refiner);
    differentiate_by({}, 0);
    for (Vec* vector : {&u, &optical_force, &force, &external, &residual, &increment, &lifting, &correction}) VecDestroy(vector);
  }
  Implementation(const Implementation&) = delete;
  Implementation& operator=(const Implementation&) = delete;

  /// MUMPS LDL^T on small problems, CG with GAMG and the rigid-body near-null space above; everything open to options. A law
  /// without associated flow has an unsymmetric tangent: LU and GMRES then. LU does not tell the tangent's inertia.
  [[nodiscard]] Factor make_solver() {
    KSP solver = nullptr;
    IMIC3D_PETSC(KSPCreate(partition.communicator.handle, &solver));
    IMIC3D_PETSC(KSPSetOptionsPrefix(solver, options.prefix.c_str()));
    PC preconditioner = nullptr;
    IMIC3D_PETSC(KSPGetPC(solver, &preconditioner));
    if (axes * mesh.nodes.rows() <= direct_limit) {
      IMIC3D_PETSC(KSPSetType(solver, KSPPREONLY));
      IMIC3D_PETSC(PCSetType(preconditioner, law->symmetric_tangent() ? PCCHOLESKY : PCLU));
      IMIC3D_PETSC(PCFactorSetMatSolverType(preconditioner, MATSOLVERMUMPS));
    } else {
      IMIC3D_PETSC(KSPSetType(solver, law->symmetric_tangent() ? KSPCG : KSPGMRES));
      IMIC3D_PETSC(PCSetType(preconditioner, PCGAMG));
      IMIC3D_PETSC(KSPSetTolerances(solver, 1e-8, PETSC_DEFAULT, PETSC_DEFAULT, 1000));
    }
    IMIC3D_PETSC(KSPSetFromOptions(solver));
    IMIC3D_PETSC(KSPSetOperators(solver, assembler.tangent(), assembler.tangent()));
    PetscBool is_factor = PETSC_FALSE;
    IMIC3D_PETSC(PetscObjectTypeCompare(reinterpret_cast<PetscObject>(preconditioner), PCCHOLESKY, &is_factor));
    direct = is_factor == PETSC_TRUE;
    tell_mumps(preconditioner);
    return {solver};
  }

  /// On the converged tangent, with the factor at hand as preconditioner.
  void make_refiner() {
    IMIC3D_PETSC(KSPCreate(partition.communicator.handle, &refiner));
    IMIC3D_PETSC(KSPSetOptionsPrefix(refiner, (options.prefix + "derivative_").c_str()));
    IMIC3D_PETSC(KSPSetType(refiner, KSPGMRES));
    IMIC3D_PETSC(KSPSetOperators(refiner, assembler.tangent(), assembler.tangent()));
    IMIC3D_PETSC(KSPSetTolerances(refiner, least_refined, PETSC_DEFAULT, PETSC_DEFAULT, 200));
    IMIC3D_PETSC(KSPSetSkipPCSetFromOptions(refiner, PETSC_TRUE));
    IMIC3D_PETSC(KSPSetFromOptions(refiner));
    IMIC3D_PETSC(KSPGetTolerances(refiner, &least_refined, nullptr, nullptr, nullptr));
  }

  /// Takes up the factor of a frame that was simulated before, if there is room for one.
  void take_factor(int of_frame, bool simulated_before) {
    at_hand = simulated_before && options.keep_factors && direct && factors.front().made ? std::min(static_cast<std::size_t>(of_frame) + 1, most_factors - 1) : 0;
    while (factors.size() <= at_hand) factors.push_back(make_solver());
  }

  /// As many factors as there is room for.
  void count_factors() {
    Mat factor = mumps_factor();
    if (factor == nullptr) return;
    PetscInt megabytes = 0;
    IMIC3D_PETSC(MatMumpsGetInfog(factor, 21, &megabytes));
    const double largest = partition.communicator.max(static_cast<double>(std::max<PetscInt>(1, megabytes)));  // every rank takes up the same factors
    most_factors = static_cast<std::size_t>(std::max(1.0, options.memory_of_factors / largest));
  }

  /// No scaling: all unknowns are displacements, and it takes a quarter of the factorisation of some thousand of them.
  /// Hourglass modes that neither the law nor the images resist make the tangent singular, but the right-hand side has no part in
  /// them: MUMPS leaves out the pivots that are zero and solves for the rest.
  void tell_mumps(PC preconditioner) const {
    MatSolverType type = nullptr;
    PetscBool by_mumps = PETSC_FALSE;
    IMIC3D_PETSC(PCFactorGetMatSolverType(preconditioner, &type));
    if (type != nullptr) IMIC3D_PETSC(PetscStrcmp(type, MATSOLVERMUMPS, &by_mumps));
    if (by_mumps != PETSC_TRUE) return;
    Mat factor = nullptr;
    IMIC3D_PETSC(PCFactorSetUpMatSolverType(preconditioner));
    IMIC3D_PETSC(PCFactorGetMatrix(preconditioner, &factor));
    if (mesh.integration == mesh::Integration::one_point)
      IMIC3D_PETSC(MatMumpsSetIcntl(factor, 24, 1));
    else if (direct)
      IMIC3D_PETSC(MatMumpsSetIcntl(factor, 8, 0));
  }

  void attach_near_null_space() {
    Vec coordinates = nullptr;
    IMIC3D_PETSC(VecDuplicate(u, &coordinates));
    IMIC3D_PETSC(VecSetBlockSize(coordinates, axes));
    const Eigen::Map<const Eigen::VectorXd> positions(mesh.nodes.data(), mesh.nodes.size());
    to_global(positions, coordinates);
    MatNullSpace rigid = nullptr;
    IMIC3D_PETSC(MatNullSpaceCreateRigidBody(coordinates, &rigid));
    IMIC3D_PETSC(MatSetNearNullSpace(assembler.tangent(), rigid));
    IMIC3D_PETSC(MatNullSpaceDestroy(&rigid));
    IMIC3D_PETSC(VecDestroy(&coordinates));
  }

  [[nodiscard]] int natural_of_owned(int i) const {
    return partition.natural_of_global[static_cast<std::size_t>(partition.first_owned() + i)];
  }

  /// Natural, replicated -> global, distributed.
  void to_global(const Eigen::Ref<const Eigen::VectorXd>& natural, Vec global) const {
    PetscScalar* values = nullptr;
    IMIC3D_PETSC(VecGetArray(global, &values));
    for (int i = 0; i < partition.owned_nodes(); ++i)
      for (int k = 0; k < axes; ++k) values[axes * i + k] = natural[3 * natural_of_owned(i) + k];
    IMIC3D_PETSC(VecRestoreArray(global, &values));
  }

  /// Global, distributed -> natural on every rank.
  [[nodiscard]] Eigen::VectorXd to_natural(Vec global) const {
    Eigen::VectorXd natural = Eigen::VectorXd::Zero(3 * mesh.nodes.rows());
    const PetscScalar* values = nullptr;
    IMIC3D_PETSC(VecGetArrayRead(global, &values));
    for (int i = 0; i < partition.owned_nodes(); ++i)
      for (int k = 0; k < axes; ++k) natural[3 * natural_of_owned(i) + k] = values[axes * i + k];
    IMIC3D_PETSC(VecRestoreArrayRead(global, &values));
    partition.communicator.sum(std::span(natural.data(), static_cast<std::size_t>(natural.size())));
    return natural;
  }

  /// u <- prescribed at constrained degrees, exactly.
  void impose(Vec prescribed_global, Vec displacement) const {
    PetscScalar* values = nullptr;
    const PetscScalar* wanted = nullptr;
    IMIC3D_PETSC(VecGetArray(displacement, &values));
    IMIC3D_PETSC(VecGetArrayRead(prescribed_global, &wanted));
    const auto& constrained = assembler.constrained_owned();
    for (std::size_t i = 0; i < constrained.size(); ++i)
      if (constrained[i] != 0) values[i] = wanted[i];
    IMIC3D_PETSC(VecRestoreArrayRead(prescribed_global, &wanted));
    IMIC3D_PETSC(VecRestoreArray(displacement, &values));
  }

  /// Where u misses the prescribed displacement by round-off only, none is left.
  void settle_prescribed(Vec prescribed_global) const {
    double missing = 0.0, largest = 0.0;
    missing_displacement(prescribed_global);
    IMIC3D_PETSC(VecNorm(increment, NORM_INFINITY, &missing));
    IMIC3D_PETSC(VecNorm(u, NORM_INFINITY, &largest));
    if (missing <= 1e-12 * largest) impose(prescribed_global, u);
  }

  /// increment <- prescribed - u at constrained degrees, 0 elsewhere.
  void missing_displacement(Vec prescribed_global) const {
    IMIC3D_PETSC(VecWAXPY(increment, -1.0, u, prescribed_global));
    PetscScalar* values = nullptr;
    IMIC3D_PETSC(VecGetArray(increment, &values));
    const auto& constrained = assembler.constrained_owned();
    for (std::size_t i = 0; i < constrained.size(); ++i)
      if (constrained[i] == 0) values[i] = 0.0;
    IMIC3D_PETSC(VecRestoreArray(increment, &values));
  }

  /// Norm of the unbalanced forces at free degrees; `residual` is left as external - internal (+ optical) there, 0 elsewhere.
  [[nodiscard]] double unbalanced() {
    IMIC3D_PETSC(VecWAXPY(residual, -1.0, force, external));
    if (optical != nullptr) {
      to_global(optical->force(frame, fraction, to_natural(u)), optical_force);
      IMIC3D_PETSC(VecAXPY(residual, 1.0, optical_force));
    }
    return norm_at_free_degrees();
  }

  /// Norm of `residual` at free degrees; it is set to 0 elsewhere.
  [[nodiscard]] double norm_at_free_degrees() const {
    PetscScalar* values = nullptr;
    IMIC3D_PETSC(VecGetArray(residual, &values));
    const auto& constrained = assembler.constrained_owned();
    for (std::size_t i = 0; i < constrained.size(); ++i)
      if (constrained[i] != 0) values[i] = 0.0;
    IMIC3D_PETSC(VecRestoreArray(residual, &values));
    double norm = 0.0;
    IMIC3D_PETSC(VecNorm(residual, NORM_2, &norm));
    return norm;
  }

  /// Work of the unbalanced forces, where `unbalanced` was asked last, along a displacement.
  [[nodiscard]] double work_along(Vec displacement) const {
    double done = 0.0;
    IMIC3D_PETSC(VecDot(displacement, residual, &done));
    return done;
  }

  /// Adds the optical stiffness to the tangent, each rank its own rows; what is held keeps its identity.
  void add_optical_stiffness() const {
    const auto& constrained = assembler.constrained_owned();
    const auto held = flags(static_cast<std::size_t>(3 * mesh.nodes.rows()), dofs);
    for (int i = 0; i < static_cast<int>(constrained.size()); ++i) {
      if (constrained[static_cast<std::size_t>(i)] != 0) continue;
      const PetscInt row = axes * partition.first_owned() + i;
      const int natural = 3 * natural_of_owned(i / axes) + i % axes;
      // Symmetric: the column of the natural degree is its row.
      for (Eigen::SparseMatrix<double>::InnerIterator entry(optical->stiffness, natural); entry; ++entry) {
        if (held[static_cast<std::size_t>(entry.row())] != 0) continue;
        const PetscInt column = axes * partition.global_of_natural[static_cast<std::size_t>(entry.row() / 3)] + entry.row() % 3;
        IMIC3D_PETSC(MatSetValue(assembler.tangent(), row, column, entry.value(), ADD_VALUES));
      }
    }
    IMIC3D_PETSC(MatAssemblyBegin(assembler.tangent(), MAT_FINAL_ASSEMBLY));
    IMIC3D_PETSC(MatAssemblyEnd(assembler.tangent(), MAT_FINAL_ASSEMBLY));
  }

  /// The factor at hand if MUMPS made it, else null.
  [[nodiscard]] Mat mumps_factor() const {
    if (!direct) return nullptr;
    PC preconditioner = nullptr;
    Mat factor = nullptr;
    IMIC3D_PETSC(KSPGetPC(factors[at_hand].solver, &preconditioner));
    IMIC3D_PETSC(PCFactorGetMatrix(preconditioner, &factor));
    MatSolverType type = nullptr;
    IMIC3D_PETSC(MatFactorGetSolverType(factor, &type));
    return std::string(type) == MATSOLVERMUMPS ? factor : nullptr;
  }

  /// Number of negative pivots of the factor at hand, -1 if the solver does not tell.
  [[nodiscard]] PetscInt negative_pivots() const {
    Mat factor = mumps_factor();
    PetscInt pivots = -1;
    if (factor != nullptr) IMIC3D_PETSC(MatMumpsGetInfog(factor, 12, &pivots));
    return pivots;
  }

  enum class Outcome { converged, diverged, limit_point };

  /// Round-off of the deformation gradient, times the stiffness: forces below it are none, as at rest and after unloading.
  [[nodiscard]] double round_off_of_forces() const {
    double stiffness = 0.0;
    IMIC3D_PETSC(MatGetDiagonal(assembler.tangent(), correction));
    IMIC3D_PETSC(VecNorm(correction, NORM_2, &stiffness));
    IMIC3D_PETSC(VecZeroEntries(correction));
    double edge = 0.0;
    for (Eigen::Index cell = 0; cell < mesh.cells.rows(); ++cell) edge += (mesh.nodes.row(mesh.cells(cell, 0)) - mesh.nodes.row(mesh.cells(cell, 1))).norm();
    return 3e-16 * stiffness * edge / static_cast<double>(mesh.cells.rows());
  }

  /// Unbalanced forces at u (`unbalanced`), infinite where an element fails; with the tangent and its lifting or without.
  [[nodiscard]] double evaluate(Vec prescribed, double time_increment, std::span<const double> parameters, bool with_tangent) {
    missing_displacement(prescribed);
    ++work.passes;
    work.tangents += with_tangent ? 1 : 0;
    return assembler.assemble(u, time_increment, parameters, force, with_tangent ? increment : nullptr, lifting) ? unbalanced() : INFINITY;
  }

  /// correction <- what Newton's method adds to u, with the tangent that was assembled last; `kept`: with the factor of an earlier one, where
  /// nothing prescribed is missing. False if the solver failed.
  [[nodiscard]] bool correct(bool kept) {
    if (!kept) {
      if (optical != nullptr) add_optical_stiffness();
      IMIC3D_PETSC(VecAXPY(residual, -1.0, lifting));
      PetscScalar* right = nullptr;
      const PetscScalar* wanted = nullptr;
      IMIC3D_PETSC(VecGetArray(residual, &right));
      IMIC3D_PETSC(VecGetArrayRead(increment, &wanted));
      const auto& constrained = assembler.constrained_owned();
      for (std::size_t i = 0; i < constrained.size(); ++i)
        if (constrained[i] != 0) right[i] = wanted[i];
      IMIC3D_PETSC(VecRestoreArrayRead(increment, &wanted));
      IMIC3D_PETSC(VecRestoreArray(residual, &right));
      ++work.factorisations;
    }
    ++work.solutions;
    Factor& factor = factors[at_hand];
    const bool first = !factor.made;
    IMIC3D_PETSC(KSPSetReusePreconditioner(factor.solver, kept ? PETSC_TRUE : PETSC_FALSE));
    IMIC3D_PETSC(KSPSolve(factor.solver, residual, correction));
    KSPConvergedReason reason = KSP_CONVERGED_ITERATING;
    IMIC3D_PETSC(KSPGetConvergedReason(factor.solver, &reason));
    factor.made = reason >= 0 || reason == KSP_DIVERGED_ITS;
    if (!kept) factor.indefinite = negative_pivots() > 0;
    if (first && at_hand == 0) count_factors();
    return factor.made;
  }

  /// One increment: from u to equilibrium with the prescribed displacement and `external`. With a consistent tangent the unbalanced
  /// forces of a plastic step may well grow before they vanish, and a search that forbids it crawls. A step is shortened where an
  /// element would be inverted, where the forces grow a thousandfold, or where the work that they do along it has turned against it:
  /// they are the slope of the incremental energy (Crisfield 1982). `begins`: u is still where the last increment ended; `near`: it is
  /// offered, and the factor at hand is tried before another is made.
  ///
  /// A factor serves as long as its corrections, accelerated, shrink the forces fast enough (modified Newton): it costs as much as some
  /// `corrections_of_a_factor` corrections. They contract only where the tangent is as definite as the factor's.
  Outcome newton(Vec prescribed, double time_increment, std::span<const double> parameters, int& iterations, bool begins, bool near) {
    last_residuals.clear();
    acceleration.restart();
    const bool may_keep = options.keep_factors && direct && optical == nullptr;
    const Factor& factor = factors[at_hand];
    Outcome failed = Outcome::diverged;
    IMIC3D_PETSC(VecZeroEntries(correction));
    const int most = optical != nullptr ? 3 * options.max_iterations : options.max_iterations;
    if (!begins) settle_prescribed(prescribed);
    bool tangent = !(near && may_keep && factors.front().made), kept = true;  // assembled at u; the last correction was made with an earlier one
    assembler.predict(begins);
    double norm = evaluate(prescribed, time_increment, parameters, tangent), previous = 0.0, rate = 0.0;
    if (!std::isfinite(norm)) return failed;
    for (int iteration = 0, renewed = 0; renewed <= most; ++iteration) {
      double missing = 0.0, size = 0.0, load = 0.0;
      if (least_norm == 0.0) least_norm = round_off_of_forces();
      IMIC3D_PETSC(VecNorm(increment, NORM_INFINITY, &missing));
      IMIC3D_PETSC(VecNorm(force, NORM_2, &size));
      IMIC3D_PETSC(VecNorm(external, NORM_2, &load));
      double scale = std::max({size, load, 1e-30});
      if (optical != nullptr) scale = std::max(scale, (optical->stiffness * to_natural(u)).norm());
      last_residuals.push_back(norm / scale);
      // Below the tolerance, or at the level of round-off where it no longer falls; grey levels are single precision.
      const bool ends_early = accuracy.forces > 0.0 && optical == nullptr;
      const double tolerance = optical != nullptr ? options.optical_tolerance : ends_early ? accuracy.forces : options.tolerance;
      const double enough = std::max(tolerance * scale, least_norm);
      // The last correction of Newton's method ends far below the tolerance: those of a kept factor go on as long as they help.
      const double target = may_keep && kept && !ends_early ? (iteration > 0 ? 1e-4 : 1e-2) * tolerance * scale : enough;
      const bool pays = may_keep && factor.made && missing == 0.0 && (iteration == 0 ? near : rate < 1.0 && std::log(target / norm) > corrections_of_a_factor * std::log(rate));
      if (missing == 0.0 && (iteration > 0 || near)) {
        const double round_off = optical != nullptr ? 1e-5 : 1e-8;
        const bool stalled = !kept && iteration > (optical != nullptr ? 5 : 2) && norm > 0.5 * previous && norm < round_off * scale;
        // A rigid motion costs hardly any force where the images pull weakly: it is the displacement that must have settled.
        double moved = 0.0, whole = 0.0;
        IMIC3D_PETSC(VecNorm(correction, NORM_2, &moved));
        IMIC3D_PETSC(VecNorm(u, NORM_2, &whole));
        const bool settled = optical == nullptr || (iteration > 0 && moved <= 1e-5 * whole);
        const bool helps = kept && pays && rate < 0.5 && norm > target;
        if ((norm <= enough && settled && !helps) || stalled) return factor.indefinite && load > 0.0 ? Outcome::limit_point : Outcome::converged;
      }
      if (renewed == most) break;

      if (!pays && !tangent) {
        tangent = true;
        norm = evaluate(prescribed, time_increment, parameters, true);
      }
      kept = pays;
      if (!correct(kept)) return failed;
      if (kept)
        acceleration.accelerate(correction);
      else
        acceleration.restart();
      const double slope = missing == 0.0 && optical == nullptr ? work_along(correction) : 0.0;
      // Under prescribed forces a tangent that is not positive definite means a limit point.
      if (factor.indefinite && load > 0.0) failed = Outcome::limit_point;
      ++iterations;
      if (!kept) ++renewed;
      IMIC3D_PETSC(VecAXPY(u, 1.0, correction));
      impose(prescribed, u);

      previous = norm;
      const double relative = norm / scale;
      tangent = !may_keep || (!kept && relative > 1e-2);
      assembler.predict(begins && iteration < 1);
      double step = 1.0;
      for (int halvings = 0;; ++halvings) {
        norm = evaluate(prescribed, time_increment, parameters, tangent);
        if (kept && !(norm < previous)) {  // the factor is of no use here
          IMIC3D_PETSC(VecAXPY(u, -step, correction));
          norm = evaluate(prescribed, time_increment, parameters, tangent = previous > enough);
          step = 0.0;
          acceleration.restart();
          break;
        }
        double shorter = 0.5 * step;
        if (std::isfinite(norm) && (iteration < 1 || norm < 1e3 * previous)) {
          if (norm <= 0.05 * previous || slope <= 0.0 || halvings == 4) break;
          const double done = work_along(correction);
          if (done >= -0.8 * slope) break;
          shorter = std::max(0.1, slope / (slope - done)) * step;
        } else if (halvings == 4) {
          return failed;
        }
        IMIC3D_PETSC(VecAXPY(u, shorter - step, correction));
        step = shorter;
      }
      if (step != 1.0) acceleration.restart();
      rate = step == 1.0 ? norm / previous : 1.0;
    }
    return failed;
  }

  /// By which of the law's parameters the path is differentiated, and in how many directions of the prescribed displacement.
  void differentiate_by(std::span<const int> free, std::size_t directions) {
    const std::size_t all = free.size() + directions;
    derivative_acceleration.clear();
    if (all <= most_accelerated)
      for (std::size_t k = 0; k < all; ++k) derivative_acceleration.emplace_back(7);
    d_prescribed.resize(static_cast<Eigen::Index>(dofs.size()), static_cast<Eigen::Index>(directions));
    for (auto* vectors : {&du, &d_force}) {
      for (Vec& vector : *vectors) VecDestroy(&vector);
      vectors->assign(all, nullptr);
      for (Vec& vector : *vectors) IMIC3D_PETSC(VecDuplicate(u, &vector));
    }
    const std::size_t parameters = law->parameters().size();
    d_parameters.assign(all * parameters, 0.0);
    for (std::size_t k = 0; k < free.size(); ++k) d_parameters[k * parameters + static_cast<std::size_t>(free[k])] = 1.0;
  }

  /// residual <- what the derivatives of the forces leave unbalanced at free degrees in direction k, 0 elsewhere; its norm.
  [[nodiscard]] double unbalanced_derivative(std::size_t k) {
    IMIC3D_PETSC(VecCopy(d_force[k], residual));
    IMIC3D_PETSC(VecScale(residual, -1.0));
    if (optical != nullptr) {
      to_global(optical->d_force(frame, fraction, to_natural(u), to_natural(du[k])), optical_force);
      IMIC3D_PETSC(VecAXPY(residual, 1.0, optical_force));
    }
    return norm_at_free_degrees();
  }

  /// du[k] = dU/dLambda_k where `newton` has just converged, and the derivatives of the new history. What is left unbalanced is solved for with
  /// the factor at hand while that shrinks it fast, else with the converged tangent. Every rank gets the same answer.
  bool differentiate(double time_increment, std::span<const double> parameters, int& corrections) {
    constexpr int most = 30;
    bool by_factor = options.keep_factors && direct && optical == nullptr;  // else with the converged tangent
    const double tolerance = accuracy.derivatives > 0.0 ? accuracy.derivatives : options.derivative_tolerance;
    if (optical != nullptr) add_optical_stiffness();
    std::vector<double> scale(du.size()), last(du.size(), INFINITY);
    KSP solver = factors[at_hand].solver;
    PC preconditioner = nullptr;
    IMIC3D_PETSC(KSPGetPC(solver, &preconditioner));
    IMIC3D_PETSC(KSPSetPC(refiner, preconditioner));
    IMIC3D_PETSC(KSPSetReusePreconditioner(refiner, PETSC_TRUE));  // of both solvers
    for (Anderson& accelerated : derivative_acceleration) accelerated.restart();
    for (std::size_t k = 0; k < du.size(); ++k) {
      const auto direction = static_cast<Eigen::Index>(k) - (static_cast<Eigen::Index>(du.size()) - d_prescribed.cols());
      IMIC3D_PETSC(VecZeroEntries(du[k]));
      if (direction < 0) continue;
      Eigen::VectorXd given = Eigen::VectorXd::Zero(3 * mesh.nodes.rows());
      for (std::size_t i = 0; i < dofs.size(); ++i) given[dofs[i]] = d_prescribed(static_cast<Eigen::Index>(i), direction);
      to_global(given, du[k]);
    }
    for (int pass = 0; pass <= most; ++pass) {
      ++work.derivative_passes;
      bool balanced = assembler.differentiate(du, time_increment, parameters, d_parameters, d_force);
      if (!balanced) break;
      for (std::size_t k = 0; k < du.size(); ++k) {
        if (pass == 0) IMIC3D_PETSC(VecNorm(d_force[k], NORM_2, &scale[k]));  // dF_int/dLambda + dF_int/dxi . dxi/dLambda
        const double norm = unbalanced_derivative(k);
        if (norm <= tolerance * scale[k]) continue;
        balanced = false;
        const double wanted = tolerance * scale[k] / norm;
        if (by_factor && (norm >= last[k] || std::log(wanted) < solutions_of_a_tangent * std::log(norm / last[k]))) {
          by_factor = false;
          ++work.passes, ++work.tangents;
          IMIC3D_PETSC(VecZeroEntries(increment));
          if (!assembler.assemble(u, time_increment, parameters, force, increment, lifting)) return false;
        }
        last[k] = norm;
        ++work.derivative_solutions;
        if (!by_factor) IMIC3D_PETSC(KSPSetTolerances(refiner, std::max(least_refined, 0.1 * wanted), PETSC_DEFAULT, PETSC_DEFAULT, PETSC_DEFAULT));
        IMIC3D_PETSC(KSPSolve(by_factor ? solver : refiner, residual, correction));
        if (by_factor && !derivative_acceleration.empty()) derivative_acceleration[k].accelerate(correction);
        IMIC3D_PETSC(VecAXPY(du[k], 1.0, correction));
      }
      if (balanced) {
        IMIC3D_PETSC(KSPSetReusePreconditioner(refiner, PETSC_FALSE));
        return true;
      }
      ++corrections;
    }
    IMIC3D_PETSC(KSPSetReusePreconditioner(refiner, PETSC_FALSE));
    return false;
  }

  void collect(FrameState& state, bool fields) const {
    state.displacement = to_natural(u);
    state.internal = to_natural(force);
    for (const Vec& vector : du) state.d_displacement.push_back(to_natural(vector));
    for (const Vec& vector : d_force) state.d_internal.push_back(to_natural(vector));
    if (!options.with_fields || !fields) return;
    const Communicator group = partition.communicator;
    const auto cells = mesh.cells.rows();
    state.cauchy_stress.setZero(cells, 6);
    state.plastic_strain.setZero(cells);
    for (std::size_t i = 0; i < partition.cells.size(); ++i) {
      const auto row = static_cast<Eigen::Index>(i);
      state.cauchy_stress.row(partition.cells[i]) = assembler.cauchy_stress().row(row);
      state.plastic_strain[partition.cells[i]] = assembler.plastic_strain()[row];
    }
    group.sum(std::span(state.cauchy_stress.data(), static_cast<std::size_t>(state.cauchy_stress.size())));
    group.sum(std::span(state.plastic_strain.data(), static_cast<std::size_t>(state.plastic_strain.size())));
  }
};

Equilibrium::Equilibrium(const mesh::Partition& partition, const mesh::Mesh& mesh,
                         std::shared_ptr<const material::FiniteStrainLaw> law, std::vector<int> constrained_dofs,
                         EquilibriumOptions options)
    : impl_(std::make_unique<Implementation>(partition, mesh, std::move(law), std::move(constrained_dofs),
                                             std::move(options))) {}

Equilibrium::~Equilibrium() = default;

const std::vector<int>& Equilibrium::constrained_dofs() const { return impl_->dofs; }

PathStatus Equilibrium::run(const std::vector<LoadStep>& steps, std::span<const double> parameters, double start_time,
                            const std::function<void(int, const FrameState&)>& frame_done,
                            const std::function<const Eigen::VectorXd*(int)>& guess,
                            const std::vector<int>& increments, const OpticalTerm* optical, std::span<const int> free,
                            const Accuracy& accuracy, bool fields) {
  auto& s = *impl_;
  const Eigen::Index directions = steps.empty() ? 0 : steps.front().d_prescribed.cols();
  const bool differentiated = !free.empty() || directions > 0;
  if (differentiated && s.mesh.integration == mesh::Integration::one_point_stabilised)
    throw std::invalid_argument("Equilibrium: no direct differentiation of hex8s elements");
  s.optical = optical;
  s.accuracy = accuracy;
  s.differentiate_by(free, static_cast<std::size_t>(directions));
  const Eigen::Index dofs = 3 * s.mesh.nodes.rows();
  s.work = {};
  PathStatus status;
  s.assembler.start(static_cast<int>(s.du.size()));
  IMIC3D_PETSC(VecSet(s.u, 0.0));

  enum class Start { offered, continued, standing };  // of an increment: at the guess, going on like the last one, where that ended
  Vec converged = nullptr, before = nullptr, change = nullptr, change_before = nullptr, prescribed = nullptr, found = nullptr, offered = nullptr;
  const auto vectors = {&converged, &before, &change, &change_before, &prescribed, &found, &offered};
  for (Vec* vector : vectors) IMIC3D_PETSC(VecDuplicate(s.u, vector));
  IMIC3D_PETSC(VecSet(converged, 0.0));
  IMIC3D_PETSC(VecSet(change, 0.0));
  Eigen::VectorXd last_load;  // of the increment that made `change`: what moved the prescribed displacement and the forces

  const auto full = [&](const LoadStep* step) {
    Eigen::VectorXd values = Eigen::VectorXd::Zero(dofs);
    if (step != nullptr)
      for (std::size_t i = 0; i < s.dofs.size(); ++i) values[s.dofs[i]] = step->prescribed[static_cast<Eigen::Index>(i)];
    return values;
  };
  const auto nodal_force = [&](const LoadStep* step) {
    return step != nullptr && step->force.size() > 0 ? step->force : Eigen::VectorXd(Eigen::VectorXd::Zero(dofs));
  };

  const LoadStep* previous = nullptr;
  for (int frame = 0; frame < static_cast<int>(steps.size()) && status.message.empty(); ++frame) {
    const LoadStep& step = steps[static_cast<std::size_t>(frame)];
    const double begin = previous != nullptr ? previous->time : start_time;
    const Eigen::VectorXd from = full(previous), to = full(&step), force_from = nodal_force(previous),
                          force_to = nodal_force(&step);
    const Eigen::VectorXd* near = guess ? guess(frame) : nullptr;
    const int first = increments.empty() ? s.options.increments : increments[static_cast<std::size_t>(frame)];
    int count = first, cuts = 0, iterations = 0;
    bool offers = near != nullptr && near->size() == dofs;
    if (offers) s.to_global(*near, offered);
    s.take_factor(frame, offers);
    s.assembler.save();
    IMIC3D_PETSC(VecCopy(converged, before));
    IMIC3D_PETSC(VecCopy(change, change_before));
    const Eigen::VectorXd last_load_before = last_load;
    Start start = Start::offered;
    for (int increment = 0; increment < count;) {
      const double target = increment + 1 == count ? 1.0 : static_cast<double>(increment + 1) / count;
      s.to_global(from + target * (to - from), prescribed);
      s.to_global(force_from + target * (force_to - force_from), s.external);
      Eigen::VectorXd load(2 * dofs);  // a change of sign or size matters, not the units: where there are forces, they count
      load << (to - from) / count, (force_to - force_from) / count;
      const double times = last_load.size() > 0 && optical == nullptr ? load.dot(last_load) / last_load.squaredNorm() : 0.0;
      if (start == Start::offered && !offers) start = Start::continued;
      if (start == Start::continued && !(times > 0.0 && times < farthest_continued)) start = Start::standing;
      IMIC3D_PETSC(VecCopy(start == Start::offered ? before : converged, s.u));
      if (start == Start::offered) IMIC3D_PETSC(VecAXPBY(s.u, target, 1.0 - target, offered));
      if (start == Start::continued) IMIC3D_PETSC(VecAXPY(s.u, times, change));
      s.frame = frame;
      s.fraction = target;
      auto outcome = s.newton(prescribed, (step.time - begin) / count, parameters, iterations, start == Start::standing, start == Start::offered);
      // Where the hourglass moduli have changed the step is solved again, from where it is, with those that it led to. If they carry no
      // equilibrium, those before stand.
      for (int again = 0; again < renewals && outcome == Implementation::Outcome::converged && s.assembler.renew_hourglass_moduli() > renewed_modulus; ++again) {
        IMIC3D_PETSC(VecCopy(s.u, found));
        if (s.newton(prescribed, (step.time - begin) / count, parameters, iterations, false, false) == Implementation::Outcome::converged) continue;
        s.assembler.restore_hourglass_moduli();
        IMIC3D_PETSC(VecCopy(found, s.u));
        outcome = s.newton(prescribed, (step.time - begin) / count, parameters, iterations, false, false);
        break;
      }
      if (outcome == Implementation::Outcome::converged) {
        if (directions > 0) s.d_prescribed = previous != nullptr ? Eigen::MatrixXd(previous->d_prescribed + target * (step.d_prescribed - previous->d_prescribed)) : Eigen::MatrixXd(target * step.d_prescribed);
        if (differentiated && !s.differentiate((step.time - begin) / count, parameters, status.derivative_corrections))
          throw ConvergenceError(fmt::format("no derivative by the parameters at frame {} of the series (time {:.6g}); with identify.sensitivities: perturbed none is needed", frame + 1, step.time));
        s.assembler.commit();
        IMIC3D_PETSC(VecWAXPY(change, -1.0, converged, s.u));
        IMIC3D_PETSC(VecCopy(s.u, converged));
        last_load = load;
        start = Start::offered;
        ++increment;
        continue;
      }
      if (start != Start::standing) {  // a poor beginning is no reason to cut the step
        offers = false;
        start = start == Start::offered ? Start::continued : Start::standing;
        continue;
      }
      if (++cuts > s.options.max_cuts) {
        status.limit_point = outcome == Implementation::Outcome::limit_point;
        status.message = fmt::format("no equilibrium at frame {} of the series (time {:.6g}) in {} increments{}", frame + 1,
                                     step.time, count,
                                     status.limit_point ? ": the prescribed force is at or beyond the maximum load that the "
                                                          "specimen can carry with these parameters"
                                                        : "");
        break;
      }
      count *= 2;
      increment = 0;
      start = Start::offered;
      s.assembler.restore();
      IMIC3D_PETSC(VecCopy(before, converged));
      IMIC3D_PETSC(VecCopy(change_before, change));
      last_load = last_load_before;
    }
    status.increments.push_back(count);
    status.total_iterations += iterations;
    if (!status.message.empty()) break;
    FrameState state;
    s.collect(state, fields);
    state.iterations = iterations;
    ++status.frames;
    frame_done(frame, state);
    previous = &step;
  }
  status.residuals = s.last_residuals;
  s.work.frames = status.frames;
  status.work = s.work;
  for (Vec* vector : vectors) IMIC3D_PETSC(VecDestroy(vector));
  return status;
}

Eigen::VectorXd Equilibrium::internal_forces(const Eigen::VectorXd& U, std::span<const double> parameters,
                                             Eigen::SparseMatrix<double>* tangent) {
  auto& s = *impl_;
  s.assembler.start();
  s.to_global(U, s.u);
  IMIC3D_PETSC(VecZeroEntries(s.increment));
  if (!s.assembler.assemble(s.u, 1.0, parameters, s.force, tangent != nullptr ? s.increment : nullptr, s.lifting))
    throw ConvergenceError("the law cannot follow the displacement");
  if (tangent == nullptr) return s.to_natural(s.force);
  std::vector<Eigen::Triplet<double>> entries;
  const auto natural = [&](PetscInt dof) { return 3 * s.natural_of_owned(dof / s.axes) + dof % s.axes; };
  for (PetscInt row = 0; row < s.axes * s.partition.owned_nodes(); ++row) {
    PetscInt size = 0;
    const PetscInt* columns = nullptr;
    const PetscScalar* values = nullptr;
    IMIC3D_PETSC(MatGetRow(s.assembler.tangent(), row, &size, &columns, &values));
    for (PetscInt k = 0; k < size; ++k) entries.emplace_back(natural(row), natural(columns[k]), values[k]);
    IMIC3D_PETSC(MatRestoreRow(s.assembler.tangent(), row, &size, &columns, &values));
  }
  tangent->resize(U.size(), U.size());
  tangent->setFromTriplets(entries.begin(), entries.end());
  return s.to_natural(s.force);
}

double Equilibrium::internal_work(const Eigen::VectorXd& U, std::span<const double> parameters) {
  auto& s = *impl_;
  s.assembler.start();
  s.to_global(U, s.u);
  double work = 0.0;
  if (!s.assembler.assemble(s.u, 1.0, parameters, s.force)) throw ConvergenceError("the law cannot follow a uniform strain");
  IMIC3D_PETSC(VecDot(s.u, s.force, &work));
  return work;
}

}  // namespace imic3d::mechanics
