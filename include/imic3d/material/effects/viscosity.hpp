#pragma once
// Viscous overstress of Perzyna (1966).

#include <cmath>

#include "imic3d/material/effects/effect.hpp"

namespace imic3d::material::effects {

/// What the stress exceeds the yield stress by: eta (dp/dt)^m. eta = 0: no viscosity.
struct Viscosity {
  static constexpr const char* name = "viscosity";
  static constexpr const char* summary = "viscous overstress, Perzyna";

  static std::vector<ParameterInfo> parameters() {
    return {{.name = "eta",
             .unit = "stress time^m",
             .description = "viscous overstress at a plastic strain rate of 1",
             .lower = 0.0,
             .null_value = 0.0,
             .effect = name,
             .scale = 1e-3},
            {.name = "m",
             .unit = "-",
             .description = "exponent of the plastic strain rate in the overstress",
             .lower = 0.01,
             .upper = 2.0,
             .null_value = 1.0,
             .effect = name,
             .shape = true,
             .scale = 1.0}};
  }
  template <Scalar T>
  static T overstress(std::span<const T> p, const T& rate) {
    using std::pow;
    return p[0] * pow(rate, p[1]);
  }
};

}  // namespace imic3d::material::effects
