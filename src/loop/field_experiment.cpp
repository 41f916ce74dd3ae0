#include "imic3d/loop/field_experiment.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <Eigen/Dense>
#include <Eigen/SparseCholesky>
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <optional>
#include <random>

#include "declared.hpp"
#include "field_series.hpp"
#include "imic3d/core/error.hpp"
#include "imic3d/loop/law_effects.hpp"
#include "imic3d/loop/statistics.hpp"

namespace imic3d::loop {

namespace id = identification;

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

/// Motions of a rig against the specimen that its face shows [unknowns x 3, with three components 6].
Eigen::MatrixXd rigid_motions(const FieldFace& face) {
  const int c = face.components;
  Eigen::MatrixXd R = Eigen::MatrixXd::Zero(face.unknowns(), c == 2 ? 3 : 6);
  const Eigen::RowVector3d middle = face.surface.nodes.colwise().mean();
  for (Eigen::Index i = 0; i < face.surface.nodes.rows(); ++i) {
    const Eigen::RowVector3d X = face.surface.nodes.row(i) - middle;
    for (int k = 0; k < c; ++k) R(c * i + k, k) = 1.0;
    R(c * i, c) = -X[1], R(c * i + 1, c) = X[0];
    if (c == 3) R(c * i + 2, 4) = X[1], R(c * i + 1, 4) = -X[2], R(c * i + 2, 5) = -X[0], R(c * i, 5) = X[2];
  }
  return R;
}

/// Refuses a measured force [frames] that has, beyond its noise, another sign than the declared model's, or is a
/// hundred times larger or smaller: no identification leads from there.
void check_force(const Eigen::VectorXd& measured, double noise, const Eigen::VectorXd& reaction) {
  if (!std::isfinite(noise) || reaction.squaredNorm() == 0.0) return;
  const double ratio = measured.dot(reaction) / reaction.squaredNorm(), doubt = 3.0 * noise / reaction.norm();
  if (ratio + doubt < 0.01 || ratio - doubt > 100.0)
    throw InputError("loads.force", fmt::format("{:.3g} times the forces that the declared parameters give", ratio),
                     "0.01 to 100 times: force, length and material in the units of the case file, tension positive "
                     "(a negative loads.force_scale turns it)");
}

}  // namespace

FieldExperiment::FieldExperiment(Communicator world, FieldData data, DeclaredModel model, const FieldOptions& options)
    : world_(world), measured_(std::move(data)), model_(std::move(model)), groups_(new Groups(world, model_.groups)) {
  std::optional<Candidate> of_poissons_ratio;
  for (std::size_t j = 0; j < model_.values.size(); ++j) {
    const double value = model_.values[j];
    parameters_.push_back({.info = model_.information[j],
                           .value = value,
                           .step = 1e-3 * (value != 0.0 ? std::abs(value) : 1.0),
                           .prior = model_.priors[j],
                           .free = model_.free[j] != 0});
    if (model_.information[j].name == "nu" && !model_.free[j]) of_poissons_ratio = poissons_ratio(static_cast<int>(j));
  }
  for (const auto& info : model_.lacking) parameters_.push_back(at_null(info));
  candidates_ = law_candidates(model_.lacking, std::vector<char>(model_.lacking.size(), 0),
                               static_cast<int>(model_.values.size()));
  if (of_poissons_ratio) candidates_.push_back(*of_poissons_ratio);
  bias_ = std::make_shared<Bias>(std::vector<double>(),
                                 Eigen::MatrixXd::Zero(measured_.displacement.rows(), measured_.displacement.cols()),
                                 Eigen::VectorXd::Zero(measured_.force.size()));
  make_scene();
  make_candidates();
  M_ = blocks(measured_.faces, [](const FieldFace& face) { return face.M; });
  const auto frames = measured_.force.size();
  for (std::size_t k = 0; k < faces_.size(); ++k) {
    const FieldFace& face = measured_.faces[k];
    faces_[k].modes = SurfaceModes(face.surface, face.M, options.modes * face.components / 2,
                                   faces_.size() > 1 || face.components == 3 ? rigid_motions(face) : Eigen::MatrixXd());
    Eigen::MatrixXd covariance = Eigen::MatrixXd::Constant(frames, frames, 1.0 / measured_.references);
    covariance.diagonal() +=
        face.frame_noise.size() > 0 ? Eigen::VectorXd(face.frame_noise.cwiseAbs2()) : Eigen::VectorXd::Ones(frames);
    faces_[k].over_time = whitening(covariance, measured_.held_out);
  }
  for (Eigen::Index t = 0; t < frames; ++t) {
    for (std::size_t k = 0; k < faces_.size(); ++k)
      for (int side : faces_[k].modes.sides()) data_.push_back({static_cast<int>(t), static_cast<int>(k), side});
    if (std::isfinite(measured_.force_noise)) data_.push_back({static_cast<int>(t), force_channel});
  }
}

