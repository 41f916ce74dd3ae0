#include "imic3d/loop/curve_experiment.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>
#include <random>

#include "imic3d/core/error.hpp"
#include "imic3d/loop/law_effects.hpp"

namespace imic3d::loop {

namespace id = identification;

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
    const auto duration = [](const Scene& s) { return s.time[s.time.size() - 1] - s.start_time; };
    if (duration(scene) < duration(scenes_[shortest])) shortest = k;
  }
  for (auto& effect : effects()) {
    if (!effect->acts_on_curves() || !effect->applies(scenes_[shortest])) continue;
    const auto description = effect->describe(scenes_[shortest]);
    Candidate candidate{description.name, description.link, {}, description.sentence, description.confused_with, description.separated_by, {}};
    first_.push_back(parameters_.size());
    for (const auto& q : description.quantities) {
      candidate.parameters.push_back(static_cast<int>(parameters_.size()));
      parameters_.push_back({.info = {.name = q.name, .unit = model_.unit(q.unit == "force" ? "stress" : q.unit), .description = q.description, .lower = q.lower, .upper = q.upper, .null_value = q.null},
                             .value = q.null, .step = q.step, .prior = 0.0, .free = false});
    }
    candidates_.push_back(std::move(candidate));
    effects_.push_back(std::move(effect));
  }
  first_.push_back(parameters_.size());
  std::vector<std::string> groups;
  for (const auto& curve : curves_)
    if (std::find(groups.begin(), groups.end(), curve.group) == groups.end()) groups.push_back(curve.group);
  if (groups.size() > 1)
    for (const auto& group : groups) {
      group_gains_.emplace_back(group, parameters_.size());
      candidates_.push_back({.name = "gain of " + group, .link = Link::record, .parameters = {static_cast<int>(parameters_.size())},
                             .sentence = "the bars of " + group + " carry more or less than the others, by a factor: another batch, section or load cell",
                             .confused_with = "whatever sets these tests apart, such as their rate", .separated_by = "bars of one batch on one machine under both conditions", .after = {}});
      parameters_.push_back({.info = {.name = "gain of " + group, .unit = "-", .description = "stress of these bars over that of the others", .lower = 0.5, .upper = 2.0, .null_value = 1.0},
                             .value = 1.0, .step = 1e-3, .prior = 0.0, .free = false});
    }
  const auto law = law_candidates(model_.information, model_.declared);
  candidates_.insert(candidates_.end(), law.begin(), law.end());
  make_bins(options);
  make_whitening();
}

