#pragma once
// How a run goes from frame to frame.

#include <petscvec.h>

#include <Eigen/Core>
#include <vector>

#include "force_balance.hpp"
#include "kept_factors.hpp"
#include "newton.hpp"
#include "path_derivatives.hpp"

namespace imic3d::mechanics {

/// A run over a series of frames, from the state that the balance was started with. Collective.
class LoadPath {
 public:
  LoadPath(ForceBalance& balance, KeptFactors& factors, Newton& newton, PathDerivatives& derivatives,
           const EquilibriumOptions& options, const Accuracy& accuracy, double start_time);

  /// Goes on to the next frame, in as many increments as are asked for or, where these fail, begun anew with twice as
  /// many. `near` (null: none): a displacement [3 * nodes] from which, or on the way to which, they begin. `status`
  /// says what it took, and in its message why the frame was not reached, if so. The corrections of the displacement.
  /// Throws ConvergenceError where no derivative is found.
  int go_to(const LoadStep& step, const Eigen::VectorXd* near, int increments, PathStatus& status);

 private:
  /// What the last increment reached, and by which change.
  struct Place {
    OwnedVec displacement, change;
    // of the increment that made `change`: what moved the prescribed displacement and the forces; empty: none yet
    Eigen::VectorXd load;
    void copy(const Place& other);
  };

  [[nodiscard]] Eigen::VectorXd natural(const Eigen::VectorXd* of_constrained) const;
  [[nodiscard]] Eigen::VectorXd force_of(const LoadStep* step) const;
  void place(Start start, int ahead, double times);
  [[nodiscard]] Outcome solve(Start start, int& iterations);
  void differentiate(const LoadStep& step, double target, PathStatus& status);
  void commit(const Eigen::VectorXd& load);

  ForceBalance& balance_;
  KeptFactors& factors_;
  Newton& newton_;
  PathDerivatives& derivatives_;
  const EquilibriumOptions& options_;
  Accuracy accuracy_;
  double start_time_;
  int frame_ = 0;                       // the next one
  const LoadStep* previous_ = nullptr;  // the last one that was reached
  Place now_, before_;                  // `before`: at the end of that
  OwnedVec offered_, found_;
};

}  // namespace imic3d::mechanics
