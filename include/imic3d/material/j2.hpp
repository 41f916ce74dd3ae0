#pragma once
// Von Mises plasticity with associated flow and isotropic hardening, integrated by backward Euler (radial return).

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "imic3d/material/scalar_root.hpp"
#include "imic3d/material/small_strain_law.hpp"

namespace imic3d::material {

/// J2 plasticity in logarithmic strain: Simo (1992), Comput. Methods Appl. Mech. Engrg. 99; de Souza Neto, Peric, Owen
/// (2008), boxes 7.3-7.5 and 14.3. Parameters: E, nu, then those of the hardening. State: accumulated plastic strain.
///
/// The hardening curve is compared with the Kirchhoff stress tau or, with `cauchy_yield`, with the true stress
/// sigma = tau/J (the curve of a tensile test as it is usually drawn). J = exp(tr E) does not change in plastic flow,
/// so the return is radial as before, to J sigma_y. The consistent tangent leaves out the change of J, which would make
/// it unsymmetric and is of the size of sigma_y/K: Newton's method needs an iteration or two more.
template <class Hardening>
struct J2 {
  static constexpr int state_size = 1;
  static constexpr int plastic_strain_index = 0;
  Hardening yield_stress;
  std::string label = "j2";
  bool cauchy_yield = false;

  [[nodiscard]] std::string name() const { return label; }

  [[nodiscard]] std::vector<ParameterInfo> parameters() const {
    std::vector<ParameterInfo> list = isotropic_elasticity_parameters();
    for (auto& parameter : yield_stress.parameters()) list.push_back(std::move(parameter));
    return list;
  }

  void initialise(std::span<double> state) const { state[0] = 0.0; }

  template <Scalar T>
  [[nodiscard]] bool update(const StrainStep<T>& step, StressUpdate<T, state_size>& result) const noexcept {
    using std::sqrt;
    const std::span<const T> p = step.parameters, hardening = p.subspan(2);
    const T &E = p[0], &ep_old = step.state[0];
    const auto [G, K] = IsotropicElasticity<T>(E, p[1]);

    // (i) elastic predictor
    const T pressure = K * trace(step.trial_strain);
    SymmetricTensor<T> s = 2.0 * G * deviator(step.trial_strain);
    const T norm_squared = double_dot(s, s);

    // (ii) admissibility
    const T J = volume_ratio(step.trial_strain);
    const T yield_old = J * yield_stress(ep_old, hardening, E);
    if (!(yield_old > 0.0)) return false;
    if (1.5 * value(norm_squared) <= value(yield_old) * value(yield_old)) {
      result.stress = add_spherical(s, pressure);
      result.plastic_increment = SymmetricTensor<T>::zero();
      result.state[0] = ep_old;
      return true;
    }
    const T q = sqrt(1.5 * norm_squared);

    // (iii) return mapping: q - 3 G dep - J sigma_y(ep_old + dep) = 0
    const auto residual = [&](const auto& dep, const auto& q_, const auto& J_, const auto& G_, const auto& ep_,
                              const auto& hardening_, const auto& E_) {
      return q_ - 3.0 * G_ * dep - J_ * yield_stress(ep_ + dep, hardening_, E_);
    };
    const double q_value = value(q), J_value = value(J), G_value = value(G), ep_value = value(ep_old),
                 E_value = value(E);
    const ParameterValues hardening_values(hardening);
    const auto residual_value = [&](const Dual<1>& dep) {
      return residual(dep, q_value, J_value, G_value, ep_value, std::span<const double>(hardening_values), E_value);
    };
    const auto root = bracketed_newton(residual_value, 0.0, q_value / (3.0 * G_value), q_value);
    if (!root) return false;
    T dep(*root);
    if constexpr (derivatives_of < T >> 0)
      dep = implicit_root(*root, residual(T(*root), q, J, G, ep_old, hardening, E),
                          residual_value(Dual<1>::variable(*root, 0)).derivative[0]);

    const T flow = 1.5 * dep / q;
    result.plastic_increment = flow * s;
    result.stress = add_spherical((1.0 - 2.0 * G * flow) * s, pressure);
    result.state[0] = ep_old + dep;
    return true;
  }