void CurveExperiment::make_bins(const CurveLoopOptions& options) {
  std::map<std::string, std::pair<int, double>> groups;  // bars, longest path
  const auto path = [](const id::Curve& curve) {
    Eigen::VectorXd along = Eigen::VectorXd::Zero(curve.stress.size());
    for (Eigen::Index row = 1; row < along.size(); ++row) along[row] = along[row - 1] + std::abs(curve.history.strain[row] - curve.history.strain[row - 1]);
    return along;
  };
  const auto judged = [](const id::Curve& curve, Eigen::Index row) { return curve.use[static_cast<std::size_t>(row)] != id::Curve::not_judged; };
  for (const auto& curve : curves_) {
    auto& [count, longest] = groups[curve.group];
    ++count;
    longest = std::max(longest, path(curve).tail(1)[0]);
  }
  int frame = -1;
  for (std::size_t k = 0; k < curves_.size(); ++k) {
    const id::Curve& curve = curves_[k];
    const auto [count, longest] = groups[curve.group];
    const Eigen::VectorXd along = path(curve) / std::max(1e-300, longest);
    const auto first = static_cast<Eigen::Index>(bins_.size());
    for (Eigen::Index row = 0; row < curve.stress.size(); ++row) {
      if (!judged(curve, row)) continue;
      const double x = along[row];
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
      const bool next = i == first || (count == 1 && in_frame >= options.numbers_per_frame) || bin.held_out != bins_[static_cast<std::size_t>(i) - 1].held_out;
      if (next) ++frame, in_frame = 0;
      ++in_frame;
      data_.push_back({frame, force_channel});
    }
    bin_noise_.push_back(curve.deviation);
  }
  if (data_.empty()) throw InputError("experiments", "no row that is judged", "rows beyond `from`");
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

void CurveExperiment::make_whitening() {
  whitening_.clear();
  for (std::size_t k = 0; k < bars_.size(); ++k) {
    const auto [first, size] = bars_[k];
    Eigen::MatrixXd covariance = std::pow(bin_noise_[k], 2) * Eigen::MatrixXd::Identity(size, size);
    if (scatter_.size() > 0) {
      const Eigen::MatrixXd B = basis(first, size);
      covariance += B * scatter_ * B.transpose();
    }
    whitening_.emplace_back(covariance.llt().matrixL().solve(Eigen::MatrixXd::Identity(size, size)));
  }
}

Eigen::VectorXd CurveExperiment::whitened(const Eigen::VectorXd& raw) const {
  Eigen::VectorXd result(raw.size());
  for (std::size_t k = 0; k < bars_.size(); ++k) {
    const auto [first, size] = bars_[k];
    result.segment(first, size) = whitening_[k].triangularView<Eigen::Lower>() * raw.segment(first, size);
  }
  return result;
}

std::vector<Eigen::VectorXd> CurveExperiment::residuals(const std::vector<std::vector<double>>& sets) {
  const auto N = static_cast<Eigen::Index>(bins_.size());
  Eigen::MatrixXd all = Eigen::MatrixXd::Zero(N, static_cast<Eigen::Index>(sets.size()));
  std::vector<double> good(sets.size(), 0.0);
  for (std::size_t s = 0; s < sets.size(); ++s) {
    if (static_cast<int>(s) % world_.size() != world_.rank()) continue;
    const auto predicted = predict(sets[s]);
    if (predicted.empty()) continue;
    all.col(static_cast<Eigen::Index>(s)) = whitened(binned(predicted));
    good[s] = 1.0;
  }
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
  for (std::size_t k = 0; k < curves_.size(); ++k) {
    paths[k].setZero(curves_[k].stress.size(), 1 + static_cast<Eigen::Index>(free.size()));
    if (static_cast<int>(k) % world_.size() != world_.rank()) continue;
    if (auto path = follow(k, law, values, free); path.size() > 0) paths[k] = std::move(path), good[k] = 1.0;
  }
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

double CurveExperiment::round_off() const {
  double square = 0.0;
  for (std::size_t i = 0; i < bins_.size(); ++i) square += std::pow(1e-6 * curves_[static_cast<std::size_t>(bins_[i].curve)].stress(bins_[i].rows).mean() / bin_noise_[static_cast<std::size_t>(bins_[i].curve)], 2);
  return std::sqrt(square);
}

/// Random-effects model of the deviations from the groups' means, by expectation-maximisation: bars that end early are in it with
/// what they have.
void CurveExperiment::learn_bias(const std::vector<double>& values) {
  const auto predicted = predict(values);
  if (predicted.empty()) throw ConvergenceError("the law cannot follow the curves");
  const Eigen::VectorXd raw = binned(predicted);
  std::map<std::string, std::vector<std::size_t>> groups;
  for (std::size_t k = 0; k < curves_.size(); ++k)
    if (bars_[k].second > 0) groups[curves_[k].group].push_back(k);
  struct Bar {
    std::size_t curve;
    Eigen::MatrixXd B;
    Eigen::VectorXd deviation;
  };
  std::map<std::string, std::vector<Bar>> deviations;
  freedom_ = 0.0;
  for (const auto& [group, members] : groups) {
    if (members.size() < 2) continue;
    freedom_ += static_cast<double>(members.size()) - 1.0;
    std::map<int, std::pair<double, int>> means;  // of a bin: sum, bars
    const auto bins_of = [&](std::size_t k, auto&& use) {
      for (Eigen::Index i = bars_[k].first; i < bars_[k].first + bars_[k].second; ++i) use(i, bins_[static_cast<std::size_t>(i)].number);
    };
    for (std::size_t k : members) bins_of(k, [&](Eigen::Index i, int number) { means[number].first += raw[i], ++means[number].second; });
    for (std::size_t k : members) {
      std::vector<Eigen::Index> rows;
      std::vector<double> deviation;
      bins_of(k, [&](Eigen::Index i, int number) {
        const auto& [sum, count] = means[number];
        if (count < 2) return;
        rows.push_back(i - bars_[k].first);
        deviation.push_back((raw[i] - sum / count) * std::sqrt(count / (count - 1.0)));
      });
      if (rows.empty()) continue;
      deviations[group].push_back({k, basis(bars_[k].first, bars_[k].second)(rows, Eigen::all), Eigen::Map<Eigen::VectorXd>(deviation.data(), static_cast<Eigen::Index>(deviation.size()))});
    }
  }
  if (freedom_ < 1.0) return;  // nothing is repeated
  constexpr int size = degree + 1;
  double square = 0.0, count = 0.0;
  for (const auto& [group, bars] : deviations)
    for (const auto& bar : bars) square += bar.deviation.squaredNorm(), count += static_cast<double>(bar.deviation.size());
  Eigen::MatrixXd D = 0.5 * square / count * Eigen::MatrixXd::Identity(size, size);
  std::map<std::string, double> variance;
  for (const auto& [group, bars] : deviations) variance[group] = 0.1 * square / count;
  for (int iteration = 0; iteration < 200; ++iteration) {
    Eigen::MatrixXd next = Eigen::MatrixXd::Zero(size, size);
    double bars_seen = 0.0;
    const Eigen::MatrixXd D_inverse = (D + 1e-9 * D.trace() * Eigen::MatrixXd::Identity(size, size)).inverse();
    for (const auto& [group, bars] : deviations) {
      double left = 0.0, numbers = 0.0;
      for (const auto& bar : bars) {
        const Eigen::MatrixXd V = (D_inverse + bar.B.transpose() * bar.B / variance[group]).inverse();
        const Eigen::VectorXd c = V * bar.B.transpose() * bar.deviation / variance[group];
        next += c * c.transpose() + V;
        bars_seen += 1.0;
        left += (bar.deviation - bar.B * c).squaredNorm() + (bar.B * V * bar.B.transpose()).trace();
        numbers += static_cast<double>(bar.deviation.size());
      }
      variance[group] = std::max(1e-12 * square / count, left / numbers);
    }
    D = next / bars_seen;
  }
  scatter_ = D;
  for (const auto& [group, members] : groups)
    if (variance.contains(group))
      for (std::size_t k : members) bin_noise_[k] = std::sqrt(variance[group]);
  make_whitening();
}

Eigen::MatrixXd CurveExperiment::noise(const std::vector<double>&, int draws) {
  const auto N = static_cast<Eigen::Index>(bins_.size());
  std::mt19937_64 random(3);
  std::normal_distribution<double> normal;
  Eigen::MatrixXd result(N, draws);
  const Eigen::MatrixXd root = scatter_.size() > 0 ? Eigen::MatrixXd(scatter_.llt().matrixL()) : Eigen::MatrixXd();
  for (int b = 0; b < draws; ++b) {
    // The scatter as it may be: an inverse Wishart about what was estimated.
    Eigen::MatrixXd own = root;
    if (root.size() > 0) {
      const auto p = root.rows();
      const double freedom = std::max(freedom_, static_cast<double>(p) + 2.0);
      Eigen::MatrixXd W = Eigen::MatrixXd::Zero(p, p);
      for (int i = 0; i < static_cast<int>(std::lround(freedom)); ++i) {
        Eigen::VectorXd g(p);
        for (double& x : g) x = normal(random);
        W += g * g.transpose() / freedom;
      }
      own = root * Eigen::MatrixXd(W.inverse()).llt().matrixL().toDenseMatrix();
    }
    Eigen::VectorXd raw(N);
    for (std::size_t k = 0; k < bars_.size(); ++k) {
      const auto [first, size] = bars_[k];
      for (Eigen::Index i = first; i < first + size; ++i) raw[i] = bin_noise_[k] * normal(random);
      if (own.size() == 0) continue;
      Eigen::VectorXd c(own.cols());
      for (double& x : c) x = normal(random);
      raw.segment(first, size) += basis(first, size) * (own * c);
    }
    result.col(b) = whitened(raw);
  }
  return result;
}

}  // namespace imic3d::loop
