#pragma once
// What a scientist writes to add a law: the response to a logarithmic strain, as if strains were small.
//
//   struct MyLaw {
//     static constexpr int state_size = 1;             // numbers that a point remembers besides Fp
//     static constexpr int plastic_strain_index = 0;   // where the accumulated plastic strain stands in it, or -1
//     std::string name() const;
//     std::vector<ParameterInfo> parameters() const;
//     void initialise(std::span<double> state) const;
//     template <Scalar T>
//     bool update(const StrainStep<T>& step, StressUpdate<T, state_size>& result) const noexcept;
//     // optional, an optimisation; without it the tangent comes from `update` with dual numbers:
//     Matrix6 consistent_tangent(const StrainStep<double>& step, const StressUpdate<double, state_size>& result) const;
//   };
//
// `T` is double or a dual number. LogStrainLaw<MyLaw> makes it a FiniteStrainLaw.

#include <array>
#include <concepts>
#include <span>
#include <string>
#include <vector>

#include "imic3d/core/parameter.hpp"
#include "imic3d/material/scalar_root.hpp"
#include "imic3d/material/tensor.hpp"

namespace imic3d::material {

/// What a law is given at the end of a step.
template <Scalar T>
struct StrainStep {
  /// elastic logarithmic strain if no more plastic flow occurred, intermediate axes
  SymmetricTensor<T> trial_strain;
  double time_increment;          ///< length of the step [time]
  std::span<const T> parameters;  ///< values in the order of `parameters()`
  std::span<const T> state;       ///< the law's own state at the start of the step
};

/// A step in plain numbers as one in numbers of type T that do not vary.
template <Scalar T, int state_size>
class ConstantStep {
 public:
  explicit ConstantStep(const StrainStep<double>& step)
      : time_increment_(step.time_increment), count_(step.parameters.size()) {
    for (int i = 0; i < 6; ++i) strain_[i] = T(step.trial_strain[i]);
    for (std::size_t i = 0; i < count_; ++i) parameters_[i] = T(step.parameters[i]);
    for (std::size_t i = 0; i < state_.size(); ++i) state_[i] = T(step.state[i]);
  }
  [[nodiscard]] StrainStep<T> step() const { return {strain_, time_increment_, {parameters_.data(), count_}, state_}; }

 private:
  SymmetricTensor<T> strain_;
  double time_increment_;
  std::size_t count_;
  std::array<T, max_parameters> parameters_;
  std::array<T, static_cast<std::size_t>(state_size)> state_;
};

/// What a law gives back.
template <Scalar T, int state_size>
struct StressUpdate {
  /// conjugate to the trial strain: d(incremental energy)/d(trial strain)
  SymmetricTensor<T> stress;
  /// Delta Ep, by which the elastic strain falls short of the trial strain
  SymmetricTensor<T> plastic_increment;
  std::array<T, static_cast<std::size_t>(state_size)> state;  ///< the law's own state at the end of the step
};

template <class Law>
concept SmallStrainLaw = requires(const Law law, std::span<double> state, const StrainStep<double>& step,
                                  StressUpdate<double, Law::state_size>& result, const StrainStep<Dual<6>>& dual_step,
                                  StressUpdate<Dual<6>, Law::state_size>& dual_result) {
  { Law::plastic_strain_index } -> std::convertible_to<int>;
  { law.name() } -> std::convertible_to<std::string>;
  { law.parameters() } -> std::convertible_to<std::vector<ParameterInfo>>;
  law.initialise(state);
  { law.update(step, result) }
  noexcept->std::same_as<bool>;
  { law.update(dual_step, dual_result) }
  noexcept->std::same_as<bool>;
};

/// A law that brings its own closed-form tangent.
template <class Law>
concept HasConsistentTangent = requires(const Law law, const StrainStep<double>& step,
                                        const StressUpdate<double, Law::state_size>& result) {
  { law.consistent_tangent(step, result) } -> std::same_as<Matrix6>;
};

/// Young's modulus and Poisson's ratio as every isotropic law lists them first.
[[nodiscard]] std::vector<ParameterInfo> isotropic_elasticity_parameters();

/// Shear and bulk modulus from Young's modulus E and Poisson's ratio nu.
template <Scalar T>
struct IsotropicElasticity {
  T G, K;
  IsotropicElasticity(const T& E, const T& nu) : G(E / (2.0 * (1.0 + nu))), K(E / (3.0 * (1.0 - 2.0 * nu))) {}
};

/// K 1 (x) 1 + 2 G_dev I_dev, for engineering shears.
[[nodiscard]] inline Matrix6 isotropic_tangent(double K, double G_dev) {
  Matrix6 A = Matrix6::Zero();
  A.topLeftCorner<3, 3>().setConstant(K - 2.0 / 3.0 * G_dev);
  for (int i = 0; i < 3; ++i) {
    A(i, i) += 2.0 * G_dev;
    A(i + 3, i + 3) = G_dev;
  }
  return A;
}

}  // namespace imic3d::material
