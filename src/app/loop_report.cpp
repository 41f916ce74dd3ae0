#include "loop_report.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "imic3d/io/loop_page.hpp"
#include "imic3d/io/pictures.hpp"
#include "imic3d/io/run_results.hpp"
#include "loop_results.hpp"
#include "loop_summary.hpp"

namespace imic3d::app {

LoopFields loop_fields(loop::FieldExperiment& experiment, const loop::Report& report) {
  experiment.put_back(report.declared.ground->learned);
  auto [U0, F0] = experiment.unwhitened(report.declared.fit.values);
  experiment.put_back(report.final.ground->learned);
  auto [U1, F1] = experiment.unwhitened(report.final.fit.values);
  return {std::move(U0), std::move(U1), std::move(F0), std::move(F1)};
}

namespace {

/// Correlation coefficients of the remainder's curve with what changed during the test.
nlohmann::json companions(const loop::Scene& scene, const Eigen::VectorXd& curve) {
  const auto frames = curve.size();
  const auto before = [](const Eigen::VectorXd& all, Eigen::Index t, double first) {
    return t == 0 ? first : all[t - 1];
  };
  Eigen::VectorXd rate(frames), unloading(frames), plastic = scene.elongation;
  Eigen::Index first_loaded = 0;
  for (Eigen::Index t = 0; t < frames; ++t) {
    const double step = scene.time[t] - before(scene.time, t, scene.start_time);
    rate[t] = step > 0.0 ? (scene.elongation[t] - before(scene.elongation, t, 0.0)) / step : 0.0;
    unloading[t] = std::abs(scene.force[t]) < std::abs(before(scene.force, t, 0.0)) ? 1.0 : 0.0;
    if (std::abs(scene.force[t]) < 0.3 * scene.force.cwiseAbs().maxCoeff()) first_loaded = t;
  }
  if (scene.force[first_loaded] != 0.0)
    plastic -= scene.force * (scene.elongation[first_loaded] / scene.force[first_loaded]);
  nlohmann::json json = nlohmann::json::object();
  for (const auto& [name, other] : {std::pair<const char*, Eigen::VectorXd>{"clock", scene.time},
                                    {"force", scene.force},
                                    {"elongation", scene.elongation},
                                    {"plastic elongation", plastic},
                                    {"rate of elongation", rate},
                                    {"unloading", unloading}}) {
    const Eigen::VectorXd a = curve.array() - curve.mean(), b = other.array() - other.mean();
    if (frames > 2 && b.norm() > 1e-9 * (1e-300 + other.norm()))
      json[name] = a.dot(b) / std::max(1e-300, a.norm() * b.norm());
  }
  return json;
}

/// A node's place without the round-off of the mesh's coordinates.
Eigen::Vector2d place_of(const mesh::Mesh& surface, Eigen::Index node) {
  const Eigen::Vector2d at = surface.nodes.row(node).head<2>();
  const double length = surface.nodes.leftCols<2>().cwiseAbs().maxCoeff();
  return (at.array().abs() > 1e-6 * length).select(at, 0.0);
}

/// Where the remainder is largest.
nlohmann::json place_of_largest(const loop::FieldExperiment& experiment, const loop::Remainder& remainder) {
  Eigen::Index node = 0, frame = 0;
  const double largest = remainder.map.maxCoeff(&node, &frame);
  const auto* face = experiment.measured().faces.data();
  for (; node >= face->surface.nodes.rows(); ++face) node -= face->surface.nodes.rows();
  const Eigen::Vector2d at = place_of(face->surface, node);
  nlohmann::json map = {{"largest", largest},
                        {"limit", remainder.limit},
                        {"frame", experiment.measured().frames[static_cast<std::size_t>(frame)]},
                        {"place", {at[0], at[1]}},
                        {"share_beyond_limit", (remainder.map.array() > remainder.limit).cast<double>().mean()}};
  if (experiment.measured().faces.size() > 1) map["face"] = face->name;
  return map;
}

/// Pictures of one frame, in units of what noise alone leaves (sigma), all faces on one scale.
class SigmaMaps {
 public:
  SigmaMaps(const std::filesystem::path& folder, const loop::FieldExperiment& experiment, const loop::Report& report)
      : folder_(folder), experiment_(experiment), report_(report) {
    report.declared.misfit.frames.maxCoeff(&frame_);
    const auto& remainder = report.remainder;
    largest_ = std::max(
        {remainder.before.col(frame_).cwiseAbs().maxCoeff(), remainder.map.col(frame_).maxCoeff(), remainder.limit});
  }

  [[nodiscard]] std::vector<io::ReportPicture> drawn() {
    Eigen::Index unknown = 0, node = 0;
    for (const auto& face : experiment_.measured().faces) {
      draw_face(face, unknown, node);
      unknown += face.unknowns(), node += face.surface.nodes.rows();
    }
    return std::move(pictures_);
  }

