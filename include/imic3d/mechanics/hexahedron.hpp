#pragma once
// The 8-node hexahedron with element-averaged dilatation at finite strain.

#include <Eigen/Core>
#include <span>

#include "imic3d/material/finite_strain_law.hpp"

namespace imic3d::mechanics {

/// Internal force, consistent tangent and cell averages of one hexahedron.
struct ElementResult {
  Eigen::Matrix<double, 24, 1> force;     ///< internal forces, node by node x, y, z [force]
  Eigen::Matrix<double, 24, 24> tangent;  ///< d(force)/d(displacement) [force/length], symmetric for associative laws
  material::Vector6 cauchy_stress;        ///< volume average of the Cauchy stress [stress]
  double plastic_strain = 0.0;            ///< volume average of the accumulated plastic strain [-]
};

/// Points of the Gauss rule: 2 x 2 x 2.
inline constexpr int hex8_points = 8;

/// Hex8 whose dilatation is averaged over the element: Fbar = (theta/J)^(1/3) F with theta the element's volume ratio
/// (Simo, Taylor & Pister 1985; the one-field form, so that the residual is the gradient of the incremental energy
/// W(Fbar) and the tangent is symmetric). Updated-Lagrangian: spatial gradients at the current configuration.
///
/// nodes: reference positions [8 x 3, length]; displacement: [24, length]; history_old, history_new: [8 * history_size].
/// Returns false where the element is inverted or the law cannot follow; `result` is then not valid.
[[nodiscard]] bool evaluate_hex8(const material::FiniteStrainLaw& law, std::span<const double> parameters,
                                 double time_increment, const Eigen::Matrix<double, 8, 3>& nodes,
                                 const Eigen::Matrix<double, 24, 1>& displacement, std::span<const double> history_old,
                                 std::span<double> history_new, ElementResult& result, bool with_tangent) noexcept;

}  // namespace imic3d::mechanics
