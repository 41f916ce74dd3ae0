#pragma once
// Newton's method for one increment.

#include <optional>
#include <vector>

#include "anderson.hpp"
#include "force_balance.hpp"
#include "kept_factors.hpp"

namespace imic3d::mechanics {

/// Where u is at the beginning of an increment: at a displacement that is offered, going on like the last increment,
/// where that ended.
enum class Start { offered, continued, standing };

enum class Outcome { converged, diverged, limit_point };

/// From u to equilibrium with what the balance was told to apply. With a consistent tangent the unbalanced
/// forces of a plastic step may well grow before they vanish, and a search that forbids it crawls. A step is shortened
/// where an element would be inverted, where the forces grow a thousandfold, or where the work that they do along it
/// has turned against it: they are the slope of the incremental energy (Crisfield 1982).
///
/// A factor serves as long as its corrections, accelerated, shrink the forces fast enough (modified Newton): it costs
/// as much as some `corrections_of_a_factor` corrections. They contract only where the tangent is as definite as the
/// factor's. From a displacement that is offered the factor at hand is tried before another is made.
class Newton {
 public:
  Newton(ForceBalance& balance, KeptFactors& factors, const EquilibriumOptions& options);

  /// `iterations` grows by the corrections of the displacement. `derivatives`: how far the factor is to reduce what is
  /// unbalanced of derivatives afterwards, too; 1: none follow. Collective.
  [[nodiscard]] Outcome solve(Start start, const Accuracy& accuracy, double derivatives, int& iterations);
  /// Relative ones of the iterations of the last increment.
  [[nodiscard]] const std::vector<double>& residuals() const { return residuals_; }

 private:
  /// What has become of a correction: the part of it that u keeps, and the norm of the unbalanced forces there.
  struct Step {
    double length, norm;
  };

  [[nodiscard]] double round_off_of_forces();
  [[nodiscard]] bool correct(bool kept, double remaining);
  [[nodiscard]] std::optional<Step> search(double previous, double enough, double slope, bool first, bool kept,
                                           bool& tangent);

  ForceBalance& balance_;
  KeptFactors& factors_;
  const EquilibriumOptions& options_;
  OwnedVec correction_;
  Anderson acceleration_;
  double least_norm_ = 0.0;  // round-off of the forces; 0: not known yet
  std::vector<double> residuals_;
};

}  // namespace imic3d::mechanics