FieldExperiment::~FieldExperiment() = default;

/// Effects as candidates, but for what the model declares of them; those of cameras once for each face, and where
/// several cameras see it in space once for each of them.
void FieldExperiment::make_candidates() {
  std::vector<Candidate> ordered;
  std::vector<std::string> keys;
  const auto add = [&](const std::shared_ptr<const Effect>& effect, int face, const std::string& which,
                       const std::string& where) {
    const Scene& scene = faces_[static_cast<std::size_t>(std::max(0, face))].scene;
    if (!effect->applies(scene)) return;
    const auto description = effect->describe(scene);
    Candidate candidate{which + description.name,  description.link,         {}, description.sentence + where,
                        description.confused_with, description.separated_by, {}};
    keys.push_back(key_of(candidate.name));
    first_.push_back(parameters_.size());
    for (const auto& q : description.quantities) {
      const int place = static_cast<int>(parameters_.size());
      parameters_.push_back(absent(q, model_.unit ? model_.unit(q.unit) : q.unit));
      const auto* declared = declare(parameters_.back(), keys.back(), model_.effects);
      if (declared != nullptr) {
        Parameter& known = parameters_.back();
        known.prior = declared->prior * q.size;
        if (known.prior > 0.0) {  // what is farther off is something else
          known.info.lower = std::max(known.info.lower, known.value - 5.0 * known.prior);
          known.info.upper = std::min(known.info.upper, known.value + 5.0 * known.prior);
        }
      } else {
        candidate.parameters.push_back(place);
      }
      Parameter& its = parameters_.back();
      its.info.name = key_of(which) + q.name;
      if (const auto& read = measured_.force_at_rest;
          q.read_at_rest && read && its.prior == 0.0 && (its.free || declared == nullptr))
        its.reading = read->value, its.prior = read->deviation;
    }
    if (candidate.parameters.size() == description.quantities.size()) candidate.elsewhere = description.elsewhere;
    candidate.changes_path = description.changes_path;
    // What says how an effect acts, not how much, is none by itself.
    if (std::any_of(candidate.parameters.begin(), candidate.parameters.end(),
                    [&](int j) { return !parameters_[static_cast<std::size_t>(j)].info.shape; }))
      ordered.push_back(std::move(candidate));
    effects_.push_back(effect);
    face_of_.push_back(face);
  };
  for (const auto& effect : effects()) {
    if (!effect->of_each_camera()) {
      add(effect, -1, "", "");
      continue;
    }
    for (std::size_t k = 0; k < faces_.size(); ++k) {
      const FieldFace& face = measured_.faces[k];
      const bool alone = faces_.size() == 1;
      add(effect, static_cast<int>(k), alone ? "" : face.name + " ", alone ? "" : ", on the " + face.name + " face");
      if (effect->of_one_of_several())
        for (std::size_t c = 0; c < face.sights.size(); ++c)
          add(of_one_camera(effect, face.sights, c, face.surface, faces_[k].scene), static_cast<int>(k),
              face.sights[c].camera + " ", ", of the camera " + face.sights[c].camera);
    }
  }
  for (const auto& one : model_.effects)
    if (std::find(keys.begin(), keys.end(), one.effect) == keys.end())
      throw InputError("effects." + one.effect,
                       "declared for a specimen that lacks what it acts on, or for cameras that it lacks",
                       fmt::format("one of {}", fmt::join(keys, ", ")));
  candidates_.insert(candidates_.end(), ordered.begin(), ordered.end());
  std::stable_sort(candidates_.begin(), candidates_.end(),
                   [](const auto& a, const auto& b) { return a.link < b.link; });
}

