#include "imic3d/core/bounded_step.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <vector>

#include "imic3d/core/linear.hpp"

namespace imic3d {

Eigen::VectorXd bounded_step(const Eigen::MatrixXd& H, const Eigen::VectorXd& g, const Eigen::VectorXd& low,
                             const Eigen::VectorXd& high, double damping) {
  Eigen::VectorXd step = Eigen::VectorXd::Zero(g.size());
  std::vector<Eigen::Index> open;
  for (Eigen::Index j = 0; j < g.size(); ++j)
    if (H(j, j) > 0.0) open.push_back(j);
  while (!open.empty()) {
    const Eigen::VectorXd scale = H.diagonal()(open).cwiseSqrt().cwiseInverse();
    Eigen::MatrixXd matrix = scale.asDiagonal() * H(open, open) * scale.asDiagonal();
    matrix.diagonal().array() += damping;
    const Eigen::VectorXd right = (g - H * step)(open);
    const Eigen::VectorXd wanted = scale.cwiseProduct(solve_symmetric(matrix, scale.cwiseProduct(right)).col(0));
    std::ptrdiff_t worst = -1;
    double excess = 1.0;
    for (std::size_t i = 0; i < open.size(); ++i) {
      const double value = wanted[static_cast<Eigen::Index>(i)];
      const double ratio =
          value > 0.0 ? value / std::max(high[open[i]], 1e-300) : value / std::min(low[open[i]], -1e-300);
      if (ratio > excess) excess = ratio, worst = static_cast<std::ptrdiff_t>(i);
    }
    if (worst < 0) {
      step(open) = wanted;
      break;
    }
    const Eigen::Index j = open[static_cast<std::size_t>(worst)];
    step[j] = wanted[worst] > 0.0 ? high[j] : low[j];
    open.erase(open.begin() + worst);
  }
  return step;
}

}  // namespace imic3d
