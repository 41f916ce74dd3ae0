#include "imic3d/loop/field_experiment.hpp"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <Eigen/SparseCholesky>
#include <algorithm>
#include <cmath>
#include <list>
#include <optional>
#include <random>

#include "imic3d/core/error.hpp"
#include "imic3d/loop/law_effects.hpp"

namespace imic3d::loop {

namespace id = identification;

/// Law, geometry, numerics and ends of one series.
struct FieldExperiment::Key {
  std::vector<double> specimen;          // values of the effects' parameters that change it or the numerics; empty: as declared
  std::vector<std::string> law_effects;  // beside the declared ones
  auto operator<=>(const Key&) const = default;
};

struct FieldExperiment::Simulation {
  std::vector<double> law;
  Key variant;
  Eigen::MatrixXd driving;      // [2n x frames]
  std::vector<double> loading;  // values of all effects' parameters, for what is driven beyond the surface
  std::vector<int> free{};                    // numbers of the law by which the series is differentiated
  std::vector<Eigen::MatrixXd> directions{};  // and in which `driving` moves
};

/// What a series is differentiated by: a number of the law, or a change of what drives the ends.
struct FieldExperiment::Tangent {
  int parameter = -1;
  Eigen::MatrixXd driving{};
};

struct FieldExperiment::Series {
  Eigen::MatrixXd U;  // of the measured surface [2n x frames]
  Eigen::VectorXd R;  // [frames]; empty if the model could not follow
  std::vector<Eigen::MatrixXd> dU;  // by the numbers of the law, then in the directions
  std::vector<Eigen::VectorXd> dR;
};

struct FieldExperiment::Variant {
  id::Specimen specimen;
  Eigen::SparseMatrix<double> to_variant, from_variant;  // surface nodes, two components
  std::unique_ptr<id::ForwardModel> model;
  bool before_test = false;  // an initial strain: the first frame is the specimen at rest
};

struct FieldExperiment::Groups {
  GroupLayout layout;
  std::list<std::pair<Key, Variant>> variants;  // this group's, the last used first
};

namespace {

/// Displacement of the loaded end minus that of the held end along the axis, per frame.
Eigen::VectorXd elongation_of(const id::Specimen& specimen, const Eigen::MatrixXd& driving) {
  const Eigen::MatrixXd prescribed = specimen.displacement_from_surface * driving;
  Eigen::VectorXd result = Eigen::VectorXd::Zero(driving.cols());
  for (const auto& [nodes, sign] : {std::pair(&specimen.loaded, 1.0), std::pair(&specimen.held, -1.0)}) {
    Eigen::VectorXd sum = Eigen::VectorXd::Zero(driving.cols());
    double count = 0.0;
    for (std::size_t i = 0; i < specimen.displacement_dofs.size(); ++i) {
      const int dof = specimen.displacement_dofs[i];
      if (dof % 3 != specimen.axis || !std::binary_search(nodes->begin(), nodes->end(), dof / 3)) continue;
      sum += prescribed.row(static_cast<Eigen::Index>(i)).transpose();
      count += 1.0;
    }
    result += sign / std::max(1.0, count) * sum;
  }
  return result;
}

Eigen::Matrix<double, Eigen::Dynamic, 2> in_plane(const mesh::Mesh& surface) { return surface.nodes.leftCols<2>(); }

/// Gives an effect's parameter what the model declares of it; whether it declares anything.
bool declare(Parameter& parameter, const std::string& effect, const std::vector<DeclaredEffect>& declared) {
  const auto its = std::find_if(declared.begin(), declared.end(), [&](const auto& one) { return one.effect == key_of(effect) && one.quantity == parameter.info.name; });
  if (its == declared.end()) return false;
  auto& info = parameter.info;
  info.lower = std::max(info.lower, its->lower.value_or(info.lower)), info.upper = std::min(info.upper, its->upper.value_or(info.upper));
  parameter.value = its->value.value_or(*info.null_value), parameter.free = its->free;
  if (parameter.value < info.lower || parameter.value > info.upper)
    throw InputError("effects." + its->effect + "." + its->quantity, fmt::format("{:.6g}", parameter.value), fmt::format("a number from {:.6g} to {:.6g} [{}]", info.lower, info.upper, info.unit));
  return true;
}

}  // namespace

std::vector<double> alike(const std::vector<double>& cut_offs) {
  std::vector<double> result = cut_offs;
  for (std::size_t t = 0; t < cut_offs.size(); ++t) {
    const auto from = t < 2 ? 0 : t - 2, to = std::min(cut_offs.size(), t + 3);
    std::vector<double> near(cut_offs.begin() + static_cast<std::ptrdiff_t>(from), cut_offs.begin() + static_cast<std::ptrdiff_t>(to));
    std::nth_element(near.begin(), near.begin() + static_cast<std::ptrdiff_t>(near.size() / 2), near.end());
    result[t] = near[near.size() / 2];
  }
  return result;
}

FieldExperiment::FieldExperiment(Communicator world, FieldData data, DeclaredModel model, const FieldOptions& options)
    : world_(world), measured_(std::move(data)), model_(std::move(model)), groups_(new Groups{GroupLayout(world, 64, model_.groups), {}}) {
  std::optional<Candidate> poissons_ratio;
  for (std::size_t j = 0; j < model_.values.size(); ++j) {
    const double value = model_.values[j];
    parameters_.push_back({.info = model_.information[j], .value = value, .step = 1e-3 * (value != 0.0 ? std::abs(value) : 1.0),
                           .prior = model_.priors[j], .free = model_.free[j] != 0});
    if (model_.information[j].name == "nu" && !model_.free[j])
      poissons_ratio = {.name = "Poisson's ratio", .link = Link::material, .parameters = {static_cast<int>(j)},
                        .sentence = "Poisson's ratio is not the declared one", .confused_with = "magnification drift, parallax",
                        .separated_by = "a second camera; a handbook value", .after = {}};
  }
  for (const auto& info : model_.lacking) parameters_.push_back(at_null(info));
  candidates_ = law_candidates(model_.lacking, std::vector<char>(model_.lacking.size(), 0), static_cast<int>(model_.values.size()));
  if (poissons_ratio) candidates_.push_back(*poissons_ratio);
  bias_ = std::make_shared<Bias>(Eigen::MatrixXd::Zero(measured_.displacement.rows(), measured_.displacement.cols()), Eigen::VectorXd::Zero(measured_.force.size()));
  make_scene();
  std::vector<Candidate> ordered;
  for (auto& effect : effects()) {
    if (!effect->applies(scene_)) continue;
    const auto description = effect->describe(scene_);
    Candidate candidate{description.name, description.link, {}, description.sentence, description.confused_with, description.separated_by, {}};
    first_.push_back(parameters_.size());
    for (const auto& q : description.quantities) {
      const int place = static_cast<int>(parameters_.size());
      parameters_.push_back({.info = {.name = q.name, .unit = model_.unit ? model_.unit(q.unit) : q.unit, .description = q.description, .lower = q.lower, .upper = q.upper, .null_value = q.null},
                             .value = q.null, .step = q.step, .prior = 0.0, .free = false});
      if (!declare(parameters_.back(), description.name, model_.effects)) candidate.parameters.push_back(place);
    }
    if (!candidate.parameters.empty()) ordered.push_back(std::move(candidate));
    effects_.push_back(std::move(effect));
  }
  for (const auto& one : model_.effects)
    if (std::none_of(effects_.begin(), effects_.end(), [&](const auto& effect) { return key_of(effect->describe(scene_).name) == one.effect; }))
      throw InputError("effects." + one.effect, "declared for a specimen that lacks what it acts on", "an effect that this test can have");
  candidates_.insert(candidates_.end(), ordered.begin(), ordered.end());
  std::stable_sort(candidates_.begin(), candidates_.end(), [](const auto& a, const auto& b) { return a.link < b.link; });
  modes_ = SurfaceModes(measured_.surface, measured_.M, options.modes);
  const auto frames = measured_.force.size();
  const Eigen::MatrixXd over_time = Eigen::MatrixXd::Identity(frames, frames) + Eigen::MatrixXd::Constant(frames, frames, 1.0 / measured_.references);
  over_time_ = over_time.llt().matrixL().solve(Eigen::MatrixXd::Identity(frames, frames));
  for (Eigen::Index t = 0; t < frames; ++t) {
    for (int side : modes_.sides()) data_.push_back({static_cast<int>(t), 0, side});
    if (std::isfinite(measured_.force_noise)) data_.push_back({static_cast<int>(t), force_channel});
  }
}

FieldExperiment::~FieldExperiment() = default;

void FieldExperiment::make_scene() {
  const auto& surface = measured_.surface;
  scene_.surface = &surface;
  measure(scene_, surface);
  scene_.thickness = model_.thickness;
  scene_.time = measured_.time, scene_.force = measured_.force, scene_.start_time = measured_.start_time;
  scene_.pixels = measured_.pixels, scene_.axis_of_lens = measured_.axis_of_lens;
  for (std::size_t j = 0; j < model_.values.size(); ++j)
    if (model_.information[j].name == "nu") scene_.poisson = model_.values[j];
  Variant& declared = variant({});
  scene_.axis = declared.specimen.axis;
  scene_.plane = mesh::dimension(declared.specimen.volume.type) == 2;
  scene_.elongation = elongation_of(declared.specimen, measured_.driving);
  // The elastic field: that of the frame of largest force that is within a fifth of the largest, from the simulation.
  Eigen::Index frame = 0;
  const double largest = measured_.force.cwiseAbs().maxCoeff();
  for (Eigen::Index t = 0; t < measured_.force.size() && std::abs(measured_.force[t]) < 0.3 * largest; ++t) frame = t;
  const auto paths = simulate({Simulation{model_.values, {}, measured_.driving, {}}});
  if (paths.front().R.size() == 0) throw ConvergenceError("the declared model cannot follow the measured displacement of the ends");
  scene_.elastic = paths.front().U.col(frame) / paths.front().R[frame];
  motion_ = paths.front().U;
}

std::span<const double> FieldExperiment::values_of(std::size_t effect, const std::vector<double>& values) const {
  const std::size_t next = effect + 1 < first_.size() ? first_[effect + 1] : parameters_.size();
  return std::span(values).subspan(first_[effect], next - first_[effect]);
}

FieldExperiment::Variant& FieldExperiment::variant(const Key& wanted) {
  const std::vector<double>& key = wanted.specimen;
  auto& variants = groups_->variants;
  for (auto it = variants.begin(); it != variants.end(); ++it)
    if (it->first == wanted) {
      variants.splice(variants.begin(), variants, it);
      return variants.front().second;
    }
  while (variants.size() > 6) variants.erase(std::prev(variants.end()));
  MeshChange change;
  Numerics numerics;
  bool before_test = false;
  if (!key.empty()) {
    numerics.refinements = change.refinements = static_cast<int>(key[0]);
    numerics.increments_factor = static_cast<int>(key[1]);
    before_test = key[2] > 0.5;
    const std::vector<double> values(key.begin() + 3, key.end());
    change.place = [this, values](Eigen::Vector2d& point) {
      for (std::size_t k = 0; k < effects_.size(); ++k) effects_[k]->place(values_of(k, values), scene_, point);
    };
    change.section = [this, values](const Eigen::Vector3d& point) {
      double factor = 1.0;
      for (std::size_t k = 0; k < effects_.size(); ++k) factor *= effects_[k]->section(values_of(k, values), scene_, point);
      return factor;
    };
    if (before_test)
      change.initial_strain = [this, values](const Eigen::Vector3d& point) {
        double strain = 0.0;
        for (std::size_t k = 0; k < effects_.size(); ++k) strain += effects_[k]->initial_strain(values_of(k, values), scene_, point);
        return strain;
      };
  }
  variants.emplace_front(wanted, Variant{});
  Variant& made = variants.front().second;
  made.specimen = model_.specimen(change);
  made.before_test = before_test;
  const auto& own = made.specimen.surface.mesh;
  if (key.empty() && own.nodes.rows() == measured_.surface.nodes.rows()) {
    made.to_variant.resize(2 * own.nodes.rows(), 2 * own.nodes.rows());
    made.to_variant.setIdentity();
    made.from_variant = made.to_variant;
  } else {
    made.to_variant = id::two_components(id::interpolation(measured_.surface, in_plane(own)));
    made.from_variant = id::two_components(id::interpolation(own, in_plane(measured_.surface)));
  }
  const Eigen::Index before = before_test ? 1 : 0, frames = measured_.force.size() + before;
  id::Record record;
  record.time.resize(frames);
  record.time.tail(measured_.force.size()) = measured_.time;
  record.start_time = measured_.start_time;
  if (before_test) record.time[0] = measured_.start_time, record.start_time -= 1e-9 * (1.0 + std::abs(measured_.start_time));
  record.force = Eigen::VectorXd::Zero(frames);
  record.surface_displacement = record.driving = Eigen::MatrixXd::Zero(2 * own.nodes.rows(), frames);
  made.model = std::make_unique<id::ForwardModel>(groups_->layout.group(), made.specimen, wanted.law_effects.empty() ? model_.law : model_.extended(wanted.law_effects), std::move(record),
                                                  mechanics::EquilibriumOptions{.increments = model_.increments * numerics.increments_factor, .derivative_tolerance = 1e-5, .with_fields = false}, 1, 1);
  if (variants.size() > 1) {  // nearly the same series as the last one of this group, of another law or specimen
    const Variant& last = std::next(variants.begin())->second;
    auto solutions = last.model->solutions();
    for (auto& solution : solutions) solution.free.clear();
    if (!before_test && !last.before_test && last.specimen.volume.nodes.rows() == made.specimen.volume.nodes.rows()) made.model->start_from(std::move(solutions));
  }
  return made;
}

std::vector<FieldExperiment::Series> FieldExperiment::simulate(const std::vector<Simulation>& wanted) {
  const auto frames = measured_.force.size();
  std::vector<Series> results(wanted.size());
  std::vector<double> done(wanted.size(), 0.0);
  for (std::size_t k = 0; k < wanted.size(); ++k) {
    results[k].U.setZero(measured_.surface.nodes.rows() * 2, frames), results[k].R.setZero(frames);
    const auto derivatives = wanted[k].free.size() + wanted[k].directions.size();
    results[k].dU.assign(derivatives, results[k].U), results[k].dR.assign(derivatives, results[k].R);
  }
  const auto& layout = groups_->layout;
  // Series of one specimen one after another: its forward model is kept.
  std::vector<std::size_t> order(wanted.size());
  for (std::size_t k = 0; k < order.size(); ++k) order[k] = k;
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return wanted[a].variant < wanted[b].variant; });
  collectively(world_, [&] {
    for (std::size_t place = 0; place < order.size(); ++place) {
      if (static_cast<int>(place % static_cast<std::size_t>(layout.groups())) != layout.index()) continue;
      const Simulation& one = wanted[order[place]];
      Series& result = results[order[place]];
      Variant& with = variant(one.variant);
      const Eigen::Index before = with.before_test ? 1 : 0;
      const auto on_variant = [&](const Eigen::MatrixXd& field) {
        Eigen::MatrixXd all = Eigen::MatrixXd::Zero(with.to_variant.rows(), frames + before);
        all.rightCols(frames) = with.to_variant * field;
        return all;
      };
      const Eigen::MatrixXd driving = on_variant(one.driving);
      Eigen::MatrixXd beyond;
      if (!one.loading.empty()) {
        const auto& dofs = with.specimen.displacement_dofs;
        const double front = with.specimen.volume.nodes.col(2).maxCoeff();
        beyond = Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(dofs.size()), frames + before);
        for (std::size_t i = 0; i < dofs.size(); ++i) {
          if (dofs[i] % 3 != scene_.axis || !std::binary_search(with.specimen.loaded.begin(), with.specimen.loaded.end(), dofs[i] / 3)) continue;
          const double z = with.specimen.volume.nodes(dofs[i] / 3, 2) - front;
          for (Eigen::Index t = 0; t < frames; ++t)
            for (std::size_t k = 0; k < effects_.size(); ++k)
              beyond(static_cast<Eigen::Index>(i), t + before) += effects_[k]->driven(values_of(k, one.loading), scene_, static_cast<int>(t), z);
        }
      }
      id::Run run{.parameters = one.law, .driving = &driving, .free = one.free};
      if (beyond.size() > 0) run.beyond = &beyond;
      for (const auto& direction : one.directions) run.directions.push_back(on_variant(direction));
      const auto path = with.model->simulate(id::Control::displacement, {run}, static_cast<int>(frames + before)).front();
      if (path.frames < frames + before || !layout.group().is_root()) continue;
      const auto on_measured = [&](const Eigen::MatrixXd& surface) -> Eigen::MatrixXd {
        if (!with.before_test) return with.from_variant * surface;
        return with.from_variant * (surface.rightCols(frames).colwise() - surface.col(0));
      };
      result.U = on_measured(path.surface), result.R = path.reaction.tail(frames);
      for (std::size_t k = 0; k < result.dU.size(); ++k) result.dU[k] = on_measured(path.d_surface[k]), result.dR[k] = path.d_reaction[k].tail(frames);
      done[order[place]] = 1.0;
    }
  });
  world_.sum(done);
  for (std::size_t k = 0; k < wanted.size(); ++k) {
    const auto share = [&](auto& values) { world_.sum(std::span(values.data(), static_cast<std::size_t>(values.size()))); };
    share(results[k].U), share(results[k].R);
    for (auto& values : results[k].dU) share(values);
    for (auto& values : results[k].dR) share(values);
    if (done[k] < 0.5) results[k].R.resize(0);
  }
  simulations_ += static_cast<int>(wanted.size());
  return results;
}

