#pragma once
// How sure the parameters are: Eq. 14, and the noise that it leaves out.

#include <Eigen/Core>
#include <functional>
#include <vector>

namespace imic3d::identification {

/// Noise of the measurement. All of it is white in time.
struct NoiseModel {
  double image = 0.0;  ///< sigma of one frame [grey level], as ImageData::noise
  int references = 1;  ///< images that were averaged to the reference, whose noise is common to all frames
  double force = 0.0;  ///< of the load record [force]
  /// What becomes of a noisy DIC displacement on its way to the ends that it drives: the smoothing, linear
  /// [unknowns x any number]; the identity if not given.
  std::function<Eigen::MatrixXd(const Eigen::MatrixXd&)> driving;
  /// Draws of the error of the measured displacement that the uncertainty of the cameras' numbers makes: each [unknowns
  /// x frames of the record, length]. Counted with `draws` > 0 only.
  std::vector<Eigen::MatrixXd> calibration = {};
  int draws = 0;  ///< draws of the force's and the driving displacement's noise; 0: these are left out
  unsigned seed = 1;
};

/// Covariance of the free parameters [free x free] and what it is made of.
struct Covariance {
  Eigen::MatrixXd image;        ///< images alone: of each frame and of the common reference
  Eigen::MatrixXd force;        ///< load record alone; zero without draws
  Eigen::MatrixXd boundary;     ///< displacement that drives the ends alone; zero without draws
  Eigen::MatrixXd calibration;  ///< the cameras' numbers alone; zero without draws of them
  /// all of them; the driving displacement's noise is that of the images, so they are correlated
  Eigen::MatrixXd total;
};

}  // namespace imic3d::identification
