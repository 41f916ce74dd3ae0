#pragma once
// Plastic work becomes heat, and heat softens.

#include "imic3d/material/effects/effect.hpp"

namespace imic3d::material::effects {

/// Stored heat w [work per reference volume]: dw = T : dEp - cooling w dt, backward Euler. Factor of the yield stress:
/// 1 - heating w, with heating = beta / (rho c (T_melt - T_0)) if beta is the part of the work that becomes heat and
/// the stress falls linearly to 0 at T_melt. cooling = 0: adiabatic; 1/cooling is the time in which the specimen gives
/// its heat away, so that slow tests are isothermal. heating = 0: no effect.
struct Heating {
  static constexpr const char* name = "heating";
  static constexpr const char* summary = "softening by the heat of plastic work";

  static std::vector<ParameterInfo> parameters() {
    return {{.name = "heating",
             .unit = "1/stress",
             .description = "loss of yield stress per plastic work",
             .lower = 0.0,
             .null_value = 0.0,
             .effect = name,
             .scale = 50.0},
            {.name = "cooling",
             .unit = "1/time",
             .description = "rate at which the heat leaves; 0: adiabatic",
             .lower = 0.0,
             .null_value = 0.0,
             .effect = name,
             .shape = true,
             .scale = 0.01}};
  }
  template <Scalar T>
  static T stored(std::span<const T> p, const T& old, const T& work, double time_increment) {
    return (old + work) / (1.0 + p[1] * time_increment);
  }
  template <Scalar T>
  static T factor(std::span<const T> p, const T& stored_heat) {
    return 1.0 - p[0] * stored_heat;
  }
};

}  // namespace imic3d::material::effects
