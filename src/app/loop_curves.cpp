// imic3d loop on the stress-strain curves of bars.

#include <fmt/format.h>

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
#include "loop_results.hpp"
#include "loop_summary.hpp"
#include "loop_test.hpp"
#include "test_effects.hpp"

namespace imic3d::app {

namespace {

std::vector<LoopCurve> curves_of(const loop::CurveExperiment& experiment, const loop::Report& report) {
  const auto before = experiment.predict(report.declared.fit.values),
             after = experiment.predict(report.final.fit.values);
  std::vector<LoopCurve> curves;
  for (std::size_t k = 0; k < experiment.curves().size(); ++k) {
    const auto& curve = experiment.curves()[k];
    curves.push_back({curve.name, curve.group, false, curve.history.strain, curve.stress, before[k], after[k]});
  }
  for (std::size_t t = 0; t < report.held_out.size(); ++t)
    if (report.held_out[t] != 0)
      curves[static_cast<std::size_t>(experiment.curve_of(static_cast<int>(t)))].held_out =
          true;  // as a whole, if it is not cut into pieces
  return curves;
}

/// Measured and predicted of every bar, and per group the rms of measured - predicted on fitted and held-out rows.
void add_curves(nlohmann::json& json, const io::Case& test, const loop::CurveExperiment& experiment,
                const std::vector<LoopCurve>& curves) {
  const auto list = [](const Eigen::VectorXd& values) { return std::vector<double>(values.begin(), values.end()); };
  struct Sums {
    double before = 0.0, after = 0.0;
    Eigen::Index rows = 0;
  };
  std::vector<std::string> order;
  std::map<std::string, std::array<Sums, 2>> sums;
  for (std::size_t k = 0; k < curves.size(); ++k) {
    const auto& curve = experiment.curves()[k];
    const LoopCurve& one = curves[k];
    json["curves"].push_back({{"name", one.name},
                              {"group", one.group},
                              {"held_out", one.held_out},
                              {"noise", experiment.bin_noise(static_cast<int>(k))},
                              {"strain", list(one.strain)},
                              {"measured", list(one.measured)},
                              {"before", list(one.before)},
                              {"after", list(one.after)}});
    if (!sums.contains(curve.group)) order.push_back(curve.group);
    for (Eigen::Index row = 0; row < curve.stress.size(); ++row) {
      const auto use = curve.use[static_cast<std::size_t>(row)];
      if (use == identification::Curve::not_judged) continue;
      auto& sum = sums[curve.group][use == identification::Curve::held_out ||
                                            (one.held_out && !experiment.cut_into_pieces(static_cast<int>(k)))
                                        ? 1
                                        : 0];
      sum.before += std::pow(one.measured[row] - one.before[row], 2),
          sum.after += std::pow(one.measured[row] - one.after[row], 2);
      ++sum.rows;
    }
  }
  for (const auto& group : order)
    for (int h = 0; h < 2; ++h)
      if (const auto& one = sums[group][static_cast<std::size_t>(h)]; one.rows > 0)
        json["groups"].push_back({{"name", group},
                                  {"held_out", h == 1},
                                  {"rows", one.rows},
                                  {"before", std::sqrt(one.before / static_cast<double>(one.rows))},
                                  {"after", std::sqrt(one.after / static_cast<double>(one.rows))},
                                  {"unit", io::stress_unit(test.units)}});
}

class CurveTest final : public LoopTest {
 public:
  CurveTest(const Communicator& world, const io::Case& test, Aim aim, loop::CurveModel model)
      : world_(world), test_(test), aim_(aim), experiment_(world, make_curves(test), std::move(model)) {
    doubts_ = doubts_of_curves(test, experiment_.curves());
    spdlog::info("{}: {} curves, {} numbers, {} candidates", test.title, experiment_.curves().size(),
                 experiment_.data().size(), experiment_.candidates().size());
  }
  loop::Experiment& experiment() override { return experiment_; }
  std::vector<int> held_out() const override {
    return aim_ == Aim::identify ? experiment_.declared_held_out() : experiment_.held_out();
  }
  int simulations() const override { return experiment_.simulations(); }
  void write(const std::filesystem::path& folder, const loop::Report& report, double seconds) override {
    collectively(world_, [&] {
      if (world_.is_root()) write_as_root(folder, report, seconds);
    });
  }

 private:
  void write_as_root(const std::filesystem::path& folder, const loop::Report& report, double seconds) const {
    nlohmann::json json = loop_summary(experiment_, report);
    const auto curves = curves_of(experiment_, report);
    json["time"] = io::quantity(seconds, "s");
    json["simulations"] = experiment_.simulations();
    json["frame_names"] = nlohmann::json::array();
    for (int frame : experiment_.frame_numbers()) json["frame_names"].push_back(experiment_.frame_name(frame));
    add_curves(json, test_, experiment_, curves);
    if (!doubts_.empty()) json["doubts"] = doubts_;
    json.update(io::case_summary(write_loop_curves(folder, test_, experiment_, report, curves)));
    io::write_json(folder / "result.json", json);
    io::write_loop_page(folder / "report.html", json, {});
    fmt::print("\n{}\n  {}\n", test_.title, answer(report, report.sentence));
    for (const auto& group : json["groups"])
      fmt::print("    {:28} {:9} rms {}{:7.4g} {}\n", group["name"].get<std::string>(),
                 group["held_out"].get<bool>() ? "held out" : "fitted",
                 report.searched ? fmt::format("{:7.4g} -> ", group["before"].get<double>()) : "",
                 group["after"].get<double>(), group["unit"].get<std::string>());
    fmt::print("  {:.0f} s, {} simulations; {}\n", seconds, experiment_.simulations(),
               (folder / "report.html").string());
  }

  const Communicator& world_;
  const io::Case& test_;
  Aim aim_;
  loop::CurveExperiment experiment_;
  std::vector<std::string> doubts_;
};

}  // namespace

std::unique_ptr<LoopTest> make_curve_test(const Communicator& world, const io::Case& test, Aim aim) {
  if (!test.cameras.empty())
    throw InputError("experiments", "given beside cameras",
                     "images or experiments, each in a case of its own (both at once: tests)");
  const ExtendedMaterial material = make_extended_material(test);
  auto declared = declared_effects(test);
  for (auto& light : declared_effects(test, true))
    declared.push_back(std::move(light));  // refused, as all that does not act on bars
  loop::CurveModel model{[&test](const std::vector<std::string>& effects) { return extended_law(test, effects); },
                         material.information,
                         material.values,
                         std::vector<double>(material.values.size(), 0.0),
                         material.declared,
                         std::vector<char>(material.values.size(), 0),
                         std::move(declared),
                         [&test](std::string word) { return unit_in(std::move(word), test.units); }};
  for (const auto& stage : test.identify.stages)
    for (const auto& name : stage.free) model.free[static_cast<std::size_t>(material.index(name))] = 1;
  for (const auto& [name, deviation] : test.loop.prior)
    model.priors[static_cast<std::size_t>(material.index(name))] = deviation;
  return std::make_unique<CurveTest>(world, test, aim, std::move(model));
}

}  // namespace imic3d::app