 private:
  void draw_face(const loop::FieldFace& face, Eigen::Index unknown, Eigen::Index node) {
    const auto& remainder = report_.remainder;
    const auto nodes = face.surface.nodes.rows();
    Eigen::Index component = 0, worst = 0;
    remainder.before.col(frame_)
        .segment(unknown, face.unknowns())
        .reshaped(face.components, nodes)
        .cwiseAbs()
        .maxCoeff(&component, &worst);
    const auto along = [&](const Eigen::MatrixXd& all) -> Eigen::VectorXd {
      return all.col(frame_)(Eigen::seqN(unknown + component, nodes, face.components));
    };
    const Eigen::VectorXd before = along(remainder.before), after = along(remainder.after),
                          left = remainder.map.col(frame_).segment(node, nodes);
    const bool added = report_.final.fit.values != report_.declared.fit.values;
    const Eigen::Vector2d middle = place_of(face.surface, worst);
    const std::string of_frame =
                          fmt::format("frame {}", experiment_.measured().frames[static_cast<std::size_t>(frame_)]),
                      of_left = fmt::format(
                          "length of what the final model leaves; one null test of a hundred exceeds {:.1f} somewhere",
                          remainder.limit);
    draw(face, "residual_before", before,
         fmt::format("displacement along {}, measured − predicted{}; {}, the worst one", "xyz"[component],
                     added ? ", before" : "", of_frame));
    if (added) draw(face, "residual_after", after, "the same, after");
    draw(face, "remainder", left, of_left);
    draw(face, "zoom_before", before,
         fmt::format("{}about the worst place ({:.3g}, {:.3g})", added ? "before, " : "", middle[0], middle[1]),
         &middle);
    if (added) draw(face, "zoom_after", after, "after, about the same place", &middle);
    draw(face, "zoom_remainder", left, "what is left there", &middle);
  }

  /// `middle`: only the elements about it, a quarter of the surface across, or three elements.
  void draw(const loop::FieldFace& face, const std::string& name, const Eigen::VectorXd& values,
            const std::string& caption, const Eigen::Vector2d* middle = nullptr) {
    const bool alone = experiment_.measured().faces.size() == 1;
    const auto surface = middle == nullptr ? face.surface : mesh_about(face.surface, *middle);
    std::vector<double> positions;
    for (const auto& at : surface.nodes.rowwise()) {
      const Eigen::Vector2d pixel = face.pixels * at.head<2>().transpose();
      positions.insert(positions.end(), {pixel[0], pixel[1]});
    }
    const auto picture = folder_ / fmt::format("{}{}.png", name, alone ? "" : "_" + face.name);
    io::draw_field(picture, surface, positions, {values.data(), static_cast<std::size_t>(values.size())},
                   {.legend = "sigma", .lower = -largest_, .upper = largest_});
    pictures_.push_back({picture, (alone ? "" : face.name + " face: ") + caption});
  }

  [[nodiscard]] mesh::Mesh mesh_about(mesh::Mesh surface, const Eigen::Vector2d& middle) const {
    const Eigen::RowVector3d low = surface.nodes.colwise().minCoeff(), high = surface.nodes.colwise().maxCoeff();
    const double reach = std::max(0.125 * (high - low).maxCoeff(), 1.5 * experiment_.scene().element);
    Eigen::Index kept = 0;
    for (Eigen::Index c = 0; c < surface.cells.rows(); ++c) {
      const Eigen::Vector2d centre = surface.nodes(surface.cells.row(c).head<4>(), Eigen::seqN(0, 2)).colwise().mean();
      if ((centre - middle).cwiseAbs().maxCoeff() < reach) surface.cells.row(kept++) = surface.cells.row(c).eval();
    }
    surface.cells.conservativeResize(kept, Eigen::NoChange);
    return surface;
  }

  const std::filesystem::path& folder_;
  const loop::FieldExperiment& experiment_;
  const loop::Report& report_;
  Eigen::Index frame_ = 0;
  double largest_ = 0.0;
  std::vector<io::ReportPicture> pictures_;
};

}  // namespace

void write_loop_report(const std::filesystem::path& folder, const io::Case& test,
                       const loop::FieldExperiment& experiment, const loop::Report& report, const LoopFields& fields,
                       const nlohmann::json& light, const std::string& left_out, const GroupTimes& groups,
                       double seconds) {
  nlohmann::json json = loop_summary(experiment, report);
  const auto& measured = experiment.measured();
  const auto& remainder = report.remainder;
  json["time"] = io::quantity(seconds, "s");
  json["simulations"] = experiment.simulations();
  json["groups"] = to_json(groups);
  json["length_unit"] = test.units.length;
  if (!test.doubts.empty()) json["doubts"] = test.doubts;
  const std::string sentence = left_out.empty() ? report.sentence : fmt::format("{} {}.", report.sentence, left_out);
  json["sentence"] = sentence;
  if (!light.is_null()) json["light"] = light;
  if (!light.is_null() && light["verdict"] != "nothing found")
    json["sentence"] = fmt::format("{} The light: {}", sentence, light["sentence"].get<std::string>());
  if (std::isfinite(measured.force_noise)) {
    json["load"] = {{"force", numbers(measured.force)}, {"unit", test.units.force}};
    json["force_residual"] = {{"before", numbers(fields.force_before)},
                              {"after", numbers(fields.force_after)},
                              {"null_rms", numbers(measured.force_noise * remainder.force)},
                              {"unit", test.units.force}};
  }
  if (remainder.time.size() > 0) json["remainder"]["goes_with"] = companions(experiment.scene(), remainder.time);
  if (remainder.map.size() > 0) json["remainder"]["map"] = place_of_largest(experiment, remainder);
  json.update(io::case_summary(write_loop_fields(folder, test, experiment, report, fields)));
  const auto pictures =
      remainder.map.size() > 0 ? SigmaMaps(folder, experiment, report).drawn() : std::vector<io::ReportPicture>();
  for (const auto& picture : pictures)
    json["pictures"].push_back({{"file", picture.file.filename().string()}, {"caption", picture.caption}});
  io::write_json(folder / "result.json", json);
  io::write_loop_page(folder / "report.html", json, pictures);
  fmt::print("\n{}\n  {}\n", test.title, answer(report, sentence));
  if (!light.is_null())
    fmt::print("  light: {}: {}\n", light["verdict"].get<std::string>(), light["sentence"].get<std::string>());
  fmt::print("  {:.0f} s, {} simulations; {}\n", seconds, experiment.simulations(), (folder / "report.html").string());
}

}  // namespace imic3d::app
