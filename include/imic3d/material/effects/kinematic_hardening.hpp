#pragma once
// Kinematic hardening of Armstrong and Frederick (1966), one back-stress an effect; three of them make Chaboche's law.

#include "imic3d/material/effects/effect.hpp"

namespace imic3d::material::effects {

/// d alpha = 2/3 C dEp - gamma alpha dp; backward Euler: alpha = (alpha_old + 2/3 C Delta Ep) / (1 + gamma dp).
/// C = 0: no back-stress. gamma = 0: linear (Prager). Uniaxial: C/gamma is what it saturates at.
template <int number>
struct KinematicHardening {
  static constexpr const char* name = number == 1 ? "kinematic" : number == 2 ? "kinematic_2" : "kinematic_3";
  static constexpr const char* summary = "back-stress of Armstrong and Frederick";

  static std::vector<ParameterInfo> parameters() {
    constexpr double usual_gamma = number == 1 ? 100.0 : number == 2 ? 10.0 : 1000.0;
    const std::string n = std::to_string(number);
    return {{.name = "C_" + n,
             .unit = "stress",
             .description = "kinematic hardening modulus",
             .lower = 0.0,
             .null_value = 0.0,
             .effect = name,
             .scale = 0.02},
            {.name = "gamma_" + n,
             .unit = "-",
             .description = "rate at which the back-stress fades, per plastic strain",
             .lower = 0.0,
             .null_value = usual_gamma,
             .effect = name,
             .shape = true,
             .scale = usual_gamma}};
  }
  /// What is left of the old back-stress.
  template <Scalar T>
  static T fading(std::span<const T> p, const T& dp) {
    return 1.0 / (1.0 + p[1] * dp);
  }
  /// Slope: C / (1 + gamma dp).
  template <Scalar T>
  static T modulus(std::span<const T> p, const T& dp) {
    return p[0] * fading(p, dp);
  }
};

}  // namespace imic3d::material::effects
