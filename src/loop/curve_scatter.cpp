// How bars of one material differ, and what that makes of a test in which nothing is missing.
#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <random>

#include "imic3d/core/linear.hpp"
#include "imic3d/loop/curve_experiment.hpp"
#include "imic3d/loop/statistics.hpp"

namespace imic3d::loop {

namespace id = identification;

namespace {

/// How far a bar may differ by another cubic where the stress is so small a part of the largest: as much at zero, by
/// none from one half on.
double elastic_share(double stress) { return std::max(0.0, 1.0 - 2.0 * stress); }

}  // namespace

/// Legendre polynomials of x in [0, 1] at bins [count x degree + 1].
Eigen::MatrixXd CurveExperiment::basis(Eigen::Index first, Eigen::Index count) const {
  Eigen::MatrixXd B(count, degree + 1);
  for (Eigen::Index i = 0; i < count; ++i) {
    const double s = 2.0 * bins_[static_cast<std::size_t>(first + i)].x - 1.0;
    B.row(i) << 1.0, s, 0.5 * (3.0 * s * s - 1.0), 0.5 * (5.0 * s * s * s - 3.0 * s);
  }
  return B;
}

std::vector<Whitening> CurveExperiment::whitening_of(const Scatter& scatter) const {
  std::vector<Whitening> all;
  const Eigen::MatrixXd root = scatter.covariance.size() > 0 ? cholesky(scatter.covariance) : Eigen::MatrixXd();
  for (std::size_t k = 0; k < bars_.size(); ++k) {
    const auto [first, size] = bars_[k];
    const Eigen::MatrixXd& turns = scatter.turns[k];
    const Eigen::Index n = root.cols();
    Eigen::MatrixXd shared(size, 2 * n + turns.cols());
    if (n > 0) {
      const Eigen::MatrixXd its = basis(first, size) * root;
      const Eigen::VectorXd elastic = scatter.elastic.segment(first, size);
      shared.leftCols(n) = (1.0 - elastic.array()).matrix().asDiagonal() * its;
      shared.middleCols(n, n) = scatter.share_of_elastic * elastic.asDiagonal() * its;
    }
    if (turns.size() > 0) shared.rightCols(turns.cols()) = turns;
    std::vector<Eigen::Index> last;
    for (Eigen::Index i = 0; i < size; ++i)
      if (bins_[static_cast<std::size_t>(first + i)].held_out) last.push_back(i);
    all.emplace_back(scatter.noise.segment(first, size), shared, last);
  }
  return all;
}

bool CurveExperiment::noise_is_estimated(std::size_t curve) const {
  return curves_[curve].estimated && !repeated_.contains(curves_[curve].group);
}

double CurveExperiment::bin_noise(int curve) const {
  const auto [first, size] = bars_[static_cast<std::size_t>(curve)];
  return std::sqrt(scatter_.noise.segment(first, size).squaredNorm() / std::max(1.0, static_cast<double>(size)));
}

Eigen::VectorXd CurveExperiment::freedom() const {
  const auto N = static_cast<Eigen::Index>(bins_.size());
  if (freedom_ > 0.0) return Eigen::VectorXd::Constant(N, std::max(3.0, freedom_ - coefficients_that_differ() + 1.0));
  return scatter_.freedom;
}

Eigen::VectorXd CurveExperiment::known_noise() const {
  Eigen::VectorXd all =
      Eigen::VectorXd::Constant(static_cast<Eigen::Index>(bins_.size()), std::numeric_limits<double>::infinity());
  for (std::size_t k = 0; k < bars_.size(); ++k)
    if (noise_is_estimated(k))
      all.segment(bars_[k].first, bars_[k].second)
          .setConstant(std::max(3.0, id::freedom_of_point_noise(bars_[k].second)));
  return all;
}

/// Bars that have repetitions, with the bins that some other bar of their group has too.
void CurveExperiment::find_repetitions() {
  std::map<std::string, std::map<int, int>> bars_with;  // of a group and a bin's number
  std::map<std::string, int> members;
  for (std::size_t k = 0; k < bars_.size(); ++k) {
    if (bars_[k].second == 0) continue;
    ++members[curves_[k].group];
    for (Eigen::Index i = bars_[k].first; i < bars_[k].first + bars_[k].second; ++i)
      ++bars_with[curves_[k].group][bins_[static_cast<std::size_t>(i)].number];
  }
  for (std::size_t k = 0; k < bars_.size(); ++k) {
    Repeated bar{.curve = k, .rows = {}, .numbers = {}, .B = {}};
    for (Eigen::Index i = bars_[k].first; i < bars_[k].first + bars_[k].second; ++i)
      if (bars_with[curves_[k].group][bins_[static_cast<std::size_t>(i)].number] > 1)
        bar.rows.push_back(i), bar.numbers.push_back(bins_[static_cast<std::size_t>(i)].number);
    if (bar.rows.empty()) continue;
    std::vector<Eigen::Index> own;
    for (Eigen::Index i : bar.rows) own.push_back(i - bars_[k].first);
    bar.B = basis(bars_[k].first, bars_[k].second)(own, Eigen::all);
    repeated_[curves_[k].group].push_back(std::move(bar));
  }
  for (const auto& [group, count] : members) freedom_ += count - 1.0;
}

id::PointNoise CurveExperiment::points_of(std::size_t curve, const Eigen::VectorXd& raw) const {
  const auto [first, size] = bars_[curve];
  Eigen::VectorXd strain(size);  // every row that is judged is a bin
  for (Eigen::Index i = 0; i < size; ++i)
    strain[i] = curves_[curve].history.strain[bins_[static_cast<std::size_t>(first + i)].rows.front()];
  return id::point_noise(strain, raw.segment(first, size), slope_.segment(first, size),
                         curves_[curve].estimated ? 0.0 : curves_[curve].deviation, curves_[curve].strain_noise);
}

/// Random-effects model of the deviations from the groups' means, by expectation-maximisation: bars that end early are
/// in it with what they have. What is left of the cubics in a bin has one variance in a group; the noise of the points
/// comes on top. `raw`: measured - predicted [N].
CurveExperiment::Scatter CurveExperiment::scatter_of(const Eigen::VectorXd& raw) const {
  Scatter result{.covariance = {},
                 .elastic = Eigen::VectorXd::Zero(of_points_.size()),
                 .noise = of_points_,
                 .freedom = known_noise(),
                 .turns = std::vector<Eigen::MatrixXd>(bars_.size()),
                 .deviations = {},
                 .coefficients = {}};
  for (std::size_t k = 0; k < bars_.size(); ++k) {
    const auto [first, size] = bars_[k];
    if (repeated_.contains(curves_[k].group)) {
      if (!turns_.empty() && size > 0) result.turns[k] = turns_[k].errors(curves_[k].strain_noise);
      continue;
    }
    if (size < 3) continue;
    const id::PointNoise noise = points_of(k, raw);
    const double least = std::max(1e-3 * curves_[k].deviation, noise.stress);
    if (!turns_.empty()) result.turns[k] = turns_[k].errors(noise.strain);
    for (Eigen::Index i = first; i < first + size; ++i) {
      const double of_strain = std::abs(slope_[i]) * noise.strain;
      result.noise[i] = std::hypot(least, of_strain);
      if (of_strain > least) result.freedom[i] = std::max(3.0, noise.steep_freedom);
    }
  }
  double square = 0.0, count = 0.0;
  for (const auto& [group, bars] : repeated_) {
    std::map<int, std::pair<double, int>> means;  // of a bin: sum, bars
    for (const auto& bar : bars)
      for (std::size_t i = 0; i < bar.rows.size(); ++i)
        means[bar.numbers[i]].first += raw[bar.rows[i]], ++means[bar.numbers[i]].second;
    for (const auto& bar : bars) {
      Eigen::VectorXd deviation(static_cast<Eigen::Index>(bar.rows.size()));
      for (std::size_t i = 0; i < bar.rows.size(); ++i) {
        const auto& [sum, its] = means[bar.numbers[i]];
        deviation[static_cast<Eigen::Index>(i)] = (raw[bar.rows[i]] - sum / its) * std::sqrt(its / (its - 1.0));
      }
      square += deviation.squaredNorm(), count += static_cast<double>(deviation.size());
      result.deviations[group].push_back(std::move(deviation));
    }
  }
  if (count == 0.0) return result;  // nothing is repeated
  for (std::size_t i = 0; i < bins_.size(); ++i)
    if (repeated_.contains(curves_[static_cast<std::size_t>(bins_[i].curve)].group))
      result.elastic[static_cast<Eigen::Index>(i)] = elastic_share(bins_[i].stress);
  constexpr int size = degree + 1;
  const Eigen::Matrix<double, size, size> one = Eigen::Matrix<double, size, size>::Identity();
  Eigen::Matrix<double, size, size> D = 0.5 * square / count * one;
  std::map<std::string, double> variance;
  for (const auto& [group, bars] : repeated_) variance[group] = 0.1 * square / count;
  using Both = Eigen::Matrix<double, Eigen::Dynamic, 2 * size>;  // cubics of a bar that flows, and of an elastic one
  std::map<std::string, std::vector<Both>> both;
  for (const auto& [group, bars] : repeated_)
    for (const auto& bar : bars) {
      const Eigen::VectorXd elastic = result.elastic(bar.rows);
      Both& B = both[group].emplace_back(bar.B.rows(), 2 * size);
      B << (1.0 - elastic.array()).matrix().asDiagonal() * bar.B, elastic.asDiagonal() * bar.B;
    }
  double ratio = 1.0;  // of the covariance of elastic bars to that of bars that flow
  for (int iteration = 0; iteration < 200; ++iteration) {
    Eigen::Matrix<double, size, size> next = Eigen::Matrix<double, size, size>::Zero();
    double bars_seen = 0.0, next_ratio = 0.0;
    bool done = true;
    const Eigen::Matrix<double, size, size> D_inverse = (D + 1e-9 * D.trace() * one).inverse();
    for (const auto& [group, bars] : repeated_) {
      double left = 0.0, all = 0.0, numbers = 0.0;
      auto& coefficients = result.coefficients[group];
      coefficients.resize(bars.size());
      for (std::size_t k = 0; k < bars.size(); ++k) {
        const auto& deviation = result.deviations[group][k];
        const Eigen::ArrayXd points = of_points_(bars[k].rows).array().square(), total = points + variance[group];
        const Both& B = both.at(group)[k];
        const Both weighted = total.inverse().matrix().asDiagonal() * B;
        Eigen::Matrix<double, 2 * size, 2 * size> information = weighted.transpose() * B;
        information.topLeftCorner<size, size>() += D_inverse;
        information.bottomRightCorner<size, size>() += D_inverse / ratio;
        const Eigen::Matrix<double, 2 * size, 2 * size> V = information.inverse();
        const Eigen::VectorXd c = V * (weighted.transpose() * deviation);
        next += c.head<size>() * c.head<size>().transpose() + V.topLeftCorner<size, size>();
        next_ratio +=
            (D_inverse * (c.tail<size>() * c.tail<size>().transpose() + V.bottomRightCorner<size, size>())).trace();
        bars_seen += 1.0;
        const Eigen::ArrayXd uncertain = (B * V).cwiseProduct(B).rowwise().sum(), share = variance[group] / total;
        left += (share.square() * ((deviation - B * c).array().square() + uncertain) + share * points).sum();
        all += total.sum();
        numbers += static_cast<double>(deviation.size());
        coefficients[k] = c;
      }
      done = done && std::abs(left / numbers - variance[group]) < 1e-4 * all / numbers;
      variance[group] = std::max(1e-12 * square / count, left / numbers);
    }
    next /= bars_seen;
    done = done && (next - D).norm() < 1e-4 * next.norm();
    D = next;
    ratio = std::max(1e-6, next_ratio / (size * bars_seen));
    if (done) break;
  }
  result.share_of_elastic = std::sqrt(ratio);
  result.covariance = D;
  for (std::size_t i = 0; i < bins_.size(); ++i)
    if (const auto its = variance.find(curves_[static_cast<std::size_t>(bins_[i].curve)].group);
        its != variance.end()) {
      const auto row = static_cast<Eigen::Index>(i);
      double& noise = result.noise[row];
      noise = std::sqrt(noise * noise + its->second);
    }
  return result;
}

/// Coefficients whose variance is that of the bars, and so estimated from them: tr D (D + (B^T S^-1 B)^-1)^-1, S the
/// variance of the bins, the mean of all bars. What the noise of the bins makes of a coefficient is known from many of
/// them.
double CurveExperiment::coefficients_that_differ() const {
  if (scatter_.covariance.size() == 0) return degree + 1;
  double sum = 0.0, bars_seen = 0.0;
  for (const auto& [group, bars] : repeated_)
    for (const auto& bar : bars) {
      const Eigen::MatrixXd& D = scatter_.covariance;
      const Eigen::MatrixXd signal =
                                D * (bar.B.transpose() *
                                     scatter_.noise(bar.rows).array().square().inverse().matrix().asDiagonal() * bar.B),
                            unity = Eigen::MatrixXd::Identity(degree + 1, degree + 1);
      sum += (unity + signal).partialPivLu().solve(signal).trace();
      bars_seen += 1.0;
    }
  return sum / bars_seen;
}

/// What cubics with these coefficients, those of a bar that flows and of one that is elastic, are in a bin of a bar.
double CurveExperiment::cubic(const Repeated& bar, Eigen::Index bin, const Eigen::VectorXd& coefficients) const {
  const double elastic = scatter_.elastic[bar.rows[static_cast<std::size_t>(bin)]];
  return bar.B.row(bin).dot((1.0 - elastic) * coefficients.head(degree + 1) + elastic * coefficients.tail(degree + 1));
}

/// Correlation of what cubics leave of the deviations of a group, from bin to bin: 0 if that is white noise.
double CurveExperiment::correlation_beyond_cubics(const std::string& group) const {
  const auto& bars = repeated_.at(group);
  double product = 0.0, square = 0.0;
  for (std::size_t k = 0; k < bars.size(); ++k) {
    Eigen::VectorXd left = scatter_.deviations.at(group)[k];
    for (Eigen::Index i = 0; i < left.size(); ++i) left[i] -= cubic(bars[k], i, scatter_.coefficients.at(group)[k]);
    left = left.cwiseQuotient(scatter_.noise(bars[k].rows));
    product += left.head(left.size() - 1).dot(left.tail(left.size() - 1)), square += left.squaredNorm();
  }
  return std::clamp(product / std::max(1e-300, square), 0.0, 1.0);
}

/// One half of their covariance is that of the model, the other that of the deviations themselves, whatever their
/// course: what cubics leave of them goes together from bin to bin as far as it does in the bars, and is white
/// otherwise.
Eigen::MatrixXd CurveExperiment::bars_like_these(int draws, double grown, unsigned seed) const {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  const auto drawn = [&](Eigen::Index count) {
    Eigen::VectorXd g(count);
    for (double& x : g) x = normal(random);
    return g;
  };
  const Eigen::MatrixXd root =
      scatter_.covariance.size() > 0 ? Eigen::MatrixXd(grown * cholesky(scatter_.covariance)) : Eigen::MatrixXd();
  Eigen::MatrixXd result(static_cast<Eigen::Index>(bins_.size()), draws);
  for (auto raw : result.colwise()) {
    for (std::size_t k = 0; k < bars_.size(); ++k) {
      const auto [first, size] = bars_[k];
      raw.segment(first, size) = scatter_.noise.segment(first, size).cwiseProduct(drawn(size));
      if (root.size() > 0) {
        const Eigen::MatrixXd its = basis(first, size) * root;
        const Eigen::ArrayXd elastic = scatter_.elastic.segment(first, size).array(), flows = its * drawn(root.cols()),
                             other = its * drawn(root.cols());
        raw.segment(first, size).array() += (1.0 - elastic) * flows + scatter_.share_of_elastic * elastic * other;
      }
      if (const auto& turns = scatter_.turns[k]; turns.size() > 0)
        raw.segment(first, size) += turns * drawn(turns.cols());
    }
    if (scatter_.deviations.empty()) continue;  // nothing is learned yet
    for (const auto& [group, bars] : repeated_) {
      const auto& deviations = scatter_.deviations.at(group);
      const auto& coefficients = scatter_.coefficients.at(group);
      const double together = std::sqrt(correlation_beyond_cubics(group)), apart = std::sqrt(1.0 - together * together);
      for (const auto& bar : bars) {
        const auto shares = [&drawn, count = static_cast<double>(bars.size())]() -> Eigen::VectorXd {
          return drawn(static_cast<Eigen::Index>(count)) / std::sqrt(count);
        };
        const Eigen::VectorXd share = shares();
        for (std::size_t i = 0; i < bar.rows.size(); ++i) {
          double sum = 0.0;
          const Eigen::VectorXd own = shares();
          for (std::size_t k = 0; k < bars.size(); ++k) {
            const auto at = std::lower_bound(bars[k].numbers.begin(), bars[k].numbers.end(), bar.numbers[i]);
            const bool has = at != bars[k].numbers.end() && *at == bar.numbers[i];
            const auto j = static_cast<Eigen::Index>(k);
            const double its = cubic(bar, static_cast<Eigen::Index>(i), coefficients[k]),
                         left = has ? deviations[k][at - bars[k].numbers.begin()] - its : 0.0;
            sum += share[j] * (its + together * left) + own[j] * apart * left;
          }
          raw[bar.rows[i]] = std::sqrt(0.5) * (raw[bar.rows[i]] + grown * sum);
        }
      }
    }
  }
  return result;
}

int CurveExperiment::draws(int asked) const { return std::max(asked, 2000); }

/// A score that is weighed with a covariance of p coefficients, itself estimated with n degrees of freedom, varies by
/// n/(n - p - 1) (n - 1)/(n - p) more than that covariance says (S a Wishart matrix: s^T S^-1 d/sqrt(s^T S^-1 s)); its
/// tails are those of Student's t with n - p + 1. One that is weighed with the noise of the points: t of their freedom.
Eigen::MatrixXd CurveExperiment::noise(const std::vector<double>&, int draws) {
  if (repeated_.empty()) {
    Eigen::MatrixXd result = bars_like_these(draws, 1.0, 3);
    const Eigen::ArrayXd f = freedom().array(), grown = f.isFinite().select((f / (f - 2.0)).sqrt(), 1.0);
    for (auto column : result.colwise()) column = whitened(column).cwiseProduct(grown.matrix());
    return result;
  }
  const double p = coefficients_that_differ(), n = std::max(freedom_, p + 2.0);
  Eigen::MatrixXd result = bars_like_these(draws, std::sqrt(n / (n - p - 1.0) * (n - 1.0) / (n - p)), 3);
  for (auto column : result.colwise()) column = whitened(column);
  return result;
}

Eigen::MatrixXd CurveExperiment::noise_of_squares(const std::vector<double>&, const Eigen::MatrixXd& noise) {
  Eigen::MatrixXd result = bars_like_these(static_cast<int>(noise.cols()), 1.0, 5);
  for (auto column : result.colwise()) column = whitened(column, whitening_of(scatter_of(column)));
  return result;
}

}  // namespace imic3d::loop
