#pragma once
// Yield stress that grows with the logarithm of the rate: Johnson and Cook (1983).

#include <cmath>

#include "imic3d/material/effects/effect.hpp"

namespace imic3d::material::effects {

/// Factor of the yield stress: 1 + C_rate ln(1 + (dp/dt)/rate_0). The 1 under the logarithm, which Johnson and Cook do
/// not have, makes it 1 at rest; well above rate_0 it does not show. C_rate = 0: no dependence on the rate.
struct JohnsonCookRate {
  static constexpr const char* name = "rate";
  static constexpr const char* summary = "yield stress growing with the logarithm of the rate, Johnson and Cook";

  static std::vector<ParameterInfo> parameters() {
    return {{.name = "C_rate",
             .unit = "-",
             .description = "rate sensitivity of the yield stress",
             .lower = -0.2,
             .upper = 1.0,
             .null_value = 0.0,
             .effect = name,
             .scale = 0.01},
            {.name = "rate_0",
             .unit = "1/time",
             .description = "plastic strain rate from which on it acts",
             .lower = 1e-12,
             .null_value = 1.0,
             .effect = name,
             .shape = true,
             .scale = 1.0}};
  }
  template <Scalar T>
  static T factor(std::span<const T> p, const T& rate) {
    using std::log;
    return 1.0 + p[0] * log(1.0 + rate / p[1]);
  }
};

}  // namespace imic3d::material::effects
