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
#include "imic3d/io/run_results.hpp"
#include "imic3d/loop/closing.hpp"
#include "imic3d/loop/field_experiment.hpp"
#include "fields.hpp"
#include "loop_curves.hpp"
#include "loop_report.hpp"
#include "rig.hpp"
#include "synthetic_images.hpp"
#include "test_effects.hpp"

namespace imic3d::app {

namespace {

/// What the loop knows of a rig; throws InputError where it knows nothing of such cameras.
loop::FieldFace field_face(const ObservedFace& seen, const identification::Face& face, const Eigen::SparseMatrix<double>& M) {
  const auto& view = seen.rig->views.front();
  const Eigen::RowVector3d middle = seen.rig->surface.nodes.colwise().mean();
  loop::FieldFace result{.name = face.back ? "back" : "front", .surface = face.surface.mesh, .components = face.components, .M = M.block(face.first_unknown, face.first_unknown, face.unknowns(), face.unknowns())};
  if (const auto held = seen.dic->held(); held.size() > 0) result.M += held;
  result.pixels = view.camera->jacobian(middle.transpose()).leftCols<2>();
  result.axis_of_lens = middle.head<2>().transpose();
  if (const auto* camera = dynamic_cast<const imaging::TelecentricCamera*>(view.camera.get())) {
    const Eigen::Vector2d centre(0.5 * (view.reference.width - 1), 0.5 * (view.reference.height - 1));
    result.axis_of_lens = result.pixels.inverse() * (centre - camera->offset);
  } else if (face.components == 2) {
    throw InputError("cameras", fmt::format("one perspective camera on the {}", result.name), "for imic3d loop a telecentric camera, or several perspective ones, on each face");
  }
  return result;
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
  for (std::size_t k = 0; k < seen.faces.size(); ++k) data.faces.push_back(field_face(seen.faces[k], specimen.faces[k], images.M));
  data.noise = images.noise;
  data.references = seen.references;
  data.displacement = record.surface_displacement.leftCols(frames);
  for (auto& face : seen.faces) face.driving_cut_off = loop::alike(face.driving_cut_off);
  data.driving = driving_displacement(seen, data.displacement);
  data.smooth = [&seen](Eigen::MatrixXd field) { return driving_displacement(seen, std::move(field)); };
  data.correlate = [&seen, &test, &world, frames](const identification::Specimen& made, const Eigen::MatrixXd& U) {
    return correlated_images(seen, test, world, made, U.leftCols(frames));
  };
  data.frames.assign(record.frames.begin(), record.frames.begin() + frames);
  data.time = record.time.head(frames);
  data.force = record.force.head(frames);
  data.start_time = record.start_time;
  data.force_noise = force_noise(seen, test);
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

}  // namespace

void loop(const Communicator& world, const CommandOptions& options) {
  const auto start = std::chrono::steady_clock::now();
  const auto seconds = [&] { return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count(); };
  const io::Case test = read_case(options, {"cameras", "material", "identify"}, true, true);
  if (!test.experiments.empty()) {
    loop_on_curves(world, options, test);
    return;
  }
  const Material material = make_material(test);
  const identification::Specimen specimen = make_specimen(test);
  if (specimen.faces.size() > 1 && specimen.section_factor != 1.0)
    throw InputError("specimen.mid_plane_symmetry", "true with cameras on both faces", "false for imic3d loop, which looks for what makes the faces differ");
  std::optional<Observation> seen;
  if (!test.fields) seen = observe(test, specimen);
  const auto folder = output_folder(test, options, world);
  spdlog::info("{}: {} frames, {} surface nodes", test.title, seen ? seen->places.size() : test.frames.size(), specimen.surface.mesh.nodes.rows());
  if (seen) correlate(*seen, test, world);
  loop::FieldExperiment experiment(world, seen ? field_data(world, *seen, test, specimen) : imported_fields(test, specimen), declared_model(test, material), {.modes = test.loop.modes});
  if (seen) spdlog::info("noise: {:.3f} grey levels{}", seen->noise, std::isfinite(experiment.measured().force_noise) ? fmt::format(", {:.4g} {} of the force", experiment.measured().force_noise, test.units.force) : "");
  loop::LoopOptions how{.draws = test.loop.draws, .additions = test.loop.additions, .rivals = test.loop.rivals, .starts = test.loop.starts, .held_out = {}};
  for (std::size_t t = 0; t < experiment.measured().frames.size(); ++t)
    if (std::binary_search(test.identify.held_out.begin(), test.identify.held_out.end(), experiment.measured().frames[t])) how.held_out.push_back(static_cast<int>(t));
  const auto report = loop::close_loop(experiment, how, [&](const std::string& line) { spdlog::info("{:6.0f} s  {}", seconds(), line); });
  const LoopFields fields = loop_fields(experiment, report);  // collective
  collectively(world, [&] {
    if (world.is_root()) write_loop_report(folder, test, experiment, report, fields, seconds());
  });
}

}  // namespace imic3d::app
