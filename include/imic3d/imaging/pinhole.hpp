#pragma once
// A perspective camera with lens distortion.

#include <Eigen/Core>
#include <array>

#include "imic3d/imaging/camera.hpp"

namespace imic3d::imaging {

/// Lens and sensor. Distortion as OpenCV has it (Brown 1966, rational and thin-prism terms, docs of calib3d): a
/// direction (x, y) = (X/Z, Y/Z) in the camera's frame with r^2 = x^2 + y^2 is seen at
///   x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6)/(1 + k4 r^2 + k5 r^4 + k6 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2) + s1 r^2 + s2
///   r^4, y' likewise with p1 and p2, s3 and s4; then column = fx x' + skew y' + cx, row = fy y' + cy.
struct Intrinsics {
  double fx = 1.0, fy = 1.0;            ///< focal lengths [px]
  double cx = 0.0, cy = 0.0;            ///< principal point; the centre of the upper left pixel is (0, 0) [px]
  double skew = 0.0;                    ///< [px]
  std::array<double, 12> distortion{};  ///< k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 [-]
};

/// x_camera = rotation * X + translation; the camera looks along its +z, its x to the right and y downwards in the
/// image.
struct Pose {
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();  ///< [length]
};

/// `inner` after `outer`: the pose of a camera in the frame of the specimen, if `outer` takes the specimen's frame to
/// the frame in which `inner` is given.
[[nodiscard]] Pose operator*(const Pose& inner, const Pose& outer);
/// The pose that takes back what another does.
[[nodiscard]] Pose inverse(const Pose& pose);

class PinholeCamera final : public Camera {
 public:
  PinholeCamera(const Intrinsics& intrinsics, const Pose& pose) : intrinsics_(intrinsics), pose_(pose) {}

  /// Points behind the camera have no image: NaN.
  [[nodiscard]] Eigen::Vector2d project(const Eigen::Vector3d& point) const override;
  [[nodiscard]] Eigen::Matrix<double, 2, 3> jacobian(const Eigen::Vector3d& point) const override;

  /// Derivative of the pixel with respect to the camera's own numbers: fx fy cx cy skew, the 12 distortion terms, then
  /// rx ry rz tx ty tz, the rotation counted on the left, exp([r]x) rotation. [2 x 23]
  [[nodiscard]] Eigen::Matrix<double, 2, 23> jacobian_of_numbers(const Eigen::Vector3d& point) const;

  [[nodiscard]] const Intrinsics& intrinsics() const { return intrinsics_; }
  [[nodiscard]] const Pose& pose() const { return pose_; }
  /// The camera's centre in the specimen's frame [length].
  [[nodiscard]] Eigen::Vector3d centre() const { return -pose_.rotation.transpose() * pose_.translation; }
  /// Unit vector in the specimen's frame along which the camera sees `pixel`: the distortion is inverted by Newton's
  /// method. Throws InputError if no direction is seen there.
  [[nodiscard]] Eigen::Vector3d ray(const Eigen::Vector2d& pixel) const;

 private:
  Intrinsics intrinsics_;
  Pose pose_;
};

}  // namespace imic3d::imaging
