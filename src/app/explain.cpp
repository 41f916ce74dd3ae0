// imic3d explain: which effect of the test, if it was left out of the model, carries one set of identified parameters
// into another? Nothing is measured: the declared specimen is simulated with the first set and the effect, and
// identified without it.

#include "imic3d/loop/explain.hpp"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>

#include "imic3d/app/output.hpp"
#include "imic3d/app/program.hpp"
#include "imic3d/app/simulation.hpp"
#include "imic3d/core/log.hpp"
#include "imic3d/identification/gauss_newton.hpp"
#include "imic3d/io/explain_page.hpp"
#include "imic3d/io/run_results.hpp"
#include "imic3d/loop/field_experiment.hpp"
#include "imic3d/loop/statistics.hpp"
#include "test_effects.hpp"

namespace imic3d::app {

namespace {

namespace id = identification;

/// Identified parameters as a result.json has them.
struct ParameterSet {
  std::string title;
  std::map<std::string, double> values, deviations;
  std::vector<std::string> correlated;  ///< parameters that `covariance` is of
  Eigen::MatrixXd covariance;           ///< empty: the deviations are all that is known
};

ParameterSet read_set(const std::filesystem::path& file, const Material& material) {
  const auto wrong = [&](const std::string& found) {
    return InputError(file.string(), found,
                      "a result.json of imic3d identify: {parameters: {E: {value: …, standard_deviation: …}}}");
  };
  std::error_code error;
  std::ifstream stream(file);
  if (!stream || std::filesystem::is_directory(file, error))
    throw wrong(std::filesystem::exists(file, error) ? "a folder, or not to be read" : "no such file");
  const auto json = nlohmann::json::parse(stream, nullptr, false);
  if (json.is_discarded()) throw wrong("no JSON");
  if (!json.is_object() || !json.contains("parameters") || !json["parameters"].is_object())
    throw wrong("no parameters");
  ParameterSet set;
  if (json.contains("title") && json["title"].is_string()) set.title = json["title"];
  for (const auto& [name, one] : json["parameters"].items()) {
    if (!one.is_object() || !one.contains("value") || !one["value"].is_number())
      throw wrong("parameters." + name + " without a value");
    set.values[name] = one["value"];
    if (one.contains("standard_deviation") && one["standard_deviation"].is_number())
      set.deviations[name] = one["standard_deviation"];
    if (set.deviations.contains(name) && !(set.deviations[name] >= 0.0))
      throw wrong(fmt::format("parameters.{}.standard_deviation: {:g}", name, set.deviations[name]));
    for (const auto& info : material.information)
      if (info.name == name && one.contains("unit") && one["unit"].is_string() && one["unit"] != info.unit)
        throw InputError(file.string(), fmt::format("{} in {}", name, one["unit"].get<std::string>()),
                         "the case's unit, " + info.unit);
  }
  if (!json.contains("covariance")) return set;
  try {
    set.correlated = json["covariance"].at("parameters").get<std::vector<std::string>>();
    const auto rows = json["covariance"].at("values").get<std::vector<std::vector<double>>>();
    const auto n = static_cast<Eigen::Index>(set.correlated.size());
    set.covariance.resize(n, n);
    const auto is_row = [&](const auto& row) { return row.size() == rows.size(); };
    if (rows.size() != set.correlated.size() || !std::all_of(rows.begin(), rows.end(), is_row))
      throw std::length_error("rows");
    for (Eigen::Index i = 0; i < n; ++i)
      for (Eigen::Index j = 0; j < n; ++j)
        set.covariance(i, j) = rows.at(static_cast<std::size_t>(i)).at(static_cast<std::size_t>(j));
  } catch (const std::exception&) {
    throw InputError(file.string() + " covariance", "not understood",
                     "{parameters: [names], values: [rows]}, as many rows and columns as names");
  }
  const Eigen::VectorXd scale = set.covariance.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  const Eigen::MatrixXd correlation = scale.asDiagonal() * set.covariance * scale.asDiagonal();
  if (set.covariance.size() > 0 &&
      (set.covariance.diagonal().minCoeff() < 0.0 ||
       Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(correlation).eigenvalues()[0] < -1e-6))
    throw InputError(file.string() + " covariance", "not positive semi-definite", "a covariance");
  return set;
}

/// Covariance of the parameters `names` [p x p].
Eigen::MatrixXd covariance_of(const ParameterSet& set, const std::vector<std::string>& names) {
  const auto p = static_cast<Eigen::Index>(names.size());
  const auto place = [&](Eigen::Index i) {
    return std::find(set.correlated.begin(), set.correlated.end(), names[static_cast<std::size_t>(i)]) -
           set.correlated.begin();
  };
  const auto known = static_cast<std::ptrdiff_t>(set.correlated.size());
  Eigen::MatrixXd covariance = Eigen::MatrixXd::Zero(p, p);
  for (Eigen::Index i = 0; i < p; ++i) {
    const auto deviation = set.deviations.find(names[static_cast<std::size_t>(i)]);
    if (deviation != set.deviations.end()) covariance(i, i) = deviation->second * deviation->second;
    for (Eigen::Index j = 0; j < p; ++j)
      if (place(i) < known && place(j) < known) covariance(i, j) = set.covariance(place(i), place(j));
  }
  return covariance;
}

/// The case as the simulation has it: without images and record, its frames those of `simulate`.
io::Case as_simulated(io::Case test) {
  test.cameras.clear(), test.loads.records.clear(), test.frames.clear();
  for (std::size_t frame = 0; frame < test.simulate->value.size(); ++frame)
    test.frames.push_back(static_cast<int>(frame));
  return test;
}

/// A test of the declared specimen as if it were measured, without noise, and its identification as the case file
/// declares it.
class VirtualIdentification {
 public:
  VirtualIdentification(const Communicator& world, const io::Case& test, const Material& material,
                        const std::vector<double>& truth, const std::filesystem::path& folder)
      : world_(world), test_(test), material_(material), truth_(truth), specimen_(make_specimen(test)) {
    if (specimen_.projection.rows() != 2 * specimen_.surface.mesh.nodes.rows() || specimen_.faces.size() > 1)
      throw InputError("cameras", "cameras on both faces, or several that see the motion along z",
                       "one camera for imic3d explain");
    Material with = material;
    with.values = truth;
    const auto frames = static_cast<Eigen::Index>(test.simulate->value.size()) - 1;
    data_.displacement.resize(specimen_.projection.rows(), frames);
    data_.force.resize(frames);
    output_.emplace(world, folder, as_simulated(test), specimen_);
    run_simulation(world, test, specimen_, with, [&](int frame, const mechanics::FrameState& state, double force) {
      output_->frame(frame, state, force);
      data_.displacement.col(frame - 1) = specimen_.project(state.displacement);
      data_.force[frame - 1] = force;
    });
    data_.driving = data_.displacement;
    data_.faces = {{.surface = specimen_.surface.mesh, .M = {}}};
    data_.smooth = [](Eigen::MatrixXd field) { return field; };
    for (Eigen::Index t = 0; t < frames; ++t) data_.frames.push_back(static_cast<int>(t) + 1);
    data_.time = Eigen::Map<const Eigen::VectorXd>(test.simulate->time.data() + 1, frames);
    data_.start_time = data_.reference_time = test.simulate->time.front();
    data_.force_noise = test.loads.noise.value_or(1e-3 * data_.force.cwiseAbs().maxCoeff());
    place_camera();
    make_stages();
    loop::DeclaredModel model;
    model.law = material.law, model.information = material.information;
    model.values = truth, model.priors.assign(truth.size(), 0.0), model.free.assign(truth.size(), 0);
    for (const int j : free_) model.free[static_cast<std::size_t>(j)] = 1;
    model.specimen = [&test](const loop::MeshChange& change) { return make_specimen(test, false, change); };
    model.increments = test.identify.increments();
    model.groups = test.identify.groups;
    model.unit = [&test](std::string unit) { return unit_in(std::move(unit), test.units); };
    experiment_ =
        std::make_unique<loop::FieldExperiment>(world, data_, std::move(model), loop::FieldOptions{.modes = 10});
    for (const auto& p : experiment_->parameters()) declared_.push_back(p.value);
    constexpr double comes_back = 1e-2;
    const auto base = identified(declared_);
    if (!base) throw ConvergenceError("without any effect the test cannot be identified");
    base_ = *base;
    const double off = (base_ - of_free(truth_)).cwiseQuotient(of_free(truth_)).cwiseAbs().maxCoeff();
    spdlog::info("without any effect the first set comes back within {:.1e}", off);
    if (!(off < comes_back))
      throw ConvergenceError(
          fmt::format("without any effect the first set comes back within {:.1e} only: the frames of the stages do not "
                      "tell these parameters",
                      off));
  }

