#include "imic3d/imaging/pinhole.hpp"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <cmath>
#include <limits>

#include "imic3d/core/error.hpp"

namespace imic3d::imaging {

namespace {

/// The distorted direction (x', y') and its derivative with respect to (x, y).
struct Distorted {
  Eigen::Vector2d position;
  Eigen::Matrix2d slope;
};

Distorted distort(const Intrinsics& lens, const Eigen::Vector2d& direction) {
  const auto& [k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4] = lens.distortion;
  const double x = direction[0], y = direction[1], r2 = x * x + y * y, r4 = r2 * r2;
  const double above = 1.0 + k1 * r2 + k2 * r4 + k3 * r4 * r2, below = 1.0 + k4 * r2 + k5 * r4 + k6 * r4 * r2;
  const double radial = above / below;
  const double radial_slope =
      ((k1 + 2.0 * k2 * r2 + 3.0 * k3 * r4) - radial * (k4 + 2.0 * k5 * r2 + 3.0 * k6 * r4)) / below;
  const Eigen::Vector2d of_r2(2.0 * x, 2.0 * y);  // d(r^2)/d(x, y)
  Distorted seen;
  seen.position << x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) + s1 * r2 + s2 * r4,
      y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y + s3 * r2 + s4 * r4;
  seen.slope.row(0) = (x * radial_slope + p2 + s1 + 2.0 * s2 * r2) * of_r2.transpose() +
                      Eigen::RowVector2d(radial + 2.0 * p1 * y + 4.0 * p2 * x, 2.0 * p1 * x);
  seen.slope.row(1) = (y * radial_slope + p1 + s3 + 2.0 * s4 * r2) * of_r2.transpose() +
                      Eigen::RowVector2d(2.0 * p2 * y, radial + 4.0 * p1 * y + 2.0 * p2 * x);
  return seen;
}

Eigen::Matrix2d sensor(const Intrinsics& lens) { return Eigen::Matrix2d{{lens.fx, lens.skew}, {0.0, lens.fy}}; }

}  // namespace

Pose operator*(const Pose& inner, const Pose& outer) {
  return {inner.rotation * outer.rotation, inner.rotation * outer.translation + inner.translation};
}

Pose inverse(const Pose& pose) { return {pose.rotation.transpose(), -pose.rotation.transpose() * pose.translation}; }

Eigen::Vector2d PinholeCamera::project(const Eigen::Vector3d& point) const {
  const Eigen::Vector3d seen = pose_.rotation * point + pose_.translation;
  if (!(seen[2] > 0.0)) return Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());
  const Eigen::Vector2d direction = seen.head<2>() / seen[2];
  return sensor(intrinsics_) * distort(intrinsics_, direction).position +
         Eigen::Vector2d(intrinsics_.cx, intrinsics_.cy);
}

Eigen::Matrix<double, 2, 3> PinholeCamera::jacobian(const Eigen::Vector3d& point) const {
  const Eigen::Vector3d seen = pose_.rotation * point + pose_.translation;
  if (!(seen[2] > 0.0)) return Eigen::Matrix<double, 2, 3>::Constant(std::numeric_limits<double>::quiet_NaN());
  const Eigen::Vector2d direction = seen.head<2>() / seen[2];
  Eigen::Matrix<double, 2, 3> of_point;  // d(direction)/d(seen)
  of_point << 1.0, 0.0, -direction[0], 0.0, 1.0, -direction[1];
  of_point /= seen[2];
  return sensor(intrinsics_) * distort(intrinsics_, direction).slope * of_point * pose_.rotation;
}

Eigen::Matrix<double, 2, 23> PinholeCamera::jacobian_of_numbers(const Eigen::Vector3d& point) const {
  const Eigen::Vector3d turned = pose_.rotation * point;
  const Eigen::Vector2d direction = (turned + pose_.translation).hnormalized();
  const Eigen::Vector2d position = distort(intrinsics_, direction).position;
  const auto& k = intrinsics_.distortion;
  const double x = direction[0], y = direction[1], r2 = x * x + y * y, r4 = r2 * r2, r6 = r4 * r2;
  const double below = 1.0 + k[5] * r2 + k[6] * r4 + k[7] * r6;
  const double slope = -(1.0 + k[0] * r2 + k[1] * r4 + k[4] * r6) / (below * below);
  Eigen::Matrix<double, 2, 12> of_terms;  // d(x', y')/d(k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4)
  of_terms << x * r2 / below, x * r4 / below, 2.0 * x * y, r2 + 2.0 * x * x, x * r6 / below, x * slope * r2,
      x * slope * r4, x * slope * r6, r2, r4, 0.0, 0.0, y * r2 / below, y * r4 / below, r2 + 2.0 * y * y, 2.0 * x * y,
      y * r6 / below, y * slope * r2, y * slope * r4, y * slope * r6, 0.0, 0.0, r2, r4;
  // d(pixel)/d(point in the camera's frame)
  const Eigen::Matrix<double, 2, 3> of_seen = jacobian(point) * pose_.rotation.transpose();
  Eigen::Matrix3d cross;
  // r x turned = cross r
  cross << 0.0, turned[2], -turned[1], -turned[2], 0.0, turned[0], turned[1], -turned[0], 0.0;
  Eigen::Matrix<double, 2, 23> derivative;
  derivative << position[0], 0.0, 1.0, 0.0, position[1], Eigen::RowVector<double, 12>::Zero(),
      Eigen::RowVector<double, 6>::Zero(), 0.0, position[1], 0.0, 1.0, 0.0, Eigen::RowVector<double, 12>::Zero(),
      Eigen::RowVector<double, 6>::Zero();
  derivative.middleCols<12>(5) = sensor(intrinsics_) * of_terms;
  derivative.middleCols<3>(17) = of_seen * cross;
  derivative.rightCols<3>() = of_seen;
  return derivative;
}

Eigen::Vector3d PinholeCamera::ray(const Eigen::Vector2d& pixel) const {
  const Eigen::Vector2d wanted =
      sensor(intrinsics_).inverse() * (pixel - Eigen::Vector2d(intrinsics_.cx, intrinsics_.cy));
  Eigen::Vector2d direction = wanted;
  for (int iteration = 0; iteration < 50; ++iteration) {
    const Distorted at = distort(intrinsics_, direction);
    const Eigen::Vector2d step = at.slope.partialPivLu().solve(wanted - at.position);
    direction += step;
    if (step.norm() < 1e-14) return (pose_.rotation.transpose() * direction.homogeneous()).normalized();
    if (!direction.allFinite()) break;
  }
  throw InputError("camera", fmt::format("no direction is seen at the pixel ({:.1f}, {:.1f})", pixel[0], pixel[1]),
                   "pixels that the lens distortion reaches");
}

}  // namespace imic3d::imaging
