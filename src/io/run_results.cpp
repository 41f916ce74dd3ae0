#include "imic3d/io/run_results.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "imic3d/core/error.hpp"

namespace imic3d::io {

namespace {

constexpr double nan = std::numeric_limits<double>::quiet_NaN();

std::span<const double> flat(const mesh::Nodes& nodes) {
  return {nodes.data(), static_cast<std::size_t>(nodes.size())};
}
std::span<const int> flat(const mesh::Cells& cells) { return {cells.data(), static_cast<std::size_t>(cells.size())}; }
std::vector<std::size_t> shape(const mesh::Cells& cells) {
  return {static_cast<std::size_t>(cells.rows()), static_cast<std::size_t>(cells.cols())};
}

void store_mesh(ResultsFile& file, const std::string& group, const mesh::Mesh& mesh, const std::string& length) {
  file.store(group + "/nodes", {static_cast<std::size_t>(mesh.nodes.rows()), 3}, flat(mesh.nodes), length,
             "reference position of the nodes [node, axis]");
  file.store(group + "/cells", shape(mesh.cells), flat(mesh.cells), "-", "nodes of the cells [cell, corner]");
  if (const int count = mesh::corners_per_cell(mesh.type); count < mesh.cells.cols()) {
    const mesh::Cells corners = mesh.cells.leftCols(count);
    file.store(group + "/corners", shape(corners), flat(corners), "-",
               "corners of the cells [cell, corner], for viewers");
  }
  if (mesh.front.size() > 0)
    file.store(group + "/front", shape(mesh.front), flat(mesh.front), "-", "faces that the camera sees [face, corner]");
  for (const auto& [name, nodes] : mesh.node_groups) {
    if (name.empty() || name.find('/') != std::string::npos || name == "." || nodes.empty()) continue;
    file.store(group + "/node_groups/" + name, {nodes.size()}, nodes, "-", "nodes of the group");
  }
}

void store_frames(ResultsFile& file, const Case& test) {
  const auto n = test.frames.size();
  std::vector<double> time(n, nan), force(n, nan);
  std::vector<std::string> images(n);
  for (std::size_t i = 0; i < n; ++i) {
    for (const auto& record : test.loads.records) {
      if (record.frame != test.frames[i]) continue;
      time[i] = record.time;
      force[i] = record.force;
    }
    if (test.loads.records.empty() && test.simulate && i < test.simulate->time.size()) time[i] = test.simulate->time[i];
    if (!test.cameras.empty() && i < test.cameras[0].images.size()) images[i] = test.cameras[0].images[i].string();
  }
  file.store("frames/number", {n}, test.frames, "-", "number of the frame, as in the load record");
  file.store("frames/time", {n}, time, test.units.time, "time of the frame");
  file.store("frames/force_measured", {n}, force, test.units.force, "recorded force");
  file.declare("frames/force_predicted", {n}, test.units.force, "force of the simulation along the axis");
  std::vector<int> use(n, 0);
  for (std::size_t i = 0; i < n; ++i) {
    const auto among = [&](const Frames& frames) {
      return std::binary_search(frames.begin(), frames.end(), test.frames[i]);
    };
    for (const auto& stage : test.identify.stages) use[i] = among(stage.frames) ? 1 : use[i];
    if (among(test.identify.held_out)) use[i] = 2;
    if (!test.cameras.empty() && among(test.cameras.front().reference)) use[i] = 3;
  }
  file.store("frames/use", {n}, use, "-", "0: not fitted, 1: fitted in some stage, 2: held out, 3: of the reference");
  file.store_texts("frames/images", images, "image of the first camera");
}

void declare_fields(ResultsFile& file, const Case& test, const mesh::Mesh& mesh) {
  const auto frames = test.frames.size();
  const auto nodes = static_cast<std::size_t>(mesh.nodes.rows()), cells = static_cast<std::size_t>(mesh.cells.rows());
  const auto stress = stress_unit(test.units);
  file.declare("fields/displacement", {frames, nodes, 3}, test.units.length,
               "displacement of the simulation [frame, node, axis]");
  file.declare("fields/cauchy_stress", {frames, cells, 6}, stress,
               "Cauchy stress, cell average, in the order 11, 22, 33, 12, 23, 13 [frame, cell, component]");
  file.declare("fields/von_mises", {frames, cells}, stress, "von Mises stress, cell average [frame, cell]");
  file.declare("fields/plastic_strain", {frames, cells}, "-", "accumulated plastic strain, cell average [frame, cell]");
  file.declare("fields/reaction", {frames, 3}, test.units.force, "resultant on the loaded end [frame, axis]");
  file.declare_frames_done("fields", frames);
}

void declare_correlation(ResultsFile& file, const Case& test, const RunPlan& plan) {
  const auto frames = test.frames.size();
  const auto nodes = static_cast<std::size_t>(plan.surface->nodes.rows()),
             cells = static_cast<std::size_t>(plan.surface->cells.rows());
  file.declare("dic/displacement", {frames, nodes, 3}, test.units.length, "displacement of DIC [frame, node, axis]");
  file.declare_frames_done("dic", frames);
  for (const auto& [name, what] : {std::pair{"dic", "pure DIC"}, std::pair{"model", "the identified model"}}) {
    file.declare(fmt::format("residual/rms_{}", name), {frames}, "grey level",
                 fmt::format("rms of f - g(x + u) over the region, {} [frame]", what));
    file.declare(fmt::format("residual/element_{}", name), {frames, cells}, "grey level",
                 fmt::format("rms of f - g(x + u) per element, {} [frame, cell]", what));
  }
  file.declare_frames_done("residual", frames);
  file.declare("residual/noise", {1}, "grey level",
               "standard deviation of the noise in the smoothed images, of which the residuals are");
}

void declare_identification(ResultsFile& file, const Case& test, const RunPlan& plan) {
  const auto n = plan.parameters.size(), most = static_cast<std::size_t>(plan.most_iterations);
  std::vector<std::string> names, units;
  std::vector<double> initial;
  for (const auto& parameter : plan.parameters) {
    names.push_back(parameter.name);
    units.push_back(parameter.unit);
    const auto it = test.material.parameters.find(parameter.name);
    initial.push_back(it == test.material.parameters.end() ? nan : it->second.value);
  }
  const std::string group = "identification/";
  const std::string unit = "see identification/units";
  file.store_texts(group + "parameters", names, "names of the parameters");
  file.store_texts(group + "units", units, "units of the parameters");
  file.store(group + "initial", {n}, initial, unit, "values in the case file");
  file.declare(group + "values", {n}, unit, "identified values");
  file.declare(group + "standard_deviation", {n}, unit,
               "standard deviation; NaN where a parameter was not free, infinite where it is not determined");
  file.declare(group + "covariance", {n, n}, unit, "covariance (Eq. 14)");
  file.declare(group + "on_bound", {n}, "-",
               "1 where a free parameter ended on a bound: its standard deviation says nothing", Storage::integer);
  file.declare(
      group + "at_once/change", {n}, unit,
      "of parameters that stages found one after another, if all were free at once (one step of Eq. 10); else NaN");
  file.declare(group + "at_once/standard_deviation", {n}, unit,
               "standard deviation if all were free at once; else NaN");
  file.declare(group + "refined_mesh/change", {n}, unit,
               "change on a mesh that is refined once (one step of Eq. 10); NaN: not found");
  file.declare(
      group + "in_space/change", {n}, unit,
      "change if the specimen were simulated in space, not in plane stress (one step of Eq. 10); NaN: not found");
  file.declare(group + "iterations/count", {1}, "-", "number of rows that are written", Storage::integer);
  file.declare(group + "iterations/stage", {most}, "-", "stage of the iteration, from 0", Storage::integer);
  file.declare(group + "iterations/iteration", {most}, "-", "number within the stage, 0: the start", Storage::integer);
  file.declare(group + "iterations/values", {most, n}, unit, "values after the iteration [iteration, parameter]");
  file.declare(group + "iterations/eta", {most}, "-", "relative change of the parameters (Eq. 13)");
  file.declare(group + "iterations/residual", {most}, "-", "value of the functional after the iteration");
}

}  // namespace

void store_case(ResultsFile& file, const Case& test, const std::map<std::string, std::string>& versions) {
  file.store_text("case/file", test.file.string(), "the case file");
  file.store_text("case/text", test.text, "its contents");
  file.store_text("case/title", test.title, "title of the test");
  for (const auto& [name, version] : versions) file.store_text("program/" + name, version, "version");
}

ResultsFile create_results(const std::filesystem::path& folder, const Case& test, const RunPlan& plan) {
  auto file = ResultsFile::create(folder / "results.h5");
  store_case(file, test, plan.versions);
  file.store_text("case/held", test.specimen.held, "group of nodes that is held");
  file.store_text("case/loaded", test.specimen.loaded, "group of nodes that is pulled");
  file.store_text("case/axis", test.specimen.axis, "direction of the load");
  store_frames(file, test);
  if (plan.volume) {
    store_mesh(file, "mesh", *plan.volume, test.units.length);
    declare_fields(file, test, *plan.volume);
  }
  if (plan.surface) {
    store_mesh(file, "surface", *plan.surface, test.units.length);
    declare_correlation(file, test, plan);
  }
  if (!plan.parameters.empty()) declare_identification(file, test, plan);
  file.start();
  write_xdmf(file, folder / "results.xdmf");
  return file;
}

void write_simulation_frame(ResultsFile& file, std::size_t index, const SimulationFrame& frame) {
  file.mark_done("fields", index, false);
  file.write("fields/displacement", index, frame.displacement);
  file.write("fields/cauchy_stress", index, frame.cauchy_stress);
  file.write("fields/von_mises", index, frame.von_mises);
  file.write("fields/plastic_strain", index, frame.plastic_strain);
  file.write("fields/reaction", index, frame.reaction);
  file.write("frames/force_predicted", index, {&frame.force, 1});
  file.mark_done("fields", index);
}

void write_dic_frame(ResultsFile& file, std::size_t index, std::span<const double> displacement, double rms,
                     std::span<const double> element_rms) {
  file.mark_done("dic", index, false);
  file.write("dic/displacement", index, displacement);
  file.write("residual/rms_dic", index, {&rms, 1});
  file.write("residual/element_dic", index, element_rms);
  file.mark_done("dic", index);
}

void write_noise(ResultsFile& file, double noise) { file.write("residual/noise", {&noise, 1}); }

void write_model_residual(ResultsFile& file, std::size_t index, double rms, std::span<const double> element_rms) {
  file.mark_done("residual", index, false);
  file.write("residual/rms_model", index, {&rms, 1});
  file.write("residual/element_model", index, element_rms);
  file.mark_done("residual", index);
}

void write_iteration(ResultsFile& file, int stage, int iteration, std::span<const double> values, double eta,
                     double residual) {
  const std::string group = "identification/iterations/";
  const auto row = static_cast<std::size_t>(file.read_integers(group + "count")[0]);
  if (row >= file.shape(group + "eta")[0]) return;
  const std::array<double, 2> number{static_cast<double>(stage), static_cast<double>(iteration)};
  const auto count = static_cast<double>(row + 1);
  file.write(group + "stage", row, {number.data(), 1});
  file.write(group + "iteration", row, {number.data() + 1, 1});
  file.write(group + "values", row, values);
  file.write(group + "eta", row, {&eta, 1});
  file.write(group + "residual", row, {&residual, 1});
  file.write(group + "count", 0, {&count, 1});  // last, so that a row that counts is whole
}

void write_identified(ResultsFile& file, std::span<const double> values, std::span<const double> covariance,
                      const std::set<int>& on_bound) {
  const auto n = values.size();
  if (covariance.size() != n * n) throw std::invalid_argument("write_identified: covariance is not [P x P]");
  std::vector<double> deviation(n);
  for (std::size_t i = 0; i < n; ++i) deviation[i] = std::sqrt(covariance[i * n + i]);
  file.write("identification/covariance", covariance);
  file.write("identification/standard_deviation", deviation);
  std::vector<double> marks(n, 0.0);
  for (const int j : on_bound) marks[static_cast<std::size_t>(j)] = 1.0;
  file.write("identification/on_bound", marks);
  file.write("identification/values", values);
}

void write_freed_at_once(ResultsFile& file, std::span<const double> changes, std::span<const double> deviations) {
  file.write("identification/at_once/change", changes);
  file.write("identification/at_once/standard_deviation", deviations);
}

void write_change(ResultsFile& file, const std::string& by, std::span<const double> changes) {
  file.write("identification/" + by + "/change", changes);
}

}  // namespace imic3d::io
