#pragma once
// Yielding at constant stress before hardening begins (Lueders bands, seen from afar).

#include "imic3d/material/effects/effect.hpp"

namespace imic3d::material::effects {

/// The hardening curve begins at the plastic strain eps_L: sigma_y(p) becomes sigma_y(max(p - eps_L, 0)). eps_L = 0:
/// none.
struct Plateau {
  static constexpr const char* name = "plateau";
  static constexpr const char* summary = "yield plateau (Lueders)";

  static std::vector<ParameterInfo> parameters() {
    return {{.name = "eps_L",
             .unit = "-",
             .description = "plastic strain at the end of the yield plateau",
             .lower = 0.0,
             .null_value = 0.0,
             .effect = name,
             .scale = 0.01}};
  }
  template <Scalar T>
  static T hardening_strain(std::span<const T> p, const T& plastic_strain) {
    return value(plastic_strain) > value(p[0]) ? plastic_strain - p[0] : T(0.0);
  }
};

}  // namespace imic3d::material::effects
