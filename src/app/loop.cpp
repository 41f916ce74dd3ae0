// imic3d loop: identify, find what is left, trace it, add it, identify again. imic3d identify by its first step alone,
// where that is what weighs the data (displacement fields, several tests, effects of the test).

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <Eigen/Dense>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <nlohmann/json.hpp>
#include <span>

#include "fields.hpp"
#include "imic3d/app/observation.hpp"
#include "imic3d/app/output.hpp"
#include "imic3d/app/program.hpp"
#include "imic3d/app/setup.hpp"
#include "imic3d/core/interrupt.hpp"
#include "imic3d/core/linear.hpp"
#include "imic3d/core/log.hpp"
#include "imic3d/correlation/smoothing.hpp"
#include "imic3d/io/loop_page.hpp"
#include "imic3d/io/run_results.hpp"
#include "imic3d/loop/closing.hpp"
#include "imic3d/loop/field_experiment.hpp"
#include "imic3d/loop/joint_experiment.hpp"
#include "imic3d/loop/recorded.hpp"
#include "light.hpp"
#include "loop_case.hpp"
#include "loop_checkpoint.hpp"
#include "loop_report.hpp"
#include "loop_results.hpp"
#include "loop_summary.hpp"
#include "loop_test.hpp"
#include "rig.hpp"
#include "synthetic_images.hpp"
#include "test_effects.hpp"