  [[nodiscard]] const std::vector<int>& free() const { return free_; }
  [[nodiscard]] const loop::FieldExperiment& experiment() const { return *experiment_; }
  [[nodiscard]] const std::vector<double>& declared() const { return declared_; }
  [[nodiscard]] const Eigen::VectorXd& forces() const { return data_.force; }
  /// Writes the test as it was simulated, and what was found: result.json, which is returned.
  nlohmann::json write(const nlohmann::json& found) { return output_->finish(found); }

  /// Shift of the identified parameters by an effect that the model does not have; `values` are those of all
  /// parameters. Collective.
  [[nodiscard]] std::optional<Eigen::VectorXd> shift(const std::vector<double>& values) {
    const auto found = identified(values);
    if (!found) return std::nullopt;
    return *found - base_;
  }

 private:
  /// Of the images it is only known how large a pixel is and, from the declared noise, how a displacement's noise
  /// compares with that of the force: M is that of a speckle whose gradient is 8 % of the dynamics per pixel in each
  /// direction.
  void place_camera() {
    loop::FieldFace& face = data_.faces.front();
    const auto& surface = face.surface;
    const double pixel =
        test_.cameras.empty() || test_.cameras.front().pixel_size <= 0.0
            ? 1e-3 * (surface.nodes.colwise().maxCoeff() - surface.nodes.colwise().minCoeff()).maxCoeff()
            : test_.cameras.front().pixel_size;
    const double dynamic = test_.virtual_test && test_.virtual_test->depth == 16 ? 65535.0 : 255.0;
    noise_ = test_.virtual_test      ? test_.virtual_test->noise * dynamic
             : test_.cameras.empty() ? 0.01 * dynamic
                                     : test_.cameras.front().noise.value_or(0.01 * dynamic);
    noise_ = std::max(noise_, 1e-4 * dynamic);
    const double gradient = 0.08 * dynamic / pixel;
    Eigen::VectorXd share = Eigen::VectorXd::Zero(surface.nodes.rows());  // area of each node
    for (Eigen::Index e = 0; e < surface.cells.rows(); ++e) {
      const Eigen::Vector3d d1 = surface.nodes.row(surface.cells(e, 2)) - surface.nodes.row(surface.cells(e, 0));
      const Eigen::Vector3d d2 = surface.nodes.row(surface.cells(e, 3)) - surface.nodes.row(surface.cells(e, 1));
      for (int a = 0; a < 4; ++a) share[surface.cells(e, a)] += 0.25 * 0.5 * d1.cross(d2).norm();
    }
    images_.M.resize(2 * share.size(), 2 * share.size());
    for (Eigen::Index i = 0; i < 2 * share.size(); ++i)
      images_.M.insert(i, i) = gradient * gradient * share[i / 2] / (pixel * pixel);
    images_.noise = noise_;
    images_.pixels_per_length = 1.0 / pixel;
    images_.reach = 0.0;  // the distance to the displacement judges: there are no grey levels
    images_.evaluate = [this](int, const Eigen::VectorXd& u, const Communicator&) {
      return id::ImageEvaluation{
          .b = Eigen::VectorXd::Zero(u.size()), .squares = 0.0, .pixels = 1.0, .element_rms = {}};
    };
    face.M = images_.M;
    data_.noise = noise_;
    face.pixels = Eigen::Vector2d(1.0, -1.0).asDiagonal();
    face.pixels /= pixel;
    face.axis_of_lens =
        0.5 * (surface.nodes.colwise().maxCoeff() + surface.nodes.colwise().minCoeff()).head<2>().transpose();
  }

