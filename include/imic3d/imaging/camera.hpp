#pragma once
// Cameras: from points of the specimen to pixels.

#include <Eigen/Core>
#include <memory>

namespace imic3d::imaging {

/// Maps a point of the specimen [length] to a position in the image [px]; the centre of the upper left pixel is (0, 0),
/// x to the right (column), y downwards (row).
class Camera {
 public:
  virtual ~Camera() = default;
  [[nodiscard]] virtual Eigen::Vector2d project(const Eigen::Vector3d& point) const = 0;
  /// d(pixel)/d(point) [px/length].
  [[nodiscard]] virtual Eigen::Matrix<double, 2, 3> jacobian(const Eigen::Vector3d& point) const = 0;
  /// Whether `project` is affine, so that what is bilinear on the specimen is bilinear in the image.
  [[nodiscard]] virtual bool affine() const { return false; }
};

/// A telecentric camera: pixel = linear * point + offset (Sec. 3.1).
class TelecentricCamera final : public Camera {
 public:
  Eigen::Matrix<double, 2, 3> linear = Eigen::Matrix<double, 2, 3>::Zero();  ///< [px/length]
  Eigen::Vector2d offset = Eigen::Vector2d::Zero();                          ///< [px]
  [[nodiscard]] Eigen::Vector2d project(const Eigen::Vector3d& point) const override { return linear * point + offset; }
  [[nodiscard]] Eigen::Matrix<double, 2, 3> jacobian(const Eigen::Vector3d&) const override { return linear; }
  [[nodiscard]] bool affine() const override { return true; }
};

}  // namespace imic3d::imaging
