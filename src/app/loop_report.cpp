#include "loop_report.hpp"

#include <fmt/format.h>

#include <fmt/ranges.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "imic3d/io/loop_page.hpp"
#include "imic3d/io/pictures.hpp"
#include "imic3d/io/run_results.hpp"
#include "loop_results.hpp"

namespace imic3d::app {

namespace {

nlohmann::json numbers(const auto& values) {
  nlohmann::json list = nlohmann::json::array();
  for (Eigen::Index i = 0; i < values.size(); ++i) list.push_back(std::isfinite(values[i]) ? nlohmann::json(values[i]) : nlohmann::json());
  return list;
}

}  // namespace

LoopFields loop_fields(loop::FieldExperiment& experiment, const loop::Report& report) {
  experiment.put_back(report.declared.ground->learned);
  auto [U0, F0] = experiment.unwhitened(report.declared.fit.values);
  experiment.put_back(report.final.ground->learned);
  auto [U1, F1] = experiment.unwhitened(report.final.fit.values);
  return {std::move(U0), std::move(U1), std::move(F0), std::move(F1)};
}

nlohmann::json loop_summary(const loop::Experiment& experiment, const loop::Report& report) {
  const auto& candidates = experiment.candidates();
  const auto& parameters = experiment.parameters();
  const auto candidate_name = [&](int k) { return candidates[static_cast<std::size_t>(k)].name; };
  const auto names = [&](const std::vector<int>& which) {
    nlohmann::json list = nlohmann::json::array();
    for (int k : which) list.push_back(candidate_name(k));
    return list;
  };
  const auto of_model = [&](const loop::Model& model) {
    nlohmann::json json;
    json["added"] = names(model.added);
    for (std::size_t j = 0; j < model.fit.free.size(); ++j) {
      const auto k = static_cast<std::size_t>(model.fit.free[j]);
      const auto place = static_cast<Eigen::Index>(j);
      json["parameters"][parameters[k].info.name] = {{"value", model.fit.values[k]}, {"standard_deviation", std::sqrt(model.covariance(place, place))}, {"unit", parameters[k].info.unit}};
    }
    json["chi"] = {{"fitted", model.misfit.fitted}, {"held_out", model.misfit.held_out}, {"null_fitted", model.misfit.null_fitted}, {"null_held_out", model.misfit.null_held_out},
                   {"frames", numbers(model.misfit.frames)}, {"null_frames", numbers(model.misfit.null_frames)}};
    if (model.misfit.null_checkerboard > 0.0) json["chi"]["checkerboard"] = model.misfit.checkerboard, json["chi"]["null_checkerboard"] = model.misfit.null_checkerboard;
    for (const auto& one : model.misfit.cameras) json["chi"]["cameras"][experiment.channel_name(one.channel)] = {{"left_out", one.chi}, {"null", one.null}};
    json["omnibus"] = {{"deviations", model.scores.omnibus}, {"threshold", model.scores.omnibus_threshold}, {"p", model.scores.omnibus_p}};
    json["threshold"] = model.scores.threshold, json["largest_p"] = model.scores.largest_p;
    if (model.added.empty()) json["baselines"] = {{"chi_squared_p", model.baselines.chi_squared_p}, {"bic", nlohmann::json::array()}};
    for (int i : model.baselines.bic) json["baselines"]["bic"].push_back(candidate_name(model.others[static_cast<std::size_t>(i)]));
    json["converged"] = model.fit.converged;
    json["iterations"] = model.fit.iterations;
    json["candidates"] = nlohmann::json::array();
    for (std::size_t i = 0; i < model.others.size(); ++i) {
      const auto& s = model.scores.candidates[i];
      nlohmann::json one = {{"name", candidate_name(model.others[i])}, {"link", std::string(name(candidates[static_cast<std::size_t>(model.others[i])].link))}, {"kappa", s.visibility},
                            {"z", s.z}, {"p", s.p}, {"degrees", s.degrees}, {"predicted_drop", s.drop}, {"significant", s.z > model.scores.threshold && !s.contradicted}, {"contradicted", s.contradicted}};
      if (const auto& function = candidates[static_cast<std::size_t>(model.others[i])].formula_for; !function.empty()) one["formula_for"] = function;
      if (!model.baselines.cosine.empty()) one["cosine"] = model.baselines.cosine[i];
      const auto& its = candidates[static_cast<std::size_t>(model.others[i])].parameters;
      const auto sizes = std::count_if(its.begin(), its.end(), [&](int j) { return !parameters[static_cast<std::size_t>(j)].info.shape; });  // the shapes come last
      Eigen::Index other = sizes;
      for (std::size_t c = 0; c < its.size(); ++c) {
        const auto& parameter = parameters[static_cast<std::size_t>(its[c])];
        const auto& info = parameter.info;
        if (info.shape) {
          for (double value : loop::other_shapes(parameter, model.fit.values[static_cast<std::size_t>(its[c])])) {
            if (sizes == 1 && std::isfinite(s.detectable[other])) one["with_other_shapes"].push_back({{"parameter", info.name}, {"value", value}, {"detectable", s.detectable[other]}});
            ++other;
          }
          continue;
        }
        const auto column = static_cast<Eigen::Index>(c);
        nlohmann::json bias;
        for (Eigen::Index j = 0; j < s.bias.rows(); ++j)
          bias[parameters[static_cast<std::size_t>(model.fit.free[static_cast<std::size_t>(j)])].info.name] = s.bias(j, column) * s.detectable[column];
        one["sizes"].push_back({{"parameter", info.name}, {"unit", info.unit}, {"size", s.size[column]}, {"standard_deviation", s.deviation[column]}, {"detectable", s.detectable[column]},
                                {"shift_of_parameters_at_detectable_size", bias}});
      }
      json["candidates"].push_back(one);
    }
    return json;
  };
  nlohmann::json json;
  json["verdict"] = std::string(name(report.verdict));
  json["set"] = names(report.set);
  json["named"] = names(report.named);
  json["sentence"] = report.sentence;
  json["invisible"] = names(report.invisible);
  json["frames"] = experiment.frame_numbers();
  json["held_out"] = nlohmann::json::array();
  for (std::size_t t = 0; t < report.held_out.size(); ++t)
    if (report.held_out[t] != 0) json["held_out"].push_back(experiment.frame_numbers()[t]);
  json["before"] = of_model(report.declared);
  json["after"] = of_model(report.final);
  json["rounds"] = nlohmann::json::array();
  for (const auto& round : report.rounds) {
    nlohmann::json one = {{"set", names(round.set)}, {"trials", nlohmann::json::array()}};
    for (const auto& trial : round.trials) {
      nlohmann::json t = trial.model.fit.values.empty() ? nlohmann::json::object() : of_model(trial.model);
      t["candidate"] = candidate_name(trial.candidate), t["sufficient"] = trial.sufficient, t["plausible"] = trial.plausible, t["objection"] = trial.objection;
      t.erase("candidates");
      one["trials"].push_back(t);
    }
    json["rounds"].push_back(one);
  }
  json["remainder"] = {{"share_of_first_mode", report.remainder.share}, {"time", numbers(report.remainder.time)}};
  return json;
}

namespace {

/// Correlation coefficients of the remainder's curve with what changed during the test.
nlohmann::json companions(const loop::Scene& scene, const Eigen::VectorXd& curve) {
  const auto frames = curve.size();
  const auto before = [](const Eigen::VectorXd& all, Eigen::Index t, double first) { return t == 0 ? first : all[t - 1]; };
  Eigen::VectorXd rate(frames), unloading(frames), plastic = scene.elongation;
  Eigen::Index first_loaded = 0;
  for (Eigen::Index t = 0; t < frames; ++t) {
    const double step = scene.time[t] - before(scene.time, t, scene.start_time);
    rate[t] = step > 0.0 ? (scene.elongation[t] - before(scene.elongation, t, 0.0)) / step : 0.0;
    unloading[t] = std::abs(scene.force[t]) < std::abs(before(scene.force, t, 0.0)) ? 1.0 : 0.0;
    if (std::abs(scene.force[t]) < 0.3 * scene.force.cwiseAbs().maxCoeff()) first_loaded = t;
  }
  if (scene.force[first_loaded] != 0.0) plastic -= scene.force * (scene.elongation[first_loaded] / scene.force[first_loaded]);
  nlohmann::json json = nlohmann::json::object();
  for (const auto& [name, other] : {std::pair<const char*, Eigen::VectorXd>{"clock", scene.time}, {"force", scene.force}, {"elongation", scene.elongation}, {"plastic elongation", plastic},
                                    {"rate of elongation", rate}, {"unloading", unloading}}) {
    const Eigen::VectorXd a = curve.array() - curve.mean(), b = other.array() - other.mean();
    if (frames > 2 && b.norm() > 1e-9 * (1e-300 + other.norm())) json[name] = a.dot(b) / std::max(1e-300, a.norm() * b.norm());
  }
  return json;
}

}  // namespace

void write_loop_report(const std::filesystem::path& folder, const io::Case& test, const loop::FieldExperiment& experiment, const loop::Report& report,
                       const LoopFields& fields, const nlohmann::json& light, const GroupTimes& groups, double seconds) {
  nlohmann::json json = loop_summary(experiment, report);
  json["time"] = io::quantity(seconds, "s");
  json["simulations"] = experiment.simulations();
  json["groups"] = to_json(groups);
  if (!test.doubts.empty()) json["doubts"] = test.doubts;
  if (!light.is_null()) json["light"] = light;
  if (!light.is_null() && light["verdict"] != "nothing found") json["sentence"] = fmt::format("{} The light: {}", report.sentence, light["sentence"].get<std::string>());
  if (std::isfinite(experiment.measured().force_noise)) json["force_residual"] = {{"before", numbers(fields.force_before)}, {"after", numbers(fields.force_after)}, {"unit", test.units.force}};
  if (report.remainder.time.size() > 0) json["remainder"]["goes_with"] = companions(experiment.scene(), report.remainder.time);
  const Eigen::MatrixXd& map = report.remainder.map;
  if (map.size() > 0) {
    Eigen::Index node = 0, frame = 0;
    const double largest = map.maxCoeff(&node, &frame);
    Eigen::Index own = node;
    const auto* face = experiment.measured().faces.data();
    for (; own >= face->surface.nodes.rows(); ++face) own -= face->surface.nodes.rows();
    const auto& at = face->surface.nodes;
    json["remainder"]["map"] = {{"largest", largest}, {"limit", report.remainder.limit}, {"frame", experiment.measured().frames[static_cast<std::size_t>(frame)]}, {"place", {at(own, 0), at(own, 1)}},
                                {"share_beyond_limit", (map.array() > report.remainder.limit).cast<double>().mean()}};
    if (experiment.measured().faces.size() > 1) json["remainder"]["map"]["face"] = face->name;
  }
  json.update(io::case_summary(write_loop_fields(folder, test, experiment, report, fields)));
  // Residual fields of the worst frame, before and after, on one scale.
  Eigen::Index worst = 0;
  report.declared.misfit.frames.maxCoeff(&worst);
  const auto& measured = experiment.measured();
  const int axis = experiment.scene().axis;
  std::vector<io::ReportPicture> pictures;
  Eigen::Index first = 0, first_node = 0;
  for (const auto& face : measured.faces) {
    const bool alone = measured.faces.size() == 1;
    const std::string file = alone ? "" : "_" + face.name, where = alone ? "" : face.name + " face; ";
    const double scale = std::sqrt(std::abs(face.pixels.determinant()));
    const auto nodes = face.surface.nodes.rows();
    std::vector<double> positions;
    for (Eigen::Index i = 0; i < nodes; ++i) {
      const Eigen::Vector2d at = face.pixels * face.surface.nodes.row(i).head<2>().transpose();
      positions.insert(positions.end(), {at[0], at[1]});
    }
    const auto field = [&](const Eigen::MatrixXd& all) {
      std::vector<double> values;
      for (Eigen::Index i = 0; i < nodes; ++i) values.push_back(scale * all(first + face.components * i + axis, worst));
      return values;
    };
    double largest = 0.0;
    for (double value : field(fields.displacement_before)) largest = std::max(largest, std::abs(value));
    for (const auto& [name, all] : {std::pair("before", &fields.displacement_before), std::pair("after", &fields.displacement_after)}) {
      const auto picture = folder / fmt::format("residual_{}{}.png", name, file);
      io::draw_field(picture, face.surface, positions, field(*all), {.legend = "measured - predicted [px]", .lower = -largest, .upper = largest});
      pictures.push_back({picture, fmt::format("{}displacement along the load, measured − predicted, {}; frame {}", where, name, measured.frames[static_cast<std::size_t>(worst)])});
    }
    if (map.size() > 0) {
      Eigen::Index node = 0, frame = 0;
      const Eigen::MatrixXd own = map.middleRows(first_node, nodes);
      own.maxCoeff(&node, &frame);
      const std::vector<double> of_frame(own.col(frame).begin(), own.col(frame).end());
      const auto picture = folder / fmt::format("remainder{}.png", file);
      io::draw_field(picture, face.surface, positions, of_frame, {.legend = "remainder [rms of the noise]", .lower = 0.0, .upper = std::max(own.maxCoeff(), report.remainder.limit), .diverging = false});
      pictures.push_back({picture, fmt::format("{}what the final model leaves, over what noise leaves (one null test of a hundred exceeds {:.1f} somewhere); frame {}", where, report.remainder.limit,
                                               measured.frames[static_cast<std::size_t>(frame)])});
    }
    first += face.unknowns(), first_node += nodes;
  }
  for (const auto& picture : pictures) json["pictures"].push_back({{"file", picture.file.filename().string()}, {"caption", picture.caption}});
  io::write_json(folder / "result.json", json);
  io::write_loop_page(folder / "report.html", json, pictures);
  fmt::print("\n{}\n  {}: {}\n", test.title, name(report.verdict), report.sentence);
  if (!light.is_null()) fmt::print("  light: {}: {}\n", light["verdict"].get<std::string>(), light["sentence"].get<std::string>());
  fmt::print("  {:.0f} s, {} simulations; {}\n", seconds, experiment.simulations(), (folder / "report.html").string());
}

}  // namespace imic3d::app