namespace imic3d::app {

namespace {

/// What parameters would be off by in plane stress alone, without what a simulation in space shows beyond it; empty
/// where that is less than their standard deviations.
std::string taken_off_plane_stress(const loop::FieldExperiment& experiment, const loop::Model& model,
                                   bool plane_stress) {
  const auto& fit = model.fit;
  if (plane_stress && experiment.in_space().size() == 0)
    return "what plane stress errs by is not known: the specimen could not be simulated in space";
  if (experiment.in_space().size() == 0 || experiment.in_space().size() != fit.residual.size() || fit.free.empty())
    return {};
  const Eigen::VectorXd shift = least_squares(fit.sensitivity, model.ground->weight(experiment.in_space()));
  std::vector<std::string> off;
  for (std::size_t k = 0; k < fit.free.size(); ++k) {
    const auto i = static_cast<Eigen::Index>(k);
    const auto& info = experiment.parameters()[static_cast<std::size_t>(fit.free[k])].info;
    const double deviations = std::abs(shift[i]) / std::sqrt(std::max(model.covariance(i, i), 1e-300));
    if (!info.shape && deviations > 1.0)
      off.push_back(
          fmt::format("{} by {:+.2g} {} ({:.1f} standard deviations)", info.name, shift[i], info.unit, deviations));
  }
  if (off.empty()) return {};
  return fmt::format(
      "the specimen is thick for plane stress: what a simulation in space shows beyond it is taken off here, without "
      "that (imic3d identify) parameters would be off, {}; specimen.kinematics: 3d has it in the model",
      fmt::join(off, ", "));
}

/// What the loop knows of a rig.
loop::FieldFace field_face(const io::Case& test, const ObservedFace& seen, const identification::Face& face,
                           const Eigen::SparseMatrix<double>& M) {
  const auto& view = seen.rig->views.front();
  const Eigen::RowVector3d middle = seen.rig->surface.nodes.colwise().mean();
  loop::FieldFace result{.name = face.back ? "back" : "front",
                         .surface = face.surface.mesh,
                         .components = face.components,
                         .M = M.block(face.first_unknown, face.first_unknown, face.unknowns(), face.unknowns())};
  if (const auto held = seen.dic->held(); held.size() > 0) result.M += held;
  result.pixels = view.camera->jacobian(middle.transpose()).leftCols<2>();
  result.axis_of_lens = middle.head<2>().transpose();
  if (const auto* camera = dynamic_cast<const imaging::TelecentricCamera*>(view.camera.get())) {
    const Eigen::Vector2d centre(0.5 * (view.reference.width - 1), 0.5 * (view.reference.height - 1));
    result.axis_of_lens = result.pixels.inverse() * (centre - camera->offset);
  }
  if (face.components == 3)
    for (std::size_t c = 0; c < seen.rig->views.size(); ++c) {
      const auto& one = seen.rig->views[c];
      result.sights.emplace_back(test.cameras[static_cast<std::size_t>(seen.rig->cameras[c])].name, *one.camera,
                                 face.surface.mesh,
                                 Eigen::Vector2d(0.5 * (one.reference.width - 1), 0.5 * (one.reference.height - 1)));
    }
  return result;
}

/// The frames that some stage uses, and those between them.
int last_frame(const io::Case& test, const identification::Record& record) {
  int last = 0;
  for (const auto& stage : test.identify.stages)
    for (std::size_t t = 0; t < record.frames.size(); ++t)
      if (std::binary_search(stage.frames.begin(), stage.frames.end(), record.frames[t]))
        last = std::max(last, static_cast<int>(t));
  return last;
}

/// `shown` gets the images of every synthetic test, if it is one then.
loop::FieldData field_data(const Communicator& world, Observation& seen, const io::Case& test,
                           const identification::Specimen& specimen, const ImageShown& shown) {
  const auto record = make_record(seen, test, specimen);
  const auto images = make_image_data(seen, test);
  const int frames = 1 + last_frame(test, record);
  loop::FieldData data;
  for (std::size_t k = 0; k < seen.faces.size(); ++k)
    data.faces.push_back(field_face(test, seen.faces[k], specimen.faces[k], images.M));
  data.noise = images.noise;
  data.references = seen.references;
  // predictions stay upright
  data.displacement = identification::without_leaning(specimen, record.surface_displacement.leftCols(frames));
  data.smooth = [&seen](Eigen::MatrixXd field) { return driving_displacement(seen, std::move(field)); };
  data.driving = data.smooth(data.displacement);
  data.correlate = [&seen, &test, &world, &shown, frames](const identification::Specimen& made,
                                                          const Eigen::MatrixXd& U) {
    return correlated_images(seen, test, world, made, U.leftCols(frames), shown);
  };
  data.frames.assign(record.frames.begin(), record.frames.begin() + frames);
  data.time = record.time.head(frames);
  data.force = record.force.head(frames);
  data.start_time = record.start_time, data.reference_time = reference_time(test);
  data.force_noise = force_noise(seen, test);
  data.force_at_rest = force_at_rest(test);
  return data;
}

/// Where a camera was placed by the outline, which tells it to some tenths of a pixel, the rest is one more unknown, if
/// nothing else is declared of it.
void free_placement(const io::Case& test, std::vector<loop::DeclaredEffect>& effects) {
  constexpr double pixels = 0.3;
  const bool both = std::any_of(test.cameras.begin(), test.cameras.end(),
                                [&](const auto& camera) { return camera.face != test.cameras.front().face; });
  for (const auto& camera : test.cameras) {
    if (camera.place.automatic.empty()) continue;
    const std::string effect = both ? camera.face + "_placement" : "placement";
    if (std::any_of(effects.begin(), effects.end(), [&](const auto& one) { return one.effect == effect; })) continue;
    for (const char* quantity : {"placement_x", "placement_y", "placement_turn"})
      effects.push_back({.effect = effect,
                         .quantity = quantity,
                         .value = {},
                         .lower = {},
                         .upper = {},
                         .free = true,
                         .prior = pixels});
  }
}

loop::DeclaredModel declared_model(const io::Case& test, const Material& material) {
  loop::DeclaredModel model;
  model.law = material.law;
  model.information = material.information;
  model.values = material.values;
  model.free.assign(material.values.size(), 0);
  model.priors.assign(material.values.size(), 0.0);
  for (const auto& stage : test.identify.stages)
    for (const auto& name : stage.free) model.free[static_cast<std::size_t>(material.index(name))] = 1;
  for (const auto& [name, deviation] : test.loop.prior)
    model.priors[static_cast<std::size_t>(material.index(name))] = deviation;
  if (test.material.law != "elastic") {
    const ExtendedMaterial extended = make_extended_material(test);
    for (std::size_t j = 0; j < extended.information.size(); ++j)
      if (extended.declared[j] == 0) model.lacking.push_back(extended.information[j]);
  }
  model.extended = [&test](const std::vector<std::string>& effects, bool in_space) {
    return extended_law(test, effects, in_space);
  };
  model.specimen = [&test](const loop::MeshChange& change) { return make_specimen(test, false, change); };
  model.increments = test.identify.increments();
  model.groups = test.identify.groups;
  model.effects = declared_effects(test);
  free_placement(test, model.effects);
  model.unit = [&test](std::string unit) { return unit_in(std::move(unit), test.units); };
  return model;
}

/// The names, which were checked before, but for those of effects that this test cannot have.
std::vector<std::string> of_candidates(const loop::Experiment& experiment, std::vector<std::string> names) {
  const auto& all = experiment.candidates();
  std::erase_if(names, [&](const std::string& name) {
    return std::none_of(all.begin(), all.end(),
                        [&](const auto& one) { return loop::key_of(one.name) == loop::key_of(name); });
  });
  return names;
}

loop::LoopOptions how(const io::Case& test, std::vector<int> held_out) {
  return {.draws = test.loop.draws,
          .additions = test.loop.additions,
          .rivals = test.loop.rivals,
          .starts = test.loop.starts,
          .leave_out = test.loop.leave_out,
          .held_out = std::move(held_out)};
}

loop::LoopOptions how(const io::Case& test, const loop::Experiment& experiment, std::vector<int> held_out, Aim aim) {
  auto options = how(test, std::move(held_out));
  options.leave_out = of_candidates(experiment, std::move(options.leave_out));
  options.search = aim == Aim::close_the_loop;
  return options;
}

void print_parameters(const Communicator& world, const loop::Experiment& experiment, const loop::Model& model) {
  if (!world.is_root()) return;
  for (std::size_t i = 0; i < model.fit.free.size(); ++i) {
    const int j = model.fit.free[i];
    const auto place = static_cast<Eigen::Index>(i);
    const auto& parameter = experiment.parameters()[static_cast<std::size_t>(j)];
    const double value = model.fit.values[static_cast<std::size_t>(j)],
                 deviation = std::sqrt(model.covariance(place, place));
    fmt::print("  {:16} {:14.6g} {:10} {}\n", parameter.info.name, value, parameter.info.unit,
               !loop::is_determined(model, j)     ? "(not determined)"
               : loop::on_bound(parameter, value) ? "(on a bound)"
                                                  : fmt::format("+- {:.2g}", deviation));
  }
}

/// After everything is written. Iterations that end at a kink (a frame in which flow sets in) have their answer, if
/// they let expect no more than chance does.
void require_convergence(const loop::Report& report) {
  const auto& fit = report.final.fit;
  if (!fit.converged && fit.expected > static_cast<double>(fit.free.size()))
    throw ConvergenceError(fmt::format("after {} iterations chi^2 should still fall by {:.3g}; the results are written",
                                       fit.iterations, fit.expected));
}

/// What is doubted of displacement fields, and of their load record.
std::vector<std::string> doubts_of_fields(const io::Case& test, const loop::FieldData& data,
                                          const loop::Report& report) {
  constexpr double most = 1.5;  // that half of the variance, which references share, makes of chi
  std::vector<std::string> doubts;
  if (auto zero = doubt_of_zero(data.force_at_rest, test); !zero.empty()) doubts.push_back(std::move(zero));
  const auto& misfit = report.final.misfit;
  if (report.verdict == loop::Verdict::unexplained && misfit.fitted < most * misfit.null_fitted &&
      !test.fields->references && data.at_rest < 2)
    doubts.emplace_back(
        "fields: without two frames at rest nothing tells whether the reference is one image or the mean of several, "
        "whose noise is less: fields.references says it, and what is left unexplained may be that");
  return doubts;
}

class FieldTest final : public LoopTest {
 public:
  FieldTest(const Communicator& world, const io::Case& test, Aim aim,
            const std::function<void(const std::string&)>& say)
      : world_(world), test_(test), aim_(aim), material_(make_material(test_)), specimen_(make_specimen(test_)) {
    if (specimen_.faces.size() > 1 && specimen_.section_factor != 1.0)
      throw InputError("specimen.mid_plane_symmetry", "true with cameras on both faces",
                       "false for imic3d loop, which looks for what makes the faces differ");
    check_light_effects(test_, specimen_.faces.front().surface.mesh);
    if (!test_.fields) seen_ = observe(test_, specimen_);
    spdlog::info("{}: {} frames, {} surface nodes", test_.title, seen_ ? seen_->places.size() : test_.frames.size(),
                 specimen_.surface.mesh.nodes.rows());
    if (!seen_) {
      lay_out(imported_fields(test_, specimen_));
      return;
    }
    correlate_frames();
    lay_out(field_data(world, *seen_, test_, specimen_, shown_));
    settle_light(say);
    spdlog::info("noise: {:.3f} grey levels{}", seen_->noise,
                 std::isfinite(experiment_->measured().force_noise)
                     ? fmt::format(", {:.4g} {} of the force", experiment_->measured().force_noise, test_.units.force)
                     : "");
  }
  loop::Experiment& experiment() override { return *experiment_; }
  std::vector<int> held_out() const override { return experiment_->measured().held_out; }
  int simulations() const override { return experiment_->simulations(); }
  GroupTimes group_times() const override {
    GroupTimes times = experiment_->group_times();
    times.insert(correlation_times_.begin(), correlation_times_.end());
    return times;
  }
  void write(const std::filesystem::path& folder, const loop::Report& report, double seconds) override {
    const LoopFields fields = loop_fields(*experiment_, report);  // collective
    const GroupTimes groups = group_times();
    app::say(groups);
    if (seen_) test_.doubts = doubts_of(test_, *seen_);
    if (test_.fields)
      for (auto& doubt : doubts_of_fields(test_, experiment_->measured(), report)) {
        spdlog::warn("{}", doubt);
        test_.doubts.push_back(std::move(doubt));
      }
    for (auto& doubt : unlikely_values(test_, material_, report.final.fit.values))
      test_.doubts.push_back(std::move(doubt));
    if (auto doubt = taken_off_plane_stress(*experiment_, report.final, test_.specimen.plane_stress());
        !doubt.empty()) {
      spdlog::warn("{}", doubt);
      test_.doubts.push_back(std::move(doubt));
    }
    collectively(world_, [&] {
      if (world_.is_root())
        write_loop_report(folder, test_, *experiment_, report, fields, light_, seen_ ? seen_->left_out : "", groups,
                          seconds);
    });
  }