  /// eps_33 that makes the stress through the thickness vanish, added to the trial strain: one equation in the plane,
  /// in which the stress returns by s = s_trial/(1 + E f/(3 - 3 nu)), sigma_22 - sigma_11 and sigma_12 by 1/(1 + 2 G
  /// f), dep = 2/3 f q (Simo and Taylor 1986; de Souza Neto et al. 2008, box 9.5). None where the yield stress goes
  /// with the volume, or falls.
  [[nodiscard]] std::optional<double> thickness_strain(const StrainStep<double>& step) const noexcept {
    if (cauchy_yield) return std::nullopt;
    const std::span<const double> p = step.parameters, hardening = p.subspan(2);
    const double E = p[0], nu = p[1], ep = step.state[0], G = E / (2.0 * (1.0 + nu)), of_sum = E / (3.0 * (1.0 - nu));
    const auto& e = step.trial_strain;
    const double sum = E / (1.0 - nu) * (e[0] + e[1]), difference = 2.0 * G * (e[1] - e[0]), shear = 2.0 * G * e[3];
    const auto equivalent = [&](const auto& f) {  // von Mises stress
      using std::sqrt;
      const auto a = sum / (1.0 + of_sum * f), b = 1.0 / (1.0 + 2.0 * G * f);
      return sqrt(0.25 * a * a + (0.75 * difference * difference + 3.0 * shear * shear) * b * b);
    };
    const double q = equivalent(0.0), yield_old = yield_stress(ep, hardening, E);
    if (!(yield_old > 0.0)) return std::nullopt;
    double f = 0.0;
    if (q > yield_old) {
      const auto residual = [&](const Dual<1>& flow) {
        const Dual<1> there = equivalent(flow);
        return there - yield_stress(Dual<1>(ep) + 2.0 / 3.0 * flow * there, hardening, E);
      };
      const auto root = bracketed_newton(residual, 0.0, (q / yield_old - 1.0) / std::min(of_sum, 2.0 * G), q);
      if (!root) return std::nullopt;
      f = *root;
    }
    return -sum / (1.0 + of_sum * f) * (nu / E + f / 3.0) - e[2];
  }

  /// De Souza Neto et al. (2008), Eq. (7.120), with engineering shears.
  [[nodiscard]] Matrix6 consistent_tangent(const StrainStep<double>& step,
                                           const StressUpdate<double, state_size>& result) const {
    const std::span<const double> p = step.parameters;
    const double E = p[0];
    const auto [G, K] = IsotropicElasticity<double>(E, p[1]);
    const double dep = std::sqrt(2.0 / 3.0 * double_dot(result.plastic_increment, result.plastic_increment));
    if (dep == 0.0) return isotropic_tangent(K, G);
    const SymmetricTensor<double> e = deviator(step.trial_strain);
    const double norm_squared = double_dot(e, e), q = 2.0 * G * std::sqrt(1.5 * norm_squared);
    const double slope = volume_ratio(step.trial_strain) *
                         yield_stress(Dual<1>::variable(result.state[0], 0), p.subspan(2), E).derivative[0];
    Matrix6 A = isotropic_tangent(K, G * (1.0 - 3.0 * G * dep / q));
    const double factor = 6.0 * G * G * (dep / q - 1.0 / (3.0 * G + slope)) / norm_squared;
    const Vector6 n = Eigen::Map<const Vector6>(e.components.data());
    A.noalias() += factor * n * n.transpose();
    return A;
  }

 private:
  template <Scalar T>
  [[nodiscard]] T volume_ratio(const SymmetricTensor<T>& strain) const noexcept {
    using std::exp;
    return cauchy_yield ? T(exp(trace(strain))) : T(1.0);
  }
};

}  // namespace imic3d::material
