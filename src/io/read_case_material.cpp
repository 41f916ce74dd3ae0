// The material of a case file and the experiments on bars.

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <stdexcept>
#include <tuple>

#include "case_reader.hpp"
#include "units.hpp"

namespace imic3d::io {

void CaseReader::read_material() {
  if (!root_.has("material")) return;
  const auto section = root_.group("material");
  auto& material = case_.material;
  section.get("law", material.law);
  section.get("hardening", material.hardening);
  section.get("tie_initial_modulus", material.tie_initial_modulus);
  section.get("yield_stress", material.yield_stress);
  section.get("table_strain", material.table_strain);
  section.get("effects", material.effects);
  const auto parameters = section.group("parameters");
  for (const auto& [name, value] : parameters.json().items()) {
    ParameterCase parameter;
    if (value.is_number()) parameter.value = value;
    if (value.is_object()) {
      const auto details = parameters.group(name);
      details.get("value", parameter.value);
      details.get("lower", parameter.lower);
      details.get("upper", parameter.upper);
    }
    material.parameters[name] = parameter;
  }
  check_table(section);
  const bool is_known = !is_refused(section.path("law")) && !is_refused(section.path("hardening")) &&
                        !is_refused(section.path("effects"));
  if (checks_.parameters_of && is_known) check_parameters(parameters);
  for (const auto& [name, parameter] : material.parameters) check_bounds(parameters.path(name), parameter);
  doubt_units();
}

/// What no solid has: a unit that is another one.
void CaseReader::doubt_units() {
  constexpr double softest = 1e6, stiffest = 2e12, most = 0.5;  // [Pa]; of the strain at which it yields
  const auto E = case_.material.parameters.find("E"), S_y = case_.material.parameters.find("S_y");
  if (E == case_.material.parameters.end()) return;
  const std::string unit = stress_unit(case_.units);
  const double in_pascals = E->second.value * newtons(case_.units.force) / std::pow(metres(case_.units.length), 2);
  if (!(in_pascals >= softest && in_pascals <= stiffest))
    case_.doubts.push_back(
        fmt::format("material.parameters.E: {:.4g} {}, {}: are length and force in {} and {} (units), and E in {}?",
                    E->second.value, unit, in_pascals < softest ? "softer than rubber" : "stiffer than diamond",
                    case_.units.length, case_.units.force, unit));
  else if (S_y != case_.material.parameters.end() && S_y->second.value > most * E->second.value)
    case_.doubts.push_back(fmt::format(
        "material.parameters.S_y: {:.4g} where E is {:.4g}: it would yield at a strain of {:.2g}; are both in {}?",
        S_y->second.value, E->second.value, S_y->second.value / E->second.value, unit));
}

void CaseReader::check_table(const Section& section) {
  const auto& strain = case_.material.table_strain;
  const bool tabulated = case_.material.hardening == "table";
  if (tabulated != section.has("table_strain")) {
    mistake(section.path("table_strain"), tabulated ? "not given" : "given without hardening: table",
            tabulated ? "a list of ascending plastic strains, from 0" : "only with hardening: table");
  } else if (tabulated && !strain.empty() &&
             (strain.front() != 0.0 ||
              std::adjacent_find(strain.begin(), strain.end(), std::greater_equal<>()) != strain.end())) {
    mistake(section.path("table_strain"), fmt::format("{}", fmt::join(strain, ", ")),
            "a list of ascending plastic strains, from 0");
  }
}

void CaseReader::doubt_bound(const ParameterInfo& info, const char* which, double declared, double own) {
  case_.doubts.push_back(fmt::format("material.parameters.{}: {} {} lies beyond the law's own bound, {}, which holds",
                                     info.name, which, declared, own));
}

void CaseReader::check_parameters(const Section& section) {
  std::vector<ParameterInfo> infos;
  try {
    infos = checks_.parameters_of(case_.material);
  } catch (const InputError& error) {
    for (const auto& one : error.mistakes()) mistake(one.place, one.found, one.allowed);  // its place is a key
    return;
  }
  auto& names = parameters_of_law_;
  for (const auto& info : infos) names.push_back(info.name);
  for (const auto& info : infos) {
    const auto found = case_.material.parameters.find(info.name);
    if (found == case_.material.parameters.end() && info.null_value) {
      case_.material.parameters[info.name].value = *info.null_value;
    } else if (found == case_.material.parameters.end()) {
      mistake(section.path(info.name), "not given", range_of(info));
    } else if (found->second.value < info.lower || found->second.value > info.upper) {
      mistake(section.path(info.name), fmt::format("{}", found->second.value), range_of(info));
    } else {
      if (found->second.lower && *found->second.lower < info.lower)
        doubt_bound(info, "lower", *found->second.lower, info.lower);
      if (found->second.upper && *found->second.upper > info.upper)
        doubt_bound(info, "upper", *found->second.upper, info.upper);
    }
  }
  for (const auto& [name, parameter] : case_.material.parameters) {
    if (std::find(names.begin(), names.end(), name) != names.end()) continue;
    const auto near = nearest(name, names);
    mistake(section.path(name),
            near.empty() ? "not a parameter of this material" : "not a parameter of this material, near to " + near,
            fmt::format("{}", fmt::join(names, ", ")));
  }
}

void CaseReader::check_bounds(const std::string& path, const ParameterCase& parameter) {
  if (parameter.lower && parameter.upper && !(*parameter.lower < *parameter.upper)) {
    mistake(path, fmt::format("lower {}, upper {}", *parameter.lower, *parameter.upper), "lower below upper");
  } else if ((parameter.lower && parameter.value < *parameter.lower) ||
             (parameter.upper && parameter.value > *parameter.upper)) {
    mistake(
        path, fmt::format("value {}", parameter.value),
        fmt::format("a value between its bounds{}{}", parameter.lower ? fmt::format(", from {}", *parameter.lower) : "",
                    parameter.upper ? fmt::format(", up to {}", *parameter.upper) : ""));
  }
}

void CaseReader::read_experiments() {
  for (const auto& section : root_.list("experiments")) {
    auto& experiment = case_.experiments.emplace_back();
    section.get("name", experiment.name);
    section.get("strain", experiment.columns.strain);
    section.get("stress", experiment.columns.stress);
    section.get("time", experiment.columns.time);
    section.get("noise", experiment.noise);
    section.get("rate", experiment.rate);
    section.get("direction", experiment.direction);
    section.get("from", experiment.from);
    section.get("monotonic", experiment.monotonic);
    section.get("held_out", experiment.held_out);
    std::string strain_kind = "engineering", stress_kind = strain_kind, until = "end", unit = stress_unit(case_.units);
    section.get("strain_kind", strain_kind);
    section.get("stress_kind", stress_kind);
    section.get("until", until);
    section.get("stress_unit", unit);
    std::string force_unit = case_.units.force, extension_unit = case_.units.length;
    section.get("force", experiment.columns.stress);
    section.get("force_unit", force_unit);
    section.get("extension", experiment.columns.strain);
    section.get("extension_unit", extension_unit);
    const bool force = section.has("force"), extension = section.has("extension");
    const auto belong = [&](bool given, const char* column, const char* by, std::initializer_list<const char*> without,
                            std::initializer_list<const char*> with) {
      if (given && !section.has(by))
        mistake(section.path(by), "not given", fmt::format("what the {} is divided by", column));
      for (const char* key : without)
        if (given && section.has(key))
          mistake(section.path(key), fmt::format("given beside {}", column), "one of the two");
      for (const char* key : with)
        if (!given && section.has(key))
          mistake(section.path(key), fmt::format("given without {}", column), "only with it");
    };
    belong(force, "force", "section", {"stress", "stress_unit", "stress_kind"}, {"section", "force_unit"});
    belong(extension, "extension", "gauge_length", {"strain", "strain_kind"}, {"gauge_length", "extension_unit"});
    experiment.engineering_strain = strain_kind == "engineering";
    experiment.engineering_stress = stress_kind == "engineering";
    experiment.until_maximum = until == "maximum_force";
    experiment.stress_scale =
        force ? newtons(force_unit) / newtons(case_.units.force) : pascals(unit) / pascals(stress_unit(case_.units));
    section.get("stress_scale", experiment.stress_scale);
    experiment.strain_scale = extension ? metres(extension_unit) / metres(case_.units.length) : 1.0;
    section.get("strain_scale", experiment.strain_scale);
    section.get("time_scale", experiment.time_scale);
    if (section.has("time_scale") && !section.has("time"))
      mistake(section.path("time_scale"), "given without time", "only with it");
    for (const auto& [scale, key] :
         {std::pair("stress_scale", force ? "force_unit" : "stress_unit"), std::pair("strain_scale", "extension_unit")})
      if (section.has(scale) && section.has(key))
        mistake(section.path(scale), fmt::format("given beside {}", key), "one of the two");
    const auto& columns = experiment.columns;
    for (const auto& [one, key, other, its_key] :
         {std::tuple(columns.strain, extension ? "extension" : "strain", columns.stress, force ? "force" : "stress"),
          {columns.time, "time", columns.stress, force ? "force" : "stress"},
          {columns.time, "time", columns.strain, extension ? "extension" : "strain"}})
      if (one == other)
        mistake(section.path(its_key), fmt::format("{}, which is {}, too", other, key), "another column for each");
    if (!experiment.columns.time.empty() && experiment.rate)
      mistake(section.path("rate"), "given beside time", "one of the two");
    if (!experiment.name.empty() && std::any_of(case_.experiments.begin(), case_.experiments.end() - 1,
                                                [&](const auto& other) { return other.name == experiment.name; }))
      mistake(section.path("name"), experiment.name, "a name that no other experiment has");
    read_curves(section, experiment);
    if (section.has("held_out") && section.value("held_out").is_string()) {
      Frames rows;
      Eigen::Index longest = 0;
      for (const auto& table : experiment.tables) longest = std::max(longest, table.strain.size());
      for (int row = 0; row < longest; ++row) rows.push_back(row);
      experiment.held_out_rows = frames_of(section, "held_out", rows, "row");
    }
  }
}

void CaseReader::read_curves(const Section& section, ExperimentCase& experiment) {
  bool all_read = true;
  for (const auto& file : files_of(section, "file")) {
    if (std::find(experiment.files.begin(), experiment.files.end(), file) != experiment.files.end()) continue;
    try {
      experiment.tables.push_back(read_curve(file, experiment.columns));
      experiment.files.push_back(file);
    } catch (const InputError& error) {
      for (const auto& one : error.mistakes()) mistakes_.push_back({document_.line(section.path("file")), one});
      all_read = false;
    }
  }
  // A force over the bar's section is an engineering stress, an extension over the gauge length a strain.
  const auto divided = [&](const char* key, Eigen::VectorXd CurveTable::*column) {
    if (!section.has(key) || !all_read || experiment.tables.empty()) return;
    double all = 0.0;
    std::vector<double> each;
    section.get(key, all), section.get(key, each);
    if (each.empty()) each.assign(experiment.tables.size(), all);
    if (each.size() != experiment.tables.size())
      return mistake(section.path(key), fmt::format("{} numbers", each.size()),
                     fmt::format("one, or one for each of the {} files", experiment.tables.size()));
    for (std::size_t k = 0; k < experiment.tables.size(); ++k)
      if (each[k] > 0.0) experiment.tables[k].*column /= each[k];
  };
  divided("section", &CurveTable::stress);
  divided("gauge_length", &CurveTable::strain);
}

}  // namespace imic3d::io
