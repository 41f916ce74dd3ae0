// imic3d identify: the paper's Secs 3.4 and 4.2, from images and load record to parameters.

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <map>
#include <optional>
#include <set>

#include "calibration_error.hpp"
#include "checkpoint.hpp"
#include "curves.hpp"
#include "imic3d/app/observation.hpp"
#include "imic3d/app/output.hpp"
#include "imic3d/app/program.hpp"
#include "imic3d/app/setup.hpp"
#include "imic3d/core/blocks.hpp"
#include "imic3d/core/interrupt.hpp"
#include "imic3d/core/log.hpp"
#include "imic3d/identification/equilibrium_gap.hpp"
#include "imic3d/identification/gauss_newton.hpp"
#include "imic3d/io/run_results.hpp"
#include "loop_test.hpp"

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

void say_iterate(const Material& material, const std::vector<int>& free, const id::Iterate& at, int iteration) {
  std::string values;
  for (int j : free)
    values += fmt::format("{} {:.6g}  ", material.information[static_cast<std::size_t>(j)].name,
                          at.parameters[static_cast<std::size_t>(j)]);
  spdlog::info("  {:2}  {} eta {:.1e}  distance {:.4f} px  residual {:.4f} grey levels{}", iteration, values, at.eta,
               at.displacement_rms, at.image_rms,
               (at.force_rms > 0.0 ? fmt::format("  force {:.4g}", at.force_rms) : std::string()) +
                   (at.increments > 1 ? fmt::format("  increments {}", at.increments) : std::string()));
  if (!at.message.empty()) spdlog::warn("      {} frames took part: {}", at.frames, at.message);
}

/// Of `steps_per_frame: auto`.
constexpr int most_increments = 32;

/// Bounds are approached by halves, to within a step that ends a stage.
bool ends_on_bound(const Material& material, int parameter, double declared, const id::GaussNewtonOptions& solver) {
  const auto k = static_cast<std::size_t>(parameter);
  const auto& info = material.information[k];
  return std::min(material.values[k] - info.lower, info.upper - material.values[k]) <=
         2.0 * solver.eta * std::max(std::abs(declared), solver.scale[k]);
}

/// What the correlation leaves beyond noise weighs and counts like it, frame by frame.
id::ImageData judging_images(const Observation& seen, const io::Case& test) {
  id::ImageData images = make_image_data(seen, test);
  images.noise *= beyond_noise(seen);
  images.frame_noise = frame_noise(seen);
  return images;
}

id::GaussNewtonOptions solver_options(const io::Case& test, const Material& material, const Observation& seen,
                                      const id::Specimen& specimen, const id::Record& record,
                                      const id::ImageData& images) {
  id::GaussNewtonOptions solver;
  solver.functional = id::functional_from(test.identify.functional);
  solver.alpha = test.identify.alpha;
  solver.sensitivities =
      test.identify.sensitivities == "direct" ? id::Sensitivities::direct : id::Sensitivities::perturbed;
  solver.eta = test.identify.eta;
  solver.max_iterations = test.identify.max_iterations;
  solver.force_noise = force_noise(seen, test);
  if (test.identify.steps_per_frame == 0) solver.most_increments = most_increments;
  for (const auto& info : material.information) solver.scale.push_back(info.effect.empty() ? 0.0 : info.scale);
  solver.noise_model = {
      .image = images.noise,
      .references = seen.references,
      .force = solver.force_noise,
      .driving = [&seen](const Eigen::MatrixXd& noise) { return driving_displacement(seen, noise); },
      .calibration = calibration_errors(seen, test, specimen, record.surface_displacement, test.identify.noise_draws),
      .draws = test.identify.noise_draws};
  return solver;
}

