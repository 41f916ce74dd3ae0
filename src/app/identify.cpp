// imic3d identify: the paper's Secs 3.4 and 4.2, from images and load record to parameters.

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <map>
#include <optional>
#include <set>

#include "imic3d/app/observation.hpp"
#include "imic3d/app/output.hpp"
#include "imic3d/app/program.hpp"
#include "imic3d/app/setup.hpp"
#include "imic3d/core/interrupt.hpp"
#include "imic3d/core/log.hpp"
#include "imic3d/identification/equilibrium_gap.hpp"
#include "imic3d/identification/gauss_newton.hpp"
#include "imic3d/io/run_results.hpp"
#include "calibration_error.hpp"
#include "checkpoint.hpp"
#include "curves.hpp"
#include "test_effects.hpp"

namespace imic3d::app {

namespace {

namespace id = identification;

/// Places in the record (frames after the reference) of frame numbers; those before it are left out.
std::vector<int> places_in_record(const id::Record& record, const io::Frames& numbers) {
  std::vector<int> places;
  for (std::size_t t = 0; t < record.frames.size(); ++t)
    if (std::binary_search(numbers.begin(), numbers.end(), record.frames[t])) places.push_back(static_cast<int>(t));
  return places;
}

void say(const Material& material, const std::vector<int>& free, const id::Iterate& at, int iteration) {
  std::string values;
  for (int j : free)
    values += fmt::format("{} {:.6g}  ", material.information[static_cast<std::size_t>(j)].name, at.parameters[static_cast<std::size_t>(j)]);
  spdlog::info("  {:2}  {} eta {:.1e}  distance {:.4f} px  residual {:.4f} grey levels{}", iteration, values, at.eta,
               at.displacement_rms, at.image_rms,
               (at.force_rms > 0.0 ? fmt::format("  force {:.4g}", at.force_rms) : std::string()) + (at.increments > 1 ? fmt::format("  increments {}", at.increments) : std::string()));
  if (!at.message.empty()) spdlog::warn("      {} frames took part: {}", at.frames, at.message);
}

/// Of `steps_per_frame: auto`.
constexpr int most_increments = 32;

/// Bounds are approached by halves, to within a step that ends a stage.
bool ends_on_bound(const Material& material, int parameter, double declared, const id::GaussNewtonOptions& solver) {
  const auto k = static_cast<std::size_t>(parameter);
  const auto& info = material.information[k];
  return std::min(material.values[k] - info.lower, info.upper - material.values[k]) <= 2.0 * solver.eta * std::max(std::abs(declared), solver.scale[k]);
}

}  // namespace

void identify(const Communicator& world, const CommandOptions& options) {
  const auto start = std::chrono::steady_clock::now();
  const io::Case test = read_case(options, {"cameras", "loads", "material", "identify"}, true);
  refuse_effects(test, "identify");
  if (!test.experiments.empty()) {
    if (!test.cameras.empty()) throw InputError("experiments", "given beside cameras", "images or experiments, each in a case of its own");
    if (options.resume) spdlog::info("curves are identified from the beginning: they take no checkpoint");
    identify_curves(world, options, test);
    return;
  }
  const SignalWatch watch;
  const auto folder = output_folder(test, options, world);
  RunCheckpoint checkpoint(world, folder, test, options.resume);
  const RunState& found = checkpoint.found();
  Material material = make_material(test);
  const id::Specimen specimen = make_specimen(test);
  Observation seen = observe(test, specimen);
  RunOutput output(world, folder, test, specimen, material, seen);

  // The displacement that the images show, without any law.
  spdlog::info("{}: {} frames, {} surface nodes, {} unknowns", test.title, seen.places.size(),
               specimen.surface.mesh.nodes.rows(), mesh::dimension(specimen.volume.type) * specimen.volume.nodes.rows());
  GroupTimes times;
  correlate(seen, test, world, [&](int place, const correlation::DicFrame& frame) { output.dic_frame(place, frame); },
            {.known = found.dic, .reached = [&, frames = seen.places.size()](std::size_t face, const correlation::DicSeries& series) {
               times[seen.faces.size() == 1 ? "correlation" : face == 0 ? "correlation_front" : "correlation_back"] = series.group_times;
               checkpoint.dic(face, series, frames);
             }});
  const id::Record record = make_record(seen, test, specimen);
  id::ImageData images = make_image_data(seen, test);
  output.noise(seen.noise);

  id::GaussNewtonOptions solver;
  solver.functional = id::functional_from(test.identify.functional);
  solver.alpha = test.identify.alpha;
  solver.sensitivities = test.identify.sensitivities == "direct" ? id::Sensitivities::direct : id::Sensitivities::perturbed;
  solver.eta = test.identify.eta;
  solver.max_iterations = test.identify.max_iterations;
  solver.force_noise = force_noise(seen, test);
  if (test.identify.steps_per_frame == 0) solver.most_increments = most_increments;
  for (const auto& info : material.information) solver.scale.push_back(info.effect.empty() ? 0.0 : info.scale);
  spdlog::info("noise: {:.3f} grey levels ({}), {:.4g} {} of the force", fmt::join(seen.camera_noise, ", "),
               seen.noise_is_measured ? "static frames or given" : "from the DIC's residual", solver.force_noise, test.units.force);

  solver.noise_model = {.image = images.noise,
                        .references = seen.references,
                        .force = solver.force_noise,
                        .driving = [&](const Eigen::MatrixXd& noise) { return driving_displacement(seen, noise); },
                        .calibration = calibration_errors(seen, test, specimen, record.surface_displacement, test.identify.noise_draws),
                        .draws = test.identify.noise_draws};
  const SimulationTasks tasks = simulation_tasks(test);
  id::ForwardModel model(world, specimen, material.law, record, {.increments = test.identify.increments()},
                         tasks.side_by_side, test.identify.groups, tasks.before);

  const bool gap = solver.functional == id::Functional::equilibrium_gap;
  if (solver.functional != id::Functional::force_driven && !gap) {
    const double reaction = found.reaction_noise ? *found.reaction_noise : id::reaction_noise(world, model, driving_noise(seen), material.values);
    checkpoint.reaction_noise(reaction);
    spdlog::info("noise of the reaction through the displacement of the ends: {:.4g} {}", reaction, test.units.force);
    solver.force_noise = std::hypot(solver.force_noise, reaction);
  }

  const auto parameters = static_cast<Eigen::Index>(material.values.size());
  Eigen::MatrixXd covariance = Eigen::MatrixXd::Constant(parameters, parameters, std::nan(""));
  std::vector<StageSummary> stages;
  const std::vector<double> first = material.values;
  std::set<int> on_bound;
  id::Stage all;  // what the stages free, from all their frames
  id::FinerIncrements finer;
  int increments = test.identify.increments();  // that the identified model takes between two frames
  if (found.solutions) model.start_from(*found.solutions);
  for (std::size_t k = 0; k < test.identify.stages.size(); ++k) {
    const auto& declared = test.identify.stages[k];
    id::Stage stage{.free = {}, .frames = places_in_record(record, declared.frames)};
    for (const auto& name : declared.free) stage.free.push_back(material.index(name));
    if (stage.frames.empty())
      throw InputError(fmt::format("identify.stages[{}].frames", k), "no frame after the reference", "frames after the reference");
    spdlog::info("stage {}: {} from {} frames, {}", k + 1, fmt::join(declared.free, ", "), stage.frames.size(), test.identify.functional);
    int iteration = 0;
    const auto report = [&](const id::Iterate& at) {
      say(material, stage.free, at, iteration);
      output.iteration(static_cast<int>(k), iteration++, at);
      if (gap) stop_if_asked(world);  // its stages are short: each is done anew
    };
    id::StageResult result;
    if (k < found.stages.size()) {
      result = found.stages[k].result;
      material.values = found.stages[k].values;
      std::for_each(result.iterates.begin(), result.iterates.end(), report);
    } else if (gap) {
      auto by_gap = id::equilibrium_gap(world, specimen, material.law, record, images, material.information, stage, solver, material.values, report);
      const int last = stage.frames.back();
      spdlog::info("  gap {:.2e} of the internal forces, {:.6g} {} on the loaded end in the last frame ({:.6g} measured, not used)",
                   by_gap.gap.mean(), by_gap.reaction[by_gap.reaction.size() - 1], test.units.force, record.force[last]);
      result = std::move(by_gap.stage);
    } else {
      const id::StagePoint* from = k == found.stages.size() && found.point ? &*found.point : nullptr;
      if (from != nullptr) std::for_each(from->iterates.begin(), from->iterates.end(), report);
      result = id::gauss_newton(world, model, images, material.information, stage, solver, material.values, report,
                                {.from = from, .reached = [&](const id::StagePoint& point) { checkpoint.stage_point(point, model.solutions()); }});
    }
    if (k >= found.stages.size()) checkpoint.stage_done({material.values, result}, k + 1 < test.identify.stages.size() ? &model.solutions() : nullptr);
    if (!result.unknown_noise.empty()) spdlog::warn("  the standard deviations hold no noise that acts through the simulation: {}", result.unknown_noise);
    if (!result.converged) spdlog::warn("  not converged: eta is still {:.2e}", result.iterates.back().eta);
    for (std::size_t i = 0; i < stage.free.size(); ++i)
      for (std::size_t j = 0; j < stage.free.size(); ++j)
        covariance(stage.free[i], stage.free[j]) = result.covariance.total(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j));
    for (auto [whole, part] : {std::pair{&all.free, &stage.free}, {&all.frames, &stage.frames}}) whole->insert(whole->end(), part->begin(), part->end());
    finer = result.finer;
    const int taken = result.iterates.back().increments;
    increments = std::max(increments, taken);
    stages.push_back({declared.free, static_cast<int>(result.iterates.size()) - 1, taken, result.converged, result.message, result.covariance, result.finer.unsure, result.unknown_noise});
    for (const int j : stage.free) {
      on_bound.erase(j);
      if (!ends_on_bound(material, j, first[static_cast<std::size_t>(j)], solver)) continue;
      on_bound.insert(j);
      spdlog::warn("  {} = {:.6g} is on its bound: the data ask for more, or do not show it", material.information[static_cast<std::size_t>(j)].name, material.values[static_cast<std::size_t>(j)]);
    }
    output.identified(material.values, covariance, on_bound);
  }

