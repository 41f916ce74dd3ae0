#pragma once
// Isotropic damage: stress and stiffness fade with plastic strain. Lemaitre (1985), strain equivalence.

#include <cmath>

#include "imic3d/material/effects/effect.hpp"

namespace imic3d::material::effects {

/// Stress = (1 - D) effective stress, 1 - D = exp(-damage <p - eps_D>): the effective stress obeys the rest of the law,
/// and unloading is softer by 1 - D. damage = 0: none.
struct Damage {
  static constexpr const char* name = "damage";
  static constexpr const char* summary = "isotropic damage beyond a plastic strain";

  static std::vector<ParameterInfo> parameters() {
    return {{.name = "damage",
             .unit = "-",
             .description = "rate of damage per plastic strain",
             .lower = 0.0,
             .null_value = 0.0,
             .effect = name,
             .scale = 0.5},
            {.name = "eps_D",
             .unit = "-",
             .description = "plastic strain at which damage begins",
             .lower = 0.0,
             .null_value = 0.0,
             .effect = name,
             .shape = true,
             .scale = 0.1}};
  }
  template <Scalar T>
  static T integrity(std::span<const T> p, const T& plastic_strain) {
    using std::exp;
    return value(plastic_strain) > value(p[1]) ? exp(-(p[0] * (plastic_strain - p[1]))) : T(1.0);
  }
};

}  // namespace imic3d::material::effects