/// From the record to the parameters, stage by stage, and to the model that they make.
class Identification {
 public:
  Identification(const Communicator& world, const io::Case& test, Material& material, const id::Specimen& specimen,
                 const Observation& seen, const id::Record& record, RunOutput& output, RunCheckpoint& checkpoint)
      : world_(world),
        test_(test),
        material_(material),
        specimen_(specimen),
        seen_(seen),
        record_(record),
        output_(output),
        checkpoint_(checkpoint),
        images_(judging_images(seen, test)),
        solver_(solver_options(test, material, seen, specimen, record, images_)),
        tasks_(simulation_tasks(test)),
        model_(world, specimen, material.law, record, {.increments = test.identify.increments()}, tasks_.side_by_side,
               test.identify.groups, tasks_.before),
        increments_(test.identify.increments()) {
    covariance_.setConstant(static_cast<Eigen::Index>(material.values.size()),
                            static_cast<Eigen::Index>(material.values.size()), std::nan(""));
    spdlog::info("noise: {:.3f} grey levels ({}), {:.4g} {} of the force", fmt::join(seen.camera_noise, ", "),
                 seen.noise_is_measured ? "static frames or given" : "from the DIC's residual", solver_.force_noise,
                 test.units.force);
    if (gap()) return;
    const auto& known = checkpoint.found().reaction_noise;
    const double reaction = known ? *known : id::reaction_noise(world, model_, driving_noise(seen), material.values);
    checkpoint.reaction_noise(reaction);
    spdlog::info("noise of the reaction through the displacement of the ends: {:.4g} {}", reaction, test.units.force);
    solver_.force_noise = std::hypot(solver_.force_noise, reaction);
  }

  void run_stages() {
    if (checkpoint_.found().solutions) model_.start_from(*checkpoint_.found().solutions);
    const std::vector<double> first = material_.values;
    for (std::size_t k = 0; k < test_.identify.stages.size(); ++k) run_stage(k, first);
  }

  /// Of parameters that the last stage does not free all at once: where these would go then.
  void free_at_once() {
    if (gap() || solver_.noise_model.draws == 0) return;
    id::Stage all;
    for (const auto& stage : declared_) {
      all.free.insert(all.free.end(), stage.free.begin(), stage.free.end());
      all.frames.insert(all.frames.end(), stage.frames.begin(), stage.frames.end());
    }
    std::erase_if(all.free, [&](int j) { return on_bound_.count(j) > 0; });
    for (auto* numbers : {&all.free, &all.frames}) {
      std::sort(numbers->begin(), numbers->end());
      numbers->erase(std::unique(numbers->begin(), numbers->end()), numbers->end());
    }
    const auto& last = declared_.back().free;
    if (all.free.size() < 2 || std::all_of(all.free.begin(), all.free.end(),
                                           [&](int j) { return std::find(last.begin(), last.end(), j) != last.end(); }))
      return;
    spdlog::info("all free at once would change by");
    try {
      if (const auto at_once = id::free_at_once(world_, model_, images_, all, solver_, material_.values, finer_);
          at_once.step.size() > 0)
        output_.freed_at_once(material_, all.free, at_once);
    } catch (const ConvergenceError& error) {
      spdlog::warn("  unknown: {}", error.what());
    }
  }

  /// The identified model on every frame, used or held out.
  void show() {
    spdlog::info("the identified model on all {} frames", record_.frames.size());
    const auto frames = static_cast<int>(record_.frames.size());
    std::optional<id::ForwardModel> by_all_ranks;
    if (model_.groups() > 1)
      by_all_ranks
          .emplace(world_, specimen_, material_.law, record_, mechanics::EquilibriumOptions{.increments = increments_},
                   1, 1)
          .start_from(model_.solutions());
    id::ForwardModel& model = by_all_ranks ? *by_all_ranks : model_;
    id::Run run{.parameters = material_.values, .increments = increments_, .accuracy = {.forces = 1e-9}};
    const auto fields = [&](int, int t, const mechanics::FrameState& state) {
      output_.simulation_frame(seen_.places[static_cast<std::size_t>(t)], state);
    };
    std::vector<id::Path> driven, shown;
    if (solver_.functional == id::Functional::displacement_driven || gap()) {
      shown = driven = model.simulate(id::Control::displacement, {run}, frames, fields);
      id::fit_rigid_motion(specimen_, id::Control::displacement, images_.M, record_.surface_displacement,
                           shown.front());
    } else {
      const auto distribution = model.distribute_forces({run}, frames, driven);
      run.forces = &distribution.front();
      if (solver_.alpha > 0.0) {
        model.follow_images(images_, solver_.alpha, material_.values);
        shown = model.simulate(id::Control::images, {run}, driven.front().frames, fields);
      } else {
        shown = model.simulate(id::Control::force, {run}, driven.front().frames, fields);
        id::fit_rigid_motion(specimen_, id::Control::force, images_.M, record_.surface_displacement, shown.front());
      }
    }
    if (!shown.front().message.empty()) spdlog::warn("{}", shown.front().message);
    output_.model(world_, images_, record_, shown.front(), driven.front());
    shown_ = shown.front().surface;
    if (!gap()) compare_force(driven.front());
    auto work = model_.work();
    if (by_all_ranks) work += by_all_ranks->work();
    spdlog::info("{} frames simulated with {} factorisations, {} passes over the elements, and {} for derivatives",
                 work.frames, work.factorisations, work.passes, work.derivative_passes);
  }

