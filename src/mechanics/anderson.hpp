#pragma once
// Anderson's acceleration of corrections with a kept factor (Walker & Ni 2011): a few modes in which the factor is not
// that of the tangent, points that began to yield or to unload since, shrink slowly and all in the same way;
// differences of past corrections tell them. On a linear problem it is GMRES.

#include <petscvec.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cstddef>
#include <utility>
#include <vector>

#include "imic3d/core/linear.hpp"
#include "imic3d/mesh/petsc.hpp"

namespace imic3d::mechanics {

class Anderson {
 public:
  explicit Anderson(std::size_t depth = 5) : depth_(depth) {}
  ~Anderson() {
    for (auto* vectors : {&steps_, &changes_})
      for (Vec& vector : *vectors) VecDestroy(&vector);
    VecDestroy(&last_);
    VecDestroy(&raw_);
  }
  Anderson(const Anderson&) = delete;
  Anderson& operator=(const Anderson&) = delete;

  /// Forgets what was before.
  void restart() { known_ = made_ = 0; }

  /// correction <- the accelerated one. What was returned before has been added to the iterate since. Collective.
  void accelerate(Vec correction) {
    if (last_ == nullptr) {
      IMIC3D_PETSC(VecDuplicate(correction, &last_));
      IMIC3D_PETSC(VecDuplicate(correction, &raw_));
    }
    IMIC3D_PETSC(VecCopy(correction, raw_));
    if (made_ > 0) {  // the newest difference: steps_[slot] was set when the step was returned
      const std::size_t slot = (made_ - 1) % depth_;
      IMIC3D_PETSC(VecWAXPY(changes_[slot], -1.0, last_, correction));
      known_ = std::min(known_ + 1, depth_);
      const auto n = static_cast<Eigen::Index>(known_);
      Eigen::VectorXd right(n), sizes(n);
      Eigen::MatrixXd gram(n, n);
      for (Eigen::Index j = 0; j < n; ++j) {
        const auto k = static_cast<std::size_t>(j);
        IMIC3D_PETSC(VecMDot(changes_[k], static_cast<PetscInt>(n), changes_.data(), gram.col(j).data()));
        IMIC3D_PETSC(VecDot(changes_[k], correction, &right[j]));
      }
      sizes = gram.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
      gram = sizes.asDiagonal() * gram * sizes.asDiagonal();
      const Eigen::VectorXd weights = sizes.asDiagonal() * least_squares(gram, sizes.asDiagonal() * right, 1e-10);
      for (Eigen::Index j = 0; j < n; ++j) {
        IMIC3D_PETSC(VecAXPY(correction, -weights[j], steps_[static_cast<std::size_t>(j)]));
        IMIC3D_PETSC(VecAXPY(correction, -weights[j], changes_[static_cast<std::size_t>(j)]));
      }
    }
    const std::size_t slot = made_ % depth_;
    if (slot >= steps_.size()) {
      steps_.push_back(nullptr), changes_.push_back(nullptr);
      IMIC3D_PETSC(VecDuplicate(correction, &steps_.back()));
      IMIC3D_PETSC(VecDuplicate(correction, &changes_.back()));
    }
    std::swap(last_, raw_);
    IMIC3D_PETSC(VecCopy(correction, steps_[slot]));
    ++made_;
  }

 private:
  std::size_t depth_, known_ = 0, made_ = 0;  // differences that are complete, steps that were returned
  std::vector<Vec> steps_, changes_;          // of the iterate, and of the plain correction thereby
  Vec last_ = nullptr, raw_ = nullptr;
};

}  // namespace imic3d::mechanics