 private:
  /// Those that are declared; for a search blocks where none of them is there.
  [[nodiscard]] std::vector<int> places_held_out(const std::vector<int>& frames) const {
    const auto& declared = test_.identify.held_out;
    std::vector<int> held;
    for (std::size_t t = 0; t < frames.size(); ++t)
      if (std::binary_search(declared.begin(), declared.end(), frames[t])) held.push_back(static_cast<int>(t));
    std::vector<int> beyond;
    std::copy_if(declared.begin(), declared.end(), std::back_inserter(beyond),
                 [&](int frame) { return frame > frames.back(); });
    if (!beyond.empty())
      spdlog::info("held-out frames behind the last one that is fitted take no part: {}", io::to_text(beyond));
    return held.empty() && aim_ == Aim::close_the_loop ? loop::held_out_blocks(static_cast<int>(frames.size())) : held;
  }

  void correlate_frames() {
    const auto name = [&](std::size_t face) {
      return seen_->faces.size() == 1 ? "correlation" : face == 0 ? "correlation_front" : "correlation_back";
    };
    correlate(*seen_, test_, world_, {}, {.reached = [&](std::size_t face, const correlation::DicSeries& series) {
      correlation_times_[name(face)] = series.group_times;
    }});
  }
  void lay_out(loop::FieldData data) {
    data.held_out = places_held_out(data.frames);
    experiment_ = std::make_unique<loop::FieldExperiment>(world_, std::move(data), declared_model(test_, material_),
                                                          loop::FieldOptions{.modes = test_.loop.modes});
  }
  /// The declared model fitted to the data as they are, near which the loop will find it again; as declared where that
  /// fails.
  std::vector<double> first_fit() {
    std::vector<double> values;
    std::vector<int> free;
    const auto& parameters = experiment_->parameters();
    for (std::size_t k = 0; k < parameters.size(); ++k) {
      values.push_back(parameters[k].value);
      if (parameters[k].free) free.push_back(static_cast<int>(k));
    }
    const auto& data = experiment_->data();
    std::vector<char> fitted(experiment_->frame_numbers().size(), 1);
    for (int t : held_out()) fitted[static_cast<std::size_t>(t)] = 0;
    try {
      return loop::fit(*experiment_, loop::Weight(data, {}), loop::rows_of_frames(data, fitted), free, values).values;
    } catch (const ConvergenceError&) {
      return values;
    }
  }

