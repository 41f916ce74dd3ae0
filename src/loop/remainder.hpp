#pragma once
// What the final model leaves: where and when.

#include "imic3d/loop/closing.hpp"

namespace imic3d::loop {

/// `left_of_null` [N x draws]: what noise alone leaves in this model, weighed as its residual is. Without a map where there is no surface, empty where frames differ in size.
[[nodiscard]] Remainder remainder_of(const Experiment& experiment, const Model& model, const Eigen::MatrixXd& left_of_null);

}  // namespace imic3d::loop
