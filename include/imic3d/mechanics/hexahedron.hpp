#pragma once
// Hexahedra at finite strain: 8 nodes with element-averaged dilatation, 20 nodes with reduced integration.

#include <span>

#include "imic3d/mechanics/element.hpp"

namespace imic3d::mechanics {

/// Points of the Gauss rule of either element: 2 x 2 x 2.
inline constexpr int hexahedron_points = 8;

/// Hex8 whose dilatation is averaged over the element: Fbar = (theta/J)^(1/3) F with theta the element's volume ratio
/// (Simo, Taylor & Pister 1985; the one-field form, so that the residual is the gradient of the incremental energy
/// W(Fbar) and the tangent is symmetric). Updated-Lagrangian: spatial gradients at the current configuration.
///
/// nodes: reference positions; history_old, history_new: [8 * history_size].
/// Returns false where the element is inverted or the law cannot follow; `result` is then not valid.
[[nodiscard]] bool evaluate(const material::FiniteStrainLaw& law, std::span<const double> parameters,
                            double time_increment, const ElementNodes<8>& nodes, const ElementVector<8>& displacement,
                            std::span<const double> history_old, std::span<double> history_new,
                            ElementResult<8>& result, bool with_tangent) noexcept;

/// Hex20, quadratic serendipity shape functions with 2 x 2 x 2 points: the reduced integration keeps it free of
/// volumetric locking (Zienkiewicz & Taylor), its one spurious mode cannot spread from element to element.
[[nodiscard]] bool evaluate(const material::FiniteStrainLaw& law, std::span<const double> parameters,
                            double time_increment, const ElementNodes<20>& nodes, const ElementVector<20>& displacement,
                            std::span<const double> history_old, std::span<double> history_new,
                            ElementResult<20>& result, bool with_tangent) noexcept;

/// Derivatives of the internal forces of either element in the directions `d_displacement` [dofs x n] and `along`, the
/// latter's history_new included. With the arguments of `evaluate` that it succeeded with.
[[nodiscard]] bool differentiate(const material::FiniteStrainLaw& law, std::span<const double> parameters,
                                 double time_increment, const ElementNodes<8>& nodes,
                                 const ElementVector<8>& displacement, std::span<const double> history_old,
                                 const ElementColumns<8>& d_displacement, const ElementDirections& along,
                                 ElementColumns<8>& d_force) noexcept;
[[nodiscard]] bool differentiate(const material::FiniteStrainLaw& law, std::span<const double> parameters,
                                 double time_increment, const ElementNodes<20>& nodes,
                                 const ElementVector<20>& displacement, std::span<const double> history_old,
                                 const ElementColumns<20>& d_displacement, const ElementDirections& along,
                                 ElementColumns<20>& d_force) noexcept;

}  // namespace imic3d::mechanics