  /// Looks at the light, beside images of the declared model's motion on a finer mesh, of which the experiment learns
  /// its bias; where it changes and the correlation has left it alone, the images are correlated again with gain and
  /// offset of each frame, or of each element, fitted.
  void settle_light(const std::function<void(const std::string&)>& say) {
    auto options = how(test_, held_out());
    options.starts = {1.0};
    options.leave_out.clear();
    const auto synthetic = [&](const ImageShown& shown) {
      const auto values = first_fit();
      shown_ = shown;
      experiment_->learn_bias(values);
      shown_ = {};
    };
    const auto look = [&] {
      return look_at_light(*seen_, test_, static_cast<int>(experiment_->frame_numbers().size()), synthetic, options,
                           [&](const std::string& line) { say("light: " + line); });
    };
    auto found = look();
    light_ = std::move(found.json);
    if (!found.gain_or_offset && !found.gradient) {
      take_noise(found.frame_noise);
      return;
    }
    bool& option = found.gradient ? test_.dic.local_brightness : test_.dic.brightness;
    option = true;
    const std::string name = found.gradient ? "dic.local_brightness" : "dic.brightness";
    say(fmt::format("light: {}; the images are correlated again with {}", found.sentence, name));
    experiment_.reset();
    seen_.reset();
    seen_ = observe(test_, specimen_);
    correlate_frames();
    lay_out(field_data(world_, *seen_, test_, specimen_, shown_));
    const auto after = look();
    say(fmt::format("light: grey levels left {:.3f} -> {:.3f}; {}", found.rms, after.rms, after.sentence));
    light_["corrected"] = {{"option", name},
                           {"rms_before", found.rms},
                           {"rms_after", after.rms},
                           {"unit", "grey level"},
                           {"after", after.json}};
    light_["sentence"] =
        fmt::format("{} The images were correlated again with {}: grey levels left {:.2f} -> {:.2f}. {}",
                    found.sentence, name, found.rms, after.rms, after.sentence);
    take_noise(after.frame_noise);
  }

