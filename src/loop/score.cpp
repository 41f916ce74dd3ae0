#include "imic3d/loop/score.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <random>
#include <utility>

#include "imic3d/core/linear.hpp"
#include "imic3d/loop/statistics.hpp"

namespace imic3d::loop {

namespace {

/// A candidate's columns among all.
struct Columns {
  Eigen::Index first, count;
};

/// How far beyond the limit the expected score of a detectable size lies: 86 % of them are beyond it, of which a
/// quarter of the frames, held out, confirms nine in ten.
constexpr double power_deviations = 0.9;

/// Standard deviation of Student's t.
double unit_of(double freedom) { return std::sqrt(freedom / (freedom - 2.0)); }

/// Scores with one covariance: what turns z into the statistics.
class Test {
 public:
  Test(const Eigen::MatrixXd& C, const Eigen::MatrixXd& G, const std::vector<Columns>& columns) : columns_(columns) {
    // Marks that are nearly the same make C nearly singular: directions below 1e-8 of the largest say nothing.
    const SymmetricEigen eigen = symmetric_eigen(C);
    const double floor = 1e-8 * eigen.values.maxCoeff();
    const Eigen::VectorXd inverse =
        (eigen.values.array() > floor).select(eigen.values.array().max(floor).inverse(), 0.0);
    const Eigen::MatrixXd C_inverse = eigen.vectors * inverse.asDiagonal() * eigen.vectors.transpose();
    for (const auto& [first, count] : columns) {
      weights_.emplace_back(G.middleCols(first, count).transpose() * C_inverse);
      information_.emplace_back(weights_.back() * G.middleCols(first, count));
      inverse_.emplace_back(pseudo_inverse(information_.back()));
    }
  }
  [[nodiscard]] double statistic(std::size_t j, const Eigen::VectorXd& z) const {
    const Eigen::VectorXd v = weights_[j] * z;
    return std::max(0.0, v.dot(inverse_[j] * v));
  }
  /// Of scores whose noise was estimated from few data: `freedom` of each candidate, `scale` the standard normal number
  /// that its estimate comes of in this test.
  [[nodiscard]] double largest_z(const Eigen::VectorXd& z, const std::vector<char>& visible,
                                 const std::vector<double>& freedom, double scale) const {
    // the largest of each number of degrees and freedom: of these it is the largest statistic
    std::map<std::pair<Eigen::Index, double>, double> statistics;
    for (std::size_t j = 0; j < weights_.size(); ++j) {
      auto& largest = statistics[{columns_[j].count, freedom[j]}];
      if (visible[j] != 0) largest = std::max(largest, statistic(j, z));
    }
    double largest = 0.0;
    for (const auto& [group, its] : statistics) {
      const auto [degrees, of_variance] = group;
      const double unit = unit_of(of_variance), share = 2.0 / (9.0 * of_variance),
                   ratio = std::pow(std::max(0.1, 1.0 - share + scale * std::sqrt(share)),
                                    3);  // chi^2/freedom (Wilson and Hilferty 1931)
      largest = std::max(largest, student_as_normal(unit * deviations(log_chi_squared_tail(its / (unit * unit * ratio),
                                                                                           static_cast<int>(degrees))),
                                                    of_variance));
    }
    return largest;
  }
  /// Of the first `k` parameters, the rest held at null.
  [[nodiscard]] Eigen::VectorXd size(std::size_t j, Eigen::Index k, const Eigen::VectorXd& z) const {
    return covariance(j, k) * (weights_[j].topRows(k) * z);
  }
  [[nodiscard]] Eigen::MatrixXd covariance(std::size_t j, Eigen::Index k) const {
    return pseudo_inverse(information_[j].topLeftCorner(k, k));
  }
  [[nodiscard]] const Eigen::MatrixXd& information(std::size_t j) const { return information_[j]; }

