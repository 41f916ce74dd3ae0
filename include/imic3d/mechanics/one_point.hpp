#pragma once
// The 8-node hexahedron with one integration point, and the stabilisation of its hourglass modes.

#include <span>

#include "imic3d/mechanics/element.hpp"

namespace imic3d::mechanics {

/// Of the virgin law [stress].
struct ElasticModuli {
  double shear = 0.0, bulk = 0.0;
};
/// From the law's tangent at rest, which is taken to be isotropic.
[[nodiscard]] ElasticModuli elastic_moduli(const material::FiniteStrainLaw& law, std::span<const double> parameters);

/// What a stabilised element remembers beside its point's history; zeros when virgin. 1 - G_hg/G; von Mises' tau; change of the
/// convected metric g_ij (11, 22, 33, 12, 23, 13); hourglass strains Q and stresses T, [3 x 4] by columns.
inline constexpr int hourglass_state = 1 + 1 + 6 + 12 + 12;

/// Least G_hg/G: what is left against hourglassing where the material flows without hardening or softens.
inline constexpr double least_hourglass_modulus = 1e-3;

/// Uniform-gradient hexahedron (Flanagan & Belytschko 1981): F = 1 + sum_a u_a b_a^T with b_a = 1/V_0 int dN_a/dX dV_0 (exact, so
/// that distorted elements pass the patch test), one evaluation of the law and f_a = V_0 tau F^-T b_a. K has 18 zero modes: 6
/// rigid ones and the 12 hourglass modes, for which
///     q_alpha = sum_a gamma_a,alpha x_a,  gamma_alpha = 1/8 (h_alpha - sum_i (h_alpha . X_i) b_i)        [length]
/// measures displacement along h = eta zeta, zeta xi, xi eta, xi eta zeta and nothing of a linear field.
///
/// With `elastic` the modes are stabilised as in Puso (2000), Int. J. Numer. Meth. Engng 49, and Reese (2005), Comput. Methods
/// Appl. Mech. Engrg. 194: a physical stabilisation by assumed strains on the element's convected axes. With g_i = F dX/dxi_i:
///     Q_i,alpha = g_i . q_alpha      hourglass part of the Green strain in natural coordinates, invariant under rotation
///     strain linear in xi_s (i, j the other two axes): E_ii = Q_ij, E_jj = Q_ji, 2 E_ij = Q_ii + Q_jj, and of E_si nothing
///     strain bilinear:                                 E_ii = Q_i4
/// The first bends and twists the surface xi_s = 0 and takes the law of plane stress in its metric (mean of xi_s^2: 1/3), the second
/// takes Young's modulus (1/9): what a regular element that is bent or twisted elastically needs, whatever its aspect ratio.
///
/// The moduli are K and the effective shear modulus of Puso, G_hg = G dq/(dq + 3 G dep) of the last converged step's change of von
/// Mises' tau and of plastic strain (G without flow, at least least_hourglass_modulus G), so that plastic bending stays soft.
/// Within a step they are constant, as is the metric in them, and the hourglass stress grows by D dQ from what is remembered: the
/// force is the gradient of 1/2 dQ.D dQ + T.dQ, its tangent exact and symmetric. What is remembered is T + D dQ with the new
/// G_hg: only the step in which flow begins sees the modulus of the one before.
///
/// nodes: reference positions; history: [history_size], with `elastic` [history_size + hourglass_state].
/// Returns false where the element is inverted or the law cannot follow; `result` is then not valid.
[[nodiscard]] bool evaluate_one_point(const material::FiniteStrainLaw& law, std::span<const double> parameters,
                                      double time_increment, const ElementNodes<8>& nodes, const ElementVector<8>& displacement,
                                      std::span<const double> history_old, std::span<double> history_new,
                                      ElementResult<8>& result, bool with_tangent, const ElasticModuli* elastic) noexcept;

}  // namespace imic3d::mechanics
