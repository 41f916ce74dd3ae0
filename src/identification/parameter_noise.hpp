#pragma once
// How sure the parameters of a stage are.

#include "imic3d/identification/gauss_newton.hpp"

namespace imic3d::identification {

inline bool has_force(Functional functional) { return functional != Functional::force_driven; }

/// How the simulation is driven that the images judge.
[[nodiscard]] Control control_of_images(const GaussNewtonOptions& options);

/// What small errors of that which drives a simulation do to what is observed, in the first order: by each error, those
/// of the ends first. Up to rigid motions that the images fix: to these the derivatives by the parameters are
/// orthogonal, in the norm of M.
struct Response {
  std::vector<Eigen::MatrixXd> surface;   ///< [unknowns x frames, length]
  std::vector<Eigen::VectorXd> reaction;  ///< of the DIC-driven simulation [frames, force]
};

/// NoiseModel::draws draws of all noise, and what the simulation makes of them; without draws empty.
struct NoiseDraws {
  std::vector<Eigen::MatrixXd> b;      ///< noise of b_DIC [unknowns x frames]
  std::vector<Eigen::VectorXd> force;  ///< of the load record [frames, force]
  /// to the displacement of the ends that follows from b, then (under forces) to `force`
  Response response;
  Response of_cameras;  ///< to NoiseModel::calibration
};
/// Of the first `frames` frames. Throws ConvergenceError where the simulation does not carry the noise.
[[nodiscard]] NoiseDraws draw_noise(ForwardModel& model, const ImageData& images, int frames,
                                    const GaussNewtonOptions& options, const std::vector<double>& parameters);

/// Standard deviation of F - R [frames, force]: of the load record and of the ends' displacement, as the specimen
/// answers it in each frame; empty with fewer draws than tell it.
[[nodiscard]] Eigen::VectorXd difference_noise(const NoiseDraws& draws, const GaussNewtonOptions& options);

/// The same at frame t; where it is not known the one that is given with the options.
[[nodiscard]] double difference_noise(const Eigen::VectorXd& known, const GaussNewtonOptions& options, Eigen::Index t);

/// Noise of the measurement, taken through the last linearisation: dLambda = A^-1 sum_t [w S^T (b_t - M dU_t) + v s
/// (dF_t - dR_t)], A the matrix of Eq. 10 with the weights w and v of images and force. b_t, the noise of frame and
/// reference, is known: its part is Eq. 14, with the reference's noise as what it is, common to all frames. dU and dR,
/// what the simulation makes of a noisy force and of ends driven by a noisy displacement, are the response to draws of
/// it. Parameters that take part in a combination which moves nothing that is observed are not determined: their
/// variances are infinite. `difference`: the standard deviations that v stands for, difference_noise.
[[nodiscard]] Covariance parameter_covariance(const ImageData& images, const Linearisation& at,
                                              const NormalEquations& normal, const Stage& stage,
                                              const GaussNewtonOptions& options, const Eigen::VectorXd& difference,
                                              const NoiseDraws& draws);

}  // namespace imic3d::identification