 private:
  std::vector<Columns> columns_;
  std::vector<Eigen::MatrixXd> weights_, information_, inverse_;
};

/// Covariance of the scores: of the draws Z [m x draws], drawn towards s G, s the mean ratio, as their number asks for.
Eigen::MatrixXd covariance(const Eigen::MatrixXd& Z, const Eigen::MatrixXd& G) {
  const auto draws = static_cast<double>(Z.cols()), m = static_cast<double>(Z.rows());
  const Eigen::MatrixXd sample = Z * Z.transpose() / draws;
  const double scale = sample.trace() / std::max(G.trace(), 1e-300);
  const double share = m / (m + draws);
  return (1.0 - share) * sample + share * scale * G;
}

/// Degrees of freedom of a score's estimated variance, whose parts come of rows [N] with `freedom` each (Satterthwaite
/// 1946); rows of equal freedom share their estimate.
double freedom_of(const Eigen::VectorXd& freedom, const Eigen::MatrixXd& marks) {
  std::map<double, double> parts;
  for (Eigen::Index i = 0; i < freedom.size(); ++i) parts[freedom[i]] += marks.row(i).squaredNorm();
  double inverse = 0.0;
  for (const auto& [its, part] : parts) inverse += std::pow(part / std::max(1e-300, marks.squaredNorm()), 2) / its;
  return inverse > 0.0 ? std::max(3.0, 1.0 / inverse) : 1e12;
}

/// P = I - Q Q^T: takes away what the free parameters explain.
class Projection {
 public:
  explicit Projection(Eigen::MatrixXd S) : Q_(Eigen::MatrixXd::Zero(S.rows(), 0)) {
    for (auto column : S.colwise()) column /= std::max(column.norm(), 1e-300);
    if (S.cols() == 0) return;
    Q_ = orthonormal(S);
  }
  [[nodiscard]] Eigen::MatrixXd operator()(const Eigen::MatrixXd& X) const { return X - Q_ * (Q_.transpose() * X); }
  [[nodiscard]] Eigen::Index rank() const { return Q_.cols(); }

