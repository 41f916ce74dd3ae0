#include "imic3d/identification/curves.hpp"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "imic3d/core/bounded_step.hpp"
#include "imic3d/core/error.hpp"
#include "imic3d/core/linear.hpp"
#include "imic3d/core/median.hpp"
#include "imic3d/identification/gauge.hpp"

namespace imic3d::identification {

void read_gauge(Curve& curve, bool timed) {
  auto &time = curve.history.time, &strain = curve.history.strain;
  auto& turns = curve.history.turns;
  curve.strain_noise = timed ? strain_noise(time, strain, curve.stress) : 0.0;
  turns = find_turns(time, strain, curve.stress, curve.strain_noise);
  if (timed) {
    const auto corners = find_corners(time, strain, turns, curve.strain_noise);
    turns.insert(turns.end(), corners.begin(), corners.end());
    std::sort(turns.begin(), turns.end(), [](const auto& a, const auto& b) { return a.time < b.time; });
  }
  strain = smooth_strain(time, strain, turns, curve.strain_noise);
}

CurveSet::CurveSet(std::shared_ptr<const material::FiniteStrainLaw> law, std::vector<Curve> curves,
                   material::BarOptions options)
    : law_(std::move(law)), curves_(std::move(curves)), options_(options) {
  if (law_->thickness_strain_index() >= 0) throw std::invalid_argument("curves take a three-dimensional law");
  std::vector<double> measured, deviation;
  for (std::size_t k = 0; k < curves_.size(); ++k) {
    const Curve& curve = curves_[k];
    const auto rows = curve.stress.size();
    if (curve.history.strain.size() != rows || curve.history.time.size() != rows ||
        static_cast<Eigen::Index>(curve.use.size()) != rows)
      throw std::invalid_argument("curve " + curve.name + ": columns of different lengths");
    const auto first = static_cast<Eigen::Index>(places_.size());
    std::vector<Eigen::Index> fitted;
    for (Eigen::Index row = 0; row < rows; ++row) {
      if (curve.use[static_cast<std::size_t>(row)] == Curve::not_judged) continue;
      if (curve.use[static_cast<std::size_t>(row)] == Curve::fitted)
        fitted.push_back(static_cast<Eigen::Index>(places_.size()) - first);
      places_.push_back({static_cast<int>(k), row});
      measured.push_back(curve.stress[row]);
      deviation.push_back(curve.deviation);
    }
    Whitening independent(Eigen::VectorXd::Constant(static_cast<Eigen::Index>(fitted.size()), curve.deviation),
                          Eigen::MatrixXd(static_cast<Eigen::Index>(fitted.size()), 0));
    spans_.push_back(
        {first, static_cast<Eigen::Index>(places_.size()) - first, std::move(fitted), std::move(independent)});
  }
  measured_ = Eigen::Map<const Eigen::VectorXd>(measured.data(), static_cast<Eigen::Index>(measured.size()));
  deviation_ = Eigen::Map<const Eigen::VectorXd>(deviation.data(), static_cast<Eigen::Index>(deviation.size()));
}

bool CurveSet::is_fitted(Eigen::Index i) const {
  const CurvePlace& place = places_[static_cast<std::size_t>(i)];
  return curves_[static_cast<std::size_t>(place.curve)].use[static_cast<std::size_t>(place.row)] == Curve::fitted;
}

Eigen::MatrixXd CurveSet::whitened(const Eigen::MatrixXd& values) const {
  Eigen::Index count = 0;
  for (const Span& span : spans_) count += static_cast<Eigen::Index>(span.fitted.size());
  Eigen::MatrixXd result(count, values.cols());
  Eigen::Index first = 0;
  for (const Span& span : spans_) {
    const auto size = static_cast<Eigen::Index>(span.fitted.size());
    result.middleRows(first, size) = span.whitening(values.middleRows(span.first, span.size)(span.fitted, Eigen::all));
    first += size;
  }
  return result;
}

std::vector<double> CurveSet::weigh(const std::vector<double>& parameters) {
  std::vector<double> of_strain(curves_.size(), 0.0);
  for (std::size_t k = 0; k < curves_.size(); ++k) {
    const Curve& curve = curves_[k];
    Span& span = spans_[k];
    const auto repeated = std::count_if(curves_.begin(), curves_.end(),
                                        [&](const Curve& other) { return other.group == curve.group; }) > 1;
    if (repeated || span.size < 3) continue;
    std::vector<Eigen::Index> rows;
    for (Eigen::Index i = span.first; i < span.first + span.size; ++i)
      rows.push_back(places_[static_cast<std::size_t>(i)].row);
    const auto stress_of = [&](const material::BarHistory& history) -> Eigen::VectorXd {
      const auto response = material::pull_bar(*law_, parameters, history, {}, options_);
      return response.rows < curve.stress.size() ? Eigen::VectorXd()
             : curve.engineering                 ? response.engineering
                                                 : response.kirchhoff;
    };
    const Eigen::VectorXd nominal = stress_of(curve.history);
    if (nominal.size() == 0) continue;
    const Eigen::VectorXd slope = slopes(curve.history, nominal, parameters.front())(rows),
                          residual = (curve.stress - nominal)(rows);
    const PointNoise noise = point_noise(curve.history.strain(rows), residual, slope,
                                         curve.estimated ? 0.0 : curve.deviation, curve.strain_noise);
    of_strain[k] = noise.strain;
    const double stress = noise.strain > 0.0 ? noise.stress : curve.deviation;
    const double freedom = std::max(3.0, noise.steep_freedom),
                 in_strain =
                     std::sqrt(freedom / (freedom - 2.0)) * noise.strain;  // few rows tell of it, as Student says
    const auto memory = memory_of_turns(curve.history, noise.strain, nominal, stress_of);
    const Eigen::MatrixXd remembered = memory.errors(in_strain)(rows, Eigen::all);
    const Eigen::VectorXd own = (stress * stress + (in_strain * slope).array().square()).sqrt();
    deviation_.segment(span.first, span.size) =
        (own.array().square() + remembered.rowwise().squaredNorm().array()).sqrt();
    span.whitening = Whitening(own(span.fitted), remembered(span.fitted, Eigen::all));
  }
  return of_strain;
}

Eigen::VectorXd CurveSet::predict(const std::vector<double>& parameters) const {
  Eigen::MatrixXd none;
  return predict(parameters, {}, none);
}

Eigen::VectorXd CurveSet::predict(const std::vector<double>& parameters, const std::vector<int>& free,
                                  Eigen::MatrixXd& derivatives) const {
  Eigen::VectorXd predicted(measured_.size());
  derivatives.resize(measured_.size(), static_cast<Eigen::Index>(free.size()));
  const auto count = static_cast<int>(curves_.size());
  int failed = count;  // the first curve that the law cannot follow
  Eigen::Index failed_row = 0;
#pragma omp parallel for schedule(dynamic)
  for (int k = 0; k < count; ++k) {
    const Curve& curve = curves_[static_cast<std::size_t>(k)];
    const auto response = material::pull_bar(*law_, parameters, curve.history, free, options_);
    if (response.rows < curve.stress.size()) {
#pragma omp critical
      if (k < failed) failed = k, failed_row = response.rows;
      continue;
    }
    Eigen::Index i = spans_[static_cast<std::size_t>(k)].first;
    for (Eigen::Index row = 0; row < curve.stress.size(); ++row) {
      if (curve.use[static_cast<std::size_t>(row)] == Curve::not_judged) continue;
      predicted[i] = curve.engineering ? response.engineering[row] : response.kirchhoff[row];
      derivatives.row(i++) =
          (curve.engineering ? std::exp(-curve.history.strain[row]) : 1.0) * response.derivatives.row(row);
    }
  }
  if (failed < count)
    throw ConvergenceError(fmt::format("{}: the law cannot follow beyond row {}",
                                       curves_[static_cast<std::size_t>(failed)].name, failed_row));
  return predicted;
}

namespace {
/// From the median of absolute values.
double robust_deviation(std::vector<double>& sizes) {
  if (sizes.empty()) return 0.0;
  return median(sizes) / 0.6745;
}
}  // namespace

double point_noise(const Curve& curve) { return noise_of_course(curve.history.strain, curve.stress); }

std::vector<double> distances(const Eigen::VectorXd& x, const Eigen::VectorXd& y,
                              const std::function<bool(Eigen::Index)>& counts) {
  std::vector<double> distance;
  for (Eigen::Index i = 1; i + 1 < x.size(); ++i) {
    const double before = x[i] - x[i - 1], after = x[i + 1] - x[i];
    if (!(before * after > 0.0) || (counts && !counts(i))) continue;  // at a turning point there is no line
    const double w = before / (before + after);
    distance.push_back((y[i] - (1.0 - w) * y[i - 1] - w * y[i + 1]) / std::sqrt(1.0 + w * w + (1.0 - w) * (1.0 - w)));
  }
  return distance;
}

namespace {
/// Huber's proposal 2.
double clipped_deviation(std::vector<double> distance) {
  for (double& d : distance) d = std::abs(d);
  double deviation = robust_deviation(distance);
  constexpr double far = 3.0, expected = 0.99500;  // E min(z^2, 9) of a standard normal number
  for (int iteration = 0; iteration < 20; ++iteration) {
    double square = 0.0;
    for (double d : distance) square += std::pow(std::min(d, far * deviation), 2);
    deviation = std::sqrt(square / (expected * std::max(1.0, static_cast<double>(distance.size()))));
  }
  return deviation;
}
}  // namespace

double point_noise(const Eigen::VectorXd& x, const Eigen::VectorXd& y) { return clipped_deviation(distances(x, y)); }

double noise_of_course(const Eigen::VectorXd& x, const Eigen::VectorXd& y) {
  const double of_line = point_noise(x, y);
  constexpr std::size_t enough = 10;
  std::vector<double> distance;
  for (Eigen::Index i = 2; i + 2 < x.size(); ++i) {
    const Eigen::Vector4d at(x[i - 2], x[i - 1], x[i + 1], x[i + 2]);
    if (!((at.array() < x[i]) == Eigen::Array<bool, 4, 1>(true, true, false, false)).all() &&
        !((at.array() > x[i]) == Eigen::Array<bool, 4, 1>(true, true, false, false)).all())
      continue;
    Eigen::Vector4d share = Eigen::Vector4d::Ones();  // Lagrange's
    for (int k = 0; k < 4; ++k)
      for (int m = 0; m < 4; ++m)
        if (m != k) share[k] *= (x[i] - at[m]) / (at[k] - at[m]);
    if (share.allFinite())
      distance.push_back(std::abs(y[i] - share.dot(Eigen::Vector4d(y[i - 2], y[i - 1], y[i + 1], y[i + 2]))) /
                         std::sqrt(1.0 + share.squaredNorm()));
  }
  const double of_cubic = robust_deviation(distance);
  // most rows of a record that was thinned out and filled again, or of coarse digits, lie on one line
  constexpr double bent = 0.75, interpolated = 1e-3;
  return distance.size() >= enough && of_cubic < bent * of_line && of_cubic > interpolated * of_line ? of_cubic
                                                                                                     : of_line;
}

Eigen::VectorXd slopes(const material::BarHistory& history, const Eigen::VectorXd& stress, double steepest) {
  const Eigen::VectorXd& strain = history.strain;
  Eigen::VectorXd slope = Eigen::VectorXd::Zero(strain.size());
  if (strain.size() < 2) return slope;
  std::vector<double> steps;
  for (Eigen::Index i = 1; i < strain.size(); ++i) steps.push_back(std::abs(strain[i] - strain[i - 1]));
  const double least = 0.1 * median(steps);
  for (Eigen::Index i = 1; i < strain.size(); ++i) {
    const double step = strain[i] - strain[i - 1];
    slope[i] =
        std::abs(step) > least ? std::clamp((stress[i] - stress[i - 1]) / step, -steepest, steepest) : slope[i - 1];
  }
  slope[0] = slope[1];
  for (const auto& turn : history.turns)
    if (turn.between && turn.back && turn.row + 1 < slope.size()) slope[turn.row] = slope[turn.row + 1];
  return slope;
}

namespace {

/// And the noise of the stress where the curve is flat.
std::pair<PointNoise, double> noise_in(const Eigen::VectorXd& strain, const Eigen::VectorXd& residual,
                                       const Eigen::VectorXd& slope, double stress) {
  const double half = 0.5 * slope.cwiseAbs().maxCoeff();
  // A steep course of less rows is hardly resolved: what the law errs by at its ends would be taken for noise.
  constexpr Eigen::Index resolved = 5;
  // length of the steep course that a row belongs to; 0: none
  std::vector<Eigen::Index> course(static_cast<std::size_t>(slope.size()), 0);
  for (Eigen::Index i = 0, from = 0; i <= slope.size(); ++i) {
    if (i < slope.size() && std::abs(slope[i]) > half) continue;
    std::fill(course.begin() + from, course.begin() + i, i - from);
    from = i + 1;
  }
  const auto of = [&](const auto& counts) {
    return distances(strain, residual, [&](Eigen::Index i) {
      return std::all_of(course.begin() + i - 1, course.begin() + i + 2, counts);
    });
  };
  const auto steep = of([](Eigen::Index length) { return length >= resolved; }),
             flat = of([](Eigen::Index length) { return length == 0; });
  constexpr std::size_t enough = 3, known = 10;
  const auto freedom = [](const std::vector<double>& distance) {
    return freedom_of_point_noise(static_cast<Eigen::Index>(distance.size()));
  };
  const bool given = stress > 0.0;
  PointNoise noise{
      .stress = given ? stress : point_noise(strain, residual), .strain = 0.0, .steep_freedom = freedom(steep)};
  const double of_flat = given ? stress : flat.size() < known ? noise.stress : clipped_deviation(flat);
  if (steep.size() < enough || (flat.size() < known && !given)) return {noise, of_flat};
  const double more = std::pow(clipped_deviation(steep), 2) - of_flat * of_flat;
  const double by_chance = of_flat * of_flat * std::sqrt(2.0 / freedom(steep) + (given ? 0.0 : 2.0 / freedom(flat)));
  if (more < 1.5 * by_chance) return {noise, of_flat};
  // What the law errs by goes on from row to row, noise does not: von Neumann's ratio is 2 for noise, in one of a
  // hundred tests 2.33 of its standard deviations less.
  double change = 0.0, size = 0.0, pairs = 0.0;
  for (Eigen::Index i = 1; i < residual.size(); ++i) {
    if (course[static_cast<std::size_t>(i)] < resolved || course[static_cast<std::size_t>(i) - 1] < resolved) continue;
    change += std::pow(residual[i] - residual[i - 1], 2),
        size += 0.5 * (residual[i] * residual[i] + residual[i - 1] * residual[i - 1]), pairs += 1.0;
  }
  if (change < (2.0 - 2.33 * 2.0 * std::sqrt((pairs - 1.0) / (pairs * (pairs + 2.0)))) * size) return {noise, of_flat};
  noise.stress = of_flat;
  double square = 0.0, rows = 0.0;
  for (const double s : slope)
    if (std::abs(s) > half) square += s * s, rows += 1.0;
  noise.strain = std::sqrt(more / (square / rows));
  return {noise, of_flat};
}

}  // namespace

PointNoise point_noise(const Eigen::VectorXd& strain, const Eigen::VectorXd& residual, const Eigen::VectorXd& slope,
                       double stress, double of_strain) {
  auto [noise, of_flat] = noise_in(strain, residual, slope, stress);
  // The course through many rows hardly scatters from one to the next; what it is off by goes together in all rows of a
  // line, as much as noise does in independent ones.
  const bool matters = of_strain * slope.cwiseAbs().maxCoeff() > 0.1 * of_flat;
  if (matters && of_strain > noise.strain)
    noise = {.stress = of_flat, .strain = of_strain, .steep_freedom = freedom_of_point_noise(strain.size())};
  return noise;
}

double scatter(const std::vector<const Curve*>& repetitions) {
  constexpr double turned = 1e-3;  // of the strain: unloading, not noise
  // Each curve's judged rows of ascending strain, in compression of descending one: |strain|, stress the way it goes.
  std::vector<std::vector<std::pair<double, double>>> ascending;
  for (const Curve* curve : repetitions) {
    auto& rows = ascending.emplace_back();
    double way = 0.0;
    for (const double strain : curve->history.strain)
      if (way == 0.0 && std::abs(strain - curve->history.strain[0]) > turned)
        way = std::copysign(1.0, strain - curve->history.strain[0]);
    for (Eigen::Index i = 0; i < curve->stress.size(); ++i) {
      if (curve->use[static_cast<std::size_t>(i)] == Curve::not_judged) continue;
      const double strain = way * curve->history.strain[i];
      if (rows.empty() || strain > rows.back().first)
        rows.emplace_back(strain, way * curve->stress[i]);
      else if (strain < rows.back().first - turned)
        break;
    }
  }
  const auto at = [](const auto& rows, double strain) {
    const auto above = std::lower_bound(rows.begin(), rows.end(), std::pair<double, double>(strain, -INFINITY));
    if (above == rows.end() || (above == rows.begin() && above->first > strain)) return std::nan("");
    if (above == rows.begin()) return above->second;
    const auto below = above - 1;
    return below->second + (above->second - below->second) * (strain - below->first) / (above->first - below->first);
  };
  double longest = 0.0, sum = 0.0;
  for (const auto& rows : ascending)
    if (!rows.empty()) longest = std::max(longest, rows.back().first);
  int strains = 0;
  constexpr int divisions = 200;
  for (int k = 1; k < divisions; ++k) {
    std::vector<double> stresses;
    for (const auto& rows : ascending)
      if (const double stress = at(rows, longest * k / divisions); std::isfinite(stress)) stresses.push_back(stress);
    if (stresses.size() < 2) continue;
    const Eigen::Map<const Eigen::VectorXd> all(stresses.data(), static_cast<Eigen::Index>(stresses.size()));
    sum += (all.array() - all.mean()).square().sum() / static_cast<double>(stresses.size() - 1);
    ++strains;
  }
  return strains > 0 ? std::sqrt(sum / strains) : 0.0;
}

namespace {

/// Residuals over their standard deviations on the fitted rows, with derivatives of the prediction.
struct Weighted {
  Eigen::VectorXd residual;
  Eigen::MatrixXd derivatives;
  std::vector<int> curve;
  double squares = INFINITY;
};

Weighted weighted(const CurveSet& set, const std::vector<double>& parameters, const std::vector<int>& free,
                  bool with_derivatives) {
  Eigen::MatrixXd derivatives;
  const Eigen::VectorXd predicted = set.predict(parameters, with_derivatives ? free : std::vector<int>{}, derivatives);
  Weighted result;
  for (Eigen::Index i = 0; i < predicted.size(); ++i)
    if (set.is_fitted(i)) result.curve.push_back(set.places()[static_cast<std::size_t>(i)].curve);
  result.residual = set.whitened(set.measured() - predicted);
  if (with_derivatives) result.derivatives = set.whitened(derivatives);
  result.squares = result.residual.squaredNorm();
  return result;
}

}  // namespace

CurveFit fit(const CurveSet& set, const std::vector<ParameterInfo>& information, const std::vector<double>& start,
             const std::vector<int>& free, const CurveFitOptions& options,
             const std::function<void(const CurveIterate&)>& report) {
  const auto unknowns = static_cast<Eigen::Index>(free.size());
  const auto of = [&](Eigen::Index j) { return static_cast<std::size_t>(free[static_cast<std::size_t>(j)]); };
  const auto low = [&](Eigen::Index j) { return information[of(j)].lower; };
  const auto high = [&](Eigen::Index j) { return information[of(j)].upper; };
  CurveFit result{.parameters = start,
                  .noise_covariance = {},
                  .covariance = {},
                  .iterates = {},
                  .at_bounds = {},
                  .converged = false};
  // A parameter that the rows do not show, all of whose value moves them by less than a thousandth of a standard
  // deviation, stays where it is.
  const auto derived = [&](const std::vector<double>& parameters) {
    constexpr double nothing = 1e-3;
    Weighted at = weighted(set, parameters, free, true);
    for (Eigen::Index j = 0; j < unknowns; ++j)
      if (const double all = std::max({std::abs(parameters[of(j)]), std::abs(start[of(j)]), information[of(j)].scale});
          all > 0.0 && all * at.derivatives.col(j).norm() < nothing)
        at.derivatives.col(j).setZero();
    return at;
  };
  Weighted now = derived(start);
  const auto rows = static_cast<double>(now.residual.size());
  const auto note = [&](double eta) {
    result.iterates.push_back({result.parameters, eta, std::sqrt(now.squares / std::max(1.0, rows))});
    if (report) report(result.iterates.back());
  };
  note(0.0);

  const auto held = [&](Eigen::Index j, double gradient) {  // on a bound, and the cost falls beyond it
    const double value = result.parameters[of(j)];
    return (value <= low(j) && gradient < 0.0) || (value >= high(j) && gradient > 0.0);
  };
  double damping = 1e-3;
  for (int iteration = 1; iteration <= options.max_iterations && !result.converged; ++iteration) {
    const Eigen::MatrixXd H = now.derivatives.transpose() * now.derivatives;
    const Eigen::VectorXd g = now.derivatives.transpose() * now.residual;
    bool better = false;
    for (int attempt = 0; attempt < 30 && !better; ++attempt) {
      Eigen::VectorXd to_low(unknowns), to_high(unknowns);
      for (Eigen::Index j = 0; j < unknowns; ++j)
        to_low[j] = low(j) - result.parameters[of(j)], to_high[j] = high(j) - result.parameters[of(j)];
      const Eigen::VectorXd step = bounded_step(H, g, to_low, to_high, damping);
      std::vector<double> trial = result.parameters;
      double eta = 0.0;
      for (Eigen::Index j = 0; j < unknowns; ++j) {
        trial[of(j)] = std::clamp(trial[of(j)] + step[j], low(j), high(j));
        const double size =
            std::max(std::abs(trial[of(j)]), information[of(j)].effect.empty() ? 0.0 : 1e-3 * information[of(j)].scale);
        if (step[j] != 0.0) eta = std::max(eta, std::abs(step[j]) / size);  // Eq. (13)
      }
      if (eta == 0.0) {
        result.converged = better = true;
        break;
      }
      double squares = INFINITY;
      try {
        squares = weighted(set, trial, free, false).squares;
      } catch (const ConvergenceError&) {  // beyond what the law can follow: a shorter step
      }
      if (squares <= now.squares) {
        better = true;
        const bool at_rest = now.squares - squares < 1e-9 * now.squares && damping < 1.0;
        result.parameters = trial;
        now = derived(trial);
        result.converged = eta < options.eta || at_rest;
        damping = std::max(1e-10, damping * 0.2);
        note(eta);
      } else if (eta < 1e-9) {
        result.converged = better = true;  // no digits left
      } else {
        damping = std::max(1e-6, damping * 5.0);
      }
    }
    if (!better) break;
  }

  // Covariance of the parameters that are not on a bound; the rest does not move.
  const Eigen::VectorXd g = now.derivatives.transpose() * now.residual;
  std::vector<Eigen::Index> open;
  for (Eigen::Index j = 0; j < unknowns; ++j) {
    const double value = result.parameters[of(j)];
    if (value <= low(j) || value >= high(j)) result.at_bounds.push_back(free[static_cast<std::size_t>(j)]);
    if (!held(j, g[j]) && now.derivatives.col(j).squaredNorm() > 0.0) open.push_back(j);
  }
  result.noise_covariance = result.covariance = Eigen::MatrixXd::Constant(unknowns, unknowns, std::nan(""));
  if (open.empty()) return result;
  const Eigen::MatrixXd J = now.derivatives(Eigen::all, open);
  const auto [inverse, undetermined] = inverse_of_seen(J.transpose() * J);
  result.noise_covariance(open, open) = inverse;
  // Rows of one bar err together: each bar of a group is off by the group's scatter, the same all along.
  Eigen::MatrixXd meat = Eigen::MatrixXd::Zero(J.cols(), J.cols());
  for (std::size_t k = 0; k < set.curves().size(); ++k) {
    const Curve& curve = set.curves()[k];
    std::vector<const Curve*> repetitions;
    for (const Curve& other : set.curves())
      if (other.group == curve.group) repetitions.push_back(&other);
    Eigen::VectorXd sum = Eigen::VectorXd::Zero(J.cols());
    for (Eigen::Index i = 0; i < J.rows(); ++i)
      if (now.curve[static_cast<std::size_t>(i)] == static_cast<int>(k)) sum += J.row(i).transpose();
    if (repetitions.size() < 2) continue;
    sum *= scatter(repetitions) / curve.deviation;
    meat += sum * sum.transpose();
  }
  result.covariance(open, open) = inverse + inverse * meat * inverse;
  for (const Eigen::Index i : undetermined)
    for (Eigen::MatrixXd* part : {&result.noise_covariance, &result.covariance}) {
      const Eigen::Index j = open[static_cast<std::size_t>(i)];
      part->row(j).setZero(), part->col(j).setZero();
      (*part)(j, j) = INFINITY;
    }
  return result;
}

Misfit misfit(const CurveSet& set, const Eigen::VectorXd& predicted, const std::string& group, bool fitted) {
  Misfit sum;
  std::vector<double> sizes;
  for (Eigen::Index i = 0; i < predicted.size(); ++i) {
    const Curve& curve = set.curves()[static_cast<std::size_t>(set.places()[static_cast<std::size_t>(i)].curve)];
    if (set.is_fitted(i) != fitted || (!group.empty() && curve.group != group)) continue;
    const double gap = set.measured()[i] - predicted[i];
    sizes.push_back(std::abs(gap));
    sum.stress += gap * gap;
    sum.chi += gap * gap / (set.standard_deviation()[i] * set.standard_deviation()[i]);
    ++sum.rows;
  }
  if (sum.rows == 0) return sum;
  sum.stress = std::sqrt(sum.stress / static_cast<double>(sum.rows)),
  sum.chi = std::sqrt(sum.chi / static_cast<double>(sum.rows));
  sum.typical = robust_deviation(sizes);
  return sum;
}

}  // namespace imic3d::identification
