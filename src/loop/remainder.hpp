#pragma once
// What a model leaves: where and when.

#include "imic3d/loop/closing.hpp"

namespace imic3d::loop {

/// What a model leaves, and what noise alone leaves in it.
struct Leftover {
  Eigen::VectorXd whitened;  ///< [N]
  Eigen::VectorXd residual;  ///< the same before it was weighed, in units of the noise [N]
  Eigen::MatrixXd null;      ///< draws like `residual` [N x draws]

  /// The rows of one test of several.
  [[nodiscard]] Leftover of(Eigen::Index first, Eigen::Index rows) const {
    return {whitened.segment(first, rows), residual.segment(first, rows), null.middleRows(first, rows)};
  }
};

/// `left_of_null` [N x draws]: what noise alone leaves in this model, weighed as its residual is.
[[nodiscard]] Leftover leftover_of(const Model& model, const Eigen::MatrixXd& left_of_null);

/// Of the declared and of the final model. Without a map where there is no surface, empty where frames differ in size.
[[nodiscard]] Remainder remainder_of(const Experiment& experiment, const Leftover& before, const Leftover& after);

}  // namespace imic3d::loop
