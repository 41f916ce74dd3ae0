#include "remainder.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "imic3d/loop/statistics.hpp"

namespace imic3d::loop {

Remainder remainder_of(const Experiment& experiment, const Model& model, const Eigen::MatrixXd& left_of_null) {
  Remainder remainder;
  const Eigen::VectorXd& r = model.fit.residual;
  const auto frames = static_cast<Eigen::Index>(experiment.frame_numbers().size()), per_frame = r.size() / frames;
  if (per_frame * frames != r.size()) return remainder;
  const Eigen::MatrixXd R = r.reshaped(per_frame, frames);
  const Eigen::BDCSVD<Eigen::MatrixXd> svd(R, Eigen::ComputeThinU | Eigen::ComputeThinV);
  remainder.time = svd.singularValues()[0] * svd.matrixV().col(0);
  remainder.share = std::pow(svd.singularValues()[0], 2) / std::max(1e-300, R.squaredNorm());

  // The residual on the surface against that of the null draws, whose parameters are fitted too.
  const auto lengths = [&](const Eigen::VectorXd& rows, Eigen::MatrixXd& all) {
    for (Eigen::Index t = 0; t < frames; ++t) {
      const Eigen::VectorXd u = experiment.displacement_of(rows.segment(t * per_frame, per_frame));
      if (u.size() == 0) return false;
      const Eigen::VectorXd of_nodes = experiment.lengths_of(u);
      if (all.size() == 0) all.resize(of_nodes.size(), frames);
      all.col(t) = of_nodes;
    }
    return true;
  };
  const Eigen::VectorXd plain = model.ground->weight.undone(r);
  if (!lengths(plain, remainder.map)) return remainder;
  const Eigen::MatrixXd left = model.ground->weight.undone(left_of_null);
  Eigen::MatrixXd squares = Eigen::MatrixXd::Zero(remainder.map.rows(), frames);
  std::vector<Eigen::MatrixXd> draws(static_cast<std::size_t>(left.cols()));
  for (Eigen::Index b = 0; b < left.cols(); ++b) {
    lengths(left.col(b), draws[static_cast<std::size_t>(b)]);
    squares += draws[static_cast<std::size_t>(b)].cwiseAbs2() / static_cast<double>(left.cols());
  }
  const Eigen::MatrixXd rms = squares.cwiseSqrt().cwiseMax(1e-300);
  Eigen::VectorXd largest(left.cols());
  for (Eigen::Index b = 0; b < left.cols(); ++b) largest[b] = draws[static_cast<std::size_t>(b)].cwiseQuotient(rms).maxCoeff();
  remainder.map = remainder.map.cwiseQuotient(rms);
  remainder.limit = quantile(largest, 0.99);
  // The first mode again of the frames' residuals, as a displacement.
  remainder.mode = experiment.displacement_of(plain.reshaped(per_frame, frames) * (remainder.time / remainder.time.squaredNorm()));
  return remainder;
}

}  // namespace imic3d::loop