FieldExperiment::Simulation FieldExperiment::simulation_of(const std::vector<double>& values, const Eigen::MatrixXd& driving) const {
  const auto count = static_cast<std::ptrdiff_t>(model_.values.size());
  Simulation one{{values.begin(), values.begin() + count}, {}, driving, {}};
  // Effects of the law cost time: only those that are there.
  for (std::size_t j = model_.values.size(); j < model_.values.size() + model_.lacking.size(); ++j) {
    const auto& info = parameters_[j].info;
    auto& there = one.variant.law_effects;
    if (!info.shape && values[j] != *info.null_value && std::find(there.begin(), there.end(), info.effect) == there.end()) there.push_back(info.effect);
  }
  if (!one.variant.law_effects.empty()) {
    one.law.clear();
    const auto law = model_.extended(one.variant.law_effects);
    for (const auto& info : law->parameters()) {
      const auto same = [&](const Parameter& p) { return p.info.name == info.name; };
      one.law.push_back(values[static_cast<std::size_t>(std::find_if(parameters_.begin(), parameters_.end(), same) - parameters_.begin())]);
    }
  }
  std::vector<double> own(parameters_.size(), 0.0);
  bool changed = false, before_test = false, loaded = false;
  for (std::size_t k = 0; k < effects_.size(); ++k) {
    const auto its = values_of(k, values);
    for (std::size_t i = 0; i < its.size(); ++i) {
      const std::size_t j = first_[k] + i;
      own[j] = effects_[k]->changes_simulation() ? its[i] : *parameters_[j].info.null_value;
      if (effects_[k]->changes_simulation() && its[i] != *parameters_[j].info.null_value) {
        const Link link = effects_[k]->describe(scene_).link;
        if (link == Link::loading)
          loaded = true;
        else if (link != Link::numerics)
          changed = true, before_test = before_test || link == Link::initial;
      }
    }
  }
  if (changed) {
    one.variant.specimen = {0.0, 1.0, before_test ? 1.0 : 0.0};
    one.variant.specimen.insert(one.variant.specimen.end(), own.begin(), own.end());
  }
  if (loaded) one.loading = own;
  return one;
}

