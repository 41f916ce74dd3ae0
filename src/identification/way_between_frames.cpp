#include "imic3d/identification/way_between_frames.hpp"

#include <algorithm>
#include <cmath>

namespace imic3d::identification {

namespace {

/// Slope between two secants over lengths, of a monotone curve; symmetric.
double inner_slope(double before, double after, double length_before, double length_after) {
  if (before * after <= 0.0) return 0.0;
  const double a = length_before + 2.0 * length_after, b = 2.0 * length_before + length_after;
  return (a + b) / (a / before + b / after);
}

/// Slope at an end, of a parabola as long as that is monotone.
double outer_slope(double secant, double next, double length, double next_length) {
  const double slope = ((2.0 * length + next_length) * secant - length * next) / (length + next_length);
  if (slope * secant <= 0.0) return 0.0;
  return secant * next <= 0.0 && std::abs(slope) > 3.0 * std::abs(secant) ? 3.0 * secant : slope;
}

}  // namespace

std::array<Eigen::MatrixXd, 2> bends(const Eigen::MatrixXd& displacement) {
  const Eigen::Index frames = displacement.cols();
  std::array<Eigen::MatrixXd, 2> result{Eigen::MatrixXd::Zero(displacement.rows(), frames), Eigen::MatrixXd::Zero(displacement.rows(), frames)};
  if (frames < 2) return result;
  Eigen::MatrixXd way = displacement;
  way.rightCols(frames - 1) -= displacement.leftCols(frames - 1);
  const Eigen::VectorXd length = way.colwise().norm().transpose().cwiseMax(std::max(1e-300, 1e-12 * displacement.lpNorm<Eigen::Infinity>()));
  const Eigen::MatrixXd secant = way * length.cwiseInverse().asDiagonal();
  const auto goes_on = [&](Eigen::Index a, Eigen::Index b) { return std::min(a, b) >= 0 && std::max(a, b) < frames && way.col(a).dot(way.col(b)) > 0.0; };
  for (Eigen::Index t = 0; t < frames; ++t)
    for (const Eigen::Index side : {0, 1}) {
      const Eigen::Index next = t - 1 + 2 * side, other = t + 1 - 2 * side;  // across this end of the way, and across the other one
      for (Eigen::Index i = 0; i < displacement.rows(); ++i) {
        double slope = secant(i, t);
        if (goes_on(t, next))
          slope = inner_slope(secant(i, t), secant(i, next), length[t], length[next]);
        else if (goes_on(t, other))
          slope = outer_slope(secant(i, t), secant(i, other), length[t], length[other]);
        result[static_cast<std::size_t>(side)](i, t) = (slope - secant(i, t)) * length[t];
      }
    }
  return result;
}

}  // namespace imic3d::identification
