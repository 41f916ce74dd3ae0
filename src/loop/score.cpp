#include "imic3d/loop/score.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <random>

#include "imic3d/loop/statistics.hpp"

namespace imic3d::loop {

namespace {

/// A candidate's columns among all.
struct Columns {
  Eigen::Index first, count;
};

/// Scores with one covariance: what turns z into the statistics.
class Test {
 public:
  Test(const Eigen::MatrixXd& C, const Eigen::MatrixXd& G, const std::vector<Columns>& columns) : columns_(columns) {
    // Marks that are nearly the same make C nearly singular: directions below 1e-8 of the largest say nothing.
    const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(C);
    const double floor = 1e-8 * eigen.eigenvalues().maxCoeff();
    const Eigen::VectorXd inverse = (eigen.eigenvalues().array() > floor).select(eigen.eigenvalues().array().max(floor).inverse(), 0.0);
    const Eigen::MatrixXd C_inverse = eigen.eigenvectors() * inverse.asDiagonal() * eigen.eigenvectors().transpose();
    for (const auto& [first, count] : columns) {
      weights_.emplace_back(G.middleCols(first, count).transpose() * C_inverse);
      information_.emplace_back(weights_.back() * G.middleCols(first, count));
    }
  }
  [[nodiscard]] double statistic(std::size_t j, const Eigen::VectorXd& z) const {
    const Eigen::VectorXd v = weights_[j] * z;
    return std::max(0.0, v.dot(pseudo_inverse(information_[j]) * v));
  }
  [[nodiscard]] double largest_z(const Eigen::VectorXd& z) const {
    double largest = 0.0;
    for (std::size_t j = 0; j < weights_.size(); ++j)
      largest = std::max(largest, deviations(log_chi_squared_tail(statistic(j, z), static_cast<int>(columns_[j].count))));
    return largest;
  }
  /// Of the first `k` parameters, the rest held at null.
  [[nodiscard]] Eigen::VectorXd size(std::size_t j, Eigen::Index k, const Eigen::VectorXd& z) const { return covariance(j, k) * (weights_[j].topRows(k) * z); }
  [[nodiscard]] Eigen::MatrixXd covariance(std::size_t j, Eigen::Index k) const { return pseudo_inverse(information_[j].topLeftCorner(k, k)); }
  [[nodiscard]] const Eigen::MatrixXd& information(std::size_t j) const { return information_[j]; }