Eigen::MatrixXd FieldExperiment::true_motion(const std::vector<double>& values, Eigen::MatrixXd driving) const {
  for (Eigen::Index t = 0; t < driving.cols(); ++t) {
    Eigen::VectorXd error = Eigen::VectorXd::Zero(driving.rows());
    for (std::size_t k = 0; k < effects_.size(); ++k) effects_[k]->see(values_of(k, values), scene_, static_cast<int>(t), motion_.col(t), error);
    driving.col(t) -= error;
  }
  return driving;
}

FieldExperiment::Prediction FieldExperiment::observed(const std::vector<double>& values, Prediction true_one) const {
  for (Eigen::Index t = 0; t < true_one.displacement.cols(); ++t) {
    const Eigen::VectorXd U = true_one.displacement.col(t);
    Eigen::VectorXd error = Eigen::VectorXd::Zero(U.size());
    for (std::size_t k = 0; k < effects_.size(); ++k) effects_[k]->see(values_of(k, values), scene_, static_cast<int>(t), U, error);
    true_one.displacement.col(t) += error;
  }
  for (std::size_t k = 0; k < effects_.size(); ++k) effects_[k]->record(values_of(k, values), scene_, true_one.force);
  return true_one;
}

std::vector<std::pair<double, FieldExperiment::Simulation>> FieldExperiment::simulations_of(const std::vector<double>& values, const Eigen::MatrixXd& driving) const {
  Simulation base = simulation_of(values, driving);
  std::vector<std::pair<double, Simulation>> all;
  double rest = 1.0;
  for (std::size_t k = 0; k < effects_.size(); ++k) {
    Numerics numerics;
    effects_[k]->numerics(numerics);
    const auto its = values_of(k, values);
    if ((numerics.refinements == 0 && numerics.increments_factor == 1) || its[0] == 0.0) continue;
    Simulation other = base;
    std::vector<double>& key = other.variant.specimen;
    if (key.empty()) {
      key = {0.0, 1.0, 0.0};
      for (const auto& p : parameters_) key.push_back(p.info.null_value.value_or(0.0));
    }
    key[0] = numerics.refinements, key[1] = numerics.increments_factor;
    rest -= its[0];
    all.emplace_back(its[0], std::move(other));
  }
  all.emplace_back(rest, std::move(base));
  return all;
}

