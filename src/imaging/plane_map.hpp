#pragma once
// The map of a specimen's plane onto the image of a telecentric camera.

#include <Eigen/Core>
#include <numbers>

#include "imic3d/imaging/placement.hpp"

namespace imic3d::imaging {

inline constexpr double degree = std::numbers::pi / 180.0;

/// pixel = linear * point + offset.
struct PlaneMap {
  Eigen::Matrix2d linear = Eigen::Matrix2d::Zero();
  Eigen::Vector2d offset = Eigen::Vector2d::Zero();
  [[nodiscard]] Eigen::Vector2d operator()(const Eigen::Vector2d& point) const { return linear * point + offset; }
};

/// `rotation` [radian]; y up in the specimen is up in the image, where rows run downwards.
[[nodiscard]] Eigen::Matrix2d similarity(double pixel_size, double rotation, bool flip);
[[nodiscard]] TelecentricCamera camera_of(const PlaneMap& map);
/// Fills in what a linear map says of magnification and rotation.
void describe(const PlaneMap& map, bool flip, Placement& placement);

}  // namespace imic3d::imaging
