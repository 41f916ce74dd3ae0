#pragma once
// How sure the parameters of a stage are.

#include "imic3d/identification/gauss_newton.hpp"

namespace imic3d::identification {

inline bool has_force(Functional functional) { return functional != Functional::force_driven; }

/// How the simulation is driven that the images judge.
[[nodiscard]] Control control_of_images(const GaussNewtonOptions& options);

/// Noise of the measurement, taken through the last linearisation: dLambda = A^-1 sum_t [w S^T (b_t - M dU_t) + v s (dF_t - dR_t)],
/// A the matrix of Eq. 10 with the weights w and v of images and force. b_t, the noise of frame and reference, is known:
/// its part is Eq. 14, with the reference's noise as what it is, common to all frames. dU and dR, what the simulation
/// makes of a noisy force and of ends driven by a noisy displacement, are the response to draws of it.
/// Parameters that take part in a combination which moves nothing that is observed are not determined: their variances are infinite.
/// Throws ConvergenceError where the simulation does not carry the noise.
[[nodiscard]] Covariance parameter_covariance(ForwardModel& model, const ImageData& images, const Linearisation& at, const NormalEquations& normal,
                                              const Stage& stage, const GaussNewtonOptions& options, const std::vector<double>& parameters);

}  // namespace imic3d::identification