std::vector<FieldExperiment::Prediction> FieldExperiment::predict(const std::vector<std::vector<double>>& sets, const std::vector<const Eigen::MatrixXd*>& drivings) {
  std::vector<Simulation> wanted;
  struct Use {
    std::size_t set;
    double weight;
    std::size_t simulation;
  };
  std::vector<Use> uses;
  for (std::size_t s = 0; s < sets.size(); ++s)
    for (auto& [weight, one] : simulations_of(sets[s], true_motion(sets[s], *drivings[s]))) {
      std::size_t k = 0;
      while (k < wanted.size() && !(wanted[k].law == one.law && wanted[k].variant == one.variant && wanted[k].loading == one.loading && wanted[k].driving == one.driving)) ++k;
      if (k == wanted.size()) wanted.push_back(std::move(one));
      uses.push_back({s, weight, k});
    }
  const auto series = simulate(wanted);
  std::vector<Prediction> predictions(sets.size());
  std::vector<char> good(sets.size(), 1);
  for (auto& p : predictions) p.displacement.setZero(measured_.displacement.rows(), measured_.force.size()), p.force.setZero(measured_.force.size());
  for (const Use& use : uses) {
    const Series& one = series[use.simulation];
    if (one.R.size() == 0) {
      good[use.set] = 0;
      continue;
    }
    predictions[use.set].displacement += use.weight * one.U;
    predictions[use.set].force += use.weight * one.R;
  }
  for (std::size_t s = 0; s < sets.size(); ++s) {
    if (good[s])
      predictions[s] = observed(sets[s], std::move(predictions[s]));
    else
      predictions[s].force.resize(0);
  }
  return predictions;
}

