#pragma once
// Isotropic hardening: the yield stress as a function of the accumulated plastic strain.
//
// A hardening law is a struct with its list of parameters and one call,
//   yield_stress(plastic_strain, p, young_modulus)
// where p are the values of its own parameters, in that order. Plastic strain and parameters may be numbers or dual
// numbers, so that slopes and parameter derivatives come from this one line. To add one: write the struct here and
// put a line into src/material/registry.cpp.

#include <cmath>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "imic3d/core/parameter.hpp"
#include "imic3d/material/dual.hpp"

namespace imic3d::material {

/// Eq. (18): sigma_y = H ep + S_y (1 + ep / eps_0)^delta.
struct PowerLinear {
  [[nodiscard]] std::vector<ParameterInfo> parameters() const {
    return {{.name = "S_y", .unit = "stress", .description = "initial yield stress", .lower = 1e-12},
            {.name = "H", .unit = "stress", .description = "linear hardening modulus", .lower = 0.0},
            {.name = "delta", .unit = "-", .description = "hardening exponent", .lower = 0.0, .upper = 1.0},
            {.name = "eps_0", .unit = "-", .description = "plastic strain scale", .lower = 1e-12}};
  }
  template <class Strain, class P>
  auto operator()(const Strain& ep, std::span<const P> p, const P& /*young_modulus*/) const {
    using std::pow;
    const P &S_y = p[0], &H = p[1], &delta = p[2], &eps_0 = p[3];
    return H * ep + S_y * pow(1.0 + ep / eps_0, delta);
  }
};

/// Eq. (18) with Eq. (19), eps_0 = delta S_y / (E - H): the curve leaves the yield point with the slope E.
/// Needs H < E and delta > 0.
struct PowerLinearTied {
  [[nodiscard]] std::vector<ParameterInfo> parameters() const {
    return {{.name = "S_y", .unit = "stress", .description = "initial yield stress", .lower = 1e-12},
            {.name = "H", .unit = "stress", .description = "linear hardening modulus, less than E", .lower = 0.0},
            {.name = "delta", .unit = "-", .description = "hardening exponent", .lower = 1e-6, .upper = 1.0}};
  }
  template <class Strain, class P>
  auto operator()(const Strain& ep, std::span<const P> p, const P& young_modulus) const {
    using std::pow;
    const P &S_y = p[0], &H = p[1], &delta = p[2];
    return H * ep + S_y * pow(1.0 + ep * ((young_modulus - H) / (delta * S_y)), delta);
  }
};

/// sigma_y = S_y + H ep.
struct Linear {
  [[nodiscard]] std::vector<ParameterInfo> parameters() const {
    return {{.name = "S_y", .unit = "stress", .description = "initial yield stress", .lower = 1e-12},
            {.name = "H", .unit = "stress", .description = "hardening modulus", .lower = 0.0}};
  }
  template <class Strain, class P>
  auto operator()(const Strain& ep, std::span<const P> p, const P& /*young_modulus*/) const {
    const P &S_y = p[0], &H = p[1];
    return S_y + H * ep;
  }
};

/// sigma_y = S_y + (S_inf - S_y) (1 - exp(-b ep)) + H ep. Voce (1948); with H the law of Simo and Armero (1992).
struct Voce {
  [[nodiscard]] std::vector<ParameterInfo> parameters() const {
    return {{.name = "S_y", .unit = "stress", .description = "initial yield stress", .lower = 1e-12},
            {.name = "S_inf", .unit = "stress", .description = "saturation stress", .lower = 1e-12},
            {.name = "b", .unit = "-", .description = "saturation rate per plastic strain", .lower = 0.0},
            {.name = "H", .unit = "stress", .description = "linear hardening modulus", .lower = 0.0}};
  }
  template <class Strain, class P>
  auto operator()(const Strain& ep, std::span<const P> p, const P& /*young_modulus*/) const {
    using std::expm1;
    const P &S_y = p[0], &S_inf = p[1], &b = p[2], &H = p[3];
    return S_y - (S_inf - S_y) * expm1(-(b * ep)) + H * ep;
  }
};

/// sigma_y = K (eps_0 + ep)^n. Swift (1952).
struct Swift {
  [[nodiscard]] std::vector<ParameterInfo> parameters() const {
    return {{.name = "K", .unit = "stress", .description = "strength coefficient", .lower = 1e-12},
            {.name = "eps_0", .unit = "-", .description = "pre-strain", .lower = 1e-12},
            {.name = "n", .unit = "-", .description = "hardening exponent", .lower = 0.0, .upper = 1.0}};
  }
  template <class Strain, class P>
  auto operator()(const Strain& ep, std::span<const P> p, const P& /*young_modulus*/) const {
    using std::pow;
    const P &K = p[0], &eps_0 = p[1], &n = p[2];
    return K * pow(eps_0 + ep, n);
  }
};

/// Piecewise linear: the yield stresses S_0 … S_k at given plastic strains; beyond the last point its slope goes on.
struct Table {
  std::vector<double> strain;  ///< accumulated plastic strain [-], from 0, ascending, two points or more

  [[nodiscard]] std::vector<ParameterInfo> parameters() const {
    std::vector<ParameterInfo> list;
    for (std::size_t i = 0; i < strain.size(); ++i)
      list.push_back({.name = "S_" + std::to_string(i),
                      .unit = "stress",
                      .description = "yield stress at plastic strain " + std::to_string(strain[i]),
                      .lower = 1e-12});
    return list;
  }
  template <class Strain, class P>
  auto operator()(const Strain& ep, std::span<const P> p, const P& /*young_modulus*/) const {
    std::size_t i = 0;
    while (i + 2 < strain.size() && value(ep) >= strain[i + 1]) ++i;
    const auto weight = (ep - strain[i]) / (strain[i + 1] - strain[i]);
    return p[i] + (p[i + 1] - p[i]) * weight;
  }
};

}  // namespace imic3d::material
