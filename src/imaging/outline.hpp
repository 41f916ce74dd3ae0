#pragma once
// The outline of a mesh: closed contours of points, the material on their left.

#include <Eigen/Core>
#include <vector>

namespace imic3d::imaging {

using Contour = std::vector<Eigen::Vector2d>;

struct OutlinePoint {
  Eigen::Vector2d place;   ///< [length]
  Eigen::Vector2d normal;  ///< unit, out of the material
  int contour;             ///< number of its contour
};

/// Points about `spacing` apart on curves through the contours' points (cubic Hermite; the mesh's edges are chords), at
/// least `margin` away from corners [length].
[[nodiscard]] std::vector<OutlinePoint> sample_outline(const std::vector<Contour>& contours, double spacing,
                                                       double margin);

/// Area inside, negative if the contour runs clockwise [length^2].
[[nodiscard]] double signed_area(const Contour& contour);

/// Points of a regular grid between `low` and `high` inside the contours (even-odd rule), about `wanted` of them
/// [length].
[[nodiscard]] std::vector<Eigen::Vector2d> points_inside(const std::vector<Contour>& contours,
                                                         const Eigen::Vector2d& low, const Eigen::Vector2d& high,
                                                         int wanted);

}  // namespace imic3d::imaging