Eigen::VectorXd FieldExperiment::whitened(const Eigen::MatrixXd& displacement, const Eigen::VectorXd& force) const {
  const Eigen::MatrixXd q = modes_.numbers(displacement) * over_time_.transpose() / measured_.noise;  // [modes x frames]
  if (!std::isfinite(measured_.force_noise)) return q.reshaped();
  Eigen::MatrixXd all(q.rows() + 1, q.cols());
  all.topRows(q.rows()) = q;
  all.bottomRows(1) = force.transpose() / measured_.force_noise;
  return all.reshaped();
}

std::vector<Eigen::VectorXd> FieldExperiment::residuals(const std::vector<std::vector<double>>& sets) {
  const auto predictions = predict(sets, std::vector<const Eigen::MatrixXd*>(sets.size(), &measured_.driving));
  std::vector<Eigen::VectorXd> result;
  for (const auto& p : predictions) result.push_back(p.force.size() == 0 ? Eigen::VectorXd() : residual_of(p));
  return result;
}

Eigen::VectorXd FieldExperiment::residual_of(const Prediction& p) const {
  return whitened(measured_.displacement - bias_->displacement - p.displacement, measured_.force - bias_->force - p.force);
}

std::pair<Eigen::MatrixXd, Eigen::VectorXd> FieldExperiment::unwhitened(const std::vector<double>& values) {
  const auto p = predict({values}, {&measured_.driving}).front();
  if (p.force.size() == 0) throw ConvergenceError("the model cannot follow the measured displacement of the ends");
  return {measured_.displacement - bias_->displacement - p.displacement, measured_.force - bias_->force - p.force};
}