  void make_stages() {
    for (const auto& declared : test_.identify.stages) {
      id::Stage stage;
      for (const auto& name : declared.free) stage.free.push_back(material_.index(name));
      for (const int frame : declared.frames)
        if (frame > 0) stage.frames.push_back(frame - 1);
      const auto last = static_cast<int>(data_.frames.size());
      if (stage.frames.empty() || stage.frames.back() >= last)
        throw InputError(fmt::format("identify.stages[{}].frames", stages_.size()),
                         stage.frames.empty() ? "no frame after the reference" : io::to_text(declared.frames),
                         fmt::format("frames of simulate, 1-{}, for imic3d explain", last));
      for (const int j : stage.free)
        if (std::find(free_.begin(), free_.end(), j) == free_.end()) free_.push_back(j);
      stages_.push_back(std::move(stage));
    }
    std::sort(free_.begin(), free_.end());
  }

  [[nodiscard]] Eigen::VectorXd of_free(const std::vector<double>& values) const {
    Eigen::VectorXd result(static_cast<Eigen::Index>(free_.size()));
    for (std::size_t i = 0; i < free_.size(); ++i)
      result[static_cast<Eigen::Index>(i)] = values[static_cast<std::size_t>(free_[i])];
    return result;
  }

  /// What the declared procedure identifies, from the first set on, in a test that is made with `values`.
  std::optional<Eigen::VectorXd> identified(const std::vector<double>& values) {
    try {
      const auto [U, F] = experiment_->unwhitened(values);  // measured - predicted
      id::Record record;
      record.frames = data_.frames, record.time = data_.time, record.start_time = data_.start_time;
      record.force = data_.force - F;
      record.surface_displacement = data_.displacement - U;
      record.driving = data_.driving;  // what the ends were seen to do
      id::GaussNewtonOptions options;
      options.sensitivities =
          test_.identify.sensitivities == "direct" ? id::Sensitivities::direct : id::Sensitivities::perturbed;
      std::size_t most_free = 1;
      for (const auto& stage : stages_) most_free = std::max(most_free, stage.free.size());
      id::ForwardModel forward(world_, specimen_, material_.law, std::move(record),
                               {.increments = test_.identify.increments(), .with_fields = false},
                               options.sensitivities == id::Sensitivities::direct ? 1 : static_cast<int>(1 + most_free),
                               test_.identify.groups);
      options.functional = id::functional_from(test_.identify.functional);
      options.alpha = test_.identify.alpha;
      options.eta = std::min(1e-4, test_.identify.eta);
      options.max_iterations = test_.identify.max_iterations;
      options.force_noise = data_.force_noise;
      for (const auto& info : material_.information) options.scale.push_back(info.effect.empty() ? 0.0 : info.scale);
      std::vector<double> found = truth_;
      for (const auto& stage : stages_)
        if (const auto result =
                id::gauss_newton(world_, forward, images_, material_.information, stage, options, found);
            !result.message.empty())
          return std::nullopt;
      Eigen::VectorXd result = of_free(found);
      if (!result.allFinite()) return std::nullopt;
      return result;
    } catch (const ConvergenceError&) {
      return std::nullopt;
    }
  }

