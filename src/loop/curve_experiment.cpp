#include "imic3d/loop/curve_experiment.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>

#include "declared.hpp"
#include "imic3d/core/error.hpp"
#include "imic3d/core/linear.hpp"
#include "imic3d/loop/law_effects.hpp"
#include "imic3d/loop/statistics.hpp"

namespace imic3d::loop {

namespace id = identification;

namespace {
/// That of the slowest curve, on the whole; 0 where no strain goes on in time.
double lowest_rate(const std::vector<id::Curve>& curves) {
  double lowest = 0.0;
  for (const auto& curve : curves) {
    const Eigen::VectorXd &strain = curve.history.strain, &time = curve.history.time;
    const Eigen::Index steps = strain.size() - 1;
    const double rate = steps > 0 && time[steps] > time[0]
                            ? (strain.tail(steps) - strain.head(steps)).cwiseAbs().sum() / (time[steps] - time[0])
                            : 0.0;
    if (rate > 0.0 && (lowest == 0.0 || rate < lowest)) lowest = rate;
  }
  return lowest;
}
}  // namespace

CurveExperiment::CurveExperiment(Communicator world, std::vector<id::Curve> curves, CurveModel model,
                                 const CurveLoopOptions& options)
    : world_(world), curves_(std::move(curves)), model_(std::move(model)) {
  const double rate = lowest_rate(curves_);
  for (std::size_t j = 0; j < model_.values.size(); ++j) {
    const auto& info = model_.information[j];
    if (model_.declared[j] == 0) {
      parameters_.push_back(at_null(info, rate));
      continue;
    }
    const double value = model_.values[j];
    parameters_.push_back({.info = info,
                           .value = value,
                           .step = 1e-4 * (value != 0.0       ? std::abs(value)
                                           : info.scale > 0.0 ? info.scale
                                                              : 1.0),
                           .prior = model_.priors[j],
                           .free = model_.free[j] != 0});
  }
  for (const id::Curve& curve : curves_) {
    Scene& scene = scenes_.emplace_back();
    scene.time = curve.history.time, scene.force = curve.stress, scene.start_time = curve.history.time[0];
    scene.elongation = curve.history.strain;
  }
  make_candidates();
  const auto law = law_candidates(model_.information, model_.declared);
  candidates_.insert(candidates_.end(), law.begin(), law.end());
  pass_turns();
  make_bins(options);
  find_repetitions();
  scatter_.turns.resize(bars_.size());
  whitening_ = whitening_of(scatter_);
}

/// Effects as candidates, but for what the model declares of them; those of a machine of each of several groups, too.
void CurveExperiment::make_candidates() {
  std::vector<std::string> keys;
  const auto add = [&](const std::shared_ptr<const Effect>& effect, const std::string& group) {
    std::vector<const Scene*> scenes;
    for (std::size_t k = 0; k < curves_.size(); ++k)
      if (group.empty() || curves_[k].group == group) scenes.push_back(&scenes_[k]);
    if (std::none_of(scenes.begin(), scenes.end(), [&](const Scene* scene) { return effect->applies(*scene); })) return;
    const auto duration = [](const Scene* s) { return s->time[s->time.size() - 1] - s->start_time; };
    const Scene& shortest = **std::min_element(
        scenes.begin(), scenes.end(), [&](const Scene* a, const Scene* b) { return duration(a) < duration(b); });
    const auto description = effect->describe(shortest);
    const auto own = [&](const std::string& name) { return group.empty() ? name : in_group(name, group); };
    Candidate candidate{own(description.name),
                        description.link,
                        {},
                        group.empty() ? description.sentence : description.sentence + ": " + group + " alone",
                        description.confused_with,
                        description.separated_by,
                        {}};
    candidate.changes_path = description.changes_path;
    keys.push_back(key_of(candidate.name));
    effects_.push_back({effect, group, parameters_.size(), description.quantities.size(),
                        description.quantities.front().read_at_rest});
    for (const auto& q : description.quantities) {
      const int place = static_cast<int>(parameters_.size());
      parameters_.push_back(absent(q, model_.unit(q.unit == "force" ? "stress" : q.unit)));
      if (!declare(parameters_.back(), keys.back(), model_.effects)) candidate.parameters.push_back(place);
      parameters_.back().info.name = key_of(own(q.name));
    }
    if (!candidate.parameters.empty()) candidates_.push_back(std::move(candidate));
  };
  for (const auto& effect : effects())
    if (effect->acts_on_curves()) add(effect, "");
  std::vector<std::string> groups;
  for (const auto& curve : curves_)
    if (std::find(groups.begin(), groups.end(), curve.group) == groups.end()) groups.push_back(curve.group);
  if (groups.size() > 1)
    for (const auto& group : groups)
      for (const auto& effect : effects())
        if (effect->of_each_group()) add(effect, group);
  for (const auto& one : model_.effects)
    if (std::find(keys.begin(), keys.end(), one.effect) == keys.end())
      throw InputError("effects." + one.effect,
                       "declared for stress-strain curves, on which it does not act or of which too little is known",
                       fmt::format("one of {}", fmt::join(keys, ", ")));
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

/// With the turns that lie between two rows as rows; `rows`: which ones are those of `history`.
material::BarHistory with_turns(const material::BarHistory& history, std::vector<Eigen::Index>* rows = nullptr) {
  const Eigen::Index between = std::count_if(history.turns.begin(), history.turns.end(),
                                             [](const auto&turn) { return turn.between; }),
                     count = history.strain.size();
  material::BarHistory all{.time = Eigen::VectorXd(count + between),
                           .strain = Eigen::VectorXd(count + between),
                           .direction = history.direction,
                           .turns = {},
                           .compliance = history.compliance};
  auto turn = history.turns.begin();
  Eigen::Index at = 0;
  const auto pass = [&](double time, double strain) { all.time[at] = time, all.strain[at++] = strain; };
  for (Eigen::Index row = 0; row < count; ++row) {
    for (; turn != history.turns.end() && turn->row == row; ++turn)
      if (turn->between) pass(turn->time, turn->strain);
    if (rows != nullptr) rows->push_back(at);
    pass(history.time[row], history.strain[row]);
  }
  return all;
}

/// Piecewise linear.
double interpolated(const Eigen::VectorXd& x, const Eigen::VectorXd& y, double at) {
  const auto above = std::upper_bound(x.begin(), x.end(), at) - x.begin();
  if (above == 0) return y[0];
  if (above == x.size()) return y[above - 1];
  return y[above - 1] + (y[above] - y[above - 1]) * (at - x[above - 1]) / (x[above] - x[above - 1]);
}

}  // namespace

void CurveExperiment::pass_turns() {
  for (std::size_t k = 0; k < curves_.size(); ++k) {
    Passed& passed = passed_.emplace_back(scenes_[k], std::vector<Eigen::Index>());
    const material::BarHistory all = with_turns(curves_[k].history, &passed.rows);
    passed.scene.time = all.time, passed.scene.elongation = all.strain;
    passed.scene.force =
        all.time.unaryExpr([&](double time) { return interpolated(scenes_[k].time, scenes_[k].force, time); });
  }
}

void CurveExperiment::make_bins(const CurveLoopOptions& options) {
  struct Group {
    int bars = 0;
    Eigen::VectorXd strain, both;  // way of its longest bar [rows]; both: from 0 to 1
    double largest = 0.0;          // stress, of all bars
  };
  std::map<std::string, Group> groups;
  const auto judged = [](const id::Curve& curve, Eigen::Index row) {
    return curve.use[static_cast<std::size_t>(row)] != id::Curve::not_judged;
  };
  for (const auto& curve : curves_) {
    Group& group = groups[curve.group];
    ++group.bars, group.largest = std::max(group.largest, curve.stress.cwiseAbs().maxCoeff());
    const Eigen::VectorXd strain = way_of(curve.history.strain);
    if (group.strain.size() > 0 && strain.tail(1)[0] <= group.strain.tail(1)[0]) continue;
    const Eigen::VectorXd stress = way_of(curve.stress, 4.0 * id::point_noise(curve));
    group.strain = strain,
    group.both = 0.5 * (strain / std::max(1e-300, strain.tail(1)[0]) + stress / std::max(1e-300, stress.tail(1)[0]));
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
      const int number =
          count > 1 ? std::min(options.bins - 1, static_cast<int>(x * options.bins)) : static_cast<int>(row);
      const bool same = static_cast<Eigen::Index>(bins_.size()) > first && bins_.back().number == number &&
                        bins_.back().held_out == held;
      if (!same) bins_.push_back({static_cast<int>(k), number, 0.0, 0.0, {}, held});
      bins_.back().rows.push_back(row);
      bins_.back().x += x;
      bins_.back().stress += std::abs(curve.stress[row]) / std::max(1e-300, group.largest);
    }
    const auto size = static_cast<Eigen::Index>(bins_.size()) - first;
    bars_.emplace_back(first, size);
    // A bar is a frame; a curve without repetition is cut into pieces, which end where its use changes.
    int in_frame = 0;
    for (Eigen::Index i = first; i < first + size; ++i) {
      Bin& bin = bins_[static_cast<std::size_t>(i)];
      bin.x /= static_cast<double>(bin.rows.size()), bin.stress /= static_cast<double>(bin.rows.size());
      of_points.push_back(noise / std::sqrt(static_cast<double>(bin.rows.size())));
      const bool next = i == first || (count == 1 && in_frame >= options.numbers_per_frame) ||
                        bin.held_out != bins_[static_cast<std::size_t>(i) - 1].held_out;
      if (next) ++frame, in_frame = 0;
      ++in_frame;
      data_.push_back({frame, force_channel});
    }
  }
  if (data_.empty()) throw InputError("experiments", "no row that is judged", "rows beyond `from`");
  of_points_ = Eigen::Map<const Eigen::VectorXd>(of_points.data(), static_cast<Eigen::Index>(of_points.size()));
  scatter_.noise = of_points_, scatter_.freedom = known_noise();
  slope_ = Eigen::VectorXd::Zero(of_points_.size());
}

