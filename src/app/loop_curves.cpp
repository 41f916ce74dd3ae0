#include "loop_curves.hpp"

#include <fmt/format.h>

#include <chrono>
#include <cmath>
#include <map>

#include "curves.hpp"
#include "imic3d/app/output.hpp"
#include "imic3d/app/setup.hpp"
#include "imic3d/core/log.hpp"
#include "imic3d/io/loop_page.hpp"
#include "imic3d/io/run_results.hpp"
#include "imic3d/loop/closing.hpp"
#include "imic3d/loop/curve_experiment.hpp"
#include "loop_report.hpp"

namespace imic3d::app {

namespace {

/// Measured and predicted of every bar, and per group the rms of measured - predicted on fitted and held-out rows.
void add_curves(nlohmann::json& json, const io::Case& test, const loop::CurveExperiment& experiment, const loop::Report& report, const std::vector<int>& held_frames) {
  const auto before = experiment.predict(report.declared.fit.values), after = experiment.predict(report.final.fit.values);
  const auto list = [](const Eigen::VectorXd& values) { return std::vector<double>(values.begin(), values.end()); };
  std::vector<char> held(experiment.curves().size(), 0);  // bars that are held out as a whole
  for (int frame : held_frames) held[static_cast<std::size_t>(experiment.curve_of(frame))] = 1;
  struct Sums { double before = 0.0, after = 0.0; Eigen::Index rows = 0; };
  std::vector<std::string> order;
  std::map<std::string, std::array<Sums, 2>> sums;
  for (std::size_t k = 0; k < experiment.curves().size(); ++k) {
    const auto& curve = experiment.curves()[k];
    json["curves"].push_back({{"name", curve.name}, {"group", curve.group}, {"held_out", held[k] != 0}, {"noise", experiment.bin_noise(static_cast<int>(k))}, {"strain", list(curve.history.strain)}, {"measured", list(curve.stress)},
                              {"before", list(before[k])}, {"after", list(after[k])}});
    if (!sums.contains(curve.group)) order.push_back(curve.group);
    for (Eigen::Index row = 0; row < curve.stress.size(); ++row) {
      const auto use = curve.use[static_cast<std::size_t>(row)];
      if (use == identification::Curve::not_judged) continue;
      auto& one = sums[curve.group][use == identification::Curve::held_out || (held[k] != 0 && !experiment.cut_into_pieces(static_cast<int>(k))) ? 1 : 0];
      one.before += std::pow(curve.stress[row] - before[k][row], 2), one.after += std::pow(curve.stress[row] - after[k][row], 2);
      ++one.rows;
    }
  }
  for (const auto& group : order)
    for (int h = 0; h < 2; ++h)
      if (const auto& one = sums[group][static_cast<std::size_t>(h)]; one.rows > 0)
        json["groups"].push_back({{"name", group}, {"held_out", h == 1}, {"rows", one.rows}, {"before", std::sqrt(one.before / static_cast<double>(one.rows))},
                                  {"after", std::sqrt(one.after / static_cast<double>(one.rows))}, {"unit", io::stress_unit(test.units)}});
}

}  // namespace

void loop_on_curves(const Communicator& world, const CommandOptions& options, const io::Case& test) {
  const auto start = std::chrono::steady_clock::now();
  const auto seconds = [&] { return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count(); };
  if (!test.cameras.empty()) throw InputError("experiments", "given beside cameras", "images or experiments, each in a case of its own");
  const ExtendedMaterial material = make_extended_material(test);
  loop::CurveModel model{[&test](const std::vector<std::string>& effects) { return extended_law(test, effects); }, material.information, material.values, std::vector<double>(material.values.size(), 0.0), material.declared,
                         std::vector<char>(material.values.size(), 0), [&test](std::string word) { return unit_in(std::move(word), test.units); }};
  for (const auto& stage : test.identify.stages)
    for (const auto& name : stage.free) model.free[static_cast<std::size_t>(material.index(name))] = 1;
  for (const auto& [name, deviation] : test.loop.prior) model.priors[static_cast<std::size_t>(material.index(name))] = deviation;
  loop::CurveExperiment experiment(world, make_curves(test), std::move(model));
  const auto folder = output_folder(test, options, world);
  spdlog::info("{}: {} curves, {} numbers, {} candidates", test.title, experiment.curves().size(), experiment.data().size(), experiment.candidates().size());
  const loop::LoopOptions how{.draws = test.loop.draws, .additions = test.loop.additions, .rivals = test.loop.rivals, .starts = test.loop.starts, .held_out = experiment.held_out()};
  const auto report = loop::close_loop(experiment, how, [&](const std::string& line) { spdlog::info("{:6.0f} s  {}", seconds(), line); });
  collectively(world, [&] {
    if (!world.is_root()) return;
    nlohmann::json json = loop_summary(experiment, report);
    std::vector<int> held;
    for (std::size_t t = 0; t < report.held_out.size(); ++t)
      if (report.held_out[t] != 0) held.push_back(static_cast<int>(t));
    json["title"] = test.title;
    json["time"] = io::quantity(seconds(), "s");
    json["simulations"] = experiment.simulations();
    json["frame_names"] = nlohmann::json::array();
    for (int frame : experiment.frame_numbers()) json["frame_names"].push_back(experiment.frame_name(frame));
    add_curves(json, test, experiment, report, held);
    io::write_json(folder / "result.json", json);
    io::write_loop_page(folder / "report.html", json, {});
    fmt::print("\n{}\n  {}: {}\n", test.title, name(report.verdict), report.sentence);
    for (const auto& group : json["groups"])
      fmt::print("    {:28} {:9} rms {:7.4g} -> {:7.4g} {}\n", group["name"].get<std::string>(), group["held_out"].get<bool>() ? "held out" : "fitted", group["before"].get<double>(), group["after"].get<double>(),
                 group["unit"].get<std::string>());
    fmt::print("  {:.0f} s, {} simulations; {}\n", seconds(), experiment.simulations(), (folder / "report.html").string());
  });
}

}  // namespace imic3d::app
