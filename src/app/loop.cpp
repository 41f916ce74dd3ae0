// imic3d loop: identify, find what is left, trace it, add it, identify again; imic3d effects: what it knows.

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>

#include "imic3d/app/observation.hpp"
#include "imic3d/app/output.hpp"
#include "imic3d/app/program.hpp"
#include "imic3d/app/setup.hpp"
#include "imic3d/core/log.hpp"
#include "imic3d/imaging/image.hpp"
#include "imic3d/imaging/synthesis.hpp"
#include "imic3d/io/run_results.hpp"
#include "imic3d/loop/closing.hpp"
#include "imic3d/loop/field_experiment.hpp"
#include "fields.hpp"
#include "loop_curves.hpp"
#include "loop_report.hpp"
#include "rig.hpp"
#include "several_cameras.hpp"
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

/// The surface with a strip of `width` [length] beyond both ends, which moves on as the specimen stretches on average: where a
/// mesh ends the specimen goes on, and so must its image. The new nodes come last.
struct Continued {
  mesh::Mesh surface;
  std::vector<std::pair<int, double>> new_nodes;  ///< the node of the end that each goes on from, and its distance along the axis

  Continued(const mesh::Mesh& cut, const io::Case& test, double width) : surface(cut), axis(test.specimen.axis == "x" ? 0 : 1) {
    const double middle = 0.5 * (cut.nodes.col(axis).maxCoeff() + cut.nodes.col(axis).minCoeff());
    length = cut.nodes.col(axis).maxCoeff() - cut.nodes.col(axis).minCoeff();
    std::vector<Eigen::Vector3d> nodes;
    std::vector<std::array<int, 4>> cells;
    for (const auto& name : {test.specimen.held, test.specimen.loaded}) {
      const auto found = cut.node_groups.find(name);
      if (found == cut.node_groups.end()) continue;
      ends.push_back(found->second);
      std::map<int, int> beyond;
      const auto next = [&](int node) {
        const auto [place, is_new] = beyond.try_emplace(node, static_cast<int>(cut.nodes.rows() + static_cast<Eigen::Index>(nodes.size())));
        if (is_new) {
          const double way = cut.nodes(node, axis) > middle ? width : -width;
          nodes.emplace_back(cut.nodes.row(node).transpose());
          nodes.back()[axis] += way;
          new_nodes.emplace_back(node, way);
        }
        return place->second;
      };
      const auto is_end = [&](int node) { return std::binary_search(found->second.begin(), found->second.end(), node); };
      for (const auto& contour : mesh::contours(cut))  // the specimen lies to the left of an edge a-b
        for (std::size_t i = 0; i < contour.size(); ++i) {
          const int a = contour[i], b = contour[(i + 1) % contour.size()];
          if (is_end(a) && is_end(b)) cells.push_back({b, a, next(a), next(b)});
        }
    }
    surface.nodes.conservativeResize(cut.nodes.rows() + static_cast<Eigen::Index>(nodes.size()), 3);
    for (std::size_t i = 0; i < nodes.size(); ++i) surface.nodes.row(cut.nodes.rows() + static_cast<Eigen::Index>(i)) = nodes[i].transpose();
    surface.cells.conservativeResize(cut.cells.rows() + static_cast<Eigen::Index>(cells.size()), 4);
    for (std::size_t i = 0; i < cells.size(); ++i)
      for (int k = 0; k < 4; ++k) surface.cells(cut.cells.rows() + static_cast<Eigen::Index>(i), k) = cells[i][static_cast<std::size_t>(k)];
  }