std::vector<int> CurveExperiment::frame_numbers() const {
  std::vector<int> numbers;
  for (int t = 0; t <= data_.back().frame; ++t) numbers.push_back(t);
  return numbers;
}

std::string CurveExperiment::frame_name(int frame) const {
  const auto at =
      std::find_if(data_.begin(), data_.end(), [&](const Datum& d) { return d.frame == frame; }) - data_.begin();
  auto last = static_cast<std::size_t>(at);
  while (last + 1 < data_.size() && data_[last + 1].frame == frame) ++last;
  const Bin &from = bins_[static_cast<std::size_t>(at)], &to = bins_[last];
  const auto& curve = curves_[static_cast<std::size_t>(from.curve)];
  return curve.name + " (" + curve.group + "), rows " + std::to_string(from.rows.front()) + "-" +
         std::to_string(to.rows.back());
}

int CurveExperiment::curve_of(int frame) const {
  return bins_[static_cast<std::size_t>(
                   std::find_if(data_.begin(), data_.end(), [&](const Datum& d) { return d.frame == frame; }) -
                   data_.begin())]
      .curve;
}

bool CurveExperiment::cut_into_pieces(int curve) const {
  const auto [first, size] = bars_[static_cast<std::size_t>(curve)];
  return size > 0 &&
         data_[static_cast<std::size_t>(first)].frame != data_[static_cast<std::size_t>(first + size) - 1].frame;
}

