#include "imic3d/loop/field_experiment.hpp"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <Eigen/SparseCholesky>
#include <algorithm>
#include <cmath>
#include <list>
#include <map>
#include <optional>
#include <random>

#include "imic3d/core/error.hpp"
#include "imic3d/correlation/smoothing.hpp"
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

/// Weights of nodes [k x n] as weights of two components a node [2k x 2n].
Eigen::SparseMatrix<double> two_components(const Eigen::SparseMatrix<double>& scalar) {
  std::vector<Eigen::Triplet<double>> entries;
  for (int column = 0; column < scalar.outerSize(); ++column)
    for (Eigen::SparseMatrix<double>::InnerIterator entry(scalar, column); entry; ++entry)
      for (int i = 0; i < 2; ++i) entries.emplace_back(2 * static_cast<int>(entry.row()) + i, 2 * column + i, entry.value());
  Eigen::SparseMatrix<double> matrix(2 * scalar.rows(), 2 * scalar.cols());
  matrix.setFromTriplets(entries.begin(), entries.end());
  return matrix;
}

Eigen::Matrix<double, Eigen::Dynamic, 2> in_plane(const mesh::Mesh& surface) { return surface.nodes.leftCols<2>(); }

/// The colour of each node: squares of a quarter of the narrower side.
std::vector<int> checkerboard(const mesh::Mesh& surface) {
  const Eigen::RowVector2d low = surface.nodes.leftCols<2>().colwise().minCoeff(), side = surface.nodes.leftCols<2>().colwise().maxCoeff() - low;
  const double square = 0.25 * side.minCoeff() * (1.0 + 1e-9);
  std::vector<int> colour;
  for (Eigen::Index i = 0; i < surface.nodes.rows(); ++i) {
    const Eigen::RowVector2d at = (surface.nodes.row(i).head<2>() - low) / square;
    colour.push_back((static_cast<int>(at[0]) + static_cast<int>(at[1])) % 2);
  }
  return colour;
}

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
  make_modes(options.modes);
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
  if (paths.front().second.size() == 0) throw ConvergenceError("the declared model cannot follow the measured displacement of the ends");
  scene_.elastic = paths.front().first.col(frame) / paths.front().second[frame];
}

/// Subspace iteration for the smallest eigenvalues of curvature x = lambda M x; affine motions come first. Any smooth subspace
/// serves, the modes need not be exact.
void FieldExperiment::make_modes(int wanted) {
  const Eigen::SparseMatrix<double>& M = measured_.M;
  const auto size = M.rows();
  const auto count = std::min<Eigen::Index>(std::max(1, wanted / 2), std::max<Eigen::Index>(1, size / 8));
  const Eigen::SparseMatrix<double> K = correlation::curvature_energy(measured_.surface, 2);
  const double shift = 1e-6 * K.diagonal().sum() / M.diagonal().sum();
  const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> factor(K + shift * M);
  std::mt19937_64 random(1);
  std::normal_distribution<double> normal;
  Eigen::MatrixXd X(size, std::min<Eigen::Index>(size, count + count / 5 + 5));
  for (double& x : X.reshaped()) x = normal(random);
  for (int iteration = 0; iteration < 12; ++iteration) {
    X = factor.solve(M * X);
    const Eigen::MatrixXd MX = M * X;
    const Eigen::GeneralizedSelfAdjointEigenSolver<Eigen::MatrixXd> ritz(X.transpose() * (K * X), X.transpose() * MX);
    X = X * ritz.eigenvectors();
  }
  const Eigen::MatrixXd smooth = M * X.leftCols(count);
  const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> inverse(M);
  const std::vector<int> colour = checkerboard(measured_.surface);
  modes_.resize(2 * count, size), shapes_.resize(size, 2 * count);
  for (int c = 0; c < 2; ++c) {
    Eigen::MatrixXd A = smooth;
    for (Eigen::Index i = 0; i < size; ++i)
      if (colour[static_cast<std::size_t>(i / 2)] != c) A.row(i).setZero();
    const Eigen::MatrixXd moved = inverse.solve(A);
    const Eigen::LLT<Eigen::MatrixXd> L(A.transpose() * moved);
    modes_.middleRows(c * count, count) = L.matrixL().solve(A.transpose());
    shapes_.middleCols(c * count, count) = L.matrixL().solve(moved.transpose()).transpose();
  }
  const auto frames = measured_.force.size();
  const Eigen::MatrixXd over_time = Eigen::MatrixXd::Identity(frames, frames) + Eigen::MatrixXd::Constant(frames, frames, 1.0 / measured_.references);
  over_time_ = over_time.llt().matrixL().solve(Eigen::MatrixXd::Identity(frames, frames));
  for (Eigen::Index t = 0; t < frames; ++t) {
    for (Eigen::Index i = 0; i < 2 * count; ++i) data_.push_back({static_cast<int>(t), 0, i < count ? 0 : 1});
    if (std::isfinite(measured_.force_noise)) data_.push_back({static_cast<int>(t), force_channel});
  }
}