  /// Driven by the ends: what the last stage would find on meshes of simulation and correlation that are refined once,
  /// where all of the face is seen, and, of plane stress, if it simulated the specimen in space.
  void doubt_the_model() {
    if (solver_.functional != id::Functional::displacement_driven || solver_.noise_model.draws == 0) return;
    using Finer = RunOutput::Finer;
    output_.before_checks();
    const auto say = [&](Finer finer, const char* what, const auto& moved) {
      spdlog::info("what {} would change is computed", what);
      try {
        if (const Eigen::VectorXd by = moved(); by.size() > 0)
          output_.moved_by(finer, material_, declared_.back().free, by, covariance_);
      } catch (const ConvergenceError& error) {
        spdlog::info("what {} would change is not known: {}", what, error.what());
      } catch (const InputError& error) {  // too few pixels for the finer correlation
        spdlog::info("what {} would change is not known: {}", what, error.what());
      }
    };
    if (std::all_of(seen_.faces.begin(), seen_.faces.end(), [](const auto& face) { return face.dic == face.whole; }))
      say(Finer::mesh, "a finer mesh", [&] {
        io::Case refined = test_;
        ++refined.specimen.refine;
        const id::Specimen finer = make_specimen(refined);
        constexpr Eigen::Index most = 20'000;  // nodes
        if (const auto nodes = finer.volume.nodes.rows(); nodes > most) {
          spdlog::info("what a finer mesh would change is not asked: it has {} nodes, more than {}", nodes, most);
          return Eigen::VectorXd();
        }
        const Observation of_finer = on_mesh(seen_, refined, finer);
        const id::ImageData images = judging_images(of_finer, test_);
        id::ForwardModel fine(world_, finer, material_.law, on_surface_of(finer),
                              {.increments = test_.identify.increments()}, 1, 1);
        const Eigen::MatrixXd driving = driving_displacement(seen_, shown_);
        const id::Path there = path_of_last_stage(fine), here = path_of_last_stage(model_, &driving);
        return id::moved_by_mesh(world_, {model_, images_, here}, {fine, images, there}, mapped(specimen_, finer),
                                 declared_.back(), solver_, material_.values, finer_, difference_);
      });
    if (!test_.specimen.plane_stress()) return;
    say(Finer::in_space, "a simulation in space", [&] {
      const auto law = extended_law(test_, {}, true);
      const auto path_of = [&](double part) {
        const id::Specimen solid = make_specimen(test_, false, {.numerics = {.in_space = true, .of_thickness = part}});
        id::ForwardModel model(world_, solid, law, on_surface_of(solid), {.increments = test_.identify.increments()}, 1,
                               1);
        id::Path path = path_of_last_stage(model);
        path.surface = (mapped(solid, specimen_) * path.surface).eval(), path.reaction /= part;
        return path;
      };
      Eigen::SparseMatrix<double> same(specimen_.projection.rows(), specimen_.projection.rows());
      same.setIdentity();
      return id::moved_by_mesh(world_, {model_, images_, path_of(loop::thin)}, {model_, images_, path_of(1.0)}, same,
                               declared_.back(), solver_, material_.values, finer_, difference_);
    });
  }

  /// After everything is written.
  void require_convergence() const {
    for (std::size_t k = 0; k < stages_.size(); ++k)
      if (!stages_[k].converged) throw ConvergenceError(not_converged(k, stages_[k]) + "; its results are written");
  }

  /// `seconds`: time of the run.
  void finish(double seconds, GroupTimes times) const {
    times["simulations"] = model_.group_times();
    say(times);
    output_.finish(material_, covariance_, stages_, force_left_, seconds, times);
  }

