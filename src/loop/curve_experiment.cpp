#include "imic3d/loop/curve_experiment.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <random>

#include "declared.hpp"
#include "imic3d/core/error.hpp"
#include "imic3d/core/linear.hpp"
#include "imic3d/loop/law_effects.hpp"
#include "imic3d/loop/statistics.hpp"

namespace imic3d::loop {

namespace id = identification;

std::pair<Candidate, Parameter> gain_of(const std::string& group, int parameter) {
  const std::string name = "gain of " + group;
  return {{.name = name, .link = Link::record, .parameters = {parameter},
           .sentence = "the bars of " + group + " carry more or less than the others, by a factor: another batch, section or load cell",
           .confused_with = "whatever sets these tests apart, such as their rate", .separated_by = "bars of one batch on one machine under both conditions", .after = {}},
          {.info = {.name = name, .unit = "-", .description = "stress of these bars over that of the others", .lower = 0.5, .upper = 2.0, .null_value = 1.0, .scale = 0.02}, .value = 1.0, .step = 1e-3, .prior = 0.0, .free = false}};
}

CurveExperiment::CurveExperiment(Communicator world, std::vector<id::Curve> curves, CurveModel model, const CurveLoopOptions& options)
    : world_(world), curves_(std::move(curves)), model_(std::move(model)) {
  for (std::size_t j = 0; j < model_.values.size(); ++j) {
    const auto& info = model_.information[j];
    if (model_.declared[j] == 0) {
      parameters_.push_back(at_null(info));
      continue;
    }
    const double value = model_.values[j];
    parameters_.push_back({.info = info, .value = value, .step = 1e-4 * (value != 0.0 ? std::abs(value) : info.scale > 0.0 ? info.scale : 1.0),
                           .prior = model_.priors[j], .free = model_.free[j] != 0});
  }
  std::size_t shortest = 0;
  for (std::size_t k = 0; k < curves_.size(); ++k) {
    const id::Curve& curve = curves_[k];
    Scene& scene = scenes_.emplace_back();
    scene.time = curve.history.time, scene.force = curve.stress, scene.start_time = curve.history.time[0];
    scene.elongation = curve.history.strain;
    const auto duration = [](const Scene& s) { return s.time[s.time.size() - 1] - s.start_time; };
    if (duration(scene) < duration(scenes_[shortest])) shortest = k;
  }
  std::vector<std::string> keys;
  for (auto& effect : effects()) {
    if (!effect->acts_on_curves() || std::none_of(scenes_.begin(), scenes_.end(), [&](const Scene& scene) { return effect->applies(scene); })) continue;
    const auto description = effect->describe(scenes_[shortest]);
    Candidate candidate{description.name, description.link, {}, description.sentence, description.confused_with, description.separated_by, {}};
    keys.push_back(key_of(description.name));
    first_.push_back(parameters_.size());
    for (const auto& q : description.quantities) {
      const int place = static_cast<int>(parameters_.size());
      parameters_.push_back({.info = {.name = q.name, .unit = model_.unit(q.unit == "force" ? "stress" : q.unit), .description = q.description, .lower = q.lower, .upper = q.upper, .null_value = q.null, .shape = q.shape, .scale = q.shape ? q.scale : std::abs(q.size - q.null)},
                             .value = q.null, .step = q.step, .prior = 0.0, .free = false});
      if (!declare(parameters_.back(), keys.back(), model_.effects)) candidate.parameters.push_back(place);
    }
    if (!candidate.parameters.empty()) candidates_.push_back(std::move(candidate));
    effects_.push_back(std::move(effect));
  }
  for (const auto& one : model_.effects)
    if (std::find(keys.begin(), keys.end(), one.effect) == keys.end())
      throw InputError("effects." + one.effect, "declared for stress-strain curves, on which it does not act or of which too little is known", fmt::format("one of {}", fmt::join(keys, ", ")));
  first_.push_back(parameters_.size());
  std::vector<std::string> groups;
  for (const auto& curve : curves_)
    if (std::find(groups.begin(), groups.end(), curve.group) == groups.end()) groups.push_back(curve.group);
  if (groups.size() > 1)
    for (const auto& group : groups) {
      group_gains_.emplace_back(group, parameters_.size());
      auto [candidate, gain] = gain_of(group, static_cast<int>(parameters_.size()));
      candidates_.push_back(std::move(candidate));
      parameters_.push_back(std::move(gain));
    }
  const auto law = law_candidates(model_.information, model_.declared);
  candidates_.insert(candidates_.end(), law.begin(), law.end());
  make_bins(options);
  find_repetitions();
  whitening_ = whitening_of(scatter_);
}

namespace {

/// Length of the way of what follows y within `play` [rows]: of the noise nothing.
Eigen::VectorXd way_of(const Eigen::VectorXd& y, double play = 0.0) {
  Eigen::VectorXd way = Eigen::VectorXd::Zero(y.size());
  double at = y[0];
  for (Eigen::Index row = 1; row < y.size(); ++row) {
    const double next = std::clamp(at, y[row] - play, y[row] + play);
    way[row] = way[row - 1] + std::abs(next - at);
    at = next;
  }
  return way;
}

/// Piecewise linear.
double interpolated(const Eigen::VectorXd& x, const Eigen::VectorXd& y, double at) {
  const auto above = std::upper_bound(x.begin(), x.end(), at) - x.begin();
  if (above == 0) return y[0];
  if (above == x.size()) return y[above - 1];
  return y[above - 1] + (y[above] - y[above - 1]) * (at - x[above - 1]) / (x[above] - x[above - 1]);
}

}  // namespace

void CurveExperiment::make_bins(const CurveLoopOptions& options) {
  struct Group {
    int bars = 0;
    Eigen::VectorXd strain, both;  // way of its longest bar [rows]; both: from 0 to 1
  };
  std::map<std::string, Group> groups;
  const auto judged = [](const id::Curve& curve, Eigen::Index row) { return curve.use[static_cast<std::size_t>(row)] != id::Curve::not_judged; };
  for (const auto& curve : curves_) {
    Group& group = groups[curve.group];
    ++group.bars;
    const Eigen::VectorXd strain = way_of(curve.history.strain);
    if (group.strain.size() > 0 && strain.tail(1)[0] <= group.strain.tail(1)[0]) continue;
    const Eigen::VectorXd stress = way_of(curve.stress, 4.0 * id::point_noise(curve));
    group.strain = strain, group.both = 0.5 * (strain / std::max(1e-300, strain.tail(1)[0]) + stress / std::max(1e-300, stress.tail(1)[0]));
    group.both /= std::max(1e-300, group.both.tail(1)[0]);
  }
  std::vector<double> of_points;
  int frame = -1;
  for (std::size_t k = 0; k < curves_.size(); ++k) {
    const id::Curve& curve = curves_[k];
    const Group& group = groups[curve.group];
    const int count = group.bars;
    const double noise = count > 1 ? id::point_noise(curve) : curve.deviation;
    const Eigen::VectorXd along = way_of(curve.history.strain);
    const auto first = static_cast<Eigen::Index>(bins_.size());
    for (Eigen::Index row = 0; row < curve.stress.size(); ++row) {
      if (!judged(curve, row)) continue;
      const double x = interpolated(group.strain, group.both, along[row]);
      const bool held = curve.use[static_cast<std::size_t>(row)] == id::Curve::held_out;
      const int number = count > 1 ? std::min(options.bins - 1, static_cast<int>(x * options.bins)) : static_cast<int>(row);
      const bool same = static_cast<Eigen::Index>(bins_.size()) > first && bins_.back().number == number && bins_.back().held_out == held;
      if (!same) bins_.push_back({static_cast<int>(k), number, 0.0, {}, held});
      bins_.back().rows.push_back(row);
      bins_.back().x += x;
    }
    const auto size = static_cast<Eigen::Index>(bins_.size()) - first;
    bars_.emplace_back(first, size);
    // A bar is a frame; a curve without repetition is cut into pieces, which end where its use changes.
    int in_frame = 0;
    for (Eigen::Index i = first; i < first + size; ++i) {
      Bin& bin = bins_[static_cast<std::size_t>(i)];
      bin.x /= static_cast<double>(bin.rows.size());
      of_points.push_back(noise / std::sqrt(static_cast<double>(bin.rows.size())));
      const bool next = i == first || (count == 1 && in_frame >= options.numbers_per_frame) || bin.held_out != bins_[static_cast<std::size_t>(i) - 1].held_out;
      if (next) ++frame, in_frame = 0;
      ++in_frame;
      data_.push_back({frame, force_channel});
    }
  }
  if (data_.empty()) throw InputError("experiments", "no row that is judged", "rows beyond `from`");
  of_points_ = Eigen::Map<const Eigen::VectorXd>(of_points.data(), static_cast<Eigen::Index>(of_points.size()));
  scatter_.noise = of_points_;
}

std::vector<int> CurveExperiment::frame_numbers() const {
  std::vector<int> numbers;
  for (int t = 0; t <= data_.back().frame; ++t) numbers.push_back(t);
  return numbers;
}

std::string CurveExperiment::frame_name(int frame) const {
  const auto at = std::find_if(data_.begin(), data_.end(), [&](const Datum& d) { return d.frame == frame; }) - data_.begin();
  auto last = static_cast<std::size_t>(at);
  while (last + 1 < data_.size() && data_[last + 1].frame == frame) ++last;
  const Bin &from = bins_[static_cast<std::size_t>(at)], &to = bins_[last];
  const auto& curve = curves_[static_cast<std::size_t>(from.curve)];
  return curve.name + " (" + curve.group + "), rows " + std::to_string(from.rows.front()) + "-" + std::to_string(to.rows.back());
}

int CurveExperiment::curve_of(int frame) const {
  return bins_[static_cast<std::size_t>(std::find_if(data_.begin(), data_.end(), [&](const Datum& d) { return d.frame == frame; }) - data_.begin())].curve;
}

bool CurveExperiment::cut_into_pieces(int curve) const {
  const auto [first, size] = bars_[static_cast<std::size_t>(curve)];
  return size > 0 && data_[static_cast<std::size_t>(first)].frame != data_[static_cast<std::size_t>(first + size) - 1].frame;
}

std::vector<int> CurveExperiment::held_out() const {
  std::vector<int> held;
  for (std::size_t i = 0; i < bins_.size(); ++i)
    if (bins_[i].held_out && (held.empty() || held.back() != data_[i].frame)) held.push_back(data_[i].frame);
  if (!held.empty()) return held;
  std::map<std::string, int> seen;
  for (const auto& [first, size] : bars_) {
    const auto& bin = bins_[static_cast<std::size_t>(first)];
    if (size > 0 && !cut_into_pieces(bin.curve) && seen[curves_[static_cast<std::size_t>(bin.curve)].group]++ % 4 == 2) held.push_back(data_[static_cast<std::size_t>(first)].frame);
  }
  return held;
}

std::span<const double> CurveExperiment::values_of(std::size_t effect, const std::vector<double>& values) const {
  return std::span(values).subspan(first_[effect], first_[effect + 1] - first_[effect]);
}

CurveExperiment::Law CurveExperiment::law_of(const std::vector<double>& values) const {
  Law result;
  // Effects of the law cost time: only those that are there.
  auto& there = result.effects;
  for (std::size_t j = 0; j < model_.values.size(); ++j) {
    const auto& info = model_.information[j];
    if (model_.declared[j] == 0 && !info.shape && values[j] != *info.null_value && std::find(there.begin(), there.end(), info.effect) == there.end()) there.push_back(info.effect);
  }
  result.law = model_.extended(there);
  for (const auto& info : result.law->parameters()) {
    const auto same = [&](const Parameter& p) { return p.info.name == info.name; };
    result.places.push_back(static_cast<std::size_t>(std::find_if(parameters_.begin(), parameters_.end(), same) - parameters_.begin()));
    result.values.push_back(values[result.places.back()]);
  }
  return result;
}

Eigen::VectorXd CurveExperiment::true_strain(std::size_t curve, const std::vector<double>& values) const {
  Eigen::VectorXd strain = curves_[curve].history.strain;
  for (std::size_t e = 0; e < effects_.size(); ++e) effects_[e]->gauge(values_of(e, values), scenes_[curve], strain);
  strain[0] = curves_[curve].history.strain[0];  // the virgin state
  return strain;
}

Eigen::MatrixXd CurveExperiment::follow(std::size_t curve, const Law& law, const std::vector<double>& values, std::span<const int> free) const {
  const id::Curve& one = curves_[curve];
  material::BarHistory history = one.history;
  history.strain = true_strain(curve, values);
  const auto response = material::pull_bar(*law.law, law.values, history, free);
  if (response.rows < one.stress.size()) return {};
  Eigen::MatrixXd all(response.rows, 1 + static_cast<Eigen::Index>(free.size()));
  all.col(0) = one.engineering ? response.engineering : response.kirchhoff;
  if (!free.empty()) all.rightCols(all.cols() - 1) = response.derivatives;
  if (one.engineering) all.rightCols(all.cols() - 1).array().colwise() *= (-history.strain.array()).exp();
  return all;
}

Eigen::VectorXd CurveExperiment::recorded(std::size_t curve, const std::vector<double>& values, Eigen::VectorXd stress) const {
  for (std::size_t e = 0; e < effects_.size(); ++e) stress *= effects_[e]->thickness(values_of(e, values));
  for (std::size_t e = 0; e < effects_.size(); ++e) effects_[e]->record(values_of(e, values), scenes_[curve], stress);
  for (const auto& [group, j] : group_gains_)
    if (curves_[curve].group == group) stress *= values[j];
  return stress;
}

std::vector<Eigen::VectorXd> CurveExperiment::predict(const std::vector<double>& values) const {
  std::vector<Eigen::VectorXd> all(curves_.size());
  ++simulations_;
  const Law law = law_of(values);
  for (std::size_t k = 0; k < curves_.size(); ++k) {
    const auto stress = follow(k, law, values);
    if (stress.size() == 0) return {};
    all[k] = recorded(k, values, stress.col(0));
    if (!all[k].allFinite()) return {};
  }
  return all;
}

Eigen::VectorXd CurveExperiment::binned(const std::vector<Eigen::VectorXd>& predicted) const {
  Eigen::VectorXd raw(static_cast<Eigen::Index>(bins_.size()));
  for (std::size_t i = 0; i < bins_.size(); ++i) {
    const Bin& bin = bins_[i];
    const auto k = static_cast<std::size_t>(bin.curve);
    raw[static_cast<Eigen::Index>(i)] = (curves_[k].stress(bin.rows) - predicted[k](bin.rows)).mean();
  }
  return raw;
}

/// Legendre polynomials of x in [0, 1] at bins [count x degree + 1].
Eigen::MatrixXd CurveExperiment::basis(Eigen::Index first, Eigen::Index count) const {
  Eigen::MatrixXd B(count, degree + 1);
  for (Eigen::Index i = 0; i < count; ++i) {
    const double s = 2.0 * bins_[static_cast<std::size_t>(first + i)].x - 1.0;
    B.row(i) << 1.0, s, 0.5 * (3.0 * s * s - 1.0), 0.5 * (5.0 * s * s * s - 3.0 * s);
  }
  return B;
}

std::vector<Eigen::MatrixXd> CurveExperiment::whitening_of(const Scatter& scatter) const {
  std::vector<Eigen::MatrixXd> all;
  for (std::size_t k = 0; k < bars_.size(); ++k) {
    const auto [first, size] = bars_[k];
    Eigen::MatrixXd covariance = scatter.noise.segment(first, size).array().square().matrix().asDiagonal();
    if (scatter.covariance.size() > 0) {
      const Eigen::MatrixXd B = basis(first, size);
      covariance += B * scatter.covariance * B.transpose();
    }
    std::vector<int> last;
    for (Eigen::Index i = 0; i < size; ++i)
      if (bins_[static_cast<std::size_t>(first + i)].held_out) last.push_back(static_cast<int>(i));
    all.emplace_back(whitening(covariance, last));
  }
  return all;
}

Eigen::VectorXd CurveExperiment::whitened(const Eigen::VectorXd& raw, const std::vector<Eigen::MatrixXd>& whitening) const {
  Eigen::VectorXd result(raw.size());
  for (std::size_t k = 0; k < bars_.size(); ++k) {
    const auto [first, size] = bars_[k];
    result.segment(first, size) = whitening[k] * raw.segment(first, size);
  }
  return result;
}

std::vector<Eigen::VectorXd> CurveExperiment::residuals(const std::vector<std::vector<double>>& sets) {
  const auto N = static_cast<Eigen::Index>(bins_.size());
  Eigen::MatrixXd all = Eigen::MatrixXd::Zero(N, static_cast<Eigen::Index>(sets.size()));
  std::vector<double> good(sets.size(), 0.0);
  collectively(world_, [&] {
    for (std::size_t s = 0; s < sets.size(); ++s) {
      if (static_cast<int>(s) % world_.size() != world_.rank()) continue;
      const auto predicted = predict(sets[s]);
      if (predicted.empty()) continue;
      all.col(static_cast<Eigen::Index>(s)) = whitened(binned(predicted));
      good[s] = 1.0;
    }
  });
  world_.sum(std::span(all.data(), static_cast<std::size_t>(all.size())));
  world_.sum(good);
  std::vector<Eigen::VectorXd> result(sets.size());
  for (std::size_t s = 0; s < sets.size(); ++s)
    if (good[s] > 0.5) result[s] = all.col(static_cast<Eigen::Index>(s));
  return result;
}

/// Sets that differ in numbers of the law, or in what is recorded only, are taken along the derivatives of the law's paths; the others are
/// computed. The bars are shared by the ranks.
std::vector<Eigen::VectorXd> CurveExperiment::residuals_near(const std::vector<double>& values, std::vector<std::vector<double>> sets) {
  const Law law = law_of(values);
  std::vector<int> free;  // parameters of the law that some near set moves
  std::vector<std::vector<std::pair<Eigen::Index, double>>> moves(sets.size());
  std::vector<std::size_t> far;
  for (std::size_t s = 0; s < sets.size(); ++s) {
    bool near = law_of(sets[s]).effects == law.effects;
    for (std::size_t k = 0; near && k < curves_.size(); ++k) near = true_strain(k, sets[s]) == true_strain(k, values);
    if (!near) {
      far.push_back(s);
      continue;
    }
    for (std::size_t j = 0; j < law.places.size(); ++j) {
      const double move = sets[s][law.places[j]] - values[law.places[j]];
      if (move == 0.0) continue;
      const auto found = std::find(free.begin(), free.end(), static_cast<int>(j));
      moves[s].emplace_back(1 + (found - free.begin()), move);
      if (found == free.end()) free.push_back(static_cast<int>(j));
    }
  }
  std::vector<Eigen::MatrixXd> paths(curves_.size());
  std::vector<double> good(curves_.size(), 0.0);
  for (std::size_t k = 0; k < curves_.size(); ++k) paths[k].setZero(curves_[k].stress.size(), 1 + static_cast<Eigen::Index>(free.size()));
  collectively(world_, [&] {
    for (std::size_t k = 0; k < curves_.size(); ++k) {
      if (static_cast<int>(k) % world_.size() != world_.rank()) continue;
      if (auto path = follow(k, law, values, free); path.size() > 0) paths[k] = std::move(path), good[k] = 1.0;
    }
  });
  for (auto& path : paths) world_.sum(std::span(path.data(), static_cast<std::size_t>(path.size())));
  world_.sum(good);
  ++simulations_;
  std::vector<Eigen::VectorXd> result(1 + sets.size());
  if (std::find(good.begin(), good.end(), 0.0) != good.end()) return result;
  const auto residual = [&](const std::vector<double>& set, const std::vector<std::pair<Eigen::Index, double>>& moved) {
    std::vector<Eigen::VectorXd> predicted;
    for (std::size_t k = 0; k < curves_.size(); ++k) {
      Eigen::VectorXd stress = paths[k].col(0);
      for (const auto& [column, length] : moved) stress += length * paths[k].col(column);
      predicted.push_back(recorded(k, set, std::move(stress)));
    }
    return whitened(binned(predicted));
  };
  result.front() = residual(values, {});
  std::vector<std::vector<double>> computed;
  for (std::size_t s : far) computed.push_back(sets[s]);
  const auto others = residuals(computed);
  for (std::size_t i = 0; i < far.size(); ++i) result[1 + far[i]] = others[i];
  for (std::size_t s = 0; s < sets.size(); ++s)
    if (!std::binary_search(far.begin(), far.end(), s)) result[1 + s] = residual(sets[s], moves[s]);
  return result;
}

bool CurveExperiment::noise_is_estimated(std::size_t curve) const { return curves_[curve].estimated && !repeated_.contains(curves_[curve].group); }

double CurveExperiment::bin_noise(int curve) const {
  const auto [first, size] = bars_[static_cast<std::size_t>(curve)];
  return std::sqrt(scatter_.noise.segment(first, size).squaredNorm() / std::max(1.0, static_cast<double>(size)));
}

Eigen::VectorXd CurveExperiment::freedom() const {
  const auto N = static_cast<Eigen::Index>(bins_.size());
  if (freedom_ > 0.0) return Eigen::VectorXd::Constant(N, std::max(3.0, freedom_ - coefficients_that_differ() + 1.0));
  Eigen::VectorXd all = Eigen::VectorXd::Constant(N, std::numeric_limits<double>::infinity());
  for (std::size_t k = 0; k < bars_.size(); ++k)
    if (noise_is_estimated(k)) all.segment(bars_[k].first, bars_[k].second).setConstant(std::max(3.0, id::freedom_of_point_noise(bars_[k].second)));
  return all;
}

double CurveExperiment::round_off() const {
  double square = 0.0;
  for (std::size_t i = 0; i < bins_.size(); ++i) square += std::pow(1e-6 * curves_[static_cast<std::size_t>(bins_[i].curve)].stress(bins_[i].rows).mean() / scatter_.noise[static_cast<Eigen::Index>(i)], 2);
  return std::sqrt(square);
}

/// Bars that have repetitions, with the bins that some other bar of their group has too.
void CurveExperiment::find_repetitions() {
  std::map<std::string, std::map<int, int>> bars_with;  // of a group and a bin's number
  std::map<std::string, int> members;
  for (std::size_t k = 0; k < bars_.size(); ++k) {
    if (bars_[k].second == 0) continue;
    ++members[curves_[k].group];
    for (Eigen::Index i = bars_[k].first; i < bars_[k].first + bars_[k].second; ++i) ++bars_with[curves_[k].group][bins_[static_cast<std::size_t>(i)].number];
  }
  for (std::size_t k = 0; k < bars_.size(); ++k) {
    Repeated bar{.curve = k, .rows = {}, .numbers = {}, .B = {}};
    for (Eigen::Index i = bars_[k].first; i < bars_[k].first + bars_[k].second; ++i)
      if (bars_with[curves_[k].group][bins_[static_cast<std::size_t>(i)].number] > 1) bar.rows.push_back(i), bar.numbers.push_back(bins_[static_cast<std::size_t>(i)].number);
    if (bar.rows.empty()) continue;
    std::vector<Eigen::Index> own;
    for (Eigen::Index i : bar.rows) own.push_back(i - bars_[k].first);
    bar.B = basis(bars_[k].first, bars_[k].second)(own, Eigen::all);
    repeated_[curves_[k].group].push_back(std::move(bar));
  }
  for (const auto& [group, count] : members) freedom_ += count - 1.0;
}

/// Random-effects model of the deviations from the groups' means, by expectation-maximisation: bars that end early are in it with
/// what they have. What is left of the cubics in a bin has one variance in a group; the noise of the points comes on top. `raw`: measured - predicted [N].
CurveExperiment::Scatter CurveExperiment::scatter_of(const Eigen::VectorXd& raw) const {
  Scatter result{.covariance = {}, .noise = of_points_, .deviations = {}, .coefficients = {}};
  for (std::size_t k = 0; k < bars_.size(); ++k) {
    const auto [first, size] = bars_[k];
    if (!noise_is_estimated(k) || size < 3) continue;
    Eigen::VectorXd strain(size);  // every row that is judged is a bin
    for (Eigen::Index i = 0; i < size; ++i) strain[i] = curves_[k].history.strain[bins_[static_cast<std::size_t>(first + i)].rows.front()];
    result.noise.segment(first, size).setConstant(std::max(1e-3 * curves_[k].deviation, id::point_noise(strain, raw.segment(first, size))));
  }
  double square = 0.0, count = 0.0;
  for (const auto& [group, bars] : repeated_) {
    std::map<int, std::pair<double, int>> means;  // of a bin: sum, bars
    for (const auto& bar : bars)
      for (std::size_t i = 0; i < bar.rows.size(); ++i) means[bar.numbers[i]].first += raw[bar.rows[i]], ++means[bar.numbers[i]].second;
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
  constexpr int size = degree + 1;
  const Eigen::Matrix<double, size, size> one = Eigen::Matrix<double, size, size>::Identity();
  Eigen::Matrix<double, size, size> D = 0.5 * square / count * one;
  std::map<std::string, double> variance;
  for (const auto& [group, bars] : repeated_) variance[group] = 0.1 * square / count;
  for (int iteration = 0; iteration < 200; ++iteration) {
    Eigen::Matrix<double, size, size> next = Eigen::Matrix<double, size, size>::Zero();
    double bars_seen = 0.0;
    bool done = true;
    const Eigen::Matrix<double, size, size> D_inverse = (D + 1e-9 * D.trace() * one).inverse();
    for (const auto& [group, bars] : repeated_) {
      double left = 0.0, all = 0.0, numbers = 0.0;
      auto& coefficients = result.coefficients[group];
      coefficients.resize(bars.size());
      for (std::size_t k = 0; k < bars.size(); ++k) {
        const auto& deviation = result.deviations[group][k];
        const Eigen::ArrayXd points = of_points_(bars[k].rows).array().square(), total = points + variance[group];
        const Eigen::Matrix<double, Eigen::Dynamic, size> weighted = total.inverse().matrix().asDiagonal() * bars[k].B;
        const Eigen::Matrix<double, size, size> V = (D_inverse + weighted.transpose() * bars[k].B).inverse();
        const Eigen::VectorXd c = V * (weighted.transpose() * deviation);
        next += c * c.transpose() + V;
        bars_seen += 1.0;
        const Eigen::ArrayXd uncertain = (bars[k].B * V).cwiseProduct(bars[k].B).rowwise().sum(), share = variance[group] / total;
        left += (share.square() * ((deviation - bars[k].B * c).array().square() + uncertain) + share * points).sum();
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
    if (done) break;
  }
  result.covariance = D;
  for (std::size_t i = 0; i < bins_.size(); ++i)
    if (const auto its = variance.find(curves_[static_cast<std::size_t>(bins_[i].curve)].group); its != variance.end()) {
      double& noise = result.noise[static_cast<Eigen::Index>(i)];
      noise = std::sqrt(noise * noise + its->second);
    }
  return result;
}

void CurveExperiment::learn_bias(const std::vector<double>& values) {
  const auto predicted = predict(values);
  if (predicted.empty()) throw ConvergenceError("the law cannot follow the curves");
  scatter_ = scatter_of(binned(predicted));
  whitening_ = whitening_of(scatter_);
}

/// Coefficients whose variance is that of the bars, and so estimated from them: tr D (D + (B^T S^-1 B)^-1)^-1, S the variance of the bins, the mean of all bars. What the noise of the bins makes of a
/// coefficient is known from many of them.
double CurveExperiment::coefficients_that_differ() const {
  if (scatter_.covariance.size() == 0) return degree + 1;
  double sum = 0.0, bars_seen = 0.0;
  for (const auto& [group, bars] : repeated_)
    for (const auto& bar : bars) {
      const Eigen::MatrixXd& D = scatter_.covariance;
      const Eigen::MatrixXd signal = D * (bar.B.transpose() * scatter_.noise(bar.rows).array().square().inverse().matrix().asDiagonal() * bar.B), unity = Eigen::MatrixXd::Identity(degree + 1, degree + 1);
      sum += (unity + signal).partialPivLu().solve(signal).trace();
      bars_seen += 1.0;
    }
  return sum / bars_seen;
}

/// Correlation of what cubics leave of the deviations of a group, from bin to bin: 0 if that is white noise.
double CurveExperiment::correlation_beyond_cubics(const std::string& group) const {
  const auto& bars = repeated_.at(group);
  double product = 0.0, square = 0.0;
  for (std::size_t k = 0; k < bars.size(); ++k) {
    const Eigen::VectorXd left = (scatter_.deviations.at(group)[k] - bars[k].B * scatter_.coefficients.at(group)[k]).cwiseQuotient(scatter_.noise(bars[k].rows));
    product += left.head(left.size() - 1).dot(left.tail(left.size() - 1)), square += left.squaredNorm();
  }
  return std::clamp(product / std::max(1e-300, square), 0.0, 1.0);
}

/// One half of their covariance is that of the model, the other that of the deviations themselves, whatever their course: what cubics leave of them goes together from bin
/// to bin as far as it does in the bars, and is white otherwise.
Eigen::MatrixXd CurveExperiment::bars_like_these(int draws, double grown, unsigned seed) const {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  const auto drawn = [&](Eigen::Index count) {
    Eigen::VectorXd g(count);
    for (double& x : g) x = normal(random);
    return g;
  };
  const Eigen::MatrixXd root = scatter_.covariance.size() > 0 ? Eigen::MatrixXd(grown * cholesky(scatter_.covariance)) : Eigen::MatrixXd();
  Eigen::MatrixXd result(static_cast<Eigen::Index>(bins_.size()), draws);
  for (auto raw : result.colwise()) {
    for (std::size_t k = 0; k < bars_.size(); ++k) {
      const auto [first, size] = bars_[k];
      raw.segment(first, size) = scatter_.noise.segment(first, size).cwiseProduct(drawn(size));
      if (root.size() > 0) raw.segment(first, size) += basis(first, size) * (root * drawn(root.cols()));
    }
    if (scatter_.deviations.empty()) continue;  // nothing is learned yet
    for (const auto& [group, bars] : repeated_) {
      const auto& deviations = scatter_.deviations.at(group);
      const auto& coefficients = scatter_.coefficients.at(group);
      const double together = std::sqrt(correlation_beyond_cubics(group)), apart = std::sqrt(1.0 - together * together);
      for (const auto& bar : bars) {
        const auto shares = [&drawn, count = static_cast<double>(bars.size())]() -> Eigen::VectorXd { return drawn(static_cast<Eigen::Index>(count)) / std::sqrt(count); };
        const Eigen::VectorXd share = shares();
        for (std::size_t i = 0; i < bar.rows.size(); ++i) {
          double sum = 0.0;
          const Eigen::VectorXd own = shares();
          for (std::size_t k = 0; k < bars.size(); ++k) {
            const auto at = std::lower_bound(bars[k].numbers.begin(), bars[k].numbers.end(), bar.numbers[i]);
            const bool has = at != bars[k].numbers.end() && *at == bar.numbers[i];
            const auto j = static_cast<Eigen::Index>(k);
            const double cubic = bar.B.row(static_cast<Eigen::Index>(i)).dot(coefficients[k]), left = has ? deviations[k][at - bars[k].numbers.begin()] - cubic : 0.0;
            sum += share[j] * (cubic + together * left) + own[j] * apart * left;
          }
          raw[bar.rows[i]] = std::sqrt(0.5) * (raw[bar.rows[i]] + grown * sum);
        }
      }
    }
  }
  return result;
}

int CurveExperiment::draws(int asked) const { return std::max(asked, 2000); }

/// A score that is weighed with a covariance of p coefficients, itself estimated with n degrees of freedom, varies by n/(n - p - 1) (n - 1)/(n - p) more than that
/// covariance says (S a Wishart matrix: s^T S^-1 d/sqrt(s^T S^-1 s)); its tails are those of Student's t with n - p + 1. One that is weighed with the noise of the points: t of their freedom.
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
