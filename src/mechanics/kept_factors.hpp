#pragma once
// Solutions with the tangent, or with the factor of one that was.

#include <petscksp.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <memory>
#include <span>
#include <vector>

#include "corner_grid.hpp"
#include "imic3d/core/parallel.hpp"
#include "imic3d/material/finite_strain_law.hpp"
#include "imic3d/mechanics/equilibrium.hpp"
#include "imic3d/mesh/mesh.hpp"
#include "imic3d/mesh/partition.hpp"
#include "imic3d/mesh/petsc.hpp"

namespace imic3d::mechanics {

/// MUMPS LDL^T as long as it pays and there is memory for it (solver_choice.hpp), else GMRES: quadratic elements with
/// two grids (corner_grid.hpp), others with GAMG and the rigid-body near-null space; everything open to options. A law
/// without associated flow has an unsymmetric tangent: LU then, which does not tell the tangent's inertia. A frame that
/// is simulated repeatedly has a factor of its own, as far as memory allows. Collective.
class KeptFactors {
 public:
  /// Whether a solver holds the factor of some tangent, and one with negative pivots.
  struct State {
    bool made = false, indefinite = false;
  };

  /// `tangent`: where it is assembled, each time before a new factor is asked for. `work` counts factorisations and
  /// solutions. `constrained`: natural degrees of freedom, ascending.
  KeptFactors(Mat tangent, const mesh::Partition& partition, const mesh::Mesh& mesh,
              const std::vector<int>& constrained, const material::FiniteStrainLaw& law,
              const EquilibriumOptions& options, Work& work);

  /// Whether a factor may serve for other tangents than its own.
  [[nodiscard]] bool may_be_kept() const { return options_.keep_factors && direct_; }
  /// Whether there was a tangent yet.
  [[nodiscard]] bool any_made() const { return factors_.front().state.made; }
  [[nodiscard]] const State& at_hand() const { return factors_[at_hand_].state; }

  /// What a factorisation with its tangent costs, in corrections with the factor at hand and their passes over the
  /// elements: measured on plates of 3,474 to 39,342 unknowns (hex20), 7 to 23.
  [[nodiscard]] double corrections_of_a_factor() const {
    return 7.0 * std::sqrt(std::max(1.0, static_cast<double>(unknowns_) / 3500.0));
  }

  /// Takes up the factor of a frame that is simulated `repeatedly`, if there is room for one.
  void take(int of_frame, bool repeatedly);
  /// `kept`: with the factor at hand; else with that of the tangent, which is then the one at hand. An iterative solver
  /// leaves `remaining` of the right-hand side, and has its preconditioner made anew where that of an earlier tangent
  /// has become slow. False if the solver failed.
  [[nodiscard]] bool solve(Vec right, Vec solution, bool kept, double remaining);

  /// Solutions for derivatives, from one of these to the other: with the factor at hand as it is (`substitute`), or on
  /// the tangent with that factor as preconditioner (`refine`), until `remaining` of the right-hand side is left.
  void begin_derivatives();
  [[nodiscard]] bool renew();  ///< the factor at hand is that of the tangent; false if there is none
  /// all at once: the factor is read once
  void substitute(std::span<const Vec> right, std::span<const Vec> solution);
  void refine(Vec right, Vec solution, double remaining);
  void end_derivatives();

 private:
  using Solver = PetscOwner<KSP, KSPDestroy>;
  struct Factor {
    Solver solver;
    State state;
  };

  [[nodiscard]] Factor make_solver();
  [[nodiscard]] bool iterate(Vec right, Vec solution, double remaining);
  void make_refiner();
  void tell_choice(double available) const;
  void tell_mumps(PC preconditioner) const;
  [[nodiscard]] Mat mumps_factor() const;
  [[nodiscard]] PetscInt negative_pivots() const;
  void count();

  Mat tangent_;
  PetscInt unknowns_ = 0;
  bool symmetric_, one_point_;
  Communicator communicator_;
  const EquilibriumOptions& options_;
  Work& work_;
  bool direct_by_default_ = true, direct_ = true, corners_directly_ = true;
  std::unique_ptr<CornerGrid> corners_;  // of an iterative solver in a quadratic mesh
  // that an e-fold reduction took the last time, and the first time with the preconditioner at hand
  double iterations_ = 0.0, of_a_new_one_ = 0.0;
  // the first for frames that nothing is known of, the others each for a frame that is simulated repeatedly
  std::vector<Factor> factors_;
  std::size_t at_hand_ = 0, most_ = 1;
  Solver refiner_;
  // what an iterative solver, and the refiner, leave at least of a right-hand side
  double least_remaining_ = 1e-8, least_refined_ = 1e-10;
};

}  // namespace imic3d::mechanics
