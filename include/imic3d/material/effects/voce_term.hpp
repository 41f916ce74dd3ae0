#pragma once
// One more saturating term of isotropic hardening: Voce (1948).

#include <cmath>

#include "imic3d/material/effects/effect.hpp"

namespace imic3d::material::effects {

/// Added to the yield stress: Q_v (1 - exp(-b_v p)). Q_v = 0: nothing; negative: cyclic softening. The second one of
/// them is Q_v2, b_v2.
template <int number>
struct VoceTerm {
  static_assert(number == 1 || number == 2);
  static constexpr const char* name = number == 1 ? "voce_term" : "voce_term_2";
  static constexpr const char* summary = "one more saturating hardening term";

  static std::vector<ParameterInfo> parameters() {
    return {{.name = number == 1 ? "Q_v" : "Q_v2",
             .unit = "stress",
             .description = "stress at which the term saturates",
             .null_value = 0.0,
             .effect = name,
             .scale = 5e-4},
            {.name = number == 1 ? "b_v" : "b_v2",
             .unit = "-",
             .description = "rate of saturation per plastic strain",
             .lower = 0.0,
             .null_value = 10.0,
             .effect = name,
             .shape = true,
             .scale = 10.0}};
  }
  template <Scalar T>
  static T stress(std::span<const T> p, const T& plastic_strain) {
    using std::expm1;
    return -p[0] * expm1(-(p[1] * plastic_strain));
  }
};

}  // namespace imic3d::material::effects