  std::erase_if(all.free, [&](int j) { return on_bound.count(j) > 0; });
  for (auto* places : {&all.free, &all.frames}) {
    std::sort(places->begin(), places->end());
    places->erase(std::unique(places->begin(), places->end()), places->end());
  }
  if (!gap && test.identify.noise_draws > 0 && all.free.size() > test.identify.stages.back().free.size()) {
    spdlog::info("all free at once would change by");
    try {
      if (const auto at_once = id::free_at_once(world, model, images, all, solver, material.values, finer); at_once.step.size() > 0) output.freed_at_once(material, all.free, at_once);
    } catch (const ConvergenceError& error) {
      spdlog::warn("  unknown: {}", error.what());
    }
  }

  // The identified model on every frame, used or held out.
  spdlog::info("the identified model on all {} frames", record.frames.size());
  const auto frames = static_cast<int>(record.frames.size());
  std::optional<id::ForwardModel> by_all_ranks;
  if (model.groups() > 1) by_all_ranks.emplace(world, specimen, material.law, record, mechanics::EquilibriumOptions{.increments = increments}, 1, 1).start_from(model.solutions());
  id::ForwardModel& final_model = by_all_ranks ? *by_all_ranks : model;
  const bool force_driven = solver.functional != id::Functional::displacement_driven && !gap;
  std::vector<id::Path> driven, shown;
  id::Run run{.parameters = material.values, .increments = increments, .accuracy = {.forces = 1e-9}};
  const auto fields = [&](int, int t, const mechanics::FrameState& state) { output.simulation_frame(seen.places[static_cast<std::size_t>(t)], state); };
  if (force_driven) {
    const auto distribution = final_model.distribute_forces({run}, frames, driven);
    run.forces = &distribution.front();
    if (solver.alpha > 0.0) {
      final_model.follow_images(images, solver.alpha, material.values);
      shown = final_model.simulate(id::Control::images, {run}, driven.front().frames, fields);
    } else {
      shown = final_model.simulate(id::Control::force, {run}, driven.front().frames, fields);
      id::fit_rigid_motion(specimen, id::Control::force, images.M, record.surface_displacement, shown.front());
    }
  } else {
    shown = driven = final_model.simulate(id::Control::displacement, {run}, frames, fields);
    id::fit_rigid_motion(specimen, id::Control::displacement, images.M, record.surface_displacement, shown.front());
  }
  if (!shown.front().message.empty()) spdlog::warn("{}", shown.front().message);
  output.model(world, images, record, shown.front(), driven.front());
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  times["simulations"] = model.group_times();
  auto work = model.work();
  if (by_all_ranks) work += by_all_ranks->work();
  spdlog::info("{} frames simulated with {} factorisations, {} passes over the elements, and {} for derivatives", work.frames, work.factorisations, work.passes, work.derivative_passes);
  app::say(times);
  output.finish(material, covariance, stages, gap ? std::nan("") : solver.force_noise, seconds, times);
}

}  // namespace imic3d::app