void FieldExperiment::make_scene() {
  Scene scene;
  scene.time = measured_.time, scene.force = measured_.force, scene.start_time = measured_.start_time,
  scene.reference_time = measured_.reference_time;
  scene.images = measured_.images;
  for (std::size_t j = 0; j < model_.values.size(); ++j)
    if (model_.information[j].name == "nu") scene.poisson = model_.values[j];
  Variant& declared = variant({});
  differentiable_ = declared.model->differentiable();
  scene.axis = declared.specimen.axis;
  scene.plane = mesh::dimension(declared.specimen.volume.type) == 2;
  scene.half = !scene.plane && declared.specimen.section_factor != 1.0;
  scene.elongation = elongation_of(declared.specimen, declared.to_variant * measured_.driving);
  const mesh::Mesh& volume = declared.specimen.volume;
  const double depth = volume.nodes.col(2).maxCoeff() - volume.nodes.col(2).minCoeff();
  scene.thickness = scene.plane ? volume.thickness : declared.specimen.section_factor * depth;
  if (!scene.half && !scene.plane) {
    scene.driven_depth = measured_.faces.size() == 2              ? 0.5 * depth
                         : measured_.faces.front().name == "back" ? depth
                                                                  : 0.0;
  }
  Eigen::Index first = 0;
  for (const auto& face : measured_.faces) {
    faces_.push_back({scene, {}, first, {}});
    Scene& own = faces_.back().scene;
    own.surface = &face.surface, own.components = face.components;
    measure(own, face.surface);
    own.pixels = face.pixels, own.axis_of_lens = face.axis_of_lens;
    first += face.unknowns();
  }
  const auto paths = simulate({Simulation{model_.values, {}, measured_.driving, {}}});
  if (paths.front().R.size() == 0)
    throw ConvergenceError("the declared model cannot follow the measured displacement of the ends");
  motion_ = paths.front().U;
  smooth_ends_ = motion_;
  for (int k = 0; k < 10; ++k)
    smooth_ends_ =
        measured_.smooth(std::move(smooth_ends_));  // of waves of which it leaves three quarters a twentieth stays
  check_force(measured_.force, measured_.force_noise, paths.front().R);
  // The elastic field: that of the last of the first loaded frames whose reaction is below 0.3 of the largest.
  const Eigen::VectorXd& reaction = paths.front().R;
  const double largest = reaction.cwiseAbs().maxCoeff();
  Eigen::Index frame = 0;
  while (frame + 1 < reaction.size() && std::abs(reaction[frame]) < 0.05 * largest) ++frame;
  while (frame + 1 < reaction.size() && std::abs(reaction[frame + 1]) >= std::abs(reaction[frame]) &&
         std::abs(reaction[frame + 1]) < 0.3 * largest)
    ++frame;
  for (std::size_t k = 0; k < faces_.size(); ++k) {
    const Eigen::VectorXd own = motion_.col(frame).segment(faces_[k].first, measured_.faces[k].unknowns());
    faces_[k].scene.elastic =
        largest > 0.0 ? Eigen::VectorXd(own / reaction[frame]) : Eigen::VectorXd::Zero(own.size());
  }
}

std::span<const double> FieldExperiment::values_of(std::size_t effect, const std::vector<double>& values) const {
  const std::size_t next = effect + 1 < first_.size() ? first_[effect + 1] : parameters_.size();
  return std::span(values).subspan(first_[effect], next - first_[effect]);
}

bool FieldExperiment::takes_simulations(int parameter) const {
  const auto effect =
      std::upper_bound(first_.begin(), first_.end(), static_cast<std::size_t>(parameter)) - first_.begin() - 1;
  if (effect < 0) return false;
  const Effect& its = *effects_[static_cast<std::size_t>(effect)];
  return its.changes_simulation(scene_of(static_cast<std::size_t>(effect))) &&
         !(its.acts_on_section() && differentiable_);
}

Eigen::VectorXd FieldExperiment::whitened(const Eigen::MatrixXd& displacement, const Eigen::VectorXd& force) const {
  const bool with_force = std::isfinite(measured_.force_noise);
  Eigen::MatrixXd all(static_cast<Eigen::Index>(data_.size()) / displacement.cols(), displacement.cols());
  Eigen::Index row = 0;
  for (std::size_t k = 0; k < faces_.size(); ++k) {
    const auto count = static_cast<Eigen::Index>(faces_[k].modes.sides().size());
    const Eigen::MatrixXd own = displacement.middleRows(faces_[k].first, measured_.faces[k].unknowns());
    all.middleRows(row, count) = faces_[k].modes.numbers(own) * faces_[k].over_time.transpose() / measured_.noise;
    row += count;
  }
  if (with_force) all.bottomRows(1) = force.transpose() / measured_.force_noise;
  return all.reshaped();
}

Eigen::VectorXd FieldExperiment::displacement_of(const Eigen::VectorXd& frame) const {
  Eigen::VectorXd all(measured_.unknowns());
  Eigen::Index row = 0;
  for (std::size_t k = 0; k < faces_.size(); ++k) {
    const auto count = static_cast<Eigen::Index>(faces_[k].modes.sides().size());
    all.segment(faces_[k].first, measured_.faces[k].unknowns()) =
        measured_.noise * faces_[k].modes.displacement(frame.segment(row, count));
    row += count;
  }
  return all;
}

