#pragma once
// A law that nobody would use, to show that a new one needs no more than this: stress and viscous flow are not coaxial
// with the strain, the response depends on time, and the tangent comes from dual numbers alone.

#include "imic3d/material/log_strain_law.hpp"

namespace imic3d::material::testing {

/// Incremental energy W(E) = 1/2 sum_I w_I E_I^2 + k/4 (E:E)^2, T = dW/dE; flow Delta Ep_I = r_I dt E_I.
/// The state counts the elapsed time.
struct AnisotropicViscous {
  static constexpr int state_size = 1;
  static constexpr int plastic_strain_index = -1;

  [[nodiscard]] std::string name() const { return "anisotropic viscous"; }
  [[nodiscard]] std::vector<ParameterInfo> parameters() const {
    return {{.name = "w", .unit = "stress", .description = "stiffness"},
            {.name = "k", .unit = "stress", .description = "fourth-order stiffness"},
            {.name = "r", .unit = "1/time", .description = "rate of flow"}};
  }
  void initialise(std::span<double> state) const { state[0] = 0.0; }

  template <Scalar T>
  [[nodiscard]] bool update(const StrainStep<T>& step, StressUpdate<T, state_size>& result) const noexcept {
    constexpr double stiffness[6] = {1.0, 1.7, 0.6, 0.9, 1.3, 0.4}, flow[6] = {0.3, -0.2, 0.1, 0.4, -0.3, 0.2};
    const T &w = step.parameters[0], &k = step.parameters[1], &r = step.parameters[2];
    const SymmetricTensor<T>& E = step.trial_strain;
    const T fourth = k * double_dot(E, E);
    for (int i = 0; i < 6; ++i) {
      result.stress[i] = (w * stiffness[i] + fourth) * E[i];
      result.plastic_increment[i] = r * (flow[i] * step.time_increment) * E[i];
    }
    result.state[0] = step.state[0] + step.time_increment;
    return true;
  }
};

}  // namespace imic3d::material::testing