 private:
  Eigen::MatrixXd Q_;
};

}  // namespace

namespace {
/// What a size at a place takes off the square of the held-out residual, the parameters giving way.
double drop_held_out(const ScoreProblem& problem, std::size_t j, Eigen::Index place, const Eigen::VectorXd& size,
                     const Eigen::MatrixXd& pull) {
  if (problem.held_out.residual.size() == 0) return 0.0;
  const Eigen::VectorXd shift = pull * (problem.elsewhere[j].middleCols(place * size.size(), size.size()) * size);
  const Eigen::VectorXd v = problem.held_out.elsewhere[j].middleCols(place * size.size(), size.size()) * size -
                            problem.held_out.sensitivity * shift;
  return problem.held_out.residual.squaredNorm() - (problem.held_out.residual - v).squaredNorm();
}
}  // namespace

Scores score(const ScoreProblem& problem) {
  const Eigen::Index N = problem.residual.size();
  const auto families = problem.signatures.size();
  std::vector<Columns> columns;
  Eigen::Index m = 0;
  for (const auto& signature : problem.signatures) columns.push_back({m, signature.cols()}), m += signature.cols();

  const Projection projected(problem.sensitivity);
  const Eigen::VectorXd Pr = projected(problem.residual);
  const Eigen::MatrixXd PR = projected(problem.null);
  Scores result;
  // what the parameters would explain, too, were they not held by their bounds
  result.energy = problem.residual.squaredNorm();
  const Eigen::VectorXd null_energy =
      (problem.squares.size() > 0 ? projected(problem.squares) : PR).colwise().squaredNorm().transpose();
  result.null_energy = null_energy.mean();
  // The cube root of a sum of squares is all but normal (Wilson and Hilferty 1931); mean and deviation are those of the
  // draws: Student's t.
  const Eigen::ArrayXd roots = null_energy.array().max(1e-300).pow(1.0 / 3.0);
  const double draws = static_cast<double>(roots.size()),
               deviation = std::sqrt((roots - roots.mean()).square().sum() / std::max(1.0, draws - 1.0));
  result.omnibus = student_as_normal(
      (std::cbrt(result.energy) - roots.mean()) / std::max(deviation * std::sqrt(1.0 + 1.0 / draws), 1e-300),
      draws - 1.0);
  result.omnibus_threshold = 2.3263;  // level_of_omnibus
  result.omnibus_p = 0.5 * std::erfc(result.omnibus / std::sqrt(2.0));
  if (families == 0) return result;

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

  const Eigen::MatrixXd G = A.transpose() * A;
  const Eigen::VectorXd z = A.transpose() * Pr;
  const Eigen::MatrixXd Z = A.transpose() * PR;
  const Eigen::MatrixXd C = covariance(Z, G);
  const Test test(C, G, columns);
  std::vector<Score> seen;  // how visible each candidate is
  std::vector<char> visible;
  for (const auto& [first, count] : columns) {
    const auto own = A.middleCols(first, count);
    Score& one = seen.emplace_back();
    one.visibility = (own.colwise().squaredNorm().transpose().array() > 0.0)
                         .select(length.segment(first, count).array() / before.segment(first, count).array(), 0.0)
                         .maxCoeff();
    one.shown_by_prior = 2.0 * own.bottomRows(problem.known).squaredNorm() > own.squaredNorm();
    visible.push_back(one.visible() ? 1 : 0);
  }

  std::vector<double> freedom;
  for (const auto& [first, count] : columns) freedom.push_back(freedom_of(problem.freedom, A.middleCols(first, count)));

  // Scores are sums of many numbers: Gaussian, and of Student's t where the noise is an estimate, which is one for all:
  // in a test where it is too small all scores are large. The null of the largest z is that of Gaussian scores of
  // covariance C, judged by a covariance that was itself estimated from as many draws: taken as known, it would be too
  // good for the draws that it was made of, and small tails of few draws say little.
  const SymmetricEigen eigen = symmetric_eigen(C);
  const Eigen::MatrixXd root = eigen.vectors * eigen.values.cwiseMax(0.0).cwiseSqrt().asDiagonal();
  std::mt19937_64 random(1), of_scale(2);
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
    for (Eigen::Index b = 0; b < each; ++b)
      result.null_largest[k * each + b] =
          other.largest_z(scores.col(b), visible, freedom, std::normal_distribution<double>()(of_scale));
  }
  result.threshold = upper_quantile(result.null_largest, problem.level);