Eigen::VectorXd FieldExperiment::lengths_of(const Eigen::VectorXd& displacement) const {
  Eigen::VectorXd all;
  for (std::size_t k = 0; k < faces_.size(); ++k) {
    const auto& face = measured_.faces[k];
    const Eigen::VectorXd own = displacement.segment(faces_[k].first, face.unknowns());
    const auto nodes = face.surface.nodes.rows();
    all.conservativeResize(all.size() + nodes);
    all.tail(nodes) = face.components == 2 ? Experiment::lengths_of(own)
                                           : Eigen::VectorXd(own.reshaped(3, nodes).colwise().norm().transpose());
  }
  return all;
}

std::vector<Eigen::VectorXd> FieldExperiment::residuals(const std::vector<std::vector<double>>& sets) {
  const auto predictions = predict(sets, std::vector<const Eigen::MatrixXd*>(sets.size(), &measured_.driving));
  std::vector<Eigen::VectorXd> result;
  for (const auto& p : predictions) result.push_back(p.force.size() == 0 ? Eigen::VectorXd() : residual_of(p));
  return result;
}

Eigen::VectorXd FieldExperiment::residual_of(const Prediction& p) const {
  return whitened(measured_.displacement - bias_->displacement - p.displacement,
                  measured_.force - bias_->force - p.force);
}

std::pair<Eigen::MatrixXd, Eigen::VectorXd> FieldExperiment::unwhitened(const std::vector<double>& values) {
  const auto p = predict({values}, {&measured_.driving}).front();
  if (p.force.size() == 0) throw ConvergenceError("the model cannot follow the measured displacement of the ends");
  return {measured_.displacement - bias_->displacement - p.displacement, measured_.force - bias_->force - p.force};
}

FieldExperiment::SyntheticTests FieldExperiment::synthetic_tests(const std::vector<double>& values,
                                                                 const Eigen::MatrixXd& driving_as_seen) {
  const auto one = [&](const Eigen::MatrixXd& driving, const Numerics& numerics) {
    Simulation made = simulation_of(values, true_motion(values, driving));
    made.variant.numerics = numerics;
    made.variant.synthetic = true;
    return made;
  };
  std::vector<Simulation> wanted;
  for (int refined = refinements(); refined > 0; --refined)
    wanted.push_back(one(driving_as_seen, {.refinements = refined, .increments_factor = more_increments()}));
  for (const int increments : {1, again, 1})
    wanted.push_back(one(measured_.driving, {.increments_factor = increments * more_increments()}));
  wanted.back().straight = true;
  for (const double part : {thin, 1.0})
    if (scene().plane) wanted.push_back(one(driving_as_seen, {.in_space = true, .of_thickness = part}));
  for (int shape = 0; scene().plane && shape < uneven_shapes(); ++shape) wanted.back().uneven.push_back(shape);
  auto series = simulate(wanted);
  auto place = series.begin();
  const auto next = [&place] { return std::move(*place++); };
  SyntheticTests made;
  for (int refined = refinements(); refined > 0; --refined) made.refined.push_back(next());
  made.few = next(), made.many = next(), made.straight = next();
  if (scene().plane) made.flat = next(), made.flat.R /= thin, made.in_space = next();
  return made;
}

