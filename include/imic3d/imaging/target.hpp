#pragma once
// Flat calibration targets and how they are found in an image.

#include <Eigen/Core>
#include <vector>

#include "imic3d/imaging/image.hpp"

namespace imic3d::imaging {

enum class TargetType { chessboard, circles, asymmetric_circles };

/// A flat target in the plane z = 0 of its own frame: x along a row, y from row to row.
struct Target {
  TargetType type = TargetType::chessboard;
  int rows = 0, columns = 0;  ///< inner corners, or circles
  /// From corner to corner, or from centre to centre; asymmetric circles: from row to row, half the way along a row.
  double spacing = 1.0;
  double diameter = 0.0;  ///< of a circle; 0: not known [as spacing]

  /// Point j of row i is number i columns + j.
  [[nodiscard]] std::vector<Eigen::Vector3d> points() const;
  /// Orders in which a finder may number the points: the rotations that take the grid onto itself, the identity first.
  /// Number k of an order is the target's point that stands k-th.
  [[nodiscard]] std::vector<std::vector<int>> orders() const;
};

/// Pixels of the target's points, rows of the target from left to right seen as a right-handed frame (its z away from
/// the camera); empty if the target is not found. Chessboard: OpenCV's findChessboardCornersSB (Duda and Frese 2018).
/// Circles, dark or bright: OpenCV's findCirclesGrid, then the centroid of each blob's grey levels.
[[nodiscard]] std::vector<Eigen::Vector2d> find_target(const Target& target, const Image& image);

}  // namespace imic3d::imaging
