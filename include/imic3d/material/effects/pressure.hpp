#pragma once
// Yield and flow that depend on the mean stress: Drucker and Prager (1952), with flow of its own dilatancy.

#include <cmath>

#include "imic3d/material/effects/effect.hpp"

namespace imic3d::material::effects {

/// Yield: q = sigma_y g(friction sigma_m / sigma_y) with g(x) = 1 - x, the cone q + friction sigma_m = sigma_y, up to
/// half way to its apex; from there on g(x) = exp(1 - 2x)/2, which never ends, so that a return exists from everywhere.
/// Flow: Delta Ep = dp (n + dilatancy/3 I), so that p is still the equivalent deviatoric strain. friction > 0: weaker
/// in tension than in compression. Equal: associated. Both 0: no effect.
struct Pressure {
  static constexpr const char* name = "pressure";
  static constexpr const char* summary = "pressure-dependent yield and dilatancy, Drucker and Prager";

  static std::vector<ParameterInfo> parameters() {
    return {{.name = "friction",
             .unit = "-",
             .description = "equivalent stress lost per mean stress",
             .lower = -1.0,
             .upper = 1.5,
             .null_value = 0.0,
             .effect = name,
             .scale = 0.1,
             .turns_flow = true},
            {.name = "dilatancy",
             .unit = "-",
             .description = "plastic volume strain per equivalent plastic strain",
             .lower = -1.0,
             .upper = 1.5,
             .null_value = 0.0,
             .effect = name,
             .scale = 0.1,
             .turns_flow = true}};
  }
  /// g: the part of the yield stress that is left under the mean stress.
  template <Scalar T>
  static T factor(std::span<const T> p, const T& mean_stress, const T& strength) {
    using std::exp;
    const T x = p[0] * mean_stress / strength;
    return value(x) <= 0.5 ? 1.0 - x : 0.5 * exp(1.0 - 2.0 * x);
  }
};

}  // namespace imic3d::material::effects