void FieldExperiment::learn_bias(const std::vector<double>& values) {
  if (!measured_.correlate) return;
  const auto followed = [&](const Eigen::MatrixXd& driving) {
    auto p = predict({values}, {&driving}).front();
    if (p.force.size() == 0)
      throw ConvergenceError("the model cannot follow the displacement of the synthetic test's ends");
    return p;
  };
  // The noise of the ends would be taken off the residual a second time, in the null it would not: simulated and
  // smoothed again, little of it is left. More often, and the synthetic test would lack what smoothing takes away.
  const auto nominal = followed(measured_.driving);
  const Eigen::MatrixXd driving = measured_.smooth(nominal.displacement);
  const auto [refined, few, many, straight, flat, in_space] = synthetic_tests(values, driving);
  const auto left = [&](const Series& made) {
    if (made.R.size() == 0)
      throw ConvergenceError("the model on a finer mesh cannot follow the measured displacement of the ends");
    const Prediction seen = observed(values, {measured_.correlate(made.specimen, made.surface), made.R});
    const auto p = followed(measured_.smooth(seen.displacement));
    return Prediction{seen.displacement - p.displacement, seen.force - p.force};
  };
  const auto of_noise = [&](const Prediction& p) { return whitened(p.displacement, p.force); };
  Bias learned(values, {}, {});
  const auto doubt_too = [&learned](const Eigen::VectorXd& column) {
    learned.doubt.conservativeResize(column.size(), learned.doubt.cols() + 1);
    learned.doubt.rightCols(1) = column;
  };
  Prediction bias = left(refined[0]);
  if (refinements() > 1) {
    // What further refinements would show, each a share q of the one before.
    const Prediction coarser = left(refined[1]),
                     last{bias.displacement - coarser.displacement, bias.force - coarser.force};
    const Eigen::VectorXd first = of_noise(coarser);
    const double q = std::clamp(first.dot(of_noise(last)) / std::max(1e-300, first.squaredNorm()), 0.0, 0.7),
                 beyond = q / (1.0 - q);
    doubt_too(0.1 * of_noise(bias));  // synthetic images are not real ones
    bias.displacement += beyond * last.displacement, bias.force += beyond * last.force;
    doubt_too(beyond * of_noise(last));
  } else {
    doubt_too(of_noise(bias));
  }
  if (few.R.size() > 0 && many.R.size() > 0) {
    constexpr double all =
        again / (again - 1.0);  // what infinitely many increments would show: the error goes with their length
    const Prediction of_few = observed(values, {few.U, few.R}), of_many = observed(values, {many.U, many.R});
    const Prediction more{all * (of_many.displacement - of_few.displacement), all * (of_many.force - of_few.force)};
    bias.displacement += more.displacement, bias.force += more.force;
    doubt_too(0.5 * of_noise(more));
  }
  if (few.R.size() > 0 && straight.R.size() > 0) {  // how the ends go between two frames no image tells
    const Prediction bent = observed(values, {few.U, few.R}), other = observed(values, {straight.U, straight.R});
    doubt_too(0.5 * of_noise({bent.displacement - other.displacement, bent.force - other.force}));
  }
  if (flat.R.size() > 0 && in_space.R.size() > 0) {
    const Prediction of_flat = observed(values, {flat.U, flat.R}), thick = observed(values, {in_space.U, in_space.R});
    const Prediction more{thick.displacement - of_flat.displacement, thick.force - of_flat.force};
    bias.displacement += more.displacement, bias.force += more.force;
    learned.in_space = of_noise(more);
    doubt_too(0.25 * learned.in_space);
  }
  if (const auto second = second_order_of_noise(values, nominal)) {
    bias.displacement += second->displacement, bias.force += second->force;
    doubt_too(0.5 * of_noise(*second));
  }
  learned.of_numerics = learned.doubt.cols();
  learned.displacement = std::move(bias.displacement), learned.force = std::move(bias.force);
  std::vector<std::vector<double>> with;
  for (const auto& [j, size] : always_there()) with.push_back(values), with.back()[j] += size;
  for (const auto& p : predict(with, std::vector<const Eigen::MatrixXd*>(with.size(), &measured_.driving)))
    if (p.force.size() > 0) doubt_too(whitened(p.displacement - nominal.displacement, p.force - nominal.force));
  for (std::size_t k = 0; k < effects_.size(); ++k)
    if (const Eigen::VectorXd unknown = effects_[k]->unknown_in_record(values_of(k, values), scene_of(k));
        unknown.size() > 0)
      for (Eigen::Index t = 0; t < unknown.size(); ++t)  // of each frame for itself
        if (unknown[t] > 0.1 * measured_.force_noise)
          doubt_too(whitened(Eigen::MatrixXd::Zero(nominal.displacement.rows(), nominal.displacement.cols()),
                             unknown[t] * Eigen::VectorXd::Unit(unknown.size(), t)));
  for (const auto& column : theory_in_doubt(values, nominal.force)) doubt_too(column);
  const double share = std::pow(std::min(1.0, scene().thickness / scene().span(1 - scene().axis) / uneven_thickness),
                                2);  // of what ends of thick specimens do at depth
  if (learned.in_space.size() > 0) {
    for (std::size_t k = 0; k < in_space.dU.size(); ++k) doubt_too(share * whitened(in_space.dU[k], in_space.dR[k]));
  } else if (differentiable_ && !scene().plane) {
    std::vector<Tangent> uneven;
    for (int shape = 0; shape < uneven_shapes(); ++shape) uneven.push_back({.uneven = shape});
    if (!uneven.empty())
      for (const auto& p : differentiate(values, uneven).second) doubt_too(share * whitened(p.displacement, p.force));
  }
  bias_ = std::make_shared<Bias>(std::move(learned));
}