std::vector<int> CurveExperiment::declared_held_out() const {
  std::vector<int> held;
  for (std::size_t i = 0; i < bins_.size(); ++i)
    if (bins_[i].held_out && (held.empty() || held.back() != data_[i].frame)) held.push_back(data_[i].frame);
  return held;
}

std::vector<int> CurveExperiment::held_out() const {
  std::vector<int> held = declared_held_out();
  if (!held.empty()) return held;
  std::map<std::string, int> seen;
  for (const auto& [first, size] : bars_) {
    const auto& bin = bins_[static_cast<std::size_t>(first)];
    if (size > 0 && !cut_into_pieces(bin.curve) && seen[curves_[static_cast<std::size_t>(bin.curve)].group]++ % 4 == 2)
      held.push_back(data_[static_cast<std::size_t>(first)].frame);
  }
  return held;
}

template <typename Act>
void CurveExperiment::for_effects(std::size_t curve, const std::vector<double>& values, const Act& act) const {
  for (const Acting& one : effects_)
    if (one.group.empty() || one.group == curves_[curve].group)
      act(*one.effect, std::span(values).subspan(one.first, one.count));
}

CurveExperiment::Law CurveExperiment::law_of(const std::vector<double>& values) const {
  Law result;
  // Effects of the law cost time: only those that are there.
  auto& there = result.effects;
  for (std::size_t j = 0; j < model_.values.size(); ++j) {
    const auto& info = model_.information[j];
    if (model_.declared[j] == 0 && !info.shape && values[j] != *info.null_value &&
        std::find(there.begin(), there.end(), info.effect) == there.end())
      there.push_back(info.effect);
  }
  result.law = model_.extended(there);
  for (const auto& info : result.law->parameters()) {
    const auto same = [&](const Parameter& p) { return p.info.name == info.name; };
    result.places.push_back(
        static_cast<std::size_t>(std::find_if(parameters_.begin(), parameters_.end(), same) - parameters_.begin()));
    result.values.push_back(values[result.places.back()]);
  }
  return result;
}

