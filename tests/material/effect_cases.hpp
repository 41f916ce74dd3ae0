#pragma once
// J2 with each effect alone and with all of them at once, all parameters away from their null values.

#include "material_point.hpp"

namespace imic3d::material::testing {

struct EffectCase {
  std::string name;
  LawChoice choice;
  std::vector<double> parameters;  ///< of the law, then of the effects
  [[nodiscard]] Case made() const { return {name, make_law(choice), parameters}; }
};

inline const std::vector<double>& voce_parameters() {
  static const std::vector<double> values = {200e3, 0.3, 300, 420, 15, 200};
  return values;
}

inline EffectCase with_effects(const std::string& name, std::vector<std::string> effects,
                               const std::vector<double>& values) {
  EffectCase c{name, {.law = "j2", .hardening = "voce", .effects = std::move(effects)}, voce_parameters()};
  c.parameters.insert(c.parameters.end(), values.begin(), values.end());
  return c;
}

inline std::vector<EffectCase> effect_cases() {
  return {with_effects("kinematic", {"kinematic"}, {20e3, 150}),
          with_effects("three back-stresses", {"kinematic", "kinematic_2", "kinematic_3"},
                       {20e3, 150, 3e3, 12, 60e3, 1200}),
          with_effects("hill", {"hill"}, {1.2, 0.85, 1.1, 25}),
          with_effects("hill, two back-stresses, rate", {"kinematic", "kinematic_2", "hill", "rate"},
                       {20e3, 150, 3e3, 12, 1.2, 0.85, 1.1, 25, 0.02, 1e-3}),
          with_effects("viscosity", {"viscosity"}, {80, 0.4}),
          with_effects("rate", {"rate"}, {0.02, 1e-3}),
          with_effects("heating", {"heating"}, {2e-3, 0.3}),
          with_effects("voce term", {"voce_term"}, {60, 40}),
          with_effects("two voce terms", {"voce_term_2", "voce_term"}, {60, 40, 25, 70}),
          with_effects("power term", {"power_term"}, {0.05, 3e-4}),
          with_effects("plateau", {"plateau"}, {5e-4}),
          with_effects("damage", {"damage"}, {1.5, 4e-4}),
          with_effects("pressure", {"pressure"}, {0.15, 0.08}),
          with_effects("all",
                       {"kinematic", "kinematic_2", "kinematic_3", "hill", "viscosity", "rate", "heating", "voce_term",
                        "plateau", "damage", "pressure", "voce_term_2", "power_term"},
                       {20e3, 150, 3e3, 12, 60e3, 1200, 1.2,  0.85, 1.1,  25, 80, 0.4,  0.02, 1e-3,
                        2e-4, 0.3, 60,  40, 5e-4, 1.5,  4e-4, 0.15, 0.08, 30, 60, 0.04, 2e-4}),
          with_effects("viscosity of a small exponent", {"viscosity"}, {80, 0.03})};
}

/// The law of a choice with every effect at its null value.
inline Case at_null(LawChoice choice, std::vector<double> parameters) {
  choice.effects = known_effects();
  Case c{choice.hardening, make_law(choice), std::move(parameters)};
  const auto& all = c.law->parameters();
  for (std::size_t i = c.parameters.size(); i < all.size(); ++i) c.parameters.push_back(*all[i].null_value);
  return c;
}

}  // namespace imic3d::material::testing
