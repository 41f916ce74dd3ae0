// imic3d effects: the effects that the loop knows and virtual tests can have.

#include <fmt/format.h>

#include "imic3d/app/program.hpp"
#include "imic3d/loop/law_effects.hpp"
#include "imic3d/material/finite_strain_law.hpp"
#include "test_effects.hpp"

namespace imic3d::app {

namespace {

std::string null_of(double value, bool shape) { return fmt::format("{} {:<4g}", shape ? "usual" : "null", value); }

void print_quantity(const std::string& name, const std::string& null, const std::string& unit,
                    const std::string& description) {
  fmt::print("    {:24} {} [{}]  {}\n", name, null, unit, description);
}

void print_confusion(const std::string& confused_with, const std::string& separated_by) {
  if (!confused_with.empty()) fmt::print("    confused with {}; told apart by {}\n", confused_with, separated_by);
}

void print_effect(const loop::Effect& effect, const io::Units& units) {
  const auto description = effect.describe(unit_scene());
  fmt::print("{} ({}): {}\n", loop::key_of(description.name), name(description.link), description.sentence);
  for (const auto& q : description.quantities)
    print_quantity(q.name, null_of(q.null, q.shape), unit_in(q.unit, units), q.description);
  print_confusion(description.confused_with, description.separated_by);
  if (effect.of_each_camera())
    fmt::print("    with cameras on both faces: front_{0}, back_{0}\n", loop::key_of(description.name));
  if (effect.of_each_group())
    fmt::print("    of one of several groups of stress-strain curves: {}\n",
               loop::key_of(loop::in_group(description.name, "GROUP")));
  if (effect.of_one_of_several() && description.link == loop::Link::light)
    fmt::print("    with several cameras: NAME_{0} for each by its name\n", loop::key_of(description.name));
  else if (effect.of_one_of_several())
    fmt::print("    with several cameras on a face, one of them a perspective one: NAME_{0} for each by its name\n",
               loop::key_of(description.name));
}

void print_effects_of_law(const io::Units& units) {
  const auto law = material::make_law({.law = "j2", .hardening = "linear", .effects = material::known_effects()});
  const auto& parameters = law->parameters();
  for (const auto& candidate : loop::law_candidates(parameters, std::vector<char>(parameters.size(), 0))) {
    fmt::print("{} (material, declared in material.effects): {}\n", candidate.name, candidate.sentence);
    for (int j : candidate.parameters) {
      const ParameterInfo& info = parameters[static_cast<std::size_t>(j)];
      print_quantity(info.name, null_of(info.null_value.value_or(0.0), info.shape), unit_in(info.unit, units),
                     info.description);
    }
    print_confusion(candidate.confused_with, candidate.separated_by);
    if (!candidate.formula_for.empty())
      fmt::print("    one formula for {}, of which a test shows the course\n", candidate.formula_for);
  }
  for (const auto& info : parameters) {
    if (info.name != "nu") continue;
    const auto candidate = loop::poissons_ratio(0);
    fmt::print("{} (material, where nu is not free): {}\n", candidate.name, candidate.sentence);
    print_quantity(info.name, "null as declared", unit_in(info.unit, units), info.description);
    print_confusion(candidate.confused_with, candidate.separated_by);
  }
}

}  // namespace

void effects(const Communicator& world, const CommandOptions& options) {
  const io::Units units = options.case_file.empty() ? io::Units{.length = "length", .force = "force", .time = "time"}
                                                    : read_case(options, {}, false).units;
  if (!world.is_root()) return;
  for (const auto& effect : loop::all_effects()) print_effect(*effect, units);
  print_effects_of_law(units);
}

}  // namespace imic3d::app
