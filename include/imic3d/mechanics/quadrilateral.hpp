#pragma once
// Quadrilaterals of a sheet in plane stress at finite strain: 4 or 8 nodes, 2 x 2 points.

#include <span>

#include "imic3d/mechanics/element.hpp"

namespace imic3d::mechanics {

/// Points of the Gauss rule: 2 x 2.
inline constexpr int quadrilateral_points = 4;

/// A sheet of `thickness` [length]. The internal force is the Kirchhoff stress over the reference volume,
///
///   f_a = sum_points tau grad N_a dV_0,    grad N_a = F^-T dN_a/dX,    dV_0 = thickness dA_0:
///
/// with tau = J sigma it holds the thickness that the law finds, lambda_3 = exp(eps_33), without naming it. Points and
/// nodes move in the plane. The sheet may thin as it likes, so that nothing locks in volume and 4 nodes need no
/// averaging; 8 nodes (serendipity) with 2 x 2 points are free of the shear locking in bending, and their one spurious
/// mode cannot spread from element to element.
///
/// law: one of plane stress (thickness_strain_index() >= 0). nodes: reference positions; history_old, history_new:
/// [4 * history_size]. Returns false where the element is inverted or the law cannot follow; `result` is then not
/// valid.
template <int nodes_count>
[[nodiscard]] bool evaluate(const material::FiniteStrainLaw& law, double thickness, std::span<const double> parameters,
                            double time_increment, const ElementNodes<nodes_count, 2>& nodes,
                            const ElementVector<nodes_count, 2>& displacement, std::span<const double> history_old,
                            std::span<double> history_new, ElementResult<nodes_count, 2>& result,
                            bool with_tangent) noexcept;

/// Derivatives of the internal forces in the directions `d_displacement` [dofs x n] and `along`, the latter's
/// history_new included. With the arguments of `evaluate` that it succeeded with.
template <int nodes_count>
[[nodiscard]] bool differentiate(const material::FiniteStrainLaw& law, double thickness,
                                 std::span<const double> parameters, double time_increment,
                                 const ElementNodes<nodes_count, 2>& nodes,
                                 const ElementVector<nodes_count, 2>& displacement, std::span<const double> history_old,
                                 const ElementColumns<nodes_count, 2>& d_displacement, const ElementDirections& along,
                                 ElementColumns<nodes_count, 2>& d_force) noexcept;

}  // namespace imic3d::mechanics