  const Eigen::MatrixXd pull =
      problem.sensitivity.cols() > 0 ? pseudo_inverse(problem.sensitivity) : Eigen::MatrixXd(0, N);
  double largest = 0.0;
  for (std::size_t j = 0; j < families; ++j) {
    const auto& [first, count] = columns[j];
    Score one = seen[j];
    one.degrees = static_cast<int>(count);
    one.statistic = test.statistic(j, z);
    one.p = chi_squared_tail(one.statistic, one.degrees);
    const double unit = unit_of(freedom[j]);  // C holds the variance of Student's t
    one.z = student_as_normal(unit * deviations(log_chi_squared_tail(one.statistic, one.degrees)), freedom[j]);
    if (visible[j] != 0) largest = std::max(largest, one.z);
    const Eigen::MatrixXd own = A.middleCols(first, count);
    const Eigen::VectorXd fitted = least_squares(own, Pr);
    one.drop = (own * fitted).squaredNorm();
    const Eigen::Index sizes = problem.sizes.empty() ? count : problem.sizes[j];
    const Eigen::VectorXd scale = length.segment(first, sizes).cwiseInverse();
    one.size = test.size(j, sizes, z).cwiseProduct(scale);
    one.deviation = test.covariance(j, sizes).diagonal().cwiseMax(0.0).cwiseSqrt().cwiseProduct(scale);
    const double wider =
        detectable(result.threshold, power_deviations, one.degrees) / (result.threshold + power_deviations);
    const Eigen::ArrayXd told = test.information(j).diagonal();  // 0: invisible
    one.detectable = (told > 0.0)
                         .select((wider * normal_as_student(result.threshold + power_deviations, freedom[j]) / unit /
                                  told.cwiseMax(1e-300).sqrt())
                                     .matrix()
                                     .cwiseQuotient(length.segment(first, count))
                                     .array(),
                                 std::numeric_limits<double>::infinity());
    const Eigen::Index places = problem.elsewhere.empty() || sizes == 0 ? 0 : problem.elsewhere[j].cols() / sizes;
    double longest = 0.0;
    one.size_there.resize(sizes, places), one.drop_there.resize(places), one.drop_there_held_out.resize(places);
    for (Eigen::Index p = 0; p < places; ++p) {
      const Eigen::MatrixXd there = projected(problem.elsewhere[j].middleCols(p * sizes, sizes));
      one.size_there.col(p) = least_squares(there, Pr);
      one.drop_there[p] = (there * one.size_there.col(p)).squaredNorm();
      one.drop_there_held_out[p] = drop_held_out(problem, j, p, one.size_there.col(p), pull);
      longest = std::max(longest, there.norm());
    }
    // The directions that places span have no size of their own. A single size is found where it is seen best (as if
    // noise were white).
    if (places > 0) one.detectable.tail(count - sizes).setConstant(std::numeric_limits<double>::infinity());
    if (places > 0 && sizes == 1 && longest > 0.0)
      one.detectable[0] = wider * normal_as_student(result.threshold + power_deviations, freedom[j]) / unit / longest;
    one.bias = pull * problem.signatures[j].leftCols(sizes);
    result.candidates.push_back(std::move(one));
  }
  result.largest_p = (1.0 + static_cast<double>((result.null_largest.array() >= largest).count())) /
                     (static_cast<double>(covariances * each) + 1.0);
  return result;
}

Baselines baselines(const ScoreProblem& problem) {
  const Projection projected(problem.sensitivity);
  Eigen::VectorXd r = projected(problem.residual);
  std::vector<Eigen::MatrixXd> marks;
  for (const auto& signature : problem.signatures) {
    marks.push_back(projected(signature));
    for (Eigen::Index c = 0; c < signature.cols(); ++c)  // what is left of an invisible mark is round-off
      marks.back().col(c) *=
          marks.back().col(c).norm() > 1e-7 * signature.col(c).norm() ? 1.0 / marks.back().col(c).norm() : 0.0;
  }
  const auto explained = [&r](const Eigen::MatrixXd& A) { return (A * least_squares(A, r)).squaredNorm(); };

  Baselines result;
  const double energy = r.squaredNorm(), rows = static_cast<double>(r.size());
  result.chi_squared_p = chi_squared_tail(energy, static_cast<int>(r.size() - projected.rank()));
  for (const auto& mark : marks) result.cosine.push_back(std::sqrt(explained(mark) / std::max(energy, 1e-300)));
  // Forward selection: the candidate that lowers |r|^2 + columns ln N most, until none does; what it explains is taken
  // off r and off the other marks.
  while (true) {
    int best = -1;
    double most = 0.0;
    for (std::size_t j = 0; j < marks.size(); ++j) {
      if (std::find(result.bic.begin(), result.bic.end(), static_cast<int>(j)) != result.bic.end()) continue;
      const double gain = explained(marks[j]) - static_cast<double>(marks[j].cols()) * std::log(rows);
      if (gain > most) most = gain, best = static_cast<int>(j);
    }
    if (best < 0) return result;
    result.bic.push_back(best);
    const Projection without(marks[static_cast<std::size_t>(best)]);
    r = without(r);
    for (auto& mark : marks) {
      mark = without(mark);
      for (auto column : mark.colwise())
        if (column.norm() < 1e-7) column.setZero();  // the mark of a twin: round-off
    }
  }
}

}  // namespace imic3d::loop