  /// Where the light of the frames is not what noise at rest makes it, the motion is as noisy as the grey levels that
  /// the correlation leaves.
  void take_noise(const std::vector<Eigen::VectorXd>& of_faces) {
    if (of_faces.empty()) return;
    loop::FieldData data = experiment_->measured();
    for (std::size_t k = 0; k < of_faces.size(); ++k) data.faces[k].frame_noise = of_faces[k];
    lay_out(std::move(data));
    double least = INFINITY, largest = 0.0;
    for (const auto& noise : of_faces)
      least = std::min(least, noise.minCoeff()), largest = std::max(largest, noise.maxCoeff());
    light_["sentence"] =
        fmt::format("{} The motion is judged by the noise of each frame, {:.2f} to {:.2f} of that at rest.",
                    light_["sentence"].get<std::string>(), least, largest);
  }

  const Communicator& world_;
  io::Case test_;  // with what the light asks of the correlation
  Aim aim_;
  nlohmann::json light_;
  GroupTimes correlation_times_;
  Material material_;
  identification::Specimen specimen_;
  std::optional<Observation> seen_;
  ImageShown shown_;  // gets the images of a synthetic test
  std::unique_ptr<loop::FieldExperiment> experiment_;
};

using Say = std::function<void(const std::string&)>;

std::unique_ptr<LoopTest> make_test(const Communicator& world, const io::Case& test, Aim aim, const Say& say) {
  return test.experiments.empty() ? make_field_test(world, test, aim, say) : make_curve_test(world, test, aim);
}

/// The loop on an experiment whose answers are kept in `checkpoint`, to go on from.
loop::Report close_loop(loop::Experiment& experiment, const loop::LoopOptions& options, const Say& say,
                        LoopCheckpoint& checkpoint) {
  loop::RecordedExperiment recorded(experiment, checkpoint.known(),
                                    [&](const loop::Answer& answer) { checkpoint.keep(answer); });
  try {
    return loop::close_loop(recorded, options, say);
  } catch (const Interrupted&) {
    checkpoint.write();
    throw;
  }
}

/// Several tests at once: the report of all, and in a folder of each test what it shows of that.
void loop_on_tests(const Communicator& world, const CommandOptions& options, const io::Case& all, Aim aim,
                   const std::function<double()>& seconds, const Say& say) {
  const std::vector<io::Case> cases = cases_of_tests(all, options);
  const SignalWatch watch;
  const auto folder = output_folder(all, options, world);
  LoopCheckpoint checkpoint(world, folder, all, cases, options.resume);
  std::vector<std::unique_ptr<LoopTest>> tests;
  std::vector<loop::JointExperiment::Test> joined;
  for (std::size_t k = 0; k < cases.size(); ++k) {
    std::vector<Mistake> mistakes;
    collect(mistakes, cases[k].file, [&] { tests.push_back(make_test(world, cases[k], aim, say)); });
    if (!mistakes.empty()) throw InputError(std::move(mistakes));
    joined.push_back({all.tests[k].name, &tests.back()->experiment(), tests.back()->held_out()});
  }
  loop::JointExperiment experiment(std::move(joined));
  const auto report = close_loop(experiment, how(all, experiment, experiment.held_out(), aim), say, checkpoint);
  for (std::size_t k = 0; k < tests.size(); ++k) {
    const auto own = folder / all.tests[k].name;
    collectively(world, [&] {
      if (world.is_root()) std::filesystem::create_directories(own);
    });
    tests[k]->write(own, experiment.report_of(k, report), seconds());
  }
  collectively(world, [&] {
    if (!world.is_root()) return;
    nlohmann::json json = loop_summary(experiment, report);
    int simulations = 0;
    for (const auto& test : tests) simulations += test->simulations();
    json["time"] = io::quantity(seconds(), "s"), json["simulations"] = simulations;
    for (int frame : experiment.frame_numbers()) json["frame_names"].push_back(experiment.frame_name(frame));
    for (const auto& test : all.tests) json["tests"].push_back(test.name);
    json.update(io::case_summary(write_loop_tests(folder, all, experiment, report, experiment.first_frames())));
    io::write_json(folder / "result.json", json);
    io::write_loop_page(folder / "report.html", json, {});
    fmt::print("\n{}\n  {}\n  {:.0f} s, {} simulations; {}\n", all.title, answer(report, report.sentence), seconds(),
               simulations, (folder / "report.html").string());
  });
  if (aim == Aim::close_the_loop) return;
  print_parameters(world, experiment, report.final);
  require_convergence(report);
}

void run_loop(const Communicator& world, const CommandOptions& options, const io::Case& test, Aim aim) {
  const auto start = std::chrono::steady_clock::now();
  const auto seconds = [&] { return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count(); };
  const Say say = [&](const std::string& line) { spdlog::info("{:6.0f} s  {}", seconds(), line); };
  if (!test.tests.empty()) {
    loop_on_tests(world, options, test, aim, seconds, say);
    return;
  }
  check_loop_case(test);
  const auto folder = output_folder(test, options, world);
  std::optional<SignalWatch> watch;
  std::optional<LoopCheckpoint> checkpoint;
  if (test.experiments.empty())
    watch.emplace(), checkpoint.emplace(world, folder, test, std::span<const io::Case>(), options.resume);
  else if (options.resume)
    spdlog::info("bars begin anew: they take no checkpoint");
  const auto one = make_test(world, test, aim, say);
  const auto how_here = how(test, one->experiment(), one->held_out(), aim);
  const auto report = checkpoint ? close_loop(one->experiment(), how_here, say, *checkpoint)
                                 : loop::close_loop(one->experiment(), how_here, say);
  one->write(folder, report, seconds());
  if (aim == Aim::close_the_loop) return;
  print_parameters(world, one->experiment(), report.final);
  require_convergence(report);
}

}  // namespace

std::unique_ptr<LoopTest> make_field_test(const Communicator& world, const io::Case& test, Aim aim,
                                          const std::function<void(const std::string&)>& say) {
  return std::make_unique<FieldTest>(world, test, aim, say);
}

void loop(const Communicator& world, const CommandOptions& options) {
  run_loop(world, options, read_case(options, {"cameras", "material", "identify"}, true, true, true),
           Aim::close_the_loop);
}

void identify_by_loop(const Communicator& world, const CommandOptions& options, const io::Case& test) {
  if (test.experiments.empty() && test.tests.empty() && test.identify.functional != "displacement_driven")
    spdlog::info("identify.functional: {} has no say here: what is compared is displacement_driven",
                 test.identify.functional);
  run_loop(world, options, test, Aim::identify);
}

}  // namespace imic3d::app