Eigen::VectorXd CurveExperiment::true_strain(std::size_t curve, const std::vector<double>& values) const {
  Eigen::VectorXd strain = curves_[curve].history.strain;
  for_effects(curve, values, [&](const Effect& effect, Effect::Values its) { effect.gauge(its, strain); });
  // Whatever a gauge shows then, the record begins in the virgin state, if that is nearer to the stress that it begins
  // with: a gauge that was set to zero under load has another one.
  const double first = curves_[curve].history.strain[0], E = values.front(), stress = curves_[curve].stress[0];
  if (std::abs(first) < std::abs(strain[0]) && std::abs(E * first - stress) < std::abs(E * strain[0] - stress))
    strain[0] = first;
  return strain;
}

double CurveExperiment::compliance(std::size_t curve, const std::vector<double>& values) const {
  double sum = 0.0;
  for_effects(curve, values, [&](const Effect& effect, Effect::Values its) { sum += effect.gives_way(its); });
  return sum;
}

material::BarHistory CurveExperiment::true_history(std::size_t curve, const std::vector<double>& values) const {
  material::BarHistory history = curves_[curve].history;
  const Eigen::VectorXd& recorded = curves_[curve].history.strain;
  history.strain = true_strain(curve, values);
  history.compliance = compliance(curve, values);
  // What a gauge errs by at a turn goes on from the row before it and one that is as far from that as the turn: in a
  // hold the strain stands still from row to row.
  const Eigen::VectorXd shift = history.strain - recorded;
  for (auto& turn : history.turns) {
    const Eigen::Index last = std::max<Eigen::Index>(0, turn.row - 1);
    const double further = turn.strain - recorded[last];
    Eigen::Index before = last - 1;
    while (before >= 0 && std::abs(recorded[last] - recorded[before]) < 0.5 * std::abs(further)) --before;
    turn.strain += shift[last];
    if (before >= 0 && recorded[last] != recorded[before])
      turn.strain += further * (shift[last] - shift[before]) / (recorded[last] - recorded[before]);
  }
  return history;
}

Eigen::MatrixXd CurveExperiment::follow(std::size_t curve, const Law& law, const material::BarHistory& history,
                                        std::span<const int> free) const {
  const id::Curve& one = curves_[curve];
  const material::BarHistory passed = with_turns(history);
  const auto response = material::pull_bar(*law.law, law.values, passed, free);
  if (response.rows < passed.strain.size()) return {};
  Eigen::MatrixXd all(response.rows, 1 + static_cast<Eigen::Index>(free.size()));
  all.col(0) = one.engineering ? response.engineering : response.kirchhoff;
  if (!free.empty()) all.rightCols(all.cols() - 1) = response.derivatives;
  if (one.engineering) all.rightCols(all.cols() - 1).array().colwise() *= (-passed.strain.array()).exp();
  return all;
}