 private:
  static Eigen::MatrixXd pseudo_inverse(const Eigen::MatrixXd& matrix) {
    return matrix.completeOrthogonalDecomposition().pseudoInverse();
  }
  std::vector<Columns> columns_;
  std::vector<Eigen::MatrixXd> weights_, information_;
};

/// Covariance of the scores: of the draws Z [m x draws], drawn towards s G, s the mean ratio, as their number asks for.
Eigen::MatrixXd covariance(const Eigen::MatrixXd& Z, const Eigen::MatrixXd& G) {
  const auto draws = static_cast<double>(Z.cols()), m = static_cast<double>(Z.rows());
  const Eigen::MatrixXd sample = Z * Z.transpose() / draws;
  const double scale = sample.trace() / std::max(G.trace(), 1e-300);
  const double share = m / (m + draws);
  return (1.0 - share) * sample + share * scale * G;
}

}  // namespace

Scores score(const ScoreProblem& problem) {
  const Eigen::Index N = problem.residual.size();
  const auto families = problem.signatures.size();
  std::vector<Columns> columns;
  Eigen::Index m = 0;
  for (const auto& signature : problem.signatures) columns.push_back({m, signature.cols()}), m += signature.cols();

  // P = I - Q Q^T on the scaled sensitivities.
  Eigen::MatrixXd S = problem.sensitivity;
  for (auto column : S.colwise()) column /= std::max(column.norm(), 1e-300);
  Eigen::MatrixXd Q = Eigen::MatrixXd::Zero(N, 0);
  if (S.cols() > 0) {
    const Eigen::ColPivHouseholderQR<Eigen::MatrixXd> qr(S);
    Q = qr.householderQ() * Eigen::MatrixXd::Identity(N, qr.rank());
  }
  const auto projected = [&Q](const Eigen::MatrixXd& X) -> Eigen::MatrixXd { return X - Q * (Q.transpose() * X); };

  // Columns of unit length; the scales come back with the sizes.
  Eigen::MatrixXd A(N, m);
  Eigen::VectorXd length(m), before(m);
  for (std::size_t j = 0; j < families; ++j) A.middleCols(columns[j].first, columns[j].count) = problem.signatures[j];
  for (Eigen::Index i = 0; i < m; ++i) before[i] = std::max(A.col(i).norm(), 1e-300);
  A = projected(A);
  for (Eigen::Index i = 0; i < m; ++i) {
    length[i] = std::max(A.col(i).norm(), 1e-300);
    A.col(i) *= length[i] > 1e-7 * before[i] ? 1.0 / length[i] : 0.0;  // what is left of an invisible mark is round-off
  }

  const Eigen::VectorXd Pr = projected(problem.residual);
  const Eigen::MatrixXd PR = projected(problem.null);
  const Eigen::MatrixXd G = A.transpose() * A;
  const Eigen::VectorXd z = A.transpose() * Pr;
  const Eigen::MatrixXd Z = A.transpose() * PR;
  const Eigen::MatrixXd C = covariance(Z, G);
  const Test test(C, G, columns);

  Scores result;
  result.energy = Pr.squaredNorm();
  const Eigen::VectorXd null_energy = PR.colwise().squaredNorm().transpose();
  result.null_energy = null_energy.mean();
  // The cube root of a sum of squares is all but normal (Wilson and Hilferty 1931); mean and deviation are those of the draws: Student's t.
  const Eigen::ArrayXd roots = null_energy.array().max(1e-300).pow(1.0 / 3.0);
  const double draws = static_cast<double>(roots.size()), deviation = std::sqrt((roots - roots.mean()).square().sum() / std::max(1.0, draws - 1.0));
  result.omnibus = student_as_normal((std::cbrt(result.energy) - roots.mean()) / std::max(deviation * std::sqrt(1.0 + 1.0 / draws), 1e-300), draws - 1.0);
  result.omnibus_threshold = 2.3263;  // 1 %
  result.omnibus_p = 0.5 * std::erfc(result.omnibus / std::sqrt(2.0));
  if (families == 0) return result;

  // Scores are sums of many numbers: Gaussian. The null of the largest z is that of Gaussian scores of covariance C, judged by a covariance that was itself
  // estimated from as many draws: taken as known, it would be too good for the draws that it was made of, and small tails of few draws say little.
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(C);
  const Eigen::MatrixXd root = eigen.eigenvectors() * eigen.eigenvalues().cwiseMax(0.0).cwiseSqrt().asDiagonal();
  std::mt19937_64 random(1);
  std::normal_distribution<double> normal;
  const auto drawn = [&](Eigen::Index count) -> Eigen::MatrixXd {
    Eigen::MatrixXd white(m, count);
    for (double& value : white.reshaped()) value = normal(random);
    return root * white;
  };
  constexpr Eigen::Index covariances = 100, each = 20;
  result.null_largest.resize(covariances * each);
  for (Eigen::Index k = 0; k < covariances; ++k) {
    const Test other(covariance(drawn(Z.cols()), G), G, columns);
    const Eigen::MatrixXd scores = drawn(each);
    for (Eigen::Index b = 0; b < each; ++b) result.null_largest[k * each + b] = other.largest_z(scores.col(b));
  }
  result.threshold = upper_quantile(result.null_largest, level_of_scores);
  result.largest_p = (1.0 + static_cast<double>((result.null_largest.array() >= test.largest_z(z)).count())) / (static_cast<double>(covariances * each) + 1.0);

  const Eigen::MatrixXd pull = S.cols() > 0 ? Eigen::MatrixXd(problem.sensitivity.completeOrthogonalDecomposition().pseudoInverse()) : Eigen::MatrixXd(0, N);
  for (std::size_t j = 0; j < families; ++j) {
    const auto& [first, count] = columns[j];
    Score one;
    one.degrees = static_cast<int>(count);
    one.statistic = test.statistic(j, z);
    one.p = chi_squared_tail(one.statistic, one.degrees);
    one.z = deviations(log_chi_squared_tail(one.statistic, one.degrees));
    one.visibility = (length.segment(first, count).array() / before.segment(first, count).array()).maxCoeff();
    const Eigen::MatrixXd own = A.middleCols(first, count);
    const Eigen::VectorXd fitted = own.completeOrthogonalDecomposition().solve(Pr);
    one.drop = (own * fitted).squaredNorm();
    const Eigen::Index sizes = problem.sizes.empty() ? count : problem.sizes[j];
    const Eigen::VectorXd scale = length.segment(first, sizes).cwiseInverse();
    one.size = test.size(j, sizes, z).cwiseProduct(scale);
    one.deviation = test.covariance(j, sizes).diagonal().cwiseMax(0.0).cwiseSqrt().cwiseProduct(scale);
    one.detectable = ((result.threshold + 0.84) / test.information(j).diagonal().head(sizes).cwiseMax(1e-300).array().sqrt()).matrix().cwiseProduct(scale);
    one.bias = pull * problem.signatures[j].leftCols(sizes);
    result.candidates.push_back(std::move(one));
  }
  return result;
}

}  // namespace imic3d::loop
