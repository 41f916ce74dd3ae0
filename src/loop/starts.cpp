#include "starts.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace imic3d::loop {

namespace {

using Start = std::vector<double>;

const Parameter& parameter(const Experiment& experiment, int j) {
  return experiment.parameters()[static_cast<std::size_t>(j)];
}

const Candidate& candidate_of(const Experiment& experiment, int k) {
  return experiment.candidates()[static_cast<std::size_t>(k)];
}

bool misfit_is_large(const Model& at) { return at.misfit.fitted > 2.0 * at.misfit.null_fitted; }

/// With the declared values of the parameters that the declared model has free.
Start as_declared(const Experiment& experiment, Start values) {
  for (std::size_t j = 0; j < values.size(); ++j)
    if (const Parameter& p = experiment.parameters()[j]; p.free && !p.info.null_value) values[j] = p.value;
  return values;
}

std::vector<Start> at_places(const Experiment& experiment, const Model& at, std::size_t i) {
  const Candidate& its = candidate_of(experiment, at.others[i]);
  const Score& score = at.scores.candidates[i];
  std::vector<Eigen::Index> order(its.elsewhere.size());
  for (std::size_t k = 0; k < order.size(); ++k) order[k] = static_cast<Eigen::Index>(k);
  const Eigen::VectorXd drop = score.drop_there + score.drop_there_held_out;
  std::stable_sort(order.begin(), order.end(), [&](Eigen::Index a, Eigen::Index b) { return drop[a] > drop[b]; });
  order.resize(std::min<std::size_t>(3, order.size()));
  std::vector<Start> starts;
  for (const Eigen::Index place : order) {
    Start& start = starts.emplace_back(at.fit.values);
    Eigen::Index size = 0;
    std::size_t shape = 0;
    for (int j : its.parameters) {
      const auto& info = parameter(experiment, j).info;
      auto& value = start[static_cast<std::size_t>(j)];
      const double margin = 0.05 * (info.upper - info.lower);
      value = info.shape
                  ? its.elsewhere[static_cast<std::size_t>(place)][shape++]
                  : std::clamp(value + score.size_there(size++, place), info.lower + margin, info.upper - margin);
    }
  }
  if (misfit_is_large(at)) starts.push_back(as_declared(experiment, starts.front()));
  return starts;
}

/// `factor`: of the shape, where there is one.
Start with_its_size(const Experiment& experiment, const Model& at, std::size_t i, double factor) {
  const auto& its = candidate_of(experiment, at.others[i]).parameters;
  const bool with_shape = shaped(experiment, at.others[i]);
  Start start = at.fit.values;
  for (std::size_t k = 0; k < its.size(); ++k) {
    const auto j = static_cast<std::size_t>(its[k]);
    const Parameter& p = experiment.parameters()[j];
    const double margin = std::isfinite(p.info.upper - p.info.lower) ? 0.05 * (p.info.upper - p.info.lower) : p.step;
    const double size = with_shape ? p.step : at.scores.candidates[i].size[static_cast<Eigen::Index>(k)];
    const double wanted = !p.info.shape     ? start[j] + size
                          : start[j] != 0.0 ? factor * start[j]
                          : factor < 1.0    ? 0.0
                                            : factor * p.info.scale / 8.0;
    start[j] = std::clamp(wanted, p.info.lower + margin, p.info.upper - margin);
  }
  return start;
}

/// From the declared parameters, with `factor` times what `start` adds to `at`.
Start from_declared(const Experiment& experiment, const Model& at, std::size_t i, const Start& start, double factor) {
  Start far = as_declared(experiment, start);
  for (int j : candidate_of(experiment, at.others[i]).parameters) {
    const auto k = static_cast<std::size_t>(j);
    const auto& info = experiment.parameters()[k].info;
    far[k] = std::clamp(at.fit.values[k] + factor * (far[k] - at.fit.values[k]), info.lower, info.upper);
  }
  return far;
}

}  // namespace

bool shaped(const Experiment& experiment, int candidate) {
  const auto& its = candidate_of(experiment, candidate).parameters;
  return std::any_of(its.begin(), its.end(), [&](int j) { return parameter(experiment, j).info.shape; });
}

bool from_afar(const Experiment& experiment, const Model& at, int candidate) {
  const Candidate& its = candidate_of(experiment, candidate);
  return (its.link == Link::material || its.changes_path) && !shaped(experiment, candidate) && misfit_is_large(at);
}

std::vector<std::vector<double>> starts_of(const Experiment& experiment, const Model& at, std::size_t i) {
  std::vector<Start> starts;
  if (const int k = at.others[i]; !candidate_of(experiment, k).elsewhere.empty())
    starts = at_places(experiment, at, i);
  else if (shaped(experiment, k))
    for (const double factor : {1.0, 8.0, 0.125}) starts.push_back(with_its_size(experiment, at, i, factor));
  else
    starts.push_back(with_its_size(experiment, at, i, 1.0));
  if (from_afar(experiment, at, at.others[i]))
    for (const double factor : {1.0, 3.0}) starts.push_back(from_declared(experiment, at, i, starts.front(), factor));
  starts.push_back(at.fit.values);
  return starts;
}

}  // namespace imic3d::loop
