#include "newton.hpp"

#include <algorithm>
#include <cmath>

namespace imic3d::mechanics {

Newton::Newton(ForceBalance& balance, KeptFactors& factors, const EquilibriumOptions& options)
    : balance_(balance), factors_(factors), options_(options) {
  IMIC3D_PETSC(VecDuplicate(balance_.displacement(), correction_.put()));
}

/// Round-off of the deformation gradient, times the stiffness: forces below it are none, as at rest and after
/// unloading.
double Newton::round_off_of_forces() {
  double stiffness = 0.0;
  IMIC3D_PETSC(MatGetDiagonal(balance_.assembler().tangent(), correction_));
  IMIC3D_PETSC(VecNorm(correction_, NORM_2, &stiffness));
  IMIC3D_PETSC(VecZeroEntries(correction_));
  const mesh::Mesh& mesh = balance_.mesh();
  double edge = 0.0;
  for (Eigen::Index cell = 0; cell < mesh.cells.rows(); ++cell)
    edge += (mesh.nodes.row(mesh.cells(cell, 0)) - mesh.nodes.row(mesh.cells(cell, 1))).norm();
  return 3e-16 * stiffness * edge / static_cast<double>(mesh.cells.rows());
}

/// correction <- what Newton's method adds to u, with the tangent that was assembled last; `kept`: with the factor of
/// an earlier one, where nothing prescribed is missing. False if the solver failed. `remaining`: of the right-hand
/// side, by an iterative solver.
bool Newton::correct(bool kept, double remaining) {
  if (!kept) balance_.linearise();
  return factors_.solve(balance_.residual(), correction_, kept, remaining);
}

Outcome Newton::solve(Start start, const Accuracy& accuracy, double derivatives, int& iterations) {
  const OpticalTerm* optical = balance_.optical();
  const bool begins = start == Start::standing, near = start == Start::offered;
  residuals_.clear();
  acceleration_.restart();
  const bool may_keep = factors_.may_be_kept() && optical == nullptr;
  const KeptFactors::State& factor = factors_.at_hand();
  Outcome failed = Outcome::diverged;
  IMIC3D_PETSC(VecZeroEntries(correction_));
  const int most = optical != nullptr ? 3 * options_.max_iterations : options_.max_iterations;
  if (!begins) balance_.settle_prescribed();
  // assembled at u; the last correction was made with an earlier one
  bool tangent = !(near && may_keep && factors_.any_made()), kept = true;
  balance_.assembler().predict(begins);
  double norm = balance_.evaluate(tangent), previous = 0.0, rate = 0.0;
  if (!std::isfinite(norm)) return failed;
  for (int iteration = 0, renewed = 0; renewed <= most; ++iteration) {
    double missing = 0.0, size = 0.0, load = 0.0;
    if (least_norm_ == 0.0) least_norm_ = round_off_of_forces();
    IMIC3D_PETSC(VecNorm(balance_.missing(), NORM_INFINITY, &missing));
    IMIC3D_PETSC(VecNorm(balance_.internal(), NORM_2, &size));
    IMIC3D_PETSC(VecNorm(balance_.external(), NORM_2, &load));
    double scale = std::max({size, load, 1e-30});
    if (optical != nullptr)
      scale = std::max(scale, (optical->stiffness * balance_.numbering().to_natural(balance_.displacement())).norm());
    residuals_.push_back(norm / scale);
    // Below the tolerance, or at the level of round-off where it no longer falls.
    const bool ends_early = accuracy.forces >= options_.tolerance && optical == nullptr;
    const double tolerance = accuracy.forces > 0.0 && optical == nullptr ? accuracy.forces : options_.tolerance;
    const double enough = std::max(tolerance * scale, least_norm_);
    // The last correction of Newton's method ends far below the tolerance: those of a kept factor go on as long as they
    // help.
    const double target = may_keep && kept && !ends_early ? (iteration > 0 ? 1e-4 : 1e-2) * tolerance * scale : enough;
    const bool pays = may_keep && factor.made && missing == 0.0 &&
                      (iteration == 0 ? near
                                      : rate < 1.0 && std::log(derivatives * target / norm) >
                                                          factors_.corrections_of_a_factor() * std::log(rate));
    if (missing == 0.0 && (iteration > 0 || near)) {
      const bool stalled =
          !kept && iteration > (optical != nullptr ? 5 : 2) && norm > 0.5 * previous && norm < 1e-8 * scale;
      // A rigid motion costs hardly any force where the images pull weakly: it is the displacement that must have
      // settled.
      double moved = 0.0, whole = 0.0;
      IMIC3D_PETSC(VecNorm(correction_, NORM_2, &moved));
      IMIC3D_PETSC(VecNorm(balance_.displacement(), NORM_2, &whole));
      const bool settled = optical == nullptr || (iteration > 0 && moved <= 1e-5 * whole);
      const bool helps = kept && pays && rate < 0.5 && norm > target;
      if ((norm <= enough && settled && !helps) || stalled)
        return factor.indefinite && load > 0.0 ? Outcome::limit_point : Outcome::converged;
    }
    if (renewed == most) break;

    if (!pays && !tangent) {
      tangent = true;
      norm = balance_.evaluate(tangent);
    }
    kept = pays;
    // Of what is unbalanced a solution by iteration may leave a part that the correction after it takes along
    // (Eisenstat and Walker, SIAM J. Sci. Comput. 17, 1996).
    const double remaining =
        0.03 * std::clamp(norm > 0.0 ? std::max(iteration > 0 ? norm / previous : 1.0, enough / norm) : 1.0, 0.0, 1.0);
    if (!correct(kept, remaining)) return failed;
    if (kept)
      acceleration_.accelerate(correction_);
    else
      acceleration_.restart();
    const double slope = missing == 0.0 && optical == nullptr ? balance_.work_along(correction_) : 0.0;
    // Under prescribed forces a tangent that is not positive definite means a limit point.
    if (factor.indefinite && load > 0.0) failed = Outcome::limit_point;
    ++iterations;
    if (!kept) ++renewed;
    IMIC3D_PETSC(VecAXPY(balance_.displacement(), 1.0, correction_));
    balance_.impose();

    previous = norm;
    const double relative = norm / scale;
    tangent = !may_keep || (!kept && relative > 1e-2);
    balance_.assembler().predict(begins && iteration < 1);
    const auto step = search(previous, enough, slope, iteration < 1, kept, tangent);
    if (!step) return failed;
    norm = step->norm;
    if (step->length != 1.0) acceleration_.restart();
    rate = step->length == 1.0 ? norm / previous : 1.0;
  }
  return failed;
}

/// Shortens a correction that was just added to u, as the class says, or takes all of it back where the factor that
/// made it is of no use here. `slope`: work of the unbalanced forces along it before; `first`: they may grow
/// thousandfold. `tangent`: whether it is assembled at u, and is to be. Empty where no part of the correction will do.
std::optional<Newton::Step> Newton::search(double previous, double enough, double slope, bool first, bool kept,
                                           bool& tangent) {
  double step = 1.0;
  for (int halvings = 0;; ++halvings) {
    double norm = balance_.evaluate(tangent);
    if (kept && !(norm < previous)) {  // the factor is of no use here
      IMIC3D_PETSC(VecAXPY(balance_.displacement(), -step, correction_));
      tangent = previous > enough;
      norm = balance_.evaluate(tangent);
      return Step{0.0, norm};
    }
    double shorter = 0.5 * step;
    if (std::isfinite(norm) && (first || norm < 1e3 * previous)) {
      if (norm <= 0.05 * previous || slope <= 0.0 || halvings == 4) return Step{step, norm};
      const double done = balance_.work_along(correction_);
      if (done >= -0.8 * slope) return Step{step, norm};
      shorter = std::max(0.1, slope / (slope - done)) * step;
    } else if (halvings == 4) {
      return std::nullopt;
    }
    IMIC3D_PETSC(VecAXPY(balance_.displacement(), shorter - step, correction_));
    step = shorter;
  }
}

}  // namespace imic3d::mechanics