Eigen::VectorXd FieldExperiment::displacement_of(const Eigen::VectorXd& frame) const { return measured_.noise * (shapes_ * frame.head(shapes_.cols())); }

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
    made.to_variant = two_components(id::interpolation(measured_.surface, in_plane(own)));
    made.from_variant = two_components(id::interpolation(own, in_plane(measured_.surface)));
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
                                                  mechanics::EquilibriumOptions{.increments = model_.increments * numerics.increments_factor, .with_fields = false}, 1, 1);
  return made;
}

std::vector<std::pair<Eigen::MatrixXd, Eigen::VectorXd>> FieldExperiment::simulate(const std::vector<Simulation>& wanted) {
  const auto frames = measured_.force.size();
  std::vector<std::pair<Eigen::MatrixXd, Eigen::VectorXd>> results(wanted.size());
  std::vector<double> done(wanted.size(), 0.0);
  for (auto& [U, R] : results) U.setZero(measured_.surface.nodes.rows() * 2, frames), R.setZero(frames);
  const auto& layout = groups_->layout;
  // Series of one specimen one after another: its forward model is kept.
  std::vector<std::size_t> order(wanted.size());
  for (std::size_t k = 0; k < order.size(); ++k) order[k] = k;
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return wanted[a].variant < wanted[b].variant; });
  collectively(world_, [&] {
    for (std::size_t place = 0; place < order.size(); ++place) {
      if (static_cast<int>(place % static_cast<std::size_t>(layout.groups())) != layout.index()) continue;
      const Simulation& one = wanted[order[place]];
      auto& [U, R] = results[order[place]];
      Variant& with = variant(one.variant);
      const Eigen::Index before = with.before_test ? 1 : 0;
      Eigen::MatrixXd driving = Eigen::MatrixXd::Zero(with.to_variant.rows(), frames + before);
      driving.rightCols(frames) = with.to_variant * one.driving;
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
      id::Run run{.parameters = one.law, .driving = &driving};
      if (beyond.size() > 0) run.beyond = &beyond;
      const auto path = with.model->simulate(id::Control::displacement, {run}, static_cast<int>(frames + before)).front();
      if (path.frames < frames + before || !layout.group().is_root()) continue;
      Eigen::MatrixXd surface = path.surface.rightCols(frames);
      if (with.before_test) surface.colwise() -= path.surface.col(0).eval();
      U = with.from_variant * surface;
      R = path.reaction.tail(frames);
      done[order[place]] = 1.0;
    }
  });
  world_.sum(done);
  for (std::size_t k = 0; k < wanted.size(); ++k) {
    auto& [U, R] = results[k];
    world_.sum(std::span(U.data(), static_cast<std::size_t>(U.size())));
    world_.sum(std::span(R.data(), static_cast<std::size_t>(R.size())));
    if (done[k] < 0.5) R.resize(0);
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

std::vector<FieldExperiment::Prediction> FieldExperiment::predict(const std::vector<std::vector<double>>& sets, const std::vector<const Eigen::MatrixXd*>& drivings) {
  const auto frames = measured_.force.size();
  // Ends as they truly moved: measured less what the camera adds.
  std::vector<Simulation> wanted;
  struct Use {
    std::size_t set;
    double weight;
    std::size_t simulation;
  };
  std::vector<Use> uses;
  const auto add = [&](Simulation one, std::size_t set, double weight) {
    for (std::size_t k = 0; k < wanted.size(); ++k)
      if (wanted[k].law == one.law && wanted[k].variant == one.variant && wanted[k].loading == one.loading && wanted[k].driving == one.driving) {
        uses.push_back({set, weight, k});
        return;
      }
    wanted.push_back(std::move(one));
    uses.push_back({set, weight, wanted.size() - 1});
  };
  for (std::size_t s = 0; s < sets.size(); ++s) {
    Eigen::MatrixXd driving = *drivings[s];
    for (Eigen::Index t = 0; t < frames; ++t) {
      const Eigen::VectorXd measured = driving.col(t);
      Eigen::VectorXd error = Eigen::VectorXd::Zero(measured.size());
      for (std::size_t k = 0; k < effects_.size(); ++k) effects_[k]->see(values_of(k, sets[s]), scene_, static_cast<int>(t), measured, error);
      driving.col(t) -= error;
    }
    Simulation base = simulation_of(sets[s], driving);
    double rest = 1.0;
    for (std::size_t k = 0; k < effects_.size(); ++k) {
      Numerics numerics;
      effects_[k]->numerics(numerics);
      const auto its = values_of(k, sets[s]);
      if ((numerics.refinements == 0 && numerics.increments_factor == 1) || its[0] == 0.0) continue;
      Simulation other = base;
      std::vector<double>& key = other.variant.specimen;
      if (key.empty()) {
        key = {0.0, 1.0, 0.0};
        for (const auto& p : parameters_) key.push_back(p.info.null_value.value_or(0.0));
      }
      key[0] = numerics.refinements, key[1] = numerics.increments_factor;
      rest -= its[0];
      add(std::move(other), s, its[0]);
    }
    add(std::move(base), s, rest);
  }
  const auto paths = simulate(wanted);
  std::vector<Prediction> predictions(sets.size());
  std::vector<char> good(sets.size(), 1);
  for (auto& p : predictions) p.displacement.setZero(measured_.displacement.rows(), frames), p.force.setZero(frames);
  for (const Use& use : uses) {
    const auto& [U, R] = paths[use.simulation];
    if (R.size() == 0) {
      good[use.set] = 0;
      continue;
    }
    predictions[use.set].displacement += use.weight * U;
    predictions[use.set].force += use.weight * R;
  }
  for (std::size_t s = 0; s < sets.size(); ++s) {
    if (!good[s]) {
      predictions[s].force.resize(0);
      continue;
    }
    for (Eigen::Index t = 0; t < frames; ++t) {
      const Eigen::VectorXd U = predictions[s].displacement.col(t);
      Eigen::VectorXd error = Eigen::VectorXd::Zero(U.size());
      for (std::size_t k = 0; k < effects_.size(); ++k) effects_[k]->see(values_of(k, sets[s]), scene_, static_cast<int>(t), U, error);
      predictions[s].displacement.col(t) += error;
    }
    for (std::size_t k = 0; k < effects_.size(); ++k) effects_[k]->record(values_of(k, sets[s]), scene_, predictions[s].force);
  }
  return predictions;
}

Eigen::VectorXd FieldExperiment::whitened(const Eigen::MatrixXd& displacement, const Eigen::VectorXd& force) const {
  const Eigen::MatrixXd q = (modes_ * displacement) * over_time_.transpose() / measured_.noise;  // [modes x frames]
  if (!std::isfinite(measured_.force_noise)) return q.reshaped();
  Eigen::MatrixXd all(q.rows() + 1, q.cols());
  all.topRows(q.rows()) = q;
  all.bottomRows(1) = force.transpose() / measured_.force_noise;
  return all.reshaped();
}

std::vector<Eigen::VectorXd> FieldExperiment::residuals(const std::vector<std::vector<double>>& sets) {
  const auto predictions = predict(sets, std::vector<const Eigen::MatrixXd*>(sets.size(), &measured_.driving));
  std::vector<Eigen::VectorXd> result;
  for (const auto& p : predictions)
    result.push_back(p.force.size() == 0 ? Eigen::VectorXd() : whitened(measured_.displacement - bias_->displacement - p.displacement, measured_.force - bias_->force - p.force));
  return result;
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
  Eigen::MatrixXd seen = measured_.correlate(own, surface);
  for (Eigen::Index t = 0; t < frames; ++t) {
    const Eigen::VectorXd U = seen.col(t);
    Eigen::VectorXd error = Eigen::VectorXd::Zero(U.size());
    for (std::size_t k = 0; k < effects_.size(); ++k) effects_[k]->see(values_of(k, values), scene_, static_cast<int>(t), U, error);
    seen.col(t) += error;
  }
  for (std::size_t k = 0; k < effects_.size(); ++k) effects_[k]->record(values_of(k, values), scene_, force);
  return {std::move(seen), std::move(force)};
}

void FieldExperiment::learn_bias(const std::vector<double>& values) {
  if (!measured_.correlate) return;
  const auto [seen, force] = synthetic_test(values);
  const Eigen::MatrixXd driving = measured_.smooth(seen);
  const auto p = predict({values}, {&driving}).front();
  if (p.force.size() == 0) throw ConvergenceError("the model cannot follow the displacement of the synthetic test's ends");
  bias_ = std::make_shared<Bias>(seen - p.displacement, force - p.force);
}

Eigen::MatrixXd FieldExperiment::noise(const std::vector<double>& values, int draws) {
  const auto frames = measured_.force.size(), unknowns = measured_.displacement.rows();
  const Eigen::SimplicialLLT<Eigen::SparseMatrix<double>> factor(measured_.M);  // P M P^T = L L^T
  std::mt19937_64 random(7);
  std::normal_distribution<double> normal;
  Eigen::MatrixXd result(static_cast<Eigen::Index>(data_.size()), draws);
  const auto nominal = predict({values}, {&measured_.driving}).front();
  if (nominal.force.size() == 0) throw ConvergenceError("the model cannot follow the measured displacement of the ends");
  const int together = 16;  // draws whose fields are held at once
  for (int first = 0; first < draws; first += together) {
    const int here = std::min(together, draws - first);
    std::vector<Eigen::MatrixXd> fields, drivings;
    for (int b = 0; b < here; ++b) {
      Eigen::MatrixXd white(unknowns, frames + 1);
      for (double& x : white.reshaped()) x = normal(random);
      const Eigen::MatrixXd field = measured_.noise * (factor.permutationPinv() * Eigen::MatrixXd(factor.matrixU().solve(white)));
      fields.emplace_back(field.leftCols(frames).colwise() + field.col(frames) / std::sqrt(static_cast<double>(measured_.references)));
      drivings.emplace_back(measured_.driving + measured_.smooth(fields.back()));
    }
    std::vector<const Eigen::MatrixXd*> pointers;
    for (const auto& driving : drivings) pointers.push_back(&driving);
    const auto predictions = predict(std::vector<std::vector<double>>(static_cast<std::size_t>(here), values), pointers);
    for (int b = 0; b < here; ++b) {
      const auto& p = predictions[static_cast<std::size_t>(b)];
      Eigen::VectorXd force(frames);
      for (double& x : force) x = std::isfinite(measured_.force_noise) ? measured_.force_noise * normal(random) : 0.0;
      Eigen::MatrixXd field = fields[static_cast<std::size_t>(b)];
      if (p.force.size() > 0) field -= p.displacement - nominal.displacement, force -= p.force - nominal.force;
      result.col(first + b) = whitened(field, force);
    }
  }
  return result;
}

}  // namespace imic3d::loop
