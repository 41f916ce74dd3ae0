#include "imic3d/loop/fit.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>

#include "imic3d/core/bounded_step.hpp"
#include "imic3d/core/error.hpp"
#include "imic3d/core/linear.hpp"

namespace imic3d::loop {

namespace {

/// Ratio of two variances that `draws` of numbers that may all go together tell: its logarithm, of variance 4/draws by
/// chance, drawn towards 0 by as much (James and Stein's positive part).
double told_ratio(double squares, double of_other, double draws) {
  if (squares == 0.0) return 0.0;
  const double logarithm = std::log(squares / of_other);
  return std::exp(logarithm * std::max(0.0, 1.0 - 4.0 / (draws * std::max(1e-12, logarithm * logarithm))));
}

}  // namespace

Weight::Weight(const std::vector<Datum>& data, const Eigen::MatrixXd& null, int window, bool apart) {
  std::vector<std::pair<Eigen::Index, Eigen::Index>> frames;  // first row, rows; apart: of a channel in a frame
  int each = 0;                                               // of these a frame
  for (std::size_t i = 0; i < data.size(); ++i) {
    if (i == 0 || data[i].frame != data[i - 1].frame || (apart && data[i].channel != data[i - 1].channel)) {
      frames.emplace_back(static_cast<Eigen::Index>(i), 0);
      if (data[i].frame == data.front().frame) ++each;
    }
    ++frames.back().second;
  }
  if (null.cols() == 0) return;
  const auto draws_of = [&](std::size_t t) { return null.middleRows(frames[t].first, frames[t].second); };
  for (std::size_t t = 0; t < frames.size(); ++t) {
    const auto [first, rows] = frames[t];
    const double squares = draws_of(t).squaredNorm();
    Eigen::MatrixXd sum = Eigen::MatrixXd::Zero(rows, rows);
    double count = 0.0;
    for (int k = -window; k <= window; ++k) {
      const auto place = static_cast<std::ptrdiff_t>(t) + k * each;
      if (place < 0 || place >= static_cast<std::ptrdiff_t>(frames.size())) continue;
      const auto other = static_cast<std::size_t>(place);
      const double of_other = draws_of(other).squaredNorm();
      if (frames[other].second != rows || of_other == 0.0) continue;
      sum += told_ratio(squares, of_other, static_cast<double>(null.cols())) * draws_of(other) *
             draws_of(other).transpose();
      count += static_cast<double>(null.cols());
    }
    if (sum.isZero(0.0)) sum = Eigen::MatrixXd::Identity(rows, rows), count = 1.0;
    const double share = static_cast<double>(rows) / (static_cast<double>(rows) + count);
    const Eigen::MatrixXd covariance = (1.0 - share) * sum / count + share * Eigen::MatrixXd::Identity(rows, rows);
    blocks_.emplace_back(first, inverse_cholesky(covariance));
  }
}

Eigen::MatrixXd Weight::operator()(const Eigen::MatrixXd& rows) const {
  if (blocks_.empty()) return rows;
  Eigen::MatrixXd result(rows.rows(), rows.cols());
  for (const auto& [first, inverse] : blocks_)
    result.middleRows(first, inverse.rows()) =
        inverse.triangularView<Eigen::Lower>() * rows.middleRows(first, inverse.rows());
  return result;
}

Eigen::MatrixXd Weight::undone(const Eigen::MatrixXd& rows) const {
  if (blocks_.empty()) return rows;
  Eigen::MatrixXd result(rows.rows(), rows.cols());
  for (const auto& [first, inverse] : blocks_)
    result.middleRows(first, inverse.rows()) =
        inverse.triangularView<Eigen::Lower>().solve(rows.middleRows(first, inverse.rows()));
  return result;
}

std::vector<Eigen::Index> rows_of_frames(const std::vector<Datum>& data, const std::vector<char>& frames) {
  std::vector<Eigen::Index> rows;
  for (std::size_t i = 0; i < data.size(); ++i)
    if (frames[static_cast<std::size_t>(data[i].frame)] != 0) rows.push_back(static_cast<Eigen::Index>(i));
  return rows;
}

bool on_bound(const Parameter& parameter, double value) {
  const auto& info = parameter.info;
  if (info.shape) return false;
  const double margin = info.null_value && std::isfinite(info.upper - info.lower) ? 0.01 * (info.upper - info.lower)
                                                                                  : 0.1 * parameter.step;
  const double above = info.null_value == info.lower ? std::min(margin, 0.1 * parameter.step) : margin;
  return value < info.lower + above || value > info.upper - margin;
}

namespace {

/// A step of the parameter that stays within its bounds.
double signed_step(const Parameter& parameter, double value) {
  const double step = parameter.info.shape && value != 0.0 ? 1e-3 * std::abs(value) : parameter.step;
  return value + step <= parameter.info.upper ? step : -step;
}

struct Linear {
  Eigen::VectorXd residual;
  Eigen::MatrixXd sensitivity;
  bool exact = true;  // not carried on by secants
};

Linear linearise(Experiment& experiment, const Weight& weight, const std::vector<double>& at,
                 const std::vector<int>& parameters) {
  std::vector<std::vector<double>> sets(parameters.size(), at);
  std::vector<double> moves;
  for (std::size_t j = 0; j < parameters.size(); ++j) {
    const auto k = static_cast<std::size_t>(parameters[j]);
    moves.push_back(signed_step(experiment.parameters()[k], at[k]));
    sets[j][k] += moves.back();
  }
  const auto residuals = experiment.residuals_near(at, sets);
  Linear result;
  if (residuals.front().size() == 0) return result;
  result.residual = weight(residuals.front());
  result.sensitivity.setZero(result.residual.size(), static_cast<Eigen::Index>(parameters.size()));
  constexpr double nothing = 1e-3;
  for (std::size_t j = 0; j < parameters.size(); ++j) {
    if (residuals[1 + j].size() == 0) continue;
    const auto k = static_cast<std::size_t>(parameters[j]);
    auto column = result.sensitivity.col(static_cast<Eigen::Index>(j));
    column = weight((residuals.front() - residuals[1 + j]) / moves[j]);
    const Parameter& its = experiment.parameters()[k];
    const double all = std::max({std::abs(at[k]), std::abs(its.value), its.info.scale});
    if (all > 0.0 && all * column.norm() < nothing) column.setZero();
  }
  return result;
}

/// The sensitivity carried on over a step to where the residual is known (Broyden 1965), in which each parameter counts
/// by its effect.
Linear secant(const Linear& from, const Eigen::VectorXd& step, Eigen::VectorXd residual) {
  Linear to{std::move(residual), from.sensitivity, false};
  const Eigen::VectorXd along = from.sensitivity.colwise().squaredNorm().transpose().cwiseProduct(step);
  if (const double size = along.dot(step); size > 0.0)
    to.sensitivity += (from.residual - to.residual - from.sensitivity * step) * along.transpose() / size;
  return to;
}

/// Finds Fit::held.
void hold_at_bounds(Fit& fit, const std::vector<Eigen::Index>& rows, const std::vector<Parameter>& parameters) {
  const Eigen::MatrixXd J = fit.sensitivity(rows, Eigen::all);
  const Eigen::VectorXd r = fit.residual(rows);
  for (Eigen::Index j = 0; j < J.cols(); ++j) {
    const int k = fit.free[static_cast<std::size_t>(j)];
    const auto& info = parameters[static_cast<std::size_t>(k)].info;
    const double value = fit.values[static_cast<std::size_t>(k)], edge = 1e-6 * (info.upper - info.lower);
    if (info.null_value || !std::isfinite(edge)) continue;
    const double pull = J.col(j).dot(r);
    if (!(value <= info.lower + edge && pull < 0.0) && !(value >= info.upper - edge && pull > 0.0)) continue;
    if (pull * pull <= 10.0 * J.col(j).squaredNorm()) continue;
    fit.held.push_back(k);
    fit.sensitivity.col(j).setZero();
  }
}

}  // namespace

std::array<double, 2> other_shapes(const Parameter& shape, double value) {
  const double usual = shape.info.scale > 0.0 ? shape.info.scale : 1.0;
  const double low = value != 0.0 ? value / 8.0 : usual / 3.0, high = value != 0.0 ? 8.0 * value : usual;
  return {std::clamp(low, shape.info.lower, shape.info.upper), std::clamp(high, shape.info.lower, shape.info.upper)};
}

namespace {

/// The few directions that hold nearly all of what the marks at many places are beside those in `columns` [N x any].
Eigen::MatrixXd directions_beside(const Eigen::MatrixXd& columns, Eigen::MatrixXd places) {
  const auto unit = [](Eigen::MatrixXd& all) {
    for (auto column : all.colwise()) column /= std::max(column.norm(), 1e-300);
  };
  unit(places);
  const Eigen::MatrixXd Q = orthonormal(columns);
  places -= Q * (Q.transpose() * places);
  const SymmetricEigen eigen = symmetric_eigen(places.transpose() * places);
  const Eigen::Index count = places.cols();
  Eigen::Index kept = 0;
  double left = eigen.values.cwiseMax(0.0).sum();
  for (; kept < std::min<Eigen::Index>(9, count) && left > 0.1 * static_cast<double>(count); ++kept)
    left -= eigen.values[count - 1 - kept];
  return places * eigen.vectors.rightCols(kept);
}

}  // namespace

namespace {

/// Sets of values whose residuals make the columns of candidates' marks.
struct Asked {
  struct Column {
    std::size_t moved;  // among the residuals, of which the first is that of no move
    double step;
  };
  std::vector<std::vector<double>> sets;
  std::vector<std::vector<Column>> columns;  // of each candidate
};

Asked asked_for(const Experiment& experiment, const std::vector<double>& values, const std::vector<int>& candidates) {
  Asked asked;
  const auto& parameters = experiment.parameters();
  const auto place_of = [](int j) { return static_cast<std::size_t>(j); };
  for (int k : candidates) {
    auto& its = asked.columns.emplace_back();
    const auto& candidate = experiment.candidates()[static_cast<std::size_t>(k)];
    std::vector<int> sizes, shapes;
    for (int j : candidate.parameters) (parameters[place_of(j)].info.shape ? shapes : sizes).push_back(j);
    const auto add = [&](std::vector<double> set, const std::vector<int>& moved) {
      double step = 1.0;
      for (int j : moved) step = signed_step(parameters[place_of(j)], values[place_of(j)]), set[place_of(j)] += step;
      asked.sets.push_back(std::move(set));
      its.push_back({asked.sets.size(), step});
    };
    for (int j : sizes) add(values, {j});
    for (int j : candidate.elsewhere.empty() ? shapes : std::vector<int>{})
      for (double shape : other_shapes(parameters[place_of(j)], values[place_of(j)])) {  // every size a step from null
        std::vector<double> set = values;
        set[place_of(j)] = shape;
        add(std::move(set), sizes);
      }
    for (const auto& place : candidate.elsewhere) {
      std::vector<double> set = values;
      for (std::size_t i = 0; i < shapes.size(); ++i) set[place_of(shapes[i])] = place[i];
      for (int j : sizes) add(set, {j});
    }
  }
  return asked;
}

}  // namespace

std::vector<Mark> marks(Experiment& experiment, const Weight& weight, const std::vector<double>& values,
                        const std::vector<int>& candidates) {
  const auto [sets, columns] = asked_for(experiment, values, candidates);
  const auto& parameters = experiment.parameters();
  const auto place_of = [](int j) { return static_cast<std::size_t>(j); };
  const auto residuals = experiment.residuals_near(values, sets);
  const Eigen::VectorXd& here = residuals.front();
  std::vector<Mark> result;
  for (std::size_t i = 0; i < columns.size(); ++i) {
    const auto& its = columns[i];
    auto& mark = result.emplace_back(Eigen::MatrixXd::Zero(here.size(), static_cast<Eigen::Index>(its.size())));
    for (std::size_t c = 0; c < its.size(); ++c) {
      const auto& moved = residuals[its[c].moved];
      if (here.size() == 0 || moved.size() == 0)
        ++mark.failed;
      else if ((here - moved).norm() > experiment.round_off())
        mark.columns.col(static_cast<Eigen::Index>(c)) = weight((here - moved) / its[c].step);
    }
    const auto& candidate = experiment.candidates()[static_cast<std::size_t>(candidates[i])];
    if (candidate.elsewhere.empty()) continue;
    const auto sizes = std::count_if(candidate.parameters.begin(), candidate.parameters.end(),
                                     [&](int j) { return !parameters[place_of(j)].info.shape; });
    const Eigen::MatrixXd here_and_there = std::move(mark.columns), own = here_and_there.leftCols(sizes);
    mark.elsewhere = here_and_there.rightCols(here_and_there.cols() - sizes);
    const Eigen::MatrixXd others = directions_beside(own, mark.elsewhere);
    mark.columns.resize(own.rows(), sizes + others.cols());
    mark.columns << own, others;
  }
  return result;
}

std::optional<DisturbedMarks> disturbed_marks(Experiment& experiment, const Weight& weight,
                                              const std::vector<double>& values, const std::vector<int>& candidates,
                                              const std::vector<int>& free, double times) {
  auto [sets, columns] = asked_for(experiment, values, candidates);
  auto& its = columns.emplace_back();  // of the free parameters
  for (int j : free) {
    const auto place = static_cast<std::size_t>(j);
    const double step = signed_step(experiment.parameters()[place], values[place]);
    sets.push_back(values), sets.back()[place] += step;
    its.push_back({sets.size(), step});
  }
  const auto residuals = experiment.residuals_disturbed(values, sets, times);
  if (residuals.empty() || std::any_of(residuals.begin(), residuals.end(), [](const auto& r) { return r.size() == 0; }))
    return std::nullopt;
  DisturbedMarks result;
  for (const auto& of_one : columns) {
    auto& all = result.columns.emplace_back(residuals.front().size(), static_cast<Eigen::Index>(of_one.size()));
    for (std::size_t c = 0; c < of_one.size(); ++c)
      all.col(static_cast<Eigen::Index>(c)) = weight((residuals.front() - residuals[of_one[c].moved]) / of_one[c].step);
  }
  result.sensitivity = std::move(result.columns.back());
  result.columns.pop_back();
  return result;
}

Fit fit(Experiment& experiment, const Weight& weight, const std::vector<Eigen::Index>& rows,
        const std::vector<int>& free, std::vector<double> start, const FitOptions& options) {
  std::vector<Parameter> parameters = experiment.parameters();
  for (int j : options.released) {
    auto& info = parameters[static_cast<std::size_t>(j)].info;
    info.lower -= 0.5 * std::abs(info.lower), info.upper += std::abs(info.upper);
  }
  const auto unknowns = static_cast<Eigen::Index>(free.size());
  const auto prior_cost = [&](const std::vector<double>& values) {
    double sum = 0.0;
    for (int j = 0; j < static_cast<int>(parameters.size()); ++j) {
      const Parameter& p = parameters[static_cast<std::size_t>(j)];
      if (p.prior > 0.0 && (p.reading || std::find(free.begin(), free.end(), j) != free.end()))
        sum += std::pow((values[static_cast<std::size_t>(j)] - p.expected()) / p.prior, 2);
    }
    return sum;
  };
  Fit result{.free = free, .values = std::move(start), .residual = {}, .sensitivity = {}};
  double damping = 1e-8;  // Levenberg's and Marquardt's
  const bool costly = std::any_of(free.begin(), free.end(), [&](int j) { return experiment.takes_simulations(j); });
  Linear at;
  // small: steps in a row that took hardly anything off of what was expected
  int last = options.max_iterations.value_or(experiment.most_iterations()), small = 0;
  for (result.iterations = 0; result.iterations <= last; ++result.iterations) {
    if (at.residual.size() == 0 || (result.iterations == last && !at.exact))
      at = linearise(experiment, weight, result.values, free);
    if (at.residual.size() == 0) {
      const std::string obstacle = experiment.obstacle(result.values);
      throw ConvergenceError("the model cannot be computed where its identification starts" +
                             (obstacle.empty() ? obstacle : ": " + obstacle));
    }
    result.residual = at.residual;
    result.sensitivity = at.sensitivity;
    const Eigen::VectorXd r = at.residual(rows);
    result.cost = r.squaredNorm() + prior_cost(result.values);
    if (result.iterations == last) break;
    const Eigen::MatrixXd J = at.sensitivity(rows, Eigen::all);
    Eigen::MatrixXd H = J.transpose() * J;
    Eigen::VectorXd b = J.transpose() * r, low(unknowns), high(unknowns);
    for (Eigen::Index j = 0; j < unknowns; ++j) {
      const auto k = static_cast<std::size_t>(free[static_cast<std::size_t>(j)]);
      const Parameter& p = parameters[k];
      const double value = result.values[k], size = std::abs(value);
      if (p.prior > 0.0) H(j, j) += 1.0 / (p.prior * p.prior), b[j] -= (value - p.expected()) / (p.prior * p.prior);
      // A parameter changes by no more than half; a shape may lie anywhere over decades; the size of an effect is free.
      const double down = p.info.shape        ? (size > 0.0 ? 0.7 * size : 0.1 * p.info.scale)
                          : p.info.null_value ? INFINITY
                                              : std::max(0.5 * size, 0.1 * std::abs(p.value));
      const double up = p.info.shape && size > 0.0 ? 2.0 * size : down;
      low[j] = std::max(-down, p.info.lower - value), high[j] = std::min(up, p.info.upper - value);
    }
    const Eigen::VectorXd full = bounded_step(H, b, low, high, 1e-12);
    const double expected = result.expected = 2.0 * b.dot(full) - full.dot(H * full);
    if (expected <
        std::max(options.tolerance * static_cast<double>(std::max<Eigen::Index>(1, unknowns)), 1e-6 * result.cost)) {
      if (!at.exact) {
        at = {};
        continue;
      }
      result.converged = true;
      break;
    }
    // More and more damped until the residual falls. The first step is taken as a rule: its derivatives are found with
    // it, where they do not take simulations of their own. Where they do, they are found anew when their secants no
    // longer serve.
    bool moved = false;
    for (int trial = 0; trial < 8 && !moved; ++trial) {
      const Eigen::VectorXd step = bounded_step(H, b, low, high, damping);
      std::vector<double> values = result.values;
      for (Eigen::Index j = 0; j < unknowns; ++j)
        values[static_cast<std::size_t>(free[static_cast<std::size_t>(j)])] += step[j];
      Linear there;
      const bool with_derivatives = trial == 0 && !costly;
      if (with_derivatives)
        there = linearise(experiment, weight, values, free);
      else if (const auto residual = experiment.residuals({values}).front(); residual.size() > 0)
        there = secant(at, step, weight(residual));
      const double cost = there.residual.size() == 0
                              ? INFINITY
                              : Eigen::VectorXd(there.residual(rows)).squaredNorm() + prior_cost(values);
      if (cost < result.cost) {
        const bool as_expected = result.cost - cost > 0.5 * (2.0 * b.dot(step) - step.dot(H * step));
        small = result.cost - cost < std::max(1e-4 * result.cost, 0.01 * expected) ? small + 1 : 0;
        result.values = std::move(values), moved = true;
        at = with_derivatives || (trial == 0 && as_expected) ? std::move(there) : Linear{};
        if (trial == 0) damping = std::max(1e-10, 0.1 * damping);
      } else {
        damping = std::max(1e-4, 10.0 * damping);
      }
    }
    if (!moved && !at.exact) {
      at = {};
    } else if (!moved) {
      result.converged = expected < 0.05 * static_cast<double>(unknowns) || expected < 1e-6 * result.cost;
      break;
    }
    // As along a wall beyond which the model cannot follow.
    if (small == 4) last = std::min(last, result.iterations + 1);
  }
  for (Eigen::Index j = 0; j < unknowns; ++j) {
    const int k = free[static_cast<std::size_t>(j)];
    if (result.sensitivity.col(j).isZero(0.0) && !(parameters[static_cast<std::size_t>(k)].prior > 0.0))
      result.unseen.push_back(k);
  }
  hold_at_bounds(result, rows, parameters);
  return result;
}

}  // namespace imic3d::loop
