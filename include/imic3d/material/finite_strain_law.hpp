#pragma once
// What the mechanics sees of a material: Kirchhoff stress and its consistent tangent from the deformation gradient.

#include <Eigen/Core>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "imic3d/core/parameter.hpp"

namespace imic3d::material {

/// Symmetric second-order tensors as 6-vectors in the order 11, 22, 33, 12, 23, 13. Stresses hold the tensor's
/// components; strains that multiply them hold twice the shear components.
using Vector6 = Eigen::Matrix<double, 6, 1>;
using Matrix6 = Eigen::Matrix<double, 6, 6>;
using Matrix3 = Eigen::Matrix3d;

/// The response of a material point at the end of a step.
struct Response {
  Vector6 kirchhoff;  ///< Kirchhoff stress tau = J sigma [stress], spatial axes
  Matrix6 tangent;    ///< spatial tangent c: Lie derivative of tau = c : d, d with engineering shears [stress]
  double dissipated_work_rate = 0.0;  ///< plastic work of the step per reference volume [stress]
};

/// A material at finite strain. Immutable and usable from several threads at once.
class FiniteStrainLaw {
 public:
  virtual ~FiniteStrainLaw() = default;
  [[nodiscard]] virtual const std::string& name() const = 0;
  /// The law's parameters in the order in which `update` takes their values.
  [[nodiscard]] virtual const std::vector<ParameterInfo>& parameters() const = 0;
  /// Number of doubles that a point remembers.
  [[nodiscard]] virtual int history_size() const = 0;
  /// Writes the virgin state. history: [history_size()].
  virtual void initialise(std::span<double> history) const = 0;
  /// Where the accumulated plastic strain stands in the history, or -1.
  [[nodiscard]] virtual int plastic_strain_index() const = 0;
  /// A law of plane stress: where ln(lambda_3), the logarithmic strain through the thickness, stands in the history.
  /// Such a law is given F with F_33 = 1 and no shear out of the plane, and of its tangent the plane's components
  /// count. Else -1.
  [[nodiscard]] virtual int thickness_strain_index() const = 0;
  /// False where flow is not associated: the tangent is then unsymmetric, and so must be the solver.
  [[nodiscard]] virtual bool symmetric_tangent() const { return true; }
  /// Stress at the end of a step that takes the point to deformation gradient F.
  /// history_old is not changed; history_new gets the trial state (the two may not overlap).
  /// The tangent is computed if `with_tangent`. Returns false where the point cannot follow (det F <= 0, no root).
  [[nodiscard]] virtual bool update(const Matrix3& F, double time_increment, std::span<const double> parameters,
                                    std::span<const double> history_old, std::span<double> history_new,
                                    Response& response, bool with_tangent) const noexcept = 0;
  /// d(kirchhoff)/d(parameter), F and history_old held fixed: 6 x number of parameters.
  [[nodiscard]] virtual bool parameter_derivatives(
      const Matrix3& F, double time_increment, std::span<const double> parameters, std::span<const double> history_old,
      Eigen::Ref<Eigen::Matrix<double, 6, Eigen::Dynamic>> derivatives) const noexcept = 0;
  /// Stress and its derivatives, and those of the new history, along n directions in which the deformation gradient,
  /// the parameters and the old history all move, as direct differentiation of a path needs them: after a step,
  /// d_history_new is the d_history_old of the next one. Direction after direction: dF [n]; d_parameters
  /// [n x number of parameters]; d_history_old, d_history_new [n x history_size()], not overlapping; d_kirchhoff [n].
  /// Returns false where `update` would.
  [[nodiscard]] virtual bool directional_derivatives(
      const Matrix3& F, std::span<const Matrix3> dF, double time_increment, std::span<const double> parameters,
      std::span<const double> d_parameters, std::span<const double> history_old, std::span<const double> d_history_old,
      Vector6& kirchhoff, std::span<Vector6> d_kirchhoff, std::span<double> d_history_new) const noexcept = 0;
  /// The same along one direction.
  [[nodiscard]] bool directional_derivative(const Matrix3& F, const Matrix3& dF, double time_increment,
                                            std::span<const double> parameters, std::span<const double> d_parameters,
                                            std::span<const double> history_old, std::span<const double> d_history_old,
                                            Vector6& d_kirchhoff, std::span<double> d_history_new) const noexcept {
    Vector6 kirchhoff;
    return directional_derivatives(F, {&dF, 1}, time_increment, parameters, d_parameters, history_old, d_history_old,
                                   kirchhoff, {&d_kirchhoff, 1}, d_history_new);
  }
};

/// How a law is chosen in the case file.
struct LawChoice {
  std::string law = "j2";                  ///< `j2`, `elastic`
  std::string hardening = "power_linear";  ///< `power_linear` (Eq. 18), `linear`, `voce`, `swift`, `table`
  bool tie_initial_modulus = false;        ///< Eq. 19: eps_0 = delta S_y / (E - H) is not a parameter then
  bool plane_stress = false;               ///< no stress along axis 3
  /// the hardening curve is that of the Cauchy stress, not of the Kirchhoff stress
  bool cauchy_yield = false;
  /// what `j2` is extended by, see known_effects(); each brings its parameters
  std::vector<std::string> effects{};
  std::vector<double> table_strain{};  ///< for `table`: accumulated plastic strain [-], from 0, ascending
};

/// Makes a law, or throws InputError naming the known laws and hardenings.
[[nodiscard]] std::shared_ptr<const FiniteStrainLaw> make_law(const LawChoice& choice);
/// The effects of LawChoice::effects, in the order in which their parameters stand after those of the law.
[[nodiscard]] std::vector<std::string> known_effects();

}  // namespace imic3d::material
