// imic3d effects: the effects that the loop knows and virtual tests can have.

#include <fmt/format.h>

#include "imic3d/app/program.hpp"
#include "imic3d/loop/law_effects.hpp"
#include "imic3d/material/finite_strain_law.hpp"
#include "test_effects.hpp"

namespace imic3d::app {

void effects(const Communicator& world, const CommandOptions& options) {
  const io::Units units =
      options.case_file.empty() ? io::Units{.length = "length", .force = "force", .time = "time"} : read_case(options, {}, false).units;
  if (!world.is_root()) return;
  for (const auto& effect : loop::all_effects()) {
    const auto description = effect->describe(unit_scene());
    fmt::print("{} ({}): {}\n", loop::key_of(description.name), name(description.link), description.sentence);
    for (const auto& q : description.quantities)
      fmt::print("    {:24} null {:<4g} [{}]  {}\n", q.name, q.null, unit_in(q.unit, units), q.description);
    if (!description.confused_with.empty())
      fmt::print("    confused with {}; told apart by {}\n", description.confused_with, description.separated_by);
    if (effect->of_each_camera()) fmt::print("    with cameras on both faces: front_{0}, back_{0}\n", loop::key_of(description.name));
  }
  const auto law = material::make_law({.law = "j2", .hardening = "linear", .effects = material::known_effects()});
  const auto& parameters = law->parameters();
  for (const auto& candidate : loop::law_candidates(parameters, std::vector<char>(parameters.size(), 0))) {
    fmt::print("{} (material, declared in material.effects): {}\n", candidate.name, candidate.sentence);
    for (int j : candidate.parameters) {
      const ParameterInfo& info = parameters[static_cast<std::size_t>(j)];
      fmt::print("    {:24} {} {:<4g} [{}]  {}\n", info.name, info.shape ? "usual" : "null", info.null_value.value_or(0.0), unit_in(info.unit, units), info.description);
    }
    fmt::print("    confused with {}; told apart by {}\n", candidate.confused_with, candidate.separated_by);
    if (!candidate.formula_for.empty()) fmt::print("    one formula for {}, of which a test shows the course\n", candidate.formula_for);
  }
  fmt::print("Poisson's ratio, where it is not free, is a candidate too; of stress-strain curves the gain of each group of bars.\n");
}

}  // namespace imic3d::app
