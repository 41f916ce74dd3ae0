#include "imic3d/loop/explain.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "imic3d/core/linear.hpp"
#include "imic3d/loop/statistics.hpp"

namespace imic3d::loop {

Explanation explain(const Eigen::VectorXd& difference, const Eigen::MatrixXd& covariance,
                    const std::vector<EffectSize>& sizes, const Bias& bias, int most) {
  const auto p = difference.size();
  const auto k = static_cast<Eigen::Index>(sizes.size());
  const Eigen::MatrixXd whitened_by = inverse_cholesky(covariance);
  const auto white = [&](const Eigen::MatrixXd& x) -> Eigen::MatrixXd { return whitened_by * x; };
  Explanation result;
  result.size = Eigen::VectorXd::Zero(k);
  result.tangent = Eigen::MatrixXd::Zero(p, k);
  result.explained = Eigen::VectorXd::Zero(p);
  result.degrees = static_cast<int>(p - k);
  if (result.degrees <= 0) {
    result.message = "as many sizes as parameters: it would fit anything";
    return result;
  }
  const auto judge = [&](const Eigen::VectorXd& shift) { return white(difference - shift).squaredNorm(); };
  const auto asked = [&](const Eigen::VectorXd& size) {
    ++result.identifications;
    return bias(size);
  };

  // Sizes in units of the steps.
  Eigen::VectorXd unit(k), low(k), high(k);
  for (Eigen::Index j = 0; j < k; ++j) {
    const auto& one = sizes[static_cast<std::size_t>(j)];
    unit[j] = one.step;
    low[j] = (one.lower - one.null) / one.step, high[j] = (one.upper - one.null) / one.step;
    Eigen::VectorXd size = Eigen::VectorXd::Zero(k);
    size[j] = one.step;
    const auto shift = asked(size);
    if (!shift) {
      result.message = "the test with a small effect could not be identified";
      result.failed = true;
      result.chi_squared = judge(result.explained);
      return result;
    }
    result.tangent.col(j) = *shift / one.step;
  }
  Eigen::MatrixXd slope = result.tangent * unit.asDiagonal();
  Eigen::VectorXd at = Eigen::VectorXd::Zero(k), shift = result.explained;
  result.chi_squared = judge(shift);
  for (int step = 0; step < most; ++step) {
    // A size on its bound that would leave it stays.
    Eigen::MatrixXd open = slope;
    Eigen::VectorXd move;
    for (bool again = true; again;) {
      again = false;
      move = least_squares(white(open), white(difference - shift));
      for (Eigen::Index j = 0; j < k; ++j) {
        if (!((at[j] >= high[j] && move[j] > 0.0) || (at[j] <= low[j] && move[j] < 0.0))) continue;
        open.col(j).setZero();
        again = true;
      }
    }
    // Once the sizes were followed, an effect that its tangent there refuses by far is left.
    if (step > 0 && chi_squared_tail(judge(shift + slope * move), result.degrees) < 1e-6) break;
    std::optional<Eigen::VectorXd> next;
    Eigen::VectorXd moved = 2.0 * ((at + move).cwiseMax(low).cwiseMin(high) - at);
    for (int halving = 0; halving < 3; ++halving) {
      moved *= 0.5;
      next = asked(unit.cwiseProduct(at + moved));
      if (!next) result.message = "followed as far as the model goes";
      if (next && judge(*next) < judge(shift)) break;
    }
    if (!next) break;
    const double length = moved.squaredNorm();
    if (length > 0.0) slope += (*next - shift - slope * moved) * moved.transpose() / length;
    if (judge(*next) >= judge(shift)) break;
    at += moved, shift = *next;
    result.chi_squared = judge(shift);
    result.explained = shift;
    result.size = unit.cwiseProduct(at);
    result.on_bound = ((at - low).array() < 1e-9).any() || ((high - at).array() < 1e-9).any();
    if (length <= std::pow(0.02, 2) * at.squaredNorm()) break;
  }
  result.p = chi_squared_tail(result.chi_squared, result.degrees);
  result.fits = result.p >= 0.01;
  return result;
}

}  // namespace imic3d::loop
