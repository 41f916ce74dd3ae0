// The laws and hardenings by the names that the case file uses.

#include <algorithm>
#include <cmath>
#include <utility>

#include "imic3d/core/error.hpp"
#include "imic3d/material/elastic.hpp"
#include "imic3d/material/extended_j2.hpp"
#include "imic3d/material/finite_strain_law.hpp"
#include "imic3d/material/hardening.hpp"
#include "imic3d/material/j2.hpp"
#include "imic3d/material/log_strain_law.hpp"
#include "imic3d/material/plane_stress.hpp"

namespace imic3d::material {
namespace {

using LawPointer = std::shared_ptr<const FiniteStrainLaw>;

template <SmallStrainLaw Law>
LawPointer finite_strain(const LawChoice& choice, Law law) {
  if (choice.plane_stress) return std::make_shared<LogStrainLaw<PlaneStress<Law>>>(PlaneStress<Law>{std::move(law)});
  return std::make_shared<LogStrainLaw<Law>>(std::move(law));
}

effects::Selection selected(const LawChoice& choice) {
  effects::Selection selection;
  std::string allowed;
  for (const auto& effect : effects::list) allowed += (allowed.empty() ? "" : ", ") + std::string(effect.name);
  for (const auto& name : choice.effects) {
    const auto found = std::find_if(effects::list.begin(), effects::list.end(),
                                    [&](const auto& effect) { return name == effect.name; });
    if (found == effects::list.end()) throw InputError("material.effects", name, allowed);
    const auto effect = static_cast<effects::Effect>(found - effects::list.begin());
    if (selection.has(effect)) throw InputError("material.effects", name + " twice", "each effect once");
    selection.add(effect);
  }
  return selection;
}

template <class Hardening>
LawPointer j2(const LawChoice& choice, Hardening hardening) {
  if (!choice.effects.empty()) {
    std::string name = "j2 " + choice.hardening;
    for (const auto& effect : choice.effects) name += " + " + effect;
    return finite_strain(choice,
                         ExtendedJ2<Hardening>{std::move(hardening), name, choice.cauchy_yield, selected(choice)});
  }
  return finite_strain(choice, J2<Hardening>{std::move(hardening), "j2 " + choice.hardening, choice.cauchy_yield});
}

Table checked_table(const LawChoice& choice) {
  const auto& strain = choice.table_strain;
  const std::string place = "material.table_strain";
  constexpr int most = 40;  // with every effect still fewer than max_parameters
  const std::string allowed =
      "2 to " + std::to_string(most) + " accumulated plastic strains [-], the first 0, each greater than the last";
  if (strain.size() < 2 || strain.size() > most)
    throw InputError(place, std::to_string(strain.size()) + " values", allowed);
  if (strain.front() != 0.0) throw InputError(place, std::to_string(strain.front()) + " first", allowed);
  for (std::size_t i = 1; i < strain.size(); ++i)
    if (!(strain[i] > strain[i - 1]) || !std::isfinite(strain[i]))
      throw InputError(place, std::to_string(strain[i]) + " after " + std::to_string(strain[i - 1]), allowed);
  return {strain};
}

struct Entry {
  const char* name;
  LawPointer (*make)(const LawChoice&);
};

// A new isotropic hardening law is a struct in hardening.hpp and one line here.
constexpr Entry hardenings[] = {
    {"power_linear",
     [](const LawChoice& c) { return c.tie_initial_modulus ? j2(c, PowerLinearTied{}) : j2(c, PowerLinear{}); }},
    {"linear", [](const LawChoice& c) { return j2(c, Linear{}); }},
    {"voce", [](const LawChoice& c) { return j2(c, Voce{}); }},
    {"swift", [](const LawChoice& c) { return j2(c, Swift{}); }},
    {"table", [](const LawChoice& c) { return j2(c, checked_table(c)); }},
};

template <std::size_t n>
LawPointer make_from(const Entry (&entries)[n], const std::string& name, const std::string& place,
                     const LawChoice& choice) {
  std::string allowed;
  for (const Entry& entry : entries) {
    if (name == entry.name) return entry.make(choice);
    allowed += (allowed.empty() ? "" : ", ") + std::string(entry.name);
  }
  throw InputError(place, name, allowed);
}

LawPointer make_j2(const LawChoice& choice) {
  if (choice.tie_initial_modulus && choice.hardening != "power_linear")
    throw InputError("material.tie_initial_modulus", "true with hardening " + choice.hardening,
                     "true with hardening power_linear (Eq. 19), or false");
  return make_from(hardenings, choice.hardening, "material.hardening", choice);
}

constexpr Entry laws[] = {
    {"elastic",
     [](const LawChoice& c) {
       if (!c.effects.empty())
         throw InputError("material.effects", c.effects.front() + " with law elastic", "effects of law j2, or none");
       return finite_strain(c, Elastic{});
     }},
    {"j2", make_j2},
};

}  // namespace

std::vector<ParameterInfo> isotropic_elasticity_parameters() {
  return {{.name = "E", .unit = "stress", .description = "Young's modulus", .lower = 1e-12},
          {.name = "nu", .unit = "-", .description = "Poisson's ratio", .lower = -0.999, .upper = 0.4999}};
}

LawPointer make_law(const LawChoice& choice) { return make_from(laws, choice.law, "material.law", choice); }
std::vector<std::string> known_effects() {
  std::vector<std::string> list;
  for (const auto& effect : effects::list) list.emplace_back(effect.name);
  return list;
}

}  // namespace imic3d::material