 private:
  /// Displacement of the faces of one specimen from that of another's.
  [[nodiscard]] static Eigen::SparseMatrix<double> mapped(const id::Specimen& from, const id::Specimen& to) {
    std::size_t k = 0;
    return blocks(from.faces, [&](const id::Face& face) {
      return id::between(face.surface.mesh, to.faces[k++].surface.mesh, face.components);
    });
  }
  /// The record whose ends the identified model's own motion drives, smoothed like the measured one, whose noise
  /// another mesh would answer otherwise.
  [[nodiscard]] id::Record on_surface_of(const id::Specimen& other) const {
    const Eigen::SparseMatrix<double> onto = mapped(specimen_, other);
    id::Record record = record_;
    record.driving = onto * driving_displacement(seen_, shown_),
    record.surface_displacement = onto * record_.surface_displacement;
    return record;
  }
  /// With as few increments as the iterations begin with: what these err by is nearly the same on either side.
  [[nodiscard]] id::Path path_of_last_stage(id::ForwardModel& model, const Eigen::MatrixXd* driving = nullptr) const {
    const id::Run run{.parameters = material_.values, .driving = driving, .accuracy = {.forces = 1e-9}};
    return model.simulate(id::Control::displacement, {run}, declared_.back().frames.back() + 1).front();
  }

  [[nodiscard]] bool gap() const { return solver_.functional == id::Functional::equilibrium_gap; }

  /// What the model leaves of the force in the fitted frames, in units of its noise there.
  void compare_force(const id::Path& driven) {
    std::set<int> fitted;
    for (const auto& stage : declared_) fitted.insert(stage.frames.begin(), stage.frames.end());
    double squares = 0.0;
    int frames = 0;
    for (const int t : fitted) {
      if (t >= driven.frames) continue;
      squares += std::pow(
          (record_.force[t] - driven.reaction[t]) / (t < difference_.size() ? difference_[t] : solver_.force_noise), 2),
          ++frames;
    }
    if (frames > 0) force_left_ = std::sqrt(squares / frames);
  }

  /// `first`: the declared values of the parameters.
  void run_stage(std::size_t k, const std::vector<double>& first) {
    const RunState& found = checkpoint_.found();
    const auto& declared = test_.identify.stages[k];
    id::Stage stage{.free = {}, .frames = places_in_record(record_, declared.frames)};
    for (const auto& name : declared.free) stage.free.push_back(material_.index(name));
    if (stage.frames.empty())
      throw InputError(fmt::format("identify.stages[{}].frames", k), "no frame after the reference",
                       "frames after the reference");
    spdlog::info("stage {}: {} from {} frames, {}", k + 1, fmt::join(declared.free, ", "), stage.frames.size(),
                 test_.identify.functional);
    int iteration = 0;
    const auto report = [&](const id::Iterate& at) {
      say_iterate(material_, stage.free, at, iteration);
      output_.iteration(static_cast<int>(k), iteration++, at);
      if (gap()) stop_if_asked(world_);  // its stages are short: each is done anew
    };
    id::StageResult result;
    if (k < found.stages.size()) {
      result = found.stages[k].result;
      material_.values = found.stages[k].values;
      std::for_each(result.iterates.begin(), result.iterates.end(), report);
    } else if (gap()) {
      auto by_gap = id::equilibrium_gap(world_, specimen_, material_.law, record_, images_, material_.information,
                                        stage, solver_, material_.values, report);
      spdlog::info(
          "  gap {:.2e} of the internal forces, {:.6g} {} on the loaded end in the last frame ({:.6g} measured, not "
          "used)",
          by_gap.gap.mean(), by_gap.reaction[by_gap.reaction.size() - 1], test_.units.force,
          record_.force[stage.frames.back()]);
      result = std::move(by_gap.stage);
    } else {
      const id::StagePoint* from = k == found.stages.size() && found.point ? &*found.point : nullptr;
      if (from != nullptr) std::for_each(from->iterates.begin(), from->iterates.end(), report);
      result = id::gauss_newton(world_, model_, images_, material_.information, stage, solver_, material_.values,
                                report, {.from = from, .reached = [&](const id::StagePoint& point) {
                                           checkpoint_.stage_point(point, model_.solutions());
                                         }});
    }
    if (k >= found.stages.size())
      checkpoint_.stage_done({material_.values, result},
                             k + 1 < test_.identify.stages.size() ? &model_.solutions() : nullptr);
    if (!result.unknown_noise.empty())
      spdlog::warn("  the standard deviations hold no noise that acts through the simulation: {}",
                   result.unknown_noise);
    put_block(covariance_, stage.free, result.covariance.total);
    const int taken = result.iterates.back().increments;
    increments_ = std::max(increments_, taken);
    stages_.push_back({declared.free, id::steps_taken(result.iterates), taken, result.converged,
                       result.iterates.back().eta, result.message, result.covariance, result.finer.unsure,
                       result.unknown_noise});
    if (!result.converged) spdlog::warn("  {}", not_converged(k, stages_.back()));
    for (const int j : stage.free) {
      on_bound_.erase(j);
      if (!ends_on_bound(material_, j, first[static_cast<std::size_t>(j)], solver_)) continue;
      on_bound_.insert(j);
      spdlog::warn("  {} = {:.6g} is on its bound: the data ask for more, or do not show it",
                   material_.information[static_cast<std::size_t>(j)].name,
                   material_.values[static_cast<std::size_t>(j)]);
    }
    output_.identified(material_.values, covariance_, on_bound_);
    finer_ = std::move(result.finer);
    difference_ = std::move(result.difference);
    declared_.push_back(std::move(stage));
  }

