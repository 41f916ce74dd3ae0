#include "remainder.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "imic3d/core/linear.hpp"
#include "imic3d/loop/statistics.hpp"

namespace imic3d::loop {

namespace {

/// Displacements on the surface [unknowns x frames] of numbers in units of the noise; empty where there is no surface.
Eigen::MatrixXd displacements_of(const Experiment& experiment, const Eigen::VectorXd& numbers, Eigen::Index frames) {
  const Eigen::Index per_frame = numbers.size() / frames;
  Eigen::MatrixXd all;
  for (Eigen::Index t = 0; t < frames; ++t) {
    const Eigen::VectorXd u = experiment.displacement_of(numbers.segment(t * per_frame, per_frame));
    if (u.size() == 0) return {};
    if (t == 0) all.resize(u.size(), frames);
    all.col(t) = u;
  }
  return all;
}

Eigen::MatrixXd lengths_of(const Experiment& experiment, const Eigen::MatrixXd& displacements) {
  Eigen::MatrixXd all;
  for (Eigen::Index t = 0; t < displacements.cols(); ++t) {
    const Eigen::VectorXd of_nodes = experiment.lengths_of(displacements.col(t));
    if (t == 0) all.resize(of_nodes.size(), displacements.cols());
    all.col(t) = of_nodes;
  }
  return all;
}

/// A residual on the surface in units of what noise leaves there.
struct OverNull {
  Eigen::MatrixXd numbers;  // of the displacement, each over its rms under the null [unknowns x frames]
  Eigen::MatrixXd lengths;  // of the nodes' displacements [nodes x frames]
  double limit = 0.0;       // what the largest of the latter exceeds in one null test of a hundred
};

OverNull over_null(const Experiment& experiment, const Leftover& left, Eigen::Index frames) {
  const Eigen::MatrixXd U = displacements_of(experiment, left.residual, frames);
  if (U.size() == 0) return {};
  OverNull result{U, lengths_of(experiment, U)};
  Eigen::MatrixXd of_numbers = Eigen::MatrixXd::Zero(U.rows(), frames),
                  of_lengths = Eigen::MatrixXd::Zero(result.lengths.rows(), frames);
  std::vector<Eigen::MatrixXd> lengths;
  const double draws = static_cast<double>(left.null.cols());
  for (const auto& draw : left.null.colwise()) {
    const Eigen::MatrixXd of_draw = displacements_of(experiment, draw, frames);
    lengths.push_back(lengths_of(experiment, of_draw));
    of_numbers += of_draw.cwiseAbs2() / draws, of_lengths += lengths.back().cwiseAbs2() / draws;
  }
  const auto rms = [](const Eigen::MatrixXd& squares) -> Eigen::MatrixXd {
    return squares.cwiseSqrt().cwiseMax(1e-300);
  };
  const Eigen::MatrixXd of_nodes = rms(of_lengths);
  Eigen::VectorXd largest(left.null.cols());
  for (Eigen::Index b = 0; b < left.null.cols(); ++b)
    largest[b] = lengths[static_cast<std::size_t>(b)].cwiseQuotient(of_nodes).maxCoeff();
  result.numbers = U.cwiseQuotient(rms(of_numbers));
  result.lengths = result.lengths.cwiseQuotient(of_nodes);
  result.limit = quantile(largest, 0.99);
  return result;
}

/// The rms of the force residual under the null [frames]; empty where a frame has not one.
Eigen::VectorXd rms_of_force(const Experiment& experiment, const Eigen::MatrixXd& null, Eigen::Index frames) {
  std::vector<Eigen::Index> rows;
  for (std::size_t i = 0; i < experiment.data().size(); ++i)
    if (experiment.data()[i].channel == force_channel) rows.push_back(static_cast<Eigen::Index>(i));
  if (static_cast<Eigen::Index>(rows.size()) != frames) return {};
  return null(rows, Eigen::all).rowwise().norm() / std::sqrt(static_cast<double>(null.cols()));
}

}  // namespace

Leftover leftover_of(const Model& model, const Eigen::MatrixXd& left_of_null) {
  return {model.fit.residual, model.ground->weight.undone(model.fit.residual),
          model.ground->weight.undone(left_of_null)};
}

Remainder remainder_of(const Experiment& experiment, const Leftover& before, const Leftover& after) {
  Remainder remainder;
  const auto frames = static_cast<Eigen::Index>(experiment.frame_numbers().size()),
             per_frame = after.whitened.size() / frames;
  if (per_frame * frames != after.whitened.size()) return remainder;
  const Eigen::MatrixXd R = after.whitened.reshaped(per_frame, frames);
  // The first singular value times its right vector, of the smaller square matrix.
  if (frames <= per_frame) {
    const SymmetricEigen modes = symmetric_eigen(R.transpose() * R);
    remainder.time = std::sqrt(std::max(0.0, modes.values[frames - 1])) * modes.vectors.col(frames - 1);
  } else {
    remainder.time = R.transpose() * symmetric_eigen(R * R.transpose()).vectors.col(per_frame - 1);
  }
  remainder.share = remainder.time.squaredNorm() / std::max(1e-300, R.squaredNorm());

  // The residual on the surface against that of the null draws, whose parameters are fitted too.
  OverNull left = over_null(experiment, after, frames);
  if (left.lengths.size() == 0) return remainder;
  remainder.before = &before == &after ? left.numbers : over_null(experiment, before, frames).numbers;
  remainder.after = std::move(left.numbers), remainder.map = std::move(left.lengths), remainder.limit = left.limit;
  remainder.force = rms_of_force(experiment, after.null, frames);
  // The first mode again of the frames' residuals, as a displacement.
  remainder.mode = experiment.displacement_of(after.residual.reshaped(per_frame, frames) *
                                              (remainder.time / remainder.time.squaredNorm()));
  return remainder;
}

}  // namespace imic3d::loop