std::pair<Eigen::MatrixXd, Eigen::VectorXd> FieldExperiment::synthetic_test(const std::vector<double>& values) {
  Simulation one = simulation_of(values, measured_.driving);
  std::vector<double>& key = one.variant.specimen;
  if (key.empty()) {
    key = {0.0, 1.0, 0.0};
    for (const auto& p : parameters_) key.push_back(p.info.null_value.value_or(0.0));
  }
  key[0] += 1.0, key[1] *= 2.0;
  const auto frames = measured_.force.size();
  Eigen::MatrixXd surface;
  Eigen::VectorXd force;
  mesh::Mesh own;
  collectively(world_, [&] {
    Variant& with = variant(one.variant);
    const Eigen::Index before = with.before_test ? 1 : 0;
    Eigen::MatrixXd driving = Eigen::MatrixXd::Zero(with.to_variant.rows(), frames + before);
    driving.rightCols(frames) = with.to_variant * one.driving;
    const auto path = with.model->simulate(id::Control::displacement, {id::Run{.parameters = one.law, .driving = &driving}}, static_cast<int>(frames + before)).front();
    if (path.frames < frames + before) throw ConvergenceError("the model on a finer mesh cannot follow the measured displacement of the ends");
    surface = path.surface.rightCols(frames);
    if (with.before_test) surface.colwise() -= path.surface.col(0).eval();
    force = path.reaction.tail(frames);
    own = with.specimen.surface.mesh;
  });
  ++simulations_;
  world_.broadcast(std::span(surface.data(), static_cast<std::size_t>(surface.size())));
  world_.broadcast(std::span(force.data(), static_cast<std::size_t>(force.size())));
  Prediction made = observed(values, {measured_.correlate(own, surface), std::move(force)});
  return {std::move(made.displacement), std::move(made.force)};
}

