#include "imic3d/imaging/placement.hpp"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>

#include "imic3d/core/linear.hpp"
#include "plane_map.hpp"

namespace imic3d::imaging {

using Eigen::Matrix2d;
using Eigen::Vector2d;

Matrix2d similarity(double pixel_size, double rotation, bool flip) {
  const double c = std::cos(rotation), s = std::sin(rotation);
  Matrix2d linear;
  linear << c, -s, -s, -c;
  if (flip) linear.row(0) *= -1.0;
  return linear / pixel_size;
}

TelecentricCamera camera_of(const PlaneMap& map) {
  TelecentricCamera camera;
  camera.linear.leftCols<2>() = map.linear;
  camera.offset = map.offset;
  return camera;
}

void describe(const PlaneMap& map, bool flip, Placement& placement) {
  placement.camera = camera_of(map);
  placement.pixel_size = 1.0 / std::sqrt(std::abs(map.linear.determinant()));
  const double sign = flip ? -1.0 : 1.0;
  placement.rotation =
      std::atan2(-map.linear(1, 0) - sign * map.linear(0, 1), sign * map.linear(0, 0) - map.linear(1, 1)) / degree;
  const Vector2d magnifications = singular_values(map.linear);
  placement.eccentricity = 2.0 * (magnifications[0] - magnifications[1]) / magnifications.sum();
}

TelecentricCamera camera_from_pose(double pixel_size, const Vector2d& origin, double rotation, bool flip) {
  if (!(pixel_size > 0.0))
    throw InputError("pixel_size", fmt::format("{}", pixel_size), "a positive number [length/px]");
  return camera_of({similarity(pixel_size, rotation * degree, flip), origin});
}

Placement place_by_points(std::span<const std::array<double, 4>> points, bool flip) {
  const auto count = static_cast<Eigen::Index>(points.size());
  if (count < 2) throw InputError("place.points", fmt::format("{} points", count), "2 or more: x, y, column, row");
  Vector2d centre = Vector2d::Zero(), centre_pixel = Vector2d::Zero();
  for (const auto& p : points) {
    centre += Vector2d(p[0], p[1]) / static_cast<double>(count);
    centre_pixel += Vector2d(p[2], p[3]) / static_cast<double>(count);
  }
  Eigen::MatrixX2d from(count, 2), to(count, 2);
  for (Eigen::Index i = 0; i < count; ++i) {
    const auto& p = points[static_cast<std::size_t>(i)];
    from.row(i) = Vector2d(p[0], p[1]) - centre;
    to.row(i) = Vector2d(p[2], p[3]) - centre_pixel;
  }
  PlaneMap map;
  if (count == 2) {
    // With z = x + i y and w = column - i row (mirrored: -column - i row), w = factor * z.
    const Vector2d z = from.row(1) - from.row(0), pixel = to.row(1) - to.row(0);
    const Vector2d w((flip ? -1.0 : 1.0) * pixel.x(), -pixel.y());
    if (z.norm() == 0.0 || w.norm() == 0.0)
      throw InputError("place.points", "two points that coincide", "points apart");
    const double rotation = std::atan2(z.x() * w.y() - z.y() * w.x(), z.dot(w));
    map.linear = similarity(z.norm() / w.norm(), rotation, flip);
  } else {
    const auto on_a_line = [](const Eigen::VectorXd& extent) { return extent[1] <= 1e-6 * extent[0]; };
    if (on_a_line(singular_values(from)) || on_a_line(singular_values(to)))
      throw InputError("place.points", "points that lie on one line", "two points, or three that span a triangle");
    map.linear = least_squares(from, to).transpose();
    if ((map.linear.determinant() > 0.0) != flip)
      throw InputError("place.points", flip ? "an image that is not mirrored" : "a mirrored image",
                       "rows counted from the top downwards and columns from the left, or the other value of flip");
  }
  map.offset = centre_pixel - map.linear * centre;

  Placement placement;
  placement.agreeing = placement.visible = placement.tried = static_cast<int>(count);
  double squares = 0.0;
  for (const auto& p : points) squares += (map(Vector2d(p[0], p[1])) - Vector2d(p[2], p[3])).squaredNorm();
  placement.rms = std::sqrt(squares / static_cast<double>(count));
  describe(map, flip, placement);
  return placement;
}

std::vector<Mistake> check_on_image(const Camera& camera, std::span<const Eigen::Vector3d> points,
                                    const ImageHeader& image, const std::string& name) {
  Vector2d low = Vector2d::Constant(std::numeric_limits<double>::infinity()), high = -low;
  std::size_t outside = 0;
  for (const auto& point : points) {
    const Vector2d pixel = camera.project(point);
    low = low.cwiseMin(pixel);
    high = high.cwiseMax(pixel);
    // Written so that a NaN is outside.
    if (!(pixel.x() >= -0.5 && pixel.y() >= -0.5 && pixel.x() <= image.width - 0.5 && pixel.y() <= image.height - 0.5))
      ++outside;
  }
  if (outside == 0) return {};
  return {{name,
           fmt::format("a mesh that does not lie on the image: {} of {} nodes are outside; columns {:.1f} to {:.1f}, "
                       "rows {:.1f} to {:.1f}",
                       outside, points.size(), low.x(), high.x(), low.y(), high.y()),
           fmt::format("columns 0 to {}, rows 0 to {}", image.width - 1, image.height - 1)}};
}

}  // namespace imic3d::imaging