  const Communicator& world_;
  const io::Case& test_;
  const Material& material_;
  std::vector<double> truth_, declared_;
  id::Specimen specimen_;
  std::optional<SimulationOutput> output_;
  loop::FieldData data_;
  id::ImageData images_;
  double noise_ = 1.0;
  std::vector<id::Stage> stages_;
  std::vector<int> free_;
  std::unique_ptr<loop::FieldExperiment> experiment_;
  Eigen::VectorXd base_;
};

/// The candidates of the experiment, and what the law is extended by in the case file.
std::vector<loop::Candidate> candidates_of(const loop::FieldExperiment& experiment, const Material& material) {
  std::vector<loop::Candidate> candidates = experiment.candidates();
  for (std::size_t j = 0; j < material.information.size(); ++j) {
    const auto& info = material.information[j];
    const bool known = std::any_of(candidates.begin(), candidates.end(), [&](const auto& one) {
      return std::count(one.parameters.begin(), one.parameters.end(), static_cast<int>(j)) > 0;
    });
    if (info.effect.empty() || info.shape || !info.null_value || experiment.parameters()[j].free || known) continue;
    const auto same =
        std::find_if(candidates.begin(), candidates.end(), [&](const auto& one) { return one.name == info.effect; });
    if (same != candidates.end())
      same->parameters.push_back(static_cast<int>(j));
    else
      candidates.push_back({.name = info.effect,
                            .link = loop::Link::material,
                            .parameters = {static_cast<int>(j)},
                            .sentence = "the material has the effect " + info.effect,
                            .confused_with = "",
                            .separated_by = "",
                            .after = {}});
  }
  // How an effect acts is as declared: what is looked for is its size.
  for (auto& one : candidates) {
    one.elsewhere.clear();
    std::erase_if(one.parameters,
                  [&](int j) { return experiment.parameters()[static_cast<std::size_t>(j)].info.shape; });
  }
  return candidates;
}

}  // namespace

void explain(const Communicator& world, const CommandOptions& options) {
  const auto start = std::chrono::steady_clock::now();
  const io::Case test = read_case(options, {"specimen", "material", "simulate", "identify"}, false);
  refuse_effects(test, "explain");
  if (!(options.tolerance >= 0.0))
    throw InputError("--tolerance", fmt::format("{}", options.tolerance), "a number from 0");
  if (id::functional_from(test.identify.functional) == id::Functional::equilibrium_gap)
    throw InputError("identify.functional", "equilibrium_gap",
                     "force_driven, displacement_driven, combined for imic3d explain");
  const Material material = make_material(test);
  const ParameterSet from = read_set(options.from, material), to = read_set(options.to, material);
  CommandOptions own = options;  // an identification of the same case file keeps its folder
  if (own.output.empty()) own.output = test.output / "explain";
  const auto folder = output_folder(test, own, world);
  std::vector<double> truth = material.values;
  for (std::size_t j = 0; j < truth.size(); ++j)
    if (const auto found = from.values.find(material.information[j].name); found != from.values.end())
      truth[j] = found->second;

  VirtualIdentification test_of(world, test, material, truth, folder);
  const auto& free = test_of.free();
  const auto p = static_cast<Eigen::Index>(free.size());
  std::vector<std::string> names;
  Eigen::VectorXd a(p), difference(p);
  for (Eigen::Index i = 0; i < p; ++i) {
    const auto& name =
        names.emplace_back(material.information[static_cast<std::size_t>(free[static_cast<std::size_t>(i)])].name);
    for (const auto& [set, file] : {std::pair(&from, &options.from), std::pair(&to, &options.to)})
      if (!set->values.contains(name))
        throw InputError(file->string(), "no parameter " + name, "all that the stages of the case file identify");
    a[i] = from.values.at(name), difference[i] = to.values.at(name) - a[i];
  }
  for (const auto& [name, value] : to.values)
    if (const auto before = from.values.find(name); std::find(names.begin(), names.end(), name) == names.end() &&
                                                    (before == from.values.end() || before->second != value))
      spdlog::warn("{} is not the same in both sets, and takes no part: the stages of the case file do not identify it",
                   name);
  Eigen::MatrixXd covariance = covariance_of(from, names) + covariance_of(to, names);
  covariance.diagonal() += (options.tolerance * a).cwiseAbs2();
  if (covariance.llt().info() != Eigen::Success || covariance.diagonal().minCoeff() <= 0.0)
    throw InputError("--tolerance", "0 with parameters that have no standard deviation", "a tolerance above 0");
  const double nothing = difference.dot(covariance.llt().solve(difference));

  const auto& parameters = test_of.experiment().parameters();
  const auto candidates = candidates_of(test_of.experiment(), material);
  const auto percent = [&](const Eigen::VectorXd& shift) -> Eigen::VectorXd { return 100.0 * shift.cwiseQuotient(a); };
  std::vector<std::pair<const loop::Candidate*, loop::Explanation>> found;
  for (const auto& candidate : candidates) {
    std::vector<loop::EffectSize> sizes;
    std::vector<double> nulls;
    for (const int j : candidate.parameters) {
      const auto& one = parameters[static_cast<std::size_t>(j)];
      const double null = one.info.null_value.value_or(one.value);
      const double step = j < static_cast<int>(material.values.size()) && one.info.scale > 0.0 ? 0.05 * one.info.scale
                                                                                               : 10.0 * one.step;
      nulls.push_back(null);
      sizes.push_back({null, std::min(step, 0.25 * (one.info.upper - null)), one.info.lower, one.info.upper});
    }
    found.emplace_back(&candidate, loop::explain(difference, covariance, sizes, [&](const Eigen::VectorXd& size) {
      std::vector<double> values = test_of.declared();
      for (std::size_t k = 0; k < candidate.parameters.size(); ++k)
        values[static_cast<std::size_t>(candidate.parameters[k])] = nulls[k] + size[static_cast<Eigen::Index>(k)];
      return test_of.shift(values);
    }));
    spdlog::info("{:6.0f} s  {}: chi^2 {:.3g}, {} identifications",
                 std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count(), candidate.name,
                 found.back().second.chi_squared, found.back().second.identifications);
  }
  std::stable_sort(found.begin(), found.end(), [](const auto& x, const auto& y) {
    if ((x.second.degrees > 0) != (y.second.degrees > 0)) return x.second.degrees > 0;
    return x.second.p != y.second.p ? x.second.p > y.second.p : x.second.chi_squared < y.second.chi_squared;
  });
  if (!world.is_root()) return;

  std::string fitting, failed;
  for (const auto& [candidate, one] : found) {
    if (one.fits) fitting += (fitting.empty() ? "" : "; ") + candidate->name;
    if (one.failed) failed += (failed.empty() ? "" : ", ") + candidate->name;
  }
  const double alone = loop::chi_squared_tail(nothing, static_cast<int>(p));
  constexpr double level = 0.01;
  const bool differ = alone < level;
  const std::string sentence =
      !differ           ? fmt::format("the two sets do not differ (chi^2 {:.1f} with {} parameters)", nothing, p)
      : fitting.empty() ? "none fits: no effect that is known carries the first set into the second"
                        : fmt::format("a hypothesis, no more: {} would carry the first set into the second", fitting);
  const std::string not_judged = failed.empty() || !differ ? "" : "; not judged: " + failed;
  nlohmann::json json;
  const auto by_name = [&](const Eigen::VectorXd& x) {
    nlohmann::json of;
    for (Eigen::Index i = 0; i < p; ++i) of[names[static_cast<std::size_t>(i)]] = x[i];
    return of;
  };
  json["sentence"] = sentence + not_judged;
  json["identified"] = names, json["differ"] = differ;
  json["from"] = {{"file", options.from.string()}, {"title", from.title}, {"values", by_name(a)}};
  json["to"] = {{"file", options.to.string()}, {"title", to.title}, {"values", by_name(a + difference)}};
  json["difference_percent"] = by_name(percent(difference));
  json["standard_deviation_percent"] = by_name(percent(covariance.diagonal().cwiseSqrt()));
  json["chi_squared_of_the_difference"] = nothing;
  json["tolerance"] = options.tolerance, json["level"] = level;
  json["forces"] = std::vector<double>(test_of.forces().begin(), test_of.forces().end());
  fmt::print("\n{}\n  {} -> {}\n\n  {:26}", test.title, from.title.empty() ? options.from.string() : from.title,
             to.title.empty() ? options.to.string() : to.title, "[%]");
  for (const auto& name : names) fmt::print("{:>9}", name);
  const auto row = [&](const std::string& label, const Eigen::VectorXd& values, const std::string& rest) {
    fmt::print("\n  {:26}", label);
    for (const double value : values) fmt::print("{:+9.2f}", value);
    fmt::print("   {}", rest);
  };
  row("difference", percent(difference), fmt::format("chi^2 {:.1f} with {}", nothing, p));
  for (std::size_t rank = 0; rank < found.size(); ++rank) {
    const auto& [candidate, one] = found[rank];
    std::string sizes;
    nlohmann::json of = {{"rank", rank + 1},
                         {"name", candidate->name},
                         {"link", std::string(name(candidate->link))},
                         {"sentence", candidate->sentence},
                         {"separated_by", candidate->separated_by},
                         {"explained_percent", by_name(percent(one.explained))},
                         {"left_percent", by_name(percent(difference - one.explained))},
                         {"chi_squared", one.chi_squared},
                         {"degrees", one.degrees},
                         {"p", one.p},
                         {"fits", one.fits},
                         {"failed", one.failed},
                         {"on_bound", one.on_bound},
                         {"identifications", one.identifications},
                         {"message", one.message}};
    for (std::size_t k = 0; k < candidate->parameters.size(); ++k) {
      const auto& info = parameters[static_cast<std::size_t>(candidate->parameters[k])].info;
      const auto place = static_cast<Eigen::Index>(k);
      of["sizes"].push_back({{"quantity", info.name},
                             {"unit", info.unit},
                             {"size", one.size[place]},
                             {"tangent_percent_per_unit", by_name(percent(one.tangent.col(place)))}});
      if (one.degrees > 0)
        sizes += fmt::format("{}{} {:+.4g} {}", sizes.empty() ? "" : ", ", info.name, one.size[place], info.unit);
    }
    json["effects"].push_back(of);
    if (one.degrees > 0 && !one.failed)
      row(candidate->name, percent(one.explained),
          fmt::format("chi^2 {:.1f} with {}, p {:.1e}{}{}; {}", one.chi_squared, one.degrees, one.p,
                      one.fits ? ", FITS" : "", one.on_bound ? ", on its bound" : "", sizes));
    else
      fmt::print("\n  {:26}not judged", candidate->name);
    if (!one.message.empty()) fmt::print(" ({})", one.message);
  }
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  json["time"] = io::quantity(seconds, "s");
  io::write_explain_page(folder / "report.html", test_of.write(json));
  fmt::print("\n\n  {}\n  {:.0f} s; report: {}\n", sentence + not_judged, seconds, (folder / "report.html").string());
}

}  // namespace imic3d::app
