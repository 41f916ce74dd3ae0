#pragma once
// The original I-MIC (Eq. 2): images and equilibrium gap, no external force.

#include <Eigen/Core>
#include <functional>
#include <memory>
#include <vector>

#include "imic3d/identification/gauss_newton.hpp"

namespace imic3d::identification {

/// What Eq. 2 finds beside the parameters.
struct EquilibriumGapResult {
  StageResult stage;  ///< iterates, covariance (images' noise alone)
  /// displacement of the surface's nodes [2 * surface nodes x frames of the stage, length]
  Eigen::MatrixXd surface;
  /// resultant on the loaded end that the parameters ask for [frames of the stage, force]
  Eigen::VectorXd reaction;
  /// norm of F_int at the nodes without external force over that of F_int [frames of the stage]
  Eigen::VectorXd gap;
};

/// Eq. 2 in plane stress, for every frame of the stage with the same parameters:
///
///   min over U_t, Lambda of  sum_t 1/m_0 |F - G(P U_t)|^2 + (1/alpha - 1) 1/k_0 |F_int(U_t, Lambda)|^2,
///
/// F_int at all nodes but those of the two ends. Gauss-Newton in all unknowns together with grad F for grad G and
/// K = dF_int/dU, so that the weight of the gap is K^T K; the U_t are eliminated frame by frame:
///
///   A_t = M_DIC/m_0 + c K^T K,  B_t = c K^T f,  f = dF_int/dLambda,  c = (1/alpha - 1)/k_0
///   sum_t (c f^T f - B_t^T A_t^-1 B_t) dLambda = sum_t (-c f^T F_int - B_t^T A_t^-1 (b_DIC/m_0 - c K^T F_int)).
///
/// m_0 = |v|^2 in the norm of P^T M_DIC P and k_0 = |K v|^2 for a wave v across the axis, one period along the
/// specimen: at alpha = 1/2 both terms weigh it alike, and waves shorter than (alpha / (1 - alpha))^(1/4) times its
/// length are left to the mechanics (Rethore et al. 2009). A small alpha makes U the solution that its own boundary
/// drives.
///
/// The law must have no memory; every frame is computed from rest. Parameters that scale F_int as a whole cannot be
/// found: without a force the gap is smallest where the stiffness vanishes. Throws InputError if one of them is free
/// (`place`), or if the specimen is not one of plane stress: nodes of the ends behind the camera's face have neither
/// image nor equation. Collective over `world`.
EquilibriumGapResult equilibrium_gap(Communicator world, const Specimen& specimen,
                                     std::shared_ptr<const material::FiniteStrainLaw> law, const Record& record,
                                     const ImageData& images, const std::vector<ParameterInfo>& information,
                                     const Stage& stage, const GaussNewtonOptions& options,
                                     std::vector<double>& parameters,
                                     const std::function<void(const Iterate&)>& report = {});

}  // namespace imic3d::identification
