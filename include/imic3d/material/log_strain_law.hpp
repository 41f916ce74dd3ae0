#pragma once
// Makes a small-strain law a finite-strain one: multiplicative plasticity in logarithmic strain with exponential map.

#include <algorithm>
#include <stdexcept>
#include <utility>

#include "imic3d/material/scalar_root.hpp"
#include "imic3d/material/small_strain_law.hpp"
#include "imic3d/material/spectral.hpp"

namespace imic3d::material {

/// F = Fe Fp; trial elastic strain E = 1/2 ln(Ce), Ce = Fe^T Fe, Fe = F Fp_old^-1; second Piola-Kirchhoff stress of the
/// intermediate configuration S = T : 2 dE/dCe; Kirchhoff stress tau = Fe S Fe^T; Fp_new = exp(Delta Ep) Fp_old.
/// Simo (1992); Miehe, Apel, Lambrecht (2002); de Souza Neto, Peric, Owen (2008), ch. 14. T need not be coaxial with E
/// (kinematic hardening, Hill 48); the axes of anisotropy and the back-stresses are those of the intermediate
/// configuration, which starts as the reference axes and has no plastic spin: they turn with the elastic rotation. With
/// a law whose T derives from an incremental energy the tangent is symmetric. History: Fp^-1 by rows (9 numbers), then
/// the law's own state. hand_tangent: use the law's `consistent_tangent` rather than dual numbers.
template <SmallStrainLaw Law, bool hand_tangent = HasConsistentTangent<Law>>
class LogStrainLaw final : public FiniteStrainLaw {
 public:
  /// Throws std::length_error where the law has more than max_parameters parameters.
  explicit LogStrainLaw(Law law) : law_(std::move(law)), name_(law_.name()), parameters_(law_.parameters()) {
    if (parameters_.size() > max_parameters) throw std::length_error(name_ + ": more than max_parameters parameters");
  }

  [[nodiscard]] const std::string& name() const override { return name_; }
  [[nodiscard]] const std::vector<ParameterInfo>& parameters() const override { return parameters_; }
  [[nodiscard]] int history_size() const override { return history_length; }
  [[nodiscard]] int plastic_strain_index() const override {
    return Law::plastic_strain_index < 0 ? -1 : 9 + Law::plastic_strain_index;
  }
  [[nodiscard]] bool symmetric_tangent() const override {
    if constexpr (requires { law_.symmetric_tangent(); })
      return law_.symmetric_tangent();
    else
      return true;
  }
  [[nodiscard]] int thickness_strain_index() const override {
    if constexpr (requires { Law::thickness_strain_index; })
      return 9 + Law::thickness_strain_index;
    else
      return -1;
  }

  void initialise(std::span<double> history) const override {
    std::fill_n(history.begin(), 9, 0.0);
    history[0] = history[4] = history[8] = 1.0;
    law_.initialise(history.subspan(9, Law::state_size));
  }

  [[nodiscard]] bool update(const Matrix3& F, double time_increment, std::span<const double> parameters,
                            std::span<const double> history_old, std::span<double> history_new, Response& response,
                            bool with_tangent) const noexcept override {
    const Kinematics<double> kinematics(by_rows(F), history_old);
    if (!kinematics.valid) return false;
    const StrainStep<double> step{kinematics.strain, time_increment, parameters, history_old.subspan(9)};
    StressUpdate<double, Law::state_size> result;
    Matrix6 material_tangent;
    if (hand_tangent || !with_tangent) {
      if (!law_.update(step, result)) return false;
      if constexpr (hand_tangent)
        if (with_tangent) material_tangent = law_.consistent_tangent(step, result);
    } else if (!differentiate(step, result, material_tangent)) {
      return false;
    }
    const SymmetricTensor<double> tau = kinematics.kirchhoff(result.stress);
    for (int i = 0; i < 6; ++i) response.kirchhoff[i] = tau[i];
    if (with_tangent)
      response.tangent = kinematics.logarithm.spatial_tangent(kinematics.Fe, result.stress, material_tangent);
    response.dissipated_work_rate = double_dot(result.stress, result.plastic_increment);
    write_history(history_old, result, history_new);
    return response.kirchhoff.allFinite() && (!with_tangent || response.tangent.allFinite());
  }

