#pragma once
// Makes a three-dimensional law one of plane stress: the strain through the thickness is what makes its stress vanish.

#include <algorithm>
#include <optional>
#include <string>
#include <vector>

#include "imic3d/material/scalar_root.hpp"
#include "imic3d/material/small_strain_law.hpp"

namespace imic3d::material {

/// Plane stress in logarithmic strain. Axis 3 is a principal axis of every strain and stress, so that the logarithmic
/// strain through the thickness, eps_33 = ln(lambda_3), is decoupled from the plane and adds to the trial strain:
///
///   stress_33(E_trial + eps_33 e_3 (x) e_3) = 0, a scalar equation in eps_33, solved at the point (by the law itself,
///   where it has a `thickness_strain`).
///
/// LogStrainLaw<PlaneStress<Law>> is given F with F_33 = 1 (and F_13 = F_23 = F_31 = F_32 = 0): its trial strain then
/// holds -Ep_33 through the thickness, to which eps_33 is added here. Of the tangent only the components in the plane
/// have a meaning (static condensation, A_ab - A_a3 A_3b / A_33: de Souza Neto et al. 2008, ch. 9). State: that of the
/// law, then eps_33, from which the next step's search starts.
template <SmallStrainLaw Law>
struct PlaneStress {
  static constexpr int state_size = Law::state_size + 1;
  static constexpr int plastic_strain_index = Law::plastic_strain_index;
  static constexpr int thickness_strain_index = Law::state_size;  // of eps_33 in the state
  Law law;

  [[nodiscard]] std::string name() const { return law.name() + ", plane stress"; }
  [[nodiscard]] std::vector<ParameterInfo> parameters() const { return law.parameters(); }

  void initialise(std::span<double> state) const {
    law.initialise(state.first(Law::state_size));
    state[thickness_strain_index] = 0.0;
  }

  template <Scalar T>
  [[nodiscard]] bool update(const StrainStep<T>& step, StressUpdate<T, state_size>& result) const noexcept {
    // (i) the root, in plain numbers
    const ParameterValues parameters(step.parameters);
    std::array<double, Law::state_size> state;
    for (std::size_t i = 0; i < state.size(); ++i) state[i] = value(step.state[i]);
    const StrainStep<double> plain{values(step.trial_strain), step.time_increment, parameters, state};
    const ConstantStep<Dual<1>, Law::state_size> constants(plain);
    double scale = 0.0;
    const auto normal_stress = [&](const Dual<1>& thickness_strain) {
      StressUpdate<Dual<1>, Law::state_size> there;
      if (!law.update(plus(constants.step(), thickness_strain), there)) return Dual<1>(std::nan(""));
      const SymmetricTensor<double> stress = values(there.stress);
      scale = std::sqrt(double_dot(stress, stress));
      return there.stress[2];
    };
    std::optional<double> root;
    if constexpr (requires { law.thickness_strain(plain); }) root = law.thickness_strain(plain);
    if (!root)
      root = increasing_newton(normal_stress, value(step.state[thickness_strain_index]), [&] { return scale; });
    if (!root) return false;

    // (ii) the law's answer there
    T thickness_strain(*root);
    StressUpdate<T, Law::state_size> there;
    if (!law.update(with(step, thickness_strain), there)) return false;

    // (iii) its derivatives: those of the root, from the equation there, and what the answer changes along them
    if constexpr (derivatives_of < T >> 0) {
      StressUpdate<Dual<1>, Law::state_size> along;
      if (!law.update(plus(constants.step(), Dual<1>::variable(*root, 0)), along)) return false;
      thickness_strain = implicit_root(*root, there.stress[2], along.stress[2].derivative[0]);
      const T change = thickness_strain - *root;  // null, but for its derivatives
      const auto follow = [&change](T& answer, const Dual<1>& its) { answer += its.derivative[0] * change; };
      for (int i = 0; i < 6; ++i)
        follow(there.stress[i], along.stress[i]), follow(there.plastic_increment[i], along.plastic_increment[i]);
      for (std::size_t i = 0; i < there.state.size(); ++i) follow(there.state[i], along.state[i]);
    }
    result.stress = there.stress;
    result.plastic_increment = there.plastic_increment;
    std::copy(there.state.begin(), there.state.end(), result.state.begin());
    result.state[thickness_strain_index] = thickness_strain;
    return true;
  }

  [[nodiscard]] bool symmetric_tangent() const {
    if constexpr (requires { law.symmetric_tangent(); })
      return law.symmetric_tangent();
    else
      return true;
  }

  [[nodiscard]] Matrix6 consistent_tangent(const StrainStep<double>& step,
                                           const StressUpdate<double, state_size>& result) const requires
      HasConsistentTangent<Law> {
    StressUpdate<double, Law::state_size> there{result.stress, result.plastic_increment, {}};
    std::copy_n(result.state.begin(), Law::state_size, there.state.begin());
    const Matrix6 A = law.consistent_tangent(with(step, result.state[thickness_strain_index]), there);
    return A - A.col(2) * A.row(2) / A(2, 2);
  }

 private:
  /// The law's step with eps_33 added to the trial strain.
  template <Scalar T>
  static StrainStep<T> with(const StrainStep<T>& step, const T& thickness_strain) {
    return plus({step.trial_strain, step.time_increment, step.parameters, step.state.first(Law::state_size)},
                thickness_strain);
  }
  template <Scalar T>
  static StrainStep<T> plus(StrainStep<T> step, const T& thickness_strain) {
    step.trial_strain[2] += thickness_strain;
    return step;
  }
};

}  // namespace imic3d::material
