#pragma once
// The 8-node hexahedron with one integration point, and the stabilisation of its hourglass modes.

#include <span>

#include "imic3d/mechanics/element.hpp"

namespace imic3d::mechanics {

/// Of the virgin law [stress].
struct ElasticModuli {
  double shear = 0.0, bulk = 0.0;
  /// A step begins: its points are elastic or flow by leaps, with a tangent that is far stiffer than G_t. The hourglass
  /// modes' tangent (not their force) then takes G q/(q + 3 G dep) of the state at hand, or Newton's first steps put
  /// all of the deformation into them.
  bool begins = false;
};
/// From the law's tangent at rest, which is taken to be isotropic.
[[nodiscard]] ElasticModuli elastic_moduli(const material::FiniteStrainLaw& law, std::span<const double> parameters);

/// What a stabilised element remembers beside its point's history; zeros when virgin. 1 - G_t/G, 1 - G_s/G; on the
/// convected axes the change of the metric g_ij and the flow direction n_ij (11, 22, 33, 12, 23, 13); hourglass strains
/// Q and stresses T, [3 x 4] by columns.
inline constexpr int hourglass_moduli = 1 + 1 + 6 + 6, hourglass_state = hourglass_moduli + 12 + 12;

/// Bounds of G_t/G and G_s/G in plastic flow: what is left against hourglassing where the material does not harden or
/// softens, and what tells flow from elasticity.
inline constexpr double least_hourglass_modulus = 1e-3, most_flowing_modulus = 0.999;

/// Uniform-gradient hexahedron (Flanagan & Belytschko 1981): F = 1 + sum_a u_a b_a^T with b_a = 1/V_0 int dN_a/dX dV_0
/// (exact, so that distorted elements pass the patch test), one evaluation of the law and f_a = V_0 tau F^-T b_a. K has
/// 18 zero modes: 6 rigid ones and the 12 hourglass modes, for which
///     q_alpha = sum_a gamma_a,alpha x_a,  gamma_alpha = 1/8 (h_alpha - sum_i (h_alpha . X_i) b_i)        [length]
/// measures displacement along h = eta zeta, zeta xi, xi eta, xi eta zeta and nothing of a linear field.
///
/// With `elastic` the modes are stabilised as in Puso (2000), Int. J. Numer. Meth. Engng 49, and Reese (2005), Comput.
/// Methods Appl. Mech. Engrg. 194: a physical stabilisation by assumed strains on the element's convected axes. With
/// g_i = F dX/dxi_i:
///     Q_i,alpha = g_i . q_alpha      hourglass part of the Green strain in natural coordinates, invariant under
///     rotation strain linear in xi_s (i, j the other two axes): E_ii = Q_ij, E_jj = Q_ji, 2 E_ij = Q_ii + Q_jj, and of
///     E_si nothing strain bilinear:                                 E_ii = Q_i4
/// The first bends and twists the surface xi_s = 0 and takes the law of plane stress in its metric (mean of xi_s^2:
/// 1/3), the second takes Young's modulus (1/9): what a regular element that is bent or twisted elastically needs,
/// whatever its aspect ratio.
///
/// The moduli are K and G and, in plastic flow, so that plastic bending stays soft, those of proportional straining:
/// along n, the direction of tau's deviator, the tangent modulus G_t, across it the secant modulus G_s = G q/(q + 3 G
/// ep), q von Mises' tau. In flow T = D(G_t, G_s) Q in total: where a whole element flows its stresses differ by what
/// its strains do, whatever they were before. Else T grows by D(G) dQ from what it was, as in elastic unloading. Which
/// of the two, the moduli and the metric are those of the last converged step: within a step the force is the gradient
/// of a quadratic form in Q, its tangent exact and symmetric. `Equilibrium` then solves the step again with what it led
/// to, until that no longer changes: the end of a step is that of its own moduli.
///
/// nodes: reference positions; history: [history_size], with `elastic` [history_size + hourglass_state].
/// Returns false where the element is inverted or the law cannot follow; `result` is then not valid.
[[nodiscard]] bool evaluate_one_point(const material::FiniteStrainLaw& law, std::span<const double> parameters,
                                      double time_increment, const ElementNodes<8>& nodes,
                                      const ElementVector<8>& displacement, std::span<const double> history_old,
                                      std::span<double> history_new, ElementResult<8>& result, bool with_tangent,
                                      const ElasticModuli* elastic) noexcept;

/// Derivatives of the internal forces without stabilisation in the directions `d_displacement` [24 x n] and `along`,
/// the latter's history_new included. (Moduli that a step is solved again with, until they hardly change, are no
/// function to differentiate.)
[[nodiscard]] bool differentiate_one_point(const material::FiniteStrainLaw& law, std::span<const double> parameters,
                                           double time_increment, const ElementNodes<8>& nodes,
                                           const ElementVector<8>& displacement, std::span<const double> history_old,
                                           const ElementColumns<8>& d_displacement, const ElementDirections& along,
                                           ElementColumns<8>& d_force) noexcept;

}  // namespace imic3d::mechanics