std::vector<Eigen::VectorXd> FieldExperiment::theory_in_doubt(const std::vector<double>& values,
                                                              const Eigen::VectorXd& reaction) {
  constexpr double known_to = 1e-3;
  const double section = scene().thickness * scene().span(1 - scene().axis), E = parameters_.front().value,
               elastic_strain = reaction.cwiseAbs().maxCoeff() / section / E;
  const auto columns = [&](bool of_flow) {
    std::vector<std::pair<std::size_t, double>> in_doubt;
    std::vector<double> at = values;
    for (std::size_t j = 0; j < model_.values.size() + model_.lacking.size(); ++j) {
      const auto& info = parameters_[j].info;
      const bool declared = j < model_.values.size();
      if (info.turns_flow && (declared || of_flow)) {
        in_doubt.emplace_back(j, std::max(known_to, elastic_strain));
        if (!declared) at[j] += 1e-9;  // so that the law has it: all are derivatives of one series
      } else if (declared && values[j] != 0.0) {
        in_doubt.emplace_back(j, known_to * values[j]);
      }
    }
    std::vector<std::vector<double>> sets;
    for (const auto& [j, size] : in_doubt) sets.push_back(at), sets.back()[j] += parameters_[j].step;
    const auto residual = residuals_near(at, sets);
    std::vector<Eigen::VectorXd> found;
    for (std::size_t k = 0; k < sets.size(); ++k)
      if (residual[0].size() > 0 && residual[1 + k].size() > 0)
        found.push_back(in_doubt[k].second / parameters_[in_doubt[k].first].step * (residual[1 + k] - residual[0]));
    return found;
  };
  auto found = columns(true);
  return found.empty() ? columns(false) : found;
}

std::vector<Eigen::MatrixXd> FieldExperiment::learned_numbers() const {
  if (!measured_.correlate) return {};
  return {bias_->displacement, bias_->force, bias_->doubt,
          Eigen::MatrixXd::Constant(1, 1, static_cast<double>(bias_->of_numerics)), bias_->in_space};
}

void FieldExperiment::learn_again(const std::vector<double>& values, const std::vector<Eigen::MatrixXd>& numbers) {
  if (!measured_.correlate) return;
  Bias learned(values, numbers.at(0), numbers.at(1));
  learned.doubt = numbers.at(2), learned.of_numerics = static_cast<Eigen::Index>(numbers.at(3)(0, 0)),
  learned.in_space = numbers.at(4);
  bias_ = std::make_shared<Bias>(std::move(learned));
}

std::vector<std::pair<std::size_t, double>> FieldExperiment::always_there() const {
  std::vector<std::pair<std::size_t, double>> there;
  for (std::size_t k = 0; k < effects_.size(); ++k) {
    const auto name = effects_[k]->describe(scene_of(k)).name;
    if (name == "misalignment" && !scene().plane && faces_.size() == 1) there.emplace_back(first_[k], 0.005);
    if (name == "sub-pixel interpolation")
      there.emplace_back(first_[k], 0.001), there.emplace_back(first_[k] + 1, 0.001);
  }
  return there;
}

Experiment::Doubt FieldExperiment::doubt() const {
  if (bias_->doubt.cols() == 0)
    return {Eigen::VectorXd::Zero(static_cast<Eigen::Index>(data_.size())),
            Eigen::MatrixXd::Zero(static_cast<Eigen::Index>(data_.size()), 1)};
  return {0.2 * bias_->doubt.leftCols(bias_->of_numerics).rowwise().norm(), bias_->doubt};
}