void FieldExperiment::learn_bias(const std::vector<double>& values) {
  if (!measured_.correlate) return;
  const auto [seen, force] = synthetic_test(values);
  const Eigen::MatrixXd driving = measured_.smooth(seen);
  const auto p = predict({values}, {&driving}).front();
  if (p.force.size() == 0) throw ConvergenceError("the model cannot follow the displacement of the synthetic test's ends");
  bias_ = std::make_shared<Bias>(seen - p.displacement, force - p.force);
}

std::pair<FieldExperiment::Prediction, std::vector<FieldExperiment::Prediction>> FieldExperiment::differentiate(const std::vector<double>& values, const std::vector<Tangent>& tangents) {
  const Eigen::MatrixXd driving = true_motion(values, measured_.driving);
  // So many at once that the histories' derivatives stay small, and no fewer batches than groups of ranks.
  const auto groups = static_cast<std::size_t>(groups_->layout.groups());
  const auto most = std::clamp<std::size_t>((tangents.size() + groups - 1) / groups, 1, 20);
  std::vector<Simulation> wanted;
  struct Use {
    double weight;
    std::size_t first;               // tangent
    std::vector<std::size_t> order;  // tangents of the derivatives
  };
  std::vector<Use> uses;
  for (std::size_t first = 0; first == 0 || first < tangents.size(); first += most)
    for (auto& [weight, one] : simulations_of(values, driving)) {
      Use use{weight, first, {}};
      const auto last = std::min(tangents.size(), first + most);
      for (std::size_t k = first; k < last; ++k)
        if (tangents[k].parameter >= 0) one.free.push_back(tangents[k].parameter), use.order.push_back(k);
      for (std::size_t k = first; k < last; ++k)
        if (tangents[k].parameter < 0) one.directions.push_back(tangents[k].driving), use.order.push_back(k);
      wanted.push_back(std::move(one));
      uses.push_back(std::move(use));
    }
  const auto series = simulate(wanted);
  const Prediction none{Eigen::MatrixXd::Zero(measured_.displacement.rows(), measured_.force.size()), Eigen::VectorXd::Zero(measured_.force.size())};
  std::pair<Prediction, std::vector<Prediction>> result{none, std::vector<Prediction>(tangents.size(), none)};
  auto& [nominal, derivatives] = result;
  for (std::size_t s = 0; s < series.size(); ++s) {
    const Use& use = uses[s];
    if (series[s].R.size() == 0) {
      nominal.force.resize(0);
      return result;
    }
    if (use.first == 0) nominal.displacement += use.weight * series[s].U, nominal.force += use.weight * series[s].R;
    for (std::size_t k = 0; k < use.order.size(); ++k)
      derivatives[use.order[k]].displacement += use.weight * series[s].dU[k], derivatives[use.order[k]].force += use.weight * series[s].dR[k];
  }
  return result;
}

/// Sets that differ from `values` in numbers of the law or in what drives the ends are taken along the derivatives of one series; the others
/// are simulated.
std::vector<Eigen::VectorXd> FieldExperiment::residuals_near(const std::vector<double>& values, std::vector<std::vector<double>> sets) {
  if (!variant({}).model->differentiable()) return Experiment::residuals_near(values, std::move(sets));
  const Eigen::MatrixXd driving = true_motion(values, measured_.driving);
  const auto here = simulations_of(values, driving);
  std::vector<Tangent> tangents;
  std::vector<std::vector<std::pair<std::size_t, double>>> moves(sets.size());  // along tangents
  std::vector<std::size_t> far;
  for (std::size_t s = 0; s < sets.size(); ++s) {
    const auto there = simulations_of(sets[s], true_motion(sets[s], measured_.driving));
    const bool near = std::equal(there.begin(), there.end(), here.begin(), here.end(), [](const auto& a, const auto& b) {
      return a.first == b.first && a.second.variant == b.second.variant && a.second.loading == b.second.loading;
    });
    if (!near) {
      far.push_back(s);
      continue;
    }
    const Simulation &one = there.front().second, &base = here.front().second;
    for (std::size_t j = 0; j < base.law.size(); ++j) {
      if (one.law[j] == base.law[j]) continue;
      const auto same = [&](const Tangent& t) { return t.parameter == static_cast<int>(j); };
      const auto found = static_cast<std::size_t>(std::find_if(tangents.begin(), tangents.end(), same) - tangents.begin());
      if (found == tangents.size()) tangents.push_back({.parameter = static_cast<int>(j)});
      moves[s].emplace_back(found, one.law[j] - base.law[j]);
    }
    if (one.driving != base.driving) {
      moves[s].emplace_back(tangents.size(), 1.0);
      tangents.push_back({.driving = one.driving - base.driving});
    }
  }
  const auto [nominal, derivatives] = differentiate(values, tangents);
  std::vector<Eigen::VectorXd> result(1 + sets.size());
  if (nominal.force.size() == 0) return result;
  result.front() = residual_of(observed(values, nominal));
  std::vector<std::vector<double>> simulated;
  for (std::size_t s : far) simulated.push_back(sets[s]);
  const auto others = residuals(simulated);
  for (std::size_t k = 0; k < far.size(); ++k) result[1 + far[k]] = others[k];
  for (std::size_t s = 0; s < sets.size(); ++s) {
    if (std::binary_search(far.begin(), far.end(), s)) continue;
    Prediction moved = nominal;
    for (const auto& [k, length] : moves[s]) moved.displacement += length * derivatives[k].displacement, moved.force += length * derivatives[k].force;
    result[1 + s] = residual_of(observed(sets[s], std::move(moved)));
  }
  return result;
}