  const Communicator& world_;
  const io::Case& test_;
  Material& material_;
  const id::Specimen& specimen_;
  const Observation& seen_;
  const id::Record& record_;
  RunOutput& output_;
  RunCheckpoint& checkpoint_;
  id::ImageData images_;
  id::GaussNewtonOptions solver_;
  // noise of the measured force less the reaction of the DIC-driven simulation, as far as the last stage found it, else
  // solver_.force_noise [frames, force]
  Eigen::VectorXd difference_;
  double force_left_ = 0.0;  // of the measured force by the identified model, in units of this noise
  SimulationTasks tasks_;
  id::ForwardModel model_;
  int increments_;  // that the identified model takes between two frames
  Eigen::MatrixXd covariance_;
  std::vector<id::Stage> declared_;
  std::vector<StageSummary> stages_;
  std::set<int> on_bound_;
  Eigen::MatrixXd shown_;      // motion of the surface by the identified model [unknowns x frames, length]
  id::FinerIncrements finer_;  // of the last stage
};

}  // namespace

void identify(const Communicator& world, const CommandOptions& options) {
  const auto start = std::chrono::steady_clock::now();
  const io::Case test = read_case(options, {"cameras", "loads", "material", "identify"}, true, true, true);
  if (test.fields || !test.tests.empty() || !test.effects.empty()) {
    identify_by_loop(world, options, test);
    return;
  }
  if (!test.experiments.empty()) {
    if (!test.cameras.empty())
      throw InputError("experiments", "given beside cameras", "images or experiments, each in a case of its own");
    if (options.resume) spdlog::info("curves are identified from the beginning: they take no checkpoint");
    identify_curves(world, options, test);
    return;
  }
  const SignalWatch watch;
  const auto folder = output_folder(test, options, world);
  RunCheckpoint checkpoint(world, folder, test, options.resume);
  Material material = make_material(test);
  const id::Specimen specimen = make_specimen(test);
  Observation seen = observe(test, specimen);
  RunOutput output(world, folder, test, specimen, material, seen);

  // The displacement that the images show, without any law.
  spdlog::info("{}: {} frames, {} surface nodes, {} unknowns", test.title, seen.places.size(),
               specimen.surface.mesh.nodes.rows(),
               mesh::dimension(specimen.volume.type) * specimen.volume.nodes.rows());
  GroupTimes times;
  correlate(seen, test, world, [&](int place, const correlation::DicFrame& frame) { output.dic_frame(place, frame); },
            {.known = checkpoint.found().dic,
             .reached = [&, frames = seen.places.size()](std::size_t face, const correlation::DicSeries& series) {
               times[seen.faces.size() == 1 ? "correlation"
                     : face == 0            ? "correlation_front"
                                            : "correlation_back"] = series.group_times;
               checkpoint.dic(face, series, frames);
             }});
  const id::Record record = make_record(seen, test, specimen);
  output.noise(seen.noise);

  Identification identification(world, test, material, specimen, seen, record, output, checkpoint);
  identification.run_stages();
  identification.free_at_once();
  identification.show();
  identification.doubt_the_model();
  identification.finish(std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count(),
                        std::move(times));
  identification.require_convergence();
}

}  // namespace imic3d::app
