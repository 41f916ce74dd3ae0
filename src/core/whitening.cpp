#include "imic3d/core/whitening.hpp"

#include <algorithm>
#include <numeric>

#include "imic3d/core/linear.hpp"

namespace imic3d {

using Eigen::Index;
using Eigen::MatrixXd;

namespace {

std::vector<Index> all_but(Index count, const std::vector<Index>& last) {
  std::vector<Index> all(static_cast<std::size_t>(count)), rest;
  std::iota(all.begin(), all.end(), 0);
  std::set_difference(all.begin(), all.end(), last.begin(), last.end(), std::back_inserter(rest));
  return rest;
}

/// S L with L L^T the covariance that is left of the shared errors: V diag(1/g^2) V^T.
MatrixXd left_of(const MatrixXd& shared, const MatrixXd& V, const Eigen::ArrayXd& g) {
  return shared * V * g.inverse().matrix().asDiagonal();
}

}  // namespace

Whitening::Part::Part(std::vector<Index> own, const Eigen::VectorXd& deviation, const MatrixXd& shared)
    : rows(std::move(own)),
      weight(deviation(rows).cwiseInverse()),
      A(weight.asDiagonal() * shared),
      V(A.cols(), A.cols()),
      g(A.cols()) {
  if (A.cols() == 0) return;
  auto eigen = symmetric_eigen(A.transpose() * A);
  V = std::move(eigen.vectors), g = (1.0 + eigen.values.array().max(0.0)).sqrt();
}

MatrixXd Whitening::Part::whitened(const MatrixXd& values) const {
  MatrixXd result = weight.asDiagonal() * values;
  if (A.cols() > 0)
    result -= A * (V * ((g * (g + 1.0)).inverse().matrix().asDiagonal() * (V.transpose() * (A.transpose() * result))));
  return result;
}

Whitening::Whitening(const Eigen::VectorXd& deviation, const MatrixXd& shared, const std::vector<Index>& last)
    : first_(all_but(deviation.size(), last), deviation, shared(all_but(deviation.size(), last), Eigen::all)),
      last_(last, deviation, left_of(shared(last, Eigen::all), first_.V, first_.g)),
      told_(first_.V * first_.g.square().inverse().matrix().asDiagonal() * first_.V.transpose() * first_.A.transpose()),
      shared_by_last_(shared(last, Eigen::all)) {}

MatrixXd Whitening::operator()(const MatrixXd& values) const {
  MatrixXd result(values.rows(), values.cols());
  const MatrixXd of_first = values(first_.rows, Eigen::all);
  result(first_.rows, Eigen::all) = first_.whitened(of_first);
  if (!last_.rows.empty())
    result(last_.rows, Eigen::all) = last_.whitened(
        values(last_.rows, Eigen::all) - shared_by_last_ * (told_ * (first_.weight.asDiagonal() * of_first)));
  return result;
}

}  // namespace imic3d
