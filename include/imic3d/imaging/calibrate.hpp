#pragma once
// Cameras from the images of a flat target: one camera or a rig, all numbers in one least-squares fit.

#include <Eigen/Core>
#include <string>
#include <vector>

#include "imic3d/imaging/calibration.hpp"
#include "imic3d/imaging/target.hpp"

namespace imic3d::imaging {

/// The images of one camera: frame k of every camera was taken at the same time.
struct CameraSightings {
  std::string name;
  int width = 0, height = 0;  ///< [px]
  /// [frames][points of the target]; empty where it was not found
  std::vector<std::vector<Eigen::Vector2d>> pixels;
};

struct RigCalibration {
  std::vector<CalibratedCamera> cameras;  ///< in the frame of the first, with their covariance
  std::vector<Pose> targets;              ///< [frames] from the target's frame to the first camera's
  std::vector<char> used;                 ///< [frames] 1: seen by a camera
  /// [cameras][frames][points of the target] seen - predicted, empty where it was not found [px]
  std::vector<std::vector<std::vector<Eigen::Vector2d>>> residuals;
  /// root of the mean squared distance of a seen point from the predicted one, all cameras [px]
  double rms = 0.0;
  /// of one coordinate of a seen point, from the residuals and the degrees of freedom [px]
  double deviation = 0.0;
  int iterations = 0;

  /// As rms, of one camera (all frames) or of one image of it; NaN if there is nothing.
  [[nodiscard]] double rms_of(std::size_t camera) const;
  [[nodiscard]] double rms_of(std::size_t camera, std::size_t frame) const;
};

/// Finds fx, fy, cx, cy and the distortion `terms` (positions in Intrinsics::distortion) of each camera, the poses of
/// the cameras after the first and the poses of the target, by Levenberg and Marquardt's method on all pixels at once;
/// start: Zhang's method (cv::calibrateCamera) for each camera, and the relative pose that most frames agree on. Where
/// the target can be numbered in several orders the one that fits the rig is taken. Circles with a known diameter: what
/// is seen is the centroid of the circle's image, not the image of its centre. The covariance is (J^T J)^-1 s^2, with
/// s^2 from the residuals: independent equal noise of all points, a target that is exactly as stated. Throws InputError
/// if a camera sees the target in fewer than 3 images, or fewer than 1 together with the first camera, or if the images
/// leave a number undetermined; ConvergenceError.
[[nodiscard]] RigCalibration calibrate_rig(const Target& target, const std::vector<CameraSightings>& sightings,
                                           const std::vector<int>& terms);

}  // namespace imic3d::imaging
