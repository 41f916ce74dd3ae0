// imic3d loop: identify, find what is left, trace it, add it, identify again; imic3d effects: what it knows.

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <Eigen/Dense>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <nlohmann/json.hpp>

#include "imic3d/app/observation.hpp"
#include "imic3d/app/output.hpp"
#include "imic3d/app/program.hpp"
#include "imic3d/app/setup.hpp"
#include "imic3d/core/log.hpp"
#include "imic3d/imaging/image.hpp"
#include "imic3d/io/run_results.hpp"
#include "imic3d/loop/closing.hpp"
#include "imic3d/loop/field_experiment.hpp"
#include "fields.hpp"
#include "light.hpp"
#include "loop_curves.hpp"
#include "loop_report.hpp"
#include "rig.hpp"
#include "several_cameras.hpp"
#include "synthetic_images.hpp"
#include "test_effects.hpp"

namespace imic3d::app {

namespace {

const imaging::TelecentricCamera& telecentric(const Observation& seen) {
  return dynamic_cast<const imaging::TelecentricCamera&>(*seen.faces.front().rig->views.front().camera);
}

/// The frames that some stage uses, and those between them.
int last_frame(const io::Case& test, const identification::Record& record) {
  int last = 0;
  for (const auto& stage : test.identify.stages)
    for (std::size_t t = 0; t < record.frames.size(); ++t)
      if (std::binary_search(stage.frames.begin(), stage.frames.end(), record.frames[t])) last = std::max(last, static_cast<int>(t));
  return last;
}

loop::FieldData field_data(const Communicator& world, Observation& seen, const io::Case& test, const identification::Specimen& specimen) {
  const auto record = make_record(seen, test, specimen);
  const auto images = make_image_data(seen, test);
  const int frames = 1 + last_frame(test, record);
  loop::FieldData data;
  data.surface = specimen.surface.mesh;
  data.M = images.M;
  data.noise = images.noise;
  data.references = seen.references;
  data.displacement = record.surface_displacement.leftCols(frames);
  seen.faces.front().driving_cut_off = loop::alike(seen.faces.front().driving_cut_off);
  data.driving = driving_displacement(seen, data.displacement);
  data.smooth = [&seen](Eigen::MatrixXd field) { return driving_displacement(seen, std::move(field)); };
  data.correlate = [&seen, &test, &world, frames](const mesh::Mesh& surface, const Eigen::MatrixXd& U) {
    return correlated_images(seen, test, world, telecentric(seen), surface, U.leftCols(frames));
  };
  data.frames.assign(record.frames.begin(), record.frames.begin() + frames);
  data.time = record.time.head(frames);
  data.force = record.force.head(frames);
  data.start_time = record.start_time;
  data.force_noise = force_noise(seen, test);
  data.pixels = telecentric(seen).linear.leftCols<2>();
  const auto& reference = test.cameras.front().images.front();
  const auto image = imaging::read_image(reference);
  data.axis_of_lens = data.pixels.inverse() * (Eigen::Vector2d(0.5 * (image.width - 1), 0.5 * (image.height - 1)) - telecentric(seen).offset);
  return data;
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
  for (const auto& [name, deviation] : test.loop.prior) model.priors[static_cast<std::size_t>(material.index(name))] = deviation;
  if (test.material.law != "elastic") {
    const ExtendedMaterial extended = make_extended_material(test);
    for (std::size_t j = 0; j < extended.information.size(); ++j)
      if (extended.declared[j] == 0) model.lacking.push_back(extended.information[j]);
  }
  model.extended = [&test](const std::vector<std::string>& effects) { return extended_law(test, effects); };
  model.specimen = [&test](const loop::MeshChange& change) { return make_specimen(test, false, change); };
  model.thickness = test.specimen.thickness;
  model.increments = test.identify.steps_per_frame;
  model.groups = test.identify.groups;
  model.effects = declared_effects(test);
  model.unit = [&test](std::string unit) { return unit_in(std::move(unit), test.units); };
  return model;
}

/// Shows images of the declared model's motion on a finer mesh, correlated.
void show_synthetic(const Communicator& world, Observation& seen, const io::Case& test, const identification::Specimen& specimen, const Material& material, const ImageShown& shown) {
  loop::FieldData data = field_data(world, seen, test, specimen);
  data.correlate = [&](const mesh::Mesh& surface, const Eigen::MatrixXd& U) { return correlated_images(seen, test, world, telecentric(seen), surface, U, shown); };
  loop::FieldExperiment experiment(world, std::move(data), declared_model(test, material), {.modes = 2});
  std::vector<double> values;
  for (const auto& p : experiment.parameters()) values.push_back(p.value);
  experiment.learn_bias(values);
}

/// Looks at the light; where it changes and the correlation has left it alone, the images are correlated again with gain and offset of each frame, or of each
/// element, fitted. For result.json.
nlohmann::json settle_light(const Communicator& world, std::optional<Observation>& seen, io::Case& test, const identification::Specimen& specimen, const Material& material,
                            const loop::LoopOptions& options, const std::function<void(const std::string&)>& say) {
  const auto look = [&] {
    identification::Record record;
    for (int place : seen->places) record.frames.push_back(test.frames[static_cast<std::size_t>(place)]);
    return look_at_light(*seen, test, 1 + last_frame(test, record), [&](const ImageShown& shown) { show_synthetic(world, *seen, test, specimen, material, shown); }, options,
                         [&](const std::string& line) { say("light: " + line); });
  };
  auto found = look();
  if (!found.gain_or_offset && !found.gradient) return std::move(found.json);
  bool& option = found.gradient ? test.dic.local_brightness : test.dic.brightness;
  option = true;
  const std::string name = found.gradient ? "dic.local_brightness" : "dic.brightness";
  say(fmt::format("light: {}; the images are correlated again with {}", found.sentence, name));
  seen.reset();
  seen = observe(test, specimen);
  correlate(*seen, test, world);
  const auto after = look();
  const double worst_before = found.rms, now = after.rms;
  say(fmt::format("light: grey levels left {:.3f} -> {:.3f}; {}", worst_before, now, after.sentence));
  found.json["corrected"] = {{"option", name}, {"rms_before", worst_before}, {"rms_after", now}, {"unit", "grey level"}, {"after", after.json}};
  found.json["sentence"] = fmt::format("{} The images were correlated again with {}: grey levels left {:.2f} -> {:.2f}. {}", found.sentence, name, worst_before, now, after.sentence);
  return std::move(found.json);
}

}  // namespace

void loop(const Communicator& world, const CommandOptions& options) {
  const auto start = std::chrono::steady_clock::now();
  const auto seconds = [&] { return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count(); };
  io::Case test = read_case(options, {"cameras", "material", "identify"}, true, true);
  if (!test.experiments.empty()) {
    loop_on_curves(world, options, test);
    return;
  }
  if (!test.fields && several_cameras(test))
    throw InputError("cameras", fmt::format("{} cameras, the first is {}", test.cameras.size(), test.cameras.front().model), "one telecentric camera for imic3d loop");
  const Material material = make_material(test);
  const identification::Specimen specimen = make_specimen(test);
  check_light_effects(test, specimen.faces.front().surface.mesh);
  std::optional<Observation> seen;
  if (!test.fields) seen = observe(test, specimen);
  const auto folder = output_folder(test, options, world);
  spdlog::info("{}: {} frames, {} surface nodes", test.title, seen ? seen->places.size() : test.frames.size(), specimen.surface.mesh.nodes.rows());
  const auto say = [&](const std::string& line) { spdlog::info("{:6.0f} s  {}", seconds(), line); };
  nlohmann::json light;
  if (seen) {
    correlate(*seen, test, world);
    loop::LoopOptions of_light{.draws = test.loop.draws, .additions = test.loop.additions, .rivals = test.loop.rivals, .starts = {1.0}, .held_out = {}};
    for (std::size_t t = 0; t < seen->places.size(); ++t)
      if (std::binary_search(test.identify.held_out.begin(), test.identify.held_out.end(), test.frames[static_cast<std::size_t>(seen->places[t])])) of_light.held_out.push_back(static_cast<int>(t));
    light = settle_light(world, seen, test, specimen, material, of_light, say);
  }
  loop::FieldExperiment experiment(world, seen ? field_data(world, *seen, test, specimen) : imported_fields(test, specimen), declared_model(test, material), {.modes = test.loop.modes});
  if (seen) spdlog::info("noise: {:.3f} grey levels{}", seen->noise, std::isfinite(experiment.measured().force_noise) ? fmt::format(", {:.4g} {} of the force", experiment.measured().force_noise, test.units.force) : "");
  loop::LoopOptions how{.draws = test.loop.draws, .additions = test.loop.additions, .rivals = test.loop.rivals, .starts = test.loop.starts, .held_out = {}};
  for (std::size_t t = 0; t < experiment.measured().frames.size(); ++t)
    if (std::binary_search(test.identify.held_out.begin(), test.identify.held_out.end(), experiment.measured().frames[t])) how.held_out.push_back(static_cast<int>(t));
  const auto report = loop::close_loop(experiment, how, say);
  const LoopFields fields = loop_fields(experiment, report);  // collective
  collectively(world, [&] {
    if (world.is_root()) write_loop_report(folder, test, experiment, report, fields, light, seconds());
  });
}

}  // namespace imic3d::app
