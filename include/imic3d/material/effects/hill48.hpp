#pragma once
// Hill's anisotropic yield function of 1948 for a sheet: orthotropic in the plane 12, as in the isotropic case through
// it.

#include <array>
#include <cmath>
#include <numbers>
#include <optional>

#include "imic3d/material/effects/effect.hpp"
#include "imic3d/material/scalar_root.hpp"

namespace imic3d::material::effects {

/// q^2 = F (s22-s33)^2 + G (s33-s11)^2 + H (s11-s22)^2 + 2 L s23^2 + 2 M s13^2 + 2 N s12^2 = s : M s, with
/// F = (1/R_22^2 + 1/R_33^2 - 1)/2, G = (1/R_33^2 + 1 - 1/R_22^2)/2, H = (1 + 1/R_22^2 - 1/R_33^2)/2, N = 3/(2 R_12^2),
/// L = M = 3/2: R_ij is the yield stress in that direction (of a shear: times sqrt 3) over the one along material
/// axis 1. Lankford: r_0 = H/G, r_90 = H/F, r_45 = N/(F+G) - 1/2. Material axis 1 lies at `hill_angle` from the x axis
/// of the reference configuration and turns with the material.
struct Hill48 {
  static constexpr const char* name = "hill";
  static constexpr const char* summary = "anisotropic yield of a sheet, Hill 1948";

  static std::vector<ParameterInfo> parameters() {
    const auto ratio = [](const char* symbol, const char* what) {
      return ParameterInfo{.name = symbol,
                           .unit = "-",
                           .description = what,
                           .lower = 0.3,
                           .upper = 3.0,
                           .null_value = 1.0,
                           .effect = name,
                           .scale = 1.0,
                           .turns_flow = true};
    };
    return {ratio("R_22", "yield stress across material axis 1 over the one along it"),
            ratio("R_33", "yield stress through the thickness over the one along material axis 1"),
            ratio("R_12", "yield stress in shear in the plane, times sqrt 3, over the one along material axis 1"),
            {.name = "hill_angle",
             .unit = "degree",
             .description = "material axis 1 from the x axis, counter-clockwise",
             .lower = -180.0,
             .upper = 180.0,
             .null_value = 0.0,
             .effect = name,
             .shape = true,
             .scale = 45.0}};
  }

  template <Scalar T>
  struct Coefficients {
    T F, G, H, N;
    explicit Coefficients(std::span<const T> p) {
      const T a = 1.0 / (p[0] * p[0]), b = 1.0 / (p[1] * p[1]);
      F = 0.5 * (a + b - 1.0), G = 0.5 * (b - a + 1.0), H = 0.5 * (1.0 + a - b), N = 1.5 / (p[2] * p[2]);
    }
    /// M s
    [[nodiscard]] SymmetricTensor<T> operator*(const SymmetricTensor<T>& s) const {
      return {{G * (s[0] - s[2]) + H * (s[0] - s[1]), F * (s[1] - s[2]) + H * (s[1] - s[0]),
               F * (s[2] - s[1]) + G * (s[2] - s[0]), N * s[3], 1.5 * s[4], 1.5 * s[5]}};
    }
  };

  /// Axes 1, 2, 3 of the material as columns.
  template <Scalar T>
  static Tensor<T> axes(std::span<const T> p) {
    using std::cos, std::sin;
    const T angle = p[3] * (std::numbers::pi / 180.0), c = cos(angle), s = sin(angle);
    return {{c, -s, T(0.0), s, c, T(0.0), T(0.0), T(0.0), T(1.0)}};
  }

  /// zeta = xi/q with (q + kappa M) zeta = eta, deviatoric.
  template <Scalar T>
  static SymmetricTensor<T> scaled(const Coefficients<T>& M, const SymmetricTensor<T>& eta, const T& kappa,
                                   const T& q) {
    const T a = q + kappa * (2.0 * M.G + M.H), b = kappa * (M.G - M.H), c = kappa * (M.F - M.H),
            d = q + kappa * (2.0 * M.F + M.H);
    const T scale = 1.0 / (a * d - b * c), first = scale * (d * eta[0] - b * eta[1]),
            second = scale * (a * eta[1] - c * eta[0]);
    const T through = q + 1.5 * kappa;
    return {{first, second, -(first + second), eta[3] / (q + kappa * M.N), eta[4] / through, eta[5] / through}};
  }

  /// Equivalent stress q of the relative stress xi = eta - kappa n, n = M xi / q the direction of flow, both returned,
  /// for a deviatoric `eta` in material axes. No value where q could not be found.
  template <Scalar T>
  struct Flow {
    T q;
    SymmetricTensor<T> n;
  };
  template <Scalar T>
  static std::optional<Flow<T>> flow(const Coefficients<T>& M, const SymmetricTensor<T>& eta, const T& kappa) {
    using std::sqrt;
    const auto residual = [](const auto& M_, const auto& eta_, const auto& kappa_, const auto& q_) {
      const auto zeta = scaled(M_, eta_, kappa_, q_);
      return 1.0 - 1.0 / sqrt(double_dot(zeta, M_ * zeta));
    };
    using D = Dual<1>;
    const Coefficients<D> constant = plain(M);
    SymmetricTensor<D> eta_plain;
    for (int i = 0; i < 6; ++i) eta_plain[i] = D(value(eta[i]));
    const D kappa_plain(value(kappa));
    const auto of_q = [&](const D& q) { return residual(constant, eta_plain, kappa_plain, q); };
    const double unrelaxed = value(sqrt(double_dot(eta_plain, constant * eta_plain)));  // q where kappa = 0
    if (!std::isfinite(unrelaxed)) return std::nullopt;
    if (unrelaxed == 0.0) return Flow<T>{T(0.0) - 1.5 * kappa, SymmetricTensor<T>::zero()};
    double root = unrelaxed;
    if (value(kappa) > 0.0) {
      const double half_trace = value(constant.F + constant.G + constant.H), F = value(constant.F),
                   G = value(constant.G), H = value(constant.H);
      const double determinant = 3.0 * (F * G + G * H + H * F);
      if (!(determinant > 0.0)) return std::nullopt;  // not convex
      const double smallest = std::min(
          {half_trace - std::sqrt(std::max(0.0, half_trace * half_trace - determinant)), value(constant.N), 1.5});
      const auto found =
          bracketed_newton(of_q, -value(kappa) * smallest * (1.0 - 1e-9), unrelaxed * (1.0 + 1e-12), 1.0);
      if (!found) return std::nullopt;
      root = *found;
    }
    const T q = implicit_root(root, residual(M, eta, kappa, T(root)), of_q(D::variable(root, 0)).derivative[0]);
    return Flow<T>{q, M * scaled(M, eta, kappa, q)};
  }

 private:
  template <Scalar T>
  static Coefficients<Dual<1>> plain(const Coefficients<T>& M) {
    const std::array<Dual<1>, 3> ones = {Dual<1>(1.0), Dual<1>(1.0), Dual<1>(1.0)};
    Coefficients<Dual<1>> copy{std::span<const Dual<1>>(ones)};
    copy.F = value(M.F), copy.G = value(M.G), copy.H = value(M.H), copy.N = value(M.N);
    return copy;
  }
};

}  // namespace imic3d::material::effects