  /// [2 nodes of the cut surface] -> [2 nodes].
  [[nodiscard]] Eigen::VectorXd operator()(const Eigen::VectorXd& U) const {
    Eigen::VectorXd all(2 * surface.nodes.rows());
    all.head(U.size()) = U;
    double way[2] = {0.0, 0.0};
    for (std::size_t k = 0; k < ends.size(); ++k)
      for (int node : ends[k]) way[k] += U[2 * node + axis] / static_cast<double>(ends[k].size());
    const double strain = std::abs(way[1] - way[0]) / length * ((way[1] - way[0]) * (surface.nodes(ends[1].front(), axis) - surface.nodes(ends[0].front(), axis)) > 0.0 ? 1.0 : -1.0);
    for (std::size_t i = 0; i < new_nodes.size(); ++i) {
      const auto [node, distance] = new_nodes[i];
      all.segment<2>(U.size() + 2 * static_cast<Eigen::Index>(i)) = U.segment<2>(2 * node);
      all[U.size() + 2 * static_cast<Eigen::Index>(i) + axis] += strain * distance;
    }
    return all;
  }

 private:
  int axis;
  double length = 1.0;
  std::vector<std::vector<int>> ends;
};

/// Images of a surface [quad4] that moves by U [2 nodes x frames, length], made of the reference and correlated like the
/// measured ones, without noise: [2n x frames, length]. Collective.
Eigen::MatrixXd correlated(const Observation& seen, const io::Case& test, const Communicator& world, const mesh::Mesh& cut, const Eigen::MatrixXd& U) {
  const double scale = std::sqrt(std::abs(telecentric(seen).linear.leftCols<2>().determinant()));
  const Continued whole(cut, test, 30.0 / scale);
  const mesh::Mesh& surface = whole.surface;
  const auto& declared = test.cameras.front();
  std::vector<imaging::Image> references;
  for (int number : declared.reference) references.push_back(imaging::read_image(declared.images[static_cast<std::size_t>(test.index_of(number))]));
  const imaging::Image reference = imaging::average(references);
  const imaging::ImageTexture texture(reference);
  imaging::SynthesisOptions options;
  options.width = reference.width, options.height = reference.height;
  options.depth = reference.depth, options.supersampling = 1;
  const auto pixels = [&](const Eigen::VectorXd& displacement) {
    imaging::PixelPoints points(surface.nodes.rows(), 2);
    for (Eigen::Index i = 0; i < points.rows(); ++i)
      points.row(i) = telecentric(seen).project(surface.nodes.row(i).transpose() + Eigen::Vector3d(displacement[2 * i], displacement[2 * i + 1], 0.0)).transpose();
    return points;
  };
  const imaging::PixelPoints at_rest = pixels(Eigen::VectorXd::Zero(2 * surface.nodes.rows()));
  const auto source = [&](int t) {
    return imaging::render(imaging::InverseMapping(at_rest, pixels(whole(U.col(t))), surface.cells), texture, texture, options);  // what is beside it stands still
  };
  const auto frames = seen.faces.front().dic->run(world, static_cast<int>(U.cols()), source);
  Eigen::MatrixXd measured(frames.front().displacement.size(), U.cols());
  for (Eigen::Index t = 0; t < U.cols(); ++t) {
    if (frames[static_cast<std::size_t>(t)].lost) throw ConvergenceError("the images of a synthetic test could not be correlated");
    measured.col(t) = frames[static_cast<std::size_t>(t)].displacement;
  }
  return measured;
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
    return correlated(seen, test, world, surface, U.leftCols(frames));
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

}  // namespace

void loop(const Communicator& world, const CommandOptions& options) {
  const auto start = std::chrono::steady_clock::now();
  const auto seconds = [&] { return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count(); };
  const io::Case test = read_case(options, {"cameras", "material", "identify"}, true, true);
  if (!test.experiments.empty()) {
    loop_on_curves(world, options, test);
    return;
  }
  if (!test.fields && several_cameras(test))
    throw InputError("cameras", fmt::format("{} cameras, the first is {}", test.cameras.size(), test.cameras.front().model), "one telecentric camera for imic3d loop");
  const Material material = make_material(test);
  const identification::Specimen specimen = make_specimen(test);
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
