#include "outline.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numbers>

namespace imic3d::imaging {

using Eigen::Vector2d;

namespace {

constexpr double corner_angle =
    30.0 * std::numbers::pi / 180.0;  // contours that turn more than this at a point have a corner there

double angle_between(const Vector2d& a, const Vector2d& b) {
  return std::abs(std::atan2(a.x() * b.y() - a.y() * b.x(), a.dot(b)));
}

}  // namespace

std::vector<OutlinePoint> sample_outline(const std::vector<Contour>& contours, double spacing, double margin) {
  std::vector<OutlinePoint> samples;
  for (std::size_t c = 0; c < contours.size(); ++c) {
    const auto& contour = contours[c];
    const std::size_t n = contour.size();
    const auto chord = [&](std::size_t i) -> Vector2d { return contour[(i + 1) % n] - contour[i % n]; };
    const auto is_corner = [&](std::size_t i) { return angle_between(chord(i + n - 1), chord(i)) > corner_angle; };
    // Unit tangent of the parabola through a point and its neighbours.
    const auto tangent = [&](std::size_t i) -> Vector2d {
      const Vector2d before = chord(i + n - 1), after = chord(i);
      return (before.normalized() * after.norm() + after.normalized() * before.norm()).normalized();
    };
    for (std::size_t i = 0; i < n; ++i) {
      const Vector2d along = chord(i);
      const double length = along.norm();
      const bool corner_before = is_corner(i), corner_after = is_corner(i + 1);
      Vector2d first = corner_before ? along : Vector2d(tangent(i) * length);
      Vector2d last = corner_after ? along : Vector2d(tangent(i + 1) * length);
      if (corner_before && !corner_after) first = 0.5 * (3.0 * along - last);
      if (corner_after && !corner_before) last = 0.5 * (3.0 * along - first);
      const int pieces = std::max(1, static_cast<int>(std::lround(length / spacing)));
      for (int k = 0; k < pieces; ++k) {
        const double t = (k + 0.5) / pieces;
        if ((corner_before && t * length < margin) || (corner_after && (1.0 - t) * length < margin)) continue;
        const Vector2d place = contour[i] + along * (t * t * (3.0 - 2.0 * t)) + first * (t * (1.0 - t) * (1.0 - t)) -
                               last * (t * t * (1.0 - t));
        const Vector2d slope =
            along * (6.0 * t * (1.0 - t)) + first * ((1.0 - t) * (1.0 - 3.0 * t)) + last * (t * (3.0 * t - 2.0));
        samples.push_back({place, Vector2d(slope.y(), -slope.x()).normalized(), static_cast<int>(c)});
      }
    }
  }
  return samples;
}

double signed_area(const Contour& contour) {
  double area = 0.0;
  for (std::size_t i = 0; i < contour.size(); ++i) {
    const Vector2d &a = contour[i], &b = contour[(i + 1) % contour.size()];
    area += 0.5 * (a.x() * b.y() - b.x() * a.y());
  }
  return area;
}

std::vector<Vector2d> points_inside(const std::vector<Contour>& contours, const Vector2d& low, const Vector2d& high,
                                    int wanted) {
  const Vector2d extent = high - low;
  const double step = std::sqrt(extent.x() * extent.y() / wanted);
  std::vector<Vector2d> inside;
  for (double y = low.y() + 0.5 * step; y < high.y(); y += step)
    for (double x = low.x() + 0.5 * step; x < high.x(); x += step) {
      bool odd = false;
      for (const auto& contour : contours)
        for (std::size_t i = 0; i < contour.size(); ++i) {
          const Vector2d &a = contour[i], &b = contour[(i + 1) % contour.size()];
          if ((a.y() > y) != (b.y() > y) && x < a.x() + (y - a.y()) * (b.x() - a.x()) / (b.y() - a.y())) odd = !odd;
        }
      if (odd) inside.push_back({x, y});
    }
  return inside;
}

}  // namespace imic3d::imaging