Eigen::VectorXd CurveExperiment::recorded(std::size_t curve, const std::vector<double>& values,
                                          Eigen::VectorXd stress) const {
  for_effects(curve, values, [&](const Effect& effect, Effect::Values its) { stress *= effect.thickness(its); });
  for_effects(curve, values,
              [&](const Effect& effect, Effect::Values its) { effect.record(its, passed_[curve].scene, stress); });
  return stress(passed_[curve].rows);
}

std::vector<Eigen::VectorXd> CurveExperiment::predict(const std::vector<double>& values) const {
  std::vector<Eigen::VectorXd> all(curves_.size());
  ++simulations_;
  const Law law = law_of(values);
  for (std::size_t k = 0; k < curves_.size(); ++k) {
    const auto stress = follow(k, law, true_history(k, values));
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

Eigen::VectorXd CurveExperiment::whitened(const Eigen::VectorXd& raw, const std::vector<Whitening>& whitening) const {
  Eigen::VectorXd result(raw.size());
  for (std::size_t k = 0; k < bars_.size(); ++k) {
    const auto [first, size] = bars_[k];
    result.segment(first, size) = whitening[k](raw.segment(first, size));
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

/// Sets that differ in numbers of the law, or in what is recorded only, are taken along the derivatives of the law's
/// paths; the others are computed. The bars are shared by the ranks.
std::vector<Eigen::VectorXd> CurveExperiment::residuals_near(const std::vector<double>& values,
                                                             std::vector<std::vector<double>> sets) {
  const Law law = law_of(values);
  std::vector<int> free;  // parameters of the law that some near set moves
  std::vector<std::vector<std::pair<Eigen::Index, double>>> moves(sets.size());
  std::vector<std::size_t> far;
  for (std::size_t s = 0; s < sets.size(); ++s) {
    bool near = law_of(sets[s]).effects == law.effects;
    for (std::size_t k = 0; near && k < curves_.size(); ++k)
      near = compliance(k, sets[s]) == compliance(k, values) && true_strain(k, sets[s]) == true_strain(k, values);
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
  for (std::size_t k = 0; k < curves_.size(); ++k)
    paths[k].setZero(passed_[k].scene.time.size(), 1 + static_cast<Eigen::Index>(free.size()));
  collectively(world_, [&] {
    for (std::size_t k = 0; k < curves_.size(); ++k) {
      if (static_cast<int>(k) % world_.size() != world_.rank()) continue;
      if (auto path = follow(k, law, true_history(k, values), free); path.size() > 0)
        paths[k] = std::move(path), good[k] = 1.0;
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

std::string CurveExperiment::obstacle(const std::vector<double>& values) const {
  const Law law = law_of(values);
  for (std::size_t k = 0; k < curves_.size(); ++k) {
    const id::Curve& curve = curves_[k];
    const auto reached = material::pull_bar(*law.law, law.values, true_history(k, values)).rows;
    if (reached < curve.stress.size())
      return fmt::format("{} ({}): the law cannot follow beyond row {}", curve.name, curve.group, reached);
  }
  return {};
}

std::string CurveExperiment::contradiction(int candidate, const std::vector<double>& values) const {
  const auto& its = candidates_[static_cast<std::size_t>(candidate)].parameters;
  const auto acting = std::find_if(effects_.begin(), effects_.end(), [&](const Acting& one) {
    return one.read_at_rest && std::find(its.begin(), its.end(), static_cast<int>(one.first)) != its.end();
  });
  if (acting == effects_.end()) return {};
  const double size = values[acting->first], E = values.front();
  std::vector<double> readings;  // 0 is what a record begins with that was set so, or a row that was added
  double square = 0.0;
  for (const auto& curve : curves_) {
    if ((!acting->group.empty() && acting->group != curve.group) || curve.stress[0] == 0.0 ||
        std::abs(E * curve.history.strain[0]) >= 0.2 * std::abs(size))
      continue;
    double others = 0.0;
    for (const Acting& one : effects_)
      if (&one != &*acting && one.read_at_rest && (one.group.empty() || one.group == curve.group))
        others += values[one.first];
    readings.push_back(curve.stress[0] - others), square += std::pow(id::point_noise(curve), 2);
  }
  if (readings.empty()) return {};
  const auto n = static_cast<double>(readings.size());
  const Eigen::Map<const Eigen::ArrayXd> all(readings.data(), static_cast<Eigen::Index>(readings.size()));
  const double mean = all.mean(), deviation = std::sqrt((square / n + (all - mean).square().mean()) / n);
  if (std::abs(mean - size) < std::max(0.5 * std::abs(size), 3.5 * deviation)) return {};
  return fmt::format("the record begins with {:.3g} where nothing is strained, and not with {:.3g}", mean, size);
}

double CurveExperiment::round_off() const {
  double square = 0.0;
  for (std::size_t i = 0; i < bins_.size(); ++i)
    square += std::pow(1e-6 * curves_[static_cast<std::size_t>(bins_[i].curve)].stress(bins_[i].rows).mean() /
                           scatter_.noise[static_cast<Eigen::Index>(i)],
                       2);
  return std::sqrt(square);
}

/// Of a bar that has repetitions: the noise of the points in a bin, which is that of their strain, too, where it is
/// steep.
void CurveExperiment::learn_noise_of_bins(std::size_t curve, const Eigen::VectorXd& predicted,
                                          const Eigen::VectorXd& slope) {
  const id::Curve& bar = curves_[curve];
  const auto [first, size] = bars_[curve];
  std::vector<Eigen::Index> judged;
  for (Eigen::Index i = first; i < first + size; ++i)
    for (const Eigen::Index row : bins_[static_cast<std::size_t>(i)].rows) judged.push_back(row);
  const Eigen::VectorXd residual = bar.stress - predicted;
  const double of_stress = id::point_noise(bar),
               of_strain = id::point_noise(bar.history.strain(judged), residual(judged), slope(judged), of_stress,
                                           bar.strain_noise)
                               .strain;
  for (Eigen::Index i = first; i < first + size; ++i) {
    const auto& rows = bins_[static_cast<std::size_t>(i)].rows;
    const double square =
        std::pow(of_stress, 2) + std::pow(of_strain, 2) * slope(rows).squaredNorm() / static_cast<double>(rows.size());
    of_points_[i] = std::sqrt(square / static_cast<double>(rows.size()));
  }
}

void CurveExperiment::learn_bias(const std::vector<double>& values) {
  const auto predicted = predict(values);
  if (predicted.empty()) {
    const std::string obstacle = this->obstacle(values);
    throw ConvergenceError(obstacle.empty() ? "the law cannot follow the curves" : obstacle);
  }
  const Law law = law_of(values);
  for (std::size_t k = 0; k < bars_.size(); ++k) {
    const auto [first, size] = bars_[k];
    const Eigen::VectorXd slope = id::slopes(curves_[k].history, predicted[k], law.values.front());
    if (repeated_.contains(curves_[k].group)) learn_noise_of_bins(k, predicted[k], slope);
    for (Eigen::Index i = first; i < first + size; ++i)
      slope_[i] = slope[bins_[static_cast<std::size_t>(i)].rows.front()];
  }
  const Eigen::VectorXd raw = binned(predicted);
  turns_.assign(curves_.size(), {});
  for (std::size_t k = 0; k < bars_.size(); ++k) {
    const auto [first, size] = bars_[k];
    if (size == 0) continue;
    const double noise = repeated_.contains(curves_[k].group) ? curves_[k].strain_noise : points_of(k, raw).strain;
    turns_[k] = id::memory_of_turns(true_history(k, values), noise, predicted[k],
                                    [&](const material::BarHistory& history) -> Eigen::VectorXd {
                                      const auto stress = follow(k, law, history);
                                      return stress.size() > 0 ? recorded(k, values, stress.col(0)) : Eigen::VectorXd();
                                    });
    Eigen::MatrixXd of_bins(size, turns_[k].slopes.cols());
    for (Eigen::Index i = 0; i < size; ++i)
      of_bins.row(i) = turns_[k].slopes(bins_[static_cast<std::size_t>(first + i)].rows, Eigen::all).colwise().mean();
    turns_[k].slopes = std::move(of_bins);
  }
  scatter_ = scatter_of(raw);
  whitening_ = whitening_of(scatter_);
}

}  // namespace imic3d::loop