  [[nodiscard]] bool parameter_derivatives(
      const Matrix3& F, double time_increment, std::span<const double> parameters, std::span<const double> history_old,
      Eigen::Ref<Eigen::Matrix<double, 6, Eigen::Dynamic>> derivatives) const noexcept override {
    constexpr int chunk = 4;  // parameters that are differentiated at once
    using T = Dual<chunk>;
    const Kinematics<double> kinematics(by_rows(F), history_old);
    if (!kinematics.valid) return false;
    const int count = static_cast<int>(parameters_.size());
    std::array<T, max_parameters> seeded;
    const auto state = constants<T, Law::state_size>(history_old.subspan(9));
    StrainStep<T> step{{}, time_increment, {seeded.data(), parameters_.size()}, state};
    for (int i = 0; i < 6; ++i) step.trial_strain[i] = T(kinematics.strain[i]);
    for (int first = 0; first < count; first += chunk) {
      const int here = std::min(chunk, count - first);
      for (int i = 0; i < count; ++i) seeded[static_cast<std::size_t>(i)] = T(parameters[static_cast<std::size_t>(i)]);
      for (int k = 0; k < here; ++k)
        seeded[static_cast<std::size_t>(first + k)].derivative[static_cast<std::size_t>(k)] = 1.0;
      StressUpdate<T, Law::state_size> result;
      if (!law_.update(step, result)) return false;
      for (int k = 0; k < here; ++k) {
        const SymmetricTensor<double> d_tau = kinematics.kirchhoff(material::derivatives(result.stress, k));
        for (int i = 0; i < 6; ++i) derivatives(i, first + k) = d_tau[i];
      }
    }
    return derivatives.leftCols(count).allFinite();
  }

  [[nodiscard]] bool directional_derivatives(const Matrix3& F, std::span<const Matrix3> dF, double time_increment,
                                             std::span<const double> parameters, std::span<const double> d_parameters,
                                             std::span<const double> history_old, std::span<const double> d_history_old,
                                             Vector6& kirchhoff, std::span<Vector6> d_kirchhoff,
                                             std::span<double> d_history_new) const noexcept override {
    constexpr std::size_t chunk = 4;  // directions that are taken at once
    const std::size_t n = dF.size(), of_parameters = parameters_.size(), of_history = history_length;
    const auto along = [&]<int N>(std::size_t first, std::size_t count) {
      return directions<N>(F, dF.subspan(first, count), time_increment, parameters,
                           d_parameters.subspan(first * of_parameters, count * of_parameters), history_old,
                           d_history_old.subspan(first * of_history, count * of_history), kirchhoff,
                           d_kirchhoff.subspan(first, count),
                           d_history_new.subspan(first * of_history, count * of_history));
    };
    if (n == 1) return along.template operator()<1>(0, 1);
    for (std::size_t first = 0; first < n; first += chunk)
      if (!along.template operator()<chunk>(first, std::min(chunk, n - first))) return false;
    return true;
  }

 private:
  static constexpr int history_length = 9 + Law::state_size;

  static Tensor<double> by_rows(const Matrix3& F) {
    return {{F(0, 0), F(0, 1), F(0, 2), F(1, 0), F(1, 1), F(1, 2), F(2, 0), F(2, 1), F(2, 2)}};
  }

  template <Scalar T, int n>
  static std::array<T, static_cast<std::size_t>(n)> constants(std::span<const double> numbers) {
    std::array<T, static_cast<std::size_t>(n)> list;
    for (std::size_t i = 0; i < list.size(); ++i) list[i] = T(numbers[i]);
    return list;
  }

  /// From the deformation gradient and Fp_old^-1 to the trial strain, and from its stress to Kirchhoff stress.
  template <Scalar T>
  struct Kinematics {
    Tensor<T> Fe;          // trial elastic deformation gradient
    SymmetricTensor<T> B;  // Ce - I
    LogarithmicStrain logarithm;
    SymmetricTensor<T> strain;
    bool valid;

    Kinematics(const Tensor<T>& F, std::span<const T> history_old)
        : Fe(F * plastic_inverse(history_old)), B(cauchy_green_minus_identity(Fe)), logarithm(values(B)) {
      valid = value(determinant(F)) > 0.0 && logarithm.valid();
      if (valid) strain = logarithm.strain(B);
    }

    [[nodiscard]] SymmetricTensor<T> kirchhoff(const SymmetricTensor<T>& stress) const {
      return push_forward(Fe, logarithm.second_piola(B, stress));
    }
  };

  template <Scalar T>
  static Tensor<T> plastic_inverse(std::span<const T> history) {
    Tensor<T> inverse;
    std::copy_n(history.begin(), 9, inverse.components.begin());
    return inverse;
  }

