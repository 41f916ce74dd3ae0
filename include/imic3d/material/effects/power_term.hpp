#pragma once
// Hardening by a power of the plastic strain beside that of the law: Ludwik (1909); what Eq. (18) has beyond linear
// hardening.

#include <cmath>

#include "imic3d/material/effects/effect.hpp"

namespace imic3d::material::effects {

/// Added to the yield stress: S ((1 + p/eps_p)^n_p - 1), S the law's yield stress at p = 0. n_p = 0: nothing. With
/// linear hardening the sum is Eq. (18) with n_p as its delta and eps_p as its eps_0.
struct PowerTerm {
  static constexpr const char* name = "power_term";
  static constexpr const char* summary = "hardening by a power of the plastic strain, as in Eq. 18";

  static std::vector<ParameterInfo> parameters() {
    return {{.name = "n_p",
             .unit = "-",
             .description = "exponent of the term",
             .lower = -0.5,
             .upper = 1.0,
             .null_value = 0.0,
             .effect = name,
             .scale = 0.01},
            {.name = "eps_p",
             .unit = "-",
             .description = "plastic strain from which on it is a power",
             .lower = 1e-9,
             .null_value = 5e-4,
             .effect = name,
             .shape = true,
             .scale = 5e-4}};
  }
  template <Scalar T>
  static T factor(std::span<const T> p, const T& plastic_strain) {
    using std::pow;
    return pow(1.0 + plastic_strain / p[1], p[0]) - 1.0;
  }
};

}  // namespace imic3d::material::effects
