#pragma once
// The step of a Gauss-Newton iteration within a box.

#include <Eigen/Core>

namespace imic3d {

/// Solves (H + damping diag H) x = g [n] for the components that are within `low` <= x <= `high`; those that would
/// leave them stand on their bound, the furthest first, and the others are solved again. low <= 0 <= high. Components
/// without curvature stay at 0.
[[nodiscard]] Eigen::VectorXd bounded_step(const Eigen::MatrixXd& H, const Eigen::VectorXd& g,
                                           const Eigen::VectorXd& low, const Eigen::VectorXd& high,
                                           double damping = 0.0);

}  // namespace imic3d