/// Sets that differ from `values` in numbers of the law, in what drives the ends or in the section are taken along the
/// derivatives of one series; the others are simulated.
std::vector<Eigen::VectorXd> FieldExperiment::residuals_near(const std::vector<double>& values,
                                                             std::vector<std::vector<double>> sets) {
  if (!differentiable_) return Experiment::residuals_near(values, std::move(sets));
  const Eigen::MatrixXd driving = true_motion(values, measured_.driving);
  const auto here = simulations_of(values, driving);
  std::vector<Tangent> tangents;
  std::vector<std::vector<std::pair<std::size_t, double>>> moves(sets.size());  // along tangents
  std::vector<std::size_t> far;
  for (std::size_t s = 0; s < sets.size(); ++s) {
    const auto there = simulations_of(sets[s], true_motion(sets[s], measured_.driving));
    const bool near =
        std::equal(there.begin(), there.end(), here.begin(), here.end(), [&](const auto& a, const auto& b) {
          const Simulation one = with_section(a.second, values), other = with_section(b.second, values);
          return a.first == b.first && one.variant == other.variant && one.loading == other.loading;
        });
    if (!near) {
      far.push_back(s);
      continue;
    }
    const Simulation &one = there.front().second, &base = here.front().second;
    for (std::size_t j = 0; j < base.law.size(); ++j) {
      if (one.law[j] == base.law[j]) continue;
      const auto same = [&](const Tangent& t) { return t.parameter == static_cast<int>(j); };
      const auto found =
          static_cast<std::size_t>(std::find_if(tangents.begin(), tangents.end(), same) - tangents.begin());
      if (found == tangents.size()) tangents.push_back({.parameter = static_cast<int>(j)});
      moves[s].emplace_back(found, one.law[j] - base.law[j]);
    }
    if (one.driving != base.driving) {
      moves[s].emplace_back(tangents.size(), 1.0);
      tangents.push_back({.driving = one.driving - base.driving});
    }
    if (one.variant.specimen != base.variant.specimen) {
      moves[s].emplace_back(tangents.size(), 1.0);
      tangents.push_back({.section = sets[s]});
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
    for (const auto& [k, length] : moves[s])
      moved.displacement += length * derivatives[k].displacement, moved.force += length * derivatives[k].force;
    result[1 + s] = residual_of(observed(sets[s], std::move(moved)));
  }
  return result;
}

std::vector<Eigen::VectorXd> FieldExperiment::residuals_disturbed(const std::vector<double>& values,
                                                                  std::vector<std::vector<double>> sets, double times) {
  if (disturbance_.size() == 0) {
    std::mt19937_64 random(17);
    disturbance_ = measured_.smooth(drawn_fields(Eigen::SimplicialLLT<Eigen::SparseMatrix<double>>(M_), random).first);
  }
  const Eigen::MatrixXd undisturbed = measured_.driving;
  measured_.driving += times * disturbance_;
  std::vector<Eigen::VectorXd> result;
  try {
    result = residuals_near(values, std::move(sets));
  } catch (...) {
    measured_.driving = undisturbed;
    throw;
  }
  measured_.driving = undisturbed;
  return result;
}

std::vector<FieldExperiment::Prediction> FieldExperiment::responses(const std::vector<double>& values,
                                                                    const std::vector<Eigen::MatrixXd>& changes) {
  const Eigen::MatrixXd driving = true_motion(values, measured_.driving);
  std::vector<Tangent> tangents;
  for (const auto& change : changes)
    tangents.push_back({.driving = true_motion(values, measured_.driving + change) - driving});
  auto [nominal, moved] = differentiate(values, tangents);
  if (nominal.force.size() == 0)
    throw ConvergenceError("the model cannot follow the measured displacement of the ends");
  const Prediction seen = observed(values, nominal);
  for (auto& one : moved) {
    one.displacement += nominal.displacement, one.force += nominal.force;
    one = observed(values, std::move(one));
    one.displacement -= seen.displacement, one.force -= seen.force;
  }
  return moved;
}

std::vector<FieldExperiment::Prediction> FieldExperiment::differences(const std::vector<double>& values,
                                                                      const std::vector<Eigen::MatrixXd>& changes) {
  const auto nominal = predict({values}, {&measured_.driving}).front();
  if (nominal.force.size() == 0)
    throw ConvergenceError("the model cannot follow the measured displacement of the ends");
  std::vector<Prediction> all;
  constexpr std::size_t together = 16;  // whose fields are held at once
  for (std::size_t first = 0; first < changes.size(); first += together) {
    std::vector<Eigen::MatrixXd> drivings;
    for (std::size_t k = first; k < std::min(changes.size(), first + together); ++k)
      drivings.emplace_back(measured_.driving + changes[k]);
    std::vector<const Eigen::MatrixXd*> pointers;
    for (const auto& driving : drivings) pointers.push_back(&driving);
    for (auto& p : predict(std::vector<std::vector<double>>(drivings.size(), values), pointers)) {
      if (p.force.size() == 0)  // out of the solver's reach: as if nothing had moved
        p = {Eigen::MatrixXd::Zero(measured_.displacement.rows(), measured_.force.size()),
             Eigen::VectorXd::Zero(measured_.force.size())};
      else
        p.displacement -= nominal.displacement, p.force -= nominal.force;
      all.push_back(std::move(p));
    }
  }
  return all;
}

namespace {
/// Fields of covariance M^-1 [unknowns x count]; factor: P M P^T = L L^T.
Eigen::MatrixXd drawn(const Eigen::SimplicialLLT<Eigen::SparseMatrix<double>>& factor, Eigen::Index count,
                      std::mt19937_64& random) {
  std::normal_distribution<double> normal;
  Eigen::MatrixXd white(factor.rows(), count);
  for (double& x : white.reshaped()) x = normal(random);
  return factor.permutationPinv() * Eigen::MatrixXd(factor.matrixU().solve(white));
}
}  // namespace

std::pair<Eigen::MatrixXd, Eigen::MatrixXd> FieldExperiment::drawn_fields(
    const Eigen::SimplicialLLT<Eigen::SparseMatrix<double>>& factor, std::mt19937_64& random, Eigen::Index rest) const {
  const auto frames = measured_.force.size();
  Eigen::MatrixXd field = measured_.noise * drawn(factor, frames + 1 + rest, random);
  for (std::size_t k = 0; k < faces_.size(); ++k)
    if (const auto& face = measured_.faces[k]; face.frame_noise.size() > 0)
      field.block(faces_[k].first, 0, face.unknowns(), frames) *= face.frame_noise.asDiagonal();
  const Eigen::VectorXd reference = field.col(frames) / std::sqrt(static_cast<double>(measured_.references));
  return {field.leftCols(frames).colwise() + reference, field.rightCols(rest).colwise() + reference};
}

std::optional<FieldExperiment::Prediction> FieldExperiment::second_order_of_noise(const std::vector<double>& values,
                                                                                  const Prediction& nominal) {
  constexpr std::size_t pairs = 4;
  const auto frames = measured_.force.size();
  const Eigen::SimplicialLLT<Eigen::SparseMatrix<double>> factor(M_);
  std::mt19937_64 random(13);
  std::vector<Eigen::MatrixXd> drivings;
  for (std::size_t k = 0; k < pairs; ++k) {
    const Eigen::MatrixXd change = measured_.smooth(drawn_fields(factor, random).first);
    drivings.push_back(measured_.driving + change), drivings.push_back(measured_.driving - change);
  }
  std::vector<const Eigen::MatrixXd*> each;
  for (const auto& driving : drivings) each.push_back(&driving);
  Prediction mean{Eigen::MatrixXd::Zero(nominal.displacement.rows(), frames), Eigen::VectorXd::Zero(frames)};
  for (const auto& p : predict(std::vector<std::vector<double>>(each.size(), values), each)) {
    if (p.force.size() == 0) return std::nullopt;
    mean.displacement += (nominal.displacement - p.displacement) / static_cast<double>(each.size()),
        mean.force += (nominal.force - p.force) / static_cast<double>(each.size());
  }
  return mean;
}

Eigen::MatrixXd FieldExperiment::noise(const std::vector<double>& values, int draws) {
  const auto frames = measured_.force.size();
  const Eigen::SimplicialLLT<Eigen::SparseMatrix<double>> factor(M_);
  const Eigen::Index rest = measured_.noise_at_rest ? measured_.at_rest : 0;
  // Other draws for another test: the same ones would err alike in all, and no rate could be told. The same ones for
  // the same record.
  std::uint64_t seed = 7;
  for (double force : measured_.force) seed = 6364136223846793005U * seed + std::bit_cast<std::uint64_t>(force);
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  std::vector<Eigen::MatrixXd> fields, changes;
  std::vector<Eigen::VectorXd> forces;
  std::vector<double> told;
  for (int b = 0; b < draws; ++b) {
    auto [field, at_rest] = drawn_fields(factor, random, rest);
    fields.push_back(std::move(field));
    if (rest > 0) told.push_back(measured_.noise_at_rest(at_rest));
    auto& force = forces.emplace_back(frames);
    for (double& x : force) x = std::isfinite(measured_.force_noise) ? measured_.force_noise * normal(random) : 0.0;
  }
  // In units of the noise that its own frames at rest would have told.
  double mean_square = 0.0;
  for (double one : told) mean_square += one * one / static_cast<double>(draws);
  for (std::size_t b = 0; b < told.size(); ++b) fields[b] *= std::sqrt(mean_square) / told[b];
  for (const auto& field : fields) changes.push_back(measured_.smooth(field));
  const auto moved = differentiable_ ? responses(values, changes) : differences(values, changes);
  Eigen::MatrixXd result(static_cast<Eigen::Index>(data_.size()), draws);
  for (int b = 0; b < draws; ++b) {
    const auto k = static_cast<std::size_t>(b);
    result.col(b) = whitened(fields[k] - moved[k].displacement, forces[k] - moved[k].force);
  }
  return result;
}

}  // namespace imic3d::loop