std::vector<FieldExperiment::Prediction> FieldExperiment::responses(const std::vector<double>& values, const std::vector<Eigen::MatrixXd>& changes) {
  const Eigen::MatrixXd driving = true_motion(values, measured_.driving);
  std::vector<Tangent> tangents;
  for (const auto& change : changes) tangents.push_back({.driving = true_motion(values, measured_.driving + change) - driving});
  auto [nominal, moved] = differentiate(values, tangents);
  if (nominal.force.size() == 0) throw ConvergenceError("the model cannot follow the measured displacement of the ends");
  const Prediction seen = observed(values, nominal);
  for (auto& one : moved) {
    one.displacement += nominal.displacement, one.force += nominal.force;
    one = observed(values, std::move(one));
    one.displacement -= seen.displacement, one.force -= seen.force;
  }
  return moved;
}

std::vector<FieldExperiment::Prediction> FieldExperiment::differences(const std::vector<double>& values, const std::vector<Eigen::MatrixXd>& changes) {
  const auto nominal = predict({values}, {&measured_.driving}).front();
  if (nominal.force.size() == 0) throw ConvergenceError("the model cannot follow the measured displacement of the ends");
  std::vector<Prediction> all;
  constexpr std::size_t together = 16;  // whose fields are held at once
  for (std::size_t first = 0; first < changes.size(); first += together) {
    std::vector<Eigen::MatrixXd> drivings;
    for (std::size_t k = first; k < std::min(changes.size(), first + together); ++k) drivings.emplace_back(measured_.driving + changes[k]);
    std::vector<const Eigen::MatrixXd*> pointers;
    for (const auto& driving : drivings) pointers.push_back(&driving);
    for (auto& p : predict(std::vector<std::vector<double>>(drivings.size(), values), pointers)) {
      if (p.force.size() == 0)  // out of the solver's reach: as if nothing had moved
        p = {Eigen::MatrixXd::Zero(measured_.displacement.rows(), measured_.force.size()), Eigen::VectorXd::Zero(measured_.force.size())};
      else
        p.displacement -= nominal.displacement, p.force -= nominal.force;
      all.push_back(std::move(p));
    }
  }
  return all;
}

Eigen::MatrixXd FieldExperiment::noise(const std::vector<double>& values, int draws) {
  const auto frames = measured_.force.size(), unknowns = measured_.displacement.rows();
  const Eigen::SimplicialLLT<Eigen::SparseMatrix<double>> factor(measured_.M);  // P M P^T = L L^T
  std::mt19937_64 random(7);
  std::normal_distribution<double> normal;
  std::vector<Eigen::MatrixXd> fields, changes;
  std::vector<Eigen::VectorXd> forces;
  for (int b = 0; b < draws; ++b) {
    Eigen::MatrixXd white(unknowns, frames + 1);
    for (double& x : white.reshaped()) x = normal(random);
    const Eigen::MatrixXd field = measured_.noise * (factor.permutationPinv() * Eigen::MatrixXd(factor.matrixU().solve(white)));
    fields.emplace_back(field.leftCols(frames).colwise() + field.col(frames) / std::sqrt(static_cast<double>(measured_.references)));
    changes.push_back(measured_.smooth(fields.back()));
    auto& force = forces.emplace_back(frames);
    for (double& x : force) x = std::isfinite(measured_.force_noise) ? measured_.force_noise * normal(random) : 0.0;
  }
  const auto moved = variant({}).model->differentiable() ? responses(values, changes) : differences(values, changes);
  Eigen::MatrixXd result(static_cast<Eigen::Index>(data_.size()), draws);
  for (int b = 0; b < draws; ++b) {
    const auto k = static_cast<std::size_t>(b);
    result.col(b) = whitened(fields[k] - moved[k].displacement, forces[k] - moved[k].force);
  }
  return result;
}

}  // namespace imic3d::loop