  /// Fp_new^-1 = Fp_old^-1 exp(-Delta Ep), and the law's own state.
  template <Scalar T>
  static void write_history(std::span<const T> history_old, const StressUpdate<T, Law::state_size>& result,
                            std::span<T> history_new) {
    const bool flows =
        std::any_of(result.plastic_increment.components.begin(), result.plastic_increment.components.end(),
                    [](const T& x) { return value(x) != 0.0; });
    if (flows) {
      const Tensor<T> change =
          plastic_inverse(history_old) * exponential_minus_identity(-1.0 * result.plastic_increment);
      for (std::size_t i = 0; i < 9; ++i) history_new[i] = history_old[i] + change.components[i];
    } else {
      std::copy_n(history_old.begin(), 9, history_new.begin());
    }
    std::copy_n(result.state.begin(), Law::state_size, history_new.begin() + 9);
  }

  /// `directional_derivatives` along up to N directions.
  template <int N>
  [[nodiscard]] bool directions(const Matrix3& F, std::span<const Matrix3> dF, double time_increment,
                                std::span<const double> parameters, std::span<const double> d_parameters,
                                std::span<const double> history_old, std::span<const double> d_history_old,
                                Vector6& kirchhoff, std::span<Vector6> d_kirchhoff,
                                std::span<double> d_history_new) const noexcept {
    using T = Dual<N>;
    const std::size_t n = dF.size();
    const auto along = [n](std::span<const double> at, std::span<const double> directions, auto& dual) {
      for (std::size_t i = 0; i < at.size(); ++i) {
        dual[i] = T(at[i]);
        for (std::size_t k = 0; k < n; ++k) dual[i].derivative[k] = directions[k * at.size() + i];
      }
    };
    Tensor<T> F_along;
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) {
        F_along(i, j) = T(F(i, j));
        for (std::size_t k = 0; k < n; ++k) F_along(i, j).derivative[k] = dF[k](i, j);
      }
    std::array<T, history_length> old_along, new_along;
    along(history_old.first(history_length), d_history_old, old_along);
    std::array<T, max_parameters> parameters_along;
    along(parameters, d_parameters, parameters_along);

    const Kinematics<T> kinematics(F_along, std::span<const T>(old_along));
    if (!kinematics.valid) return false;
    const StrainStep<T> step{kinematics.strain,
                             time_increment,
                             {parameters_along.data(), parameters_.size()},
                             std::span<const T>(old_along).subspan(9)};
    StressUpdate<T, Law::state_size> result;
    if (!law_.update(step, result)) return false;
    const SymmetricTensor<T> tau = kinematics.kirchhoff(result.stress);
    write_history(std::span<const T>(old_along), result, std::span<T>(new_along));
    bool finite = true;
    for (int i = 0; i < 6; ++i) kirchhoff[i] = tau[i].value;
    for (std::size_t k = 0; k < n; ++k) {
      for (int i = 0; i < 6; ++i) d_kirchhoff[k][i] = tau[i].derivative[k];
      for (std::size_t i = 0; i < history_length; ++i)
        d_history_new[k * history_length + i] = new_along[i].derivative[k];
      finite = finite && d_kirchhoff[k].allFinite();
    }
    return finite;
  }

  /// Values of the law's update and its tangent dT/dE (engineering shears) from dual numbers; its symmetric part where
  /// the law says that it has no other to speak of.
  bool differentiate(const StrainStep<double>& step, StressUpdate<double, Law::state_size>& result,
                     Matrix6& tangent) const noexcept {
    using T = Dual<6>;
    std::array<T, max_parameters> parameters;
    for (std::size_t i = 0; i < parameters_.size(); ++i) parameters[i] = T(step.parameters[i]);
    const auto state = constants<T, Law::state_size>(step.state);
    StrainStep<T> dual_step{{}, step.time_increment, {parameters.data(), parameters_.size()}, state};
    for (int i = 0; i < 6; ++i) dual_step.trial_strain[i] = T::variable(step.trial_strain[i], i, i < 3 ? 1.0 : 0.5);
    StressUpdate<T, Law::state_size> dual_result;
    if (!law_.update(dual_step, dual_result)) return false;
    result.stress = values(dual_result.stress);
    result.plastic_increment = values(dual_result.plastic_increment);
    for (std::size_t i = 0; i < result.state.size(); ++i) result.state[i] = value(dual_result.state[i]);
    for (int i = 0; i < 6; ++i)
      for (int j = 0; j < 6; ++j) tangent(i, j) = dual_result.stress[i].derivative[static_cast<std::size_t>(j)];
    if (symmetric_tangent()) tangent = (0.5 * (tangent + tangent.transpose())).eval();
    return true;
  }

  Law law_;
  std::string name_;
  std::vector<ParameterInfo> parameters_;
};

}  // namespace imic3d::material
