#pragma once
// Hencky elasticity: the linear isotropic law between Kirchhoff stress and logarithmic strain.

#include "imic3d/material/small_strain_law.hpp"

namespace imic3d::material {

/// T = K tr(E) 1 + 2 G dev(E). Parameters: E, nu.
struct Elastic {
  static constexpr int state_size = 0;
  static constexpr int plastic_strain_index = -1;

  [[nodiscard]] std::string name() const { return "elastic"; }
  [[nodiscard]] std::vector<ParameterInfo> parameters() const { return isotropic_elasticity_parameters(); }
  void initialise(std::span<double> /*state*/) const {}

  template <Scalar T>
  [[nodiscard]] bool update(const StrainStep<T>& step, StressUpdate<T, state_size>& result) const noexcept {
    const IsotropicElasticity<T> elasticity(step.parameters[0], step.parameters[1]);
    result.stress =
        add_spherical(2.0 * elasticity.G * deviator(step.trial_strain), elasticity.K * trace(step.trial_strain));
    result.plastic_increment = SymmetricTensor<T>::zero();
    return true;
  }

  [[nodiscard]] Matrix6 consistent_tangent(const StrainStep<double>& step,
                                           const StressUpdate<double, state_size>& /*result*/) const {
    const IsotropicElasticity<double> elasticity(step.parameters[0], step.parameters[1]);
    return isotropic_tangent(elasticity.K, elasticity.G);
  }
};

}  // namespace imic3d::material
