#include "loop_results.hpp"

#include <fmt/format.h>

#include <cmath>

#include "imic3d/app/output.hpp"

namespace imic3d::app {

namespace {

std::span<const double> as_span(const Eigen::VectorXd& values) {
  return {values.data(), static_cast<std::size_t>(values.size())};
}

template <typename Number>
std::vector<Number> row_major(const auto& matrix) {
  const Eigen::Matrix<Number, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> copy = matrix;
  return {copy.data(), copy.data() + copy.size()};
}

/// Nodal displacement of a face [unknowns x frames] with three components [frames, nodes, 3]; what its cameras do not
/// see is 0.
std::vector<double> three_components(const auto& displacement, Eigen::Index components) {
  std::vector<double> all;
  for (Eigen::Index t = 0; t < displacement.cols(); ++t)
    for (Eigen::Index i = 0; i < displacement.rows(); i += components)
      for (Eigen::Index k = 0; k < 3; ++k) all.push_back(k < components ? displacement(i + k, t) : 0.0);
  return all;
}

io::ResultsFile begun(const std::filesystem::path& folder, const io::Case& test) {
  auto h5 = io::ResultsFile::create(folder / "results.h5");
  io::store_case(h5, test, versions());
  return h5;
}

/// The error of each frame.
void store_frames(io::ResultsFile& h5, const std::vector<int>& frames, const loop::Report& report) {
  h5.store("loop/frames", {frames.size()}, frames, "-", "numbers of the frames");
  h5.store("loop/held_out", {frames.size()}, std::vector<int>(report.held_out.begin(), report.held_out.end()), "-",
           "1: never fitted");
  for (const auto& [name, model] : {std::pair("before", &report.declared), std::pair("after", &report.final)}) {
    const std::string group = fmt::format("loop/{}/", name);
    h5.store(group + "chi", {frames.size()}, as_span(model->misfit.frames), "noise", "residual of each frame");
    h5.store(group + "null_chi", {frames.size()}, as_span(model->misfit.null_frames), "noise",
             "its 95 % quantile under the null");
  }
}

void store_frame_names(io::ResultsFile& h5, const loop::Experiment& experiment) {
  std::vector<std::string> names;
  for (int t = 0; t < static_cast<int>(experiment.frame_numbers().size()); ++t)
    names.push_back(experiment.frame_name(t));
  h5.store_texts("loop/frame_names", names, "what each frame is");
}

/// A face of the surface whose unknowns begin at `first` and whose nodes at `first_node`.
void store_face(io::ResultsFile& h5, const std::string& at, const loop::FieldFace& face, Eigen::Index first,
                Eigen::Index first_node, const loop::Report& report, const LoopFields& fields,
                const std::string& length) {
  const auto nodes = static_cast<std::size_t>(face.surface.nodes.rows()),
             components = static_cast<std::size_t>(face.components), frames = report.held_out.size();
  h5.store(at + "surface/nodes", {nodes, 3}, row_major<double>(face.surface.nodes), length, "nodes of the surface");
  const mesh::Cells cells = face.surface.cells.leftCols(4);
  h5.store(at + "surface/cells", {static_cast<std::size_t>(cells.rows()), 4}, row_major<int>(cells), "-",
           "nodes of the quadrilaterals, from 0");
  for (const auto& [name, U] :
       {std::pair("before", &fields.displacement_before), std::pair("after", &fields.displacement_after)})
    h5.store(fmt::format("{}loop/{}/displacement", at, name), {frames, nodes, 3},
             three_components(U->middleRows(first, face.unknowns()), face.components), length,
             "measured - predicted displacement of the nodes; 0 along z where no camera sees it");
  if (report.remainder.map.size() == 0) return;
  const Eigen::MatrixXd map = report.remainder.map.middleRows(first_node, face.surface.nodes.rows());
  h5.store(at + "loop/remainder/map", {frames, nodes}, std::span(map.data(), static_cast<std::size_t>(map.size())),
           "noise", "length of the residual displacement over its rms under the null");
  h5.store(at + "loop/remainder/mode", {nodes, components},
           as_span(report.remainder.mode.segment(first, face.unknowns())), length, "displacement of the first mode");
}

}  // namespace

io::ResultsFile write_loop_fields(const std::filesystem::path& folder, const io::Case& test,
                                  const loop::FieldExperiment& experiment, const loop::Report& report,
                                  const LoopFields& fields) {
  auto h5 = begun(folder, test);
  const auto& measured = experiment.measured();
  const auto frames = measured.frames.size();
  Eigen::Index first = 0, first_node = 0;
  for (const auto& face : measured.faces) {
    store_face(h5, measured.faces.size() == 1 ? "" : face.name + "/", face, first, first_node, report, fields,
               test.units.length);
    first += face.unknowns(), first_node += face.surface.nodes.rows();
  }
  store_frames(h5, measured.frames, report);
  h5.store("loop/time", {frames}, as_span(measured.time), test.units.time, "time");
  if (std::isfinite(measured.force_noise)) {
    h5.store("loop/force", {frames}, as_span(measured.force), test.units.force, "measured force");
    for (const auto& [name, F] : {std::pair("before", &fields.force_before), std::pair("after", &fields.force_after)})
      h5.store(fmt::format("loop/{}/force", name), {frames}, as_span(*F), test.units.force,
               "measured - predicted force");
  }
  if (report.remainder.map.size() > 0)
    h5.store("loop/remainder/time", {frames}, as_span(report.remainder.time), "noise", "first mode over the frames");
  h5.start();
  io::write_xdmf(h5, folder / "results.xdmf");
  return h5;
}

io::ResultsFile write_loop_curves(const std::filesystem::path& folder, const io::Case& test,
                                  const loop::Experiment& experiment, const loop::Report& report,
                                  const std::vector<LoopCurve>& curves) {
  auto h5 = begun(folder, test);
  store_frames(h5, experiment.frame_numbers(), report);
  store_frame_names(h5, experiment);
  std::vector<std::string> names, groups;
  std::vector<int> held_out;
  const std::string stress = io::stress_unit(test.units);
  for (std::size_t k = 0; k < curves.size(); ++k) {
    const LoopCurve& one = curves[k];
    names.push_back(one.name), groups.push_back(one.group), held_out.push_back(one.held_out ? 1 : 0);
    const auto store = [&](const char* name, const Eigen::VectorXd& values, const std::string& unit, const char* what) {
      h5.store(fmt::format("curves/{:04d}/{}", k, name), {static_cast<std::size_t>(values.size())}, as_span(values),
               unit, what);
    };
    store("strain", one.strain, "-", "logarithmic strain");
    store("measured", one.measured, stress, "measured stress");
    store("before", one.before, stress, "stress that the declared model predicts");
    store("after", one.after, stress, "stress that the final model predicts");
  }
  h5.store_texts("curves/names", names, "name of each curve");
  h5.store_texts("curves/groups", groups, "the experiment that it belongs to");
  h5.store("curves/held_out", {held_out.size()}, held_out, "-", "1: never fitted");
  h5.start();
  return h5;
}

io::ResultsFile write_loop_tests(const std::filesystem::path& folder, const io::Case& all,
                                 const loop::Experiment& experiment, const loop::Report& report,
                                 const std::vector<int>& first_frames) {
  auto h5 = begun(folder, all);
  store_frames(h5, experiment.frame_numbers(), report);
  store_frame_names(h5, experiment);
  std::vector<std::string> tests;
  for (const auto& test : all.tests) tests.push_back(test.name);
  h5.store_texts("loop/tests", tests, "names of the tests, each of which has a folder of its own");
  h5.store("loop/first_frames", {first_frames.size()}, first_frames, "-", "the first frame of each test");
  h5.start();
  return h5;
}

}  // namespace imic3d::app
