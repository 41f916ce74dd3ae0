#pragma once
// The bilinear map of a four-node element.

#include <Eigen/Core>

namespace imic3d::correlation {

using Corners = Eigen::Matrix<double, 4, 2>;  // positions of an element's nodes

inline const Eigen::Vector4d corner_xi(-1.0, 1.0, 1.0, -1.0), corner_eta(-1.0, -1.0, 1.0, 1.0);

/// A nodal field of one element as c0 + c1 xi + c2 eta + c3 xi eta.
inline Eigen::Vector4d bilinear(const Eigen::Vector4d& nodal) {
  return 0.25 * Eigen::Vector4d(nodal.sum(), corner_xi.dot(nodal), corner_eta.dot(nodal),
                                corner_xi.cwiseProduct(corner_eta).dot(nodal));
}

/// dN/d(xi, eta) at the element's centre [4 x 2].
inline Corners central_slopes() {
  Corners slopes;
  slopes << corner_xi / 4, corner_eta / 4;
  return slopes;
}

/// What a smooth map of an element has beyond its bilinear part: the biquadratic through the middles of the edges and
/// the centre. A perspective camera makes such maps of a bilinear surface; the rest is of third order in the element's
/// size.
struct Bulge {
  /// Where it is evaluated: middles of the edges 01, 12, 23, 30, then the centre.
  static constexpr double xi[5] = {0.0, 1.0, 0.0, -1.0, 0.0}, eta[5] = {-1.0, 0.0, 1.0, 0.0, 0.0};
  Eigen::Matrix<double, 5, 2> coefficients = Eigen::Matrix<double, 5, 2>::Zero();

  Bulge() = default;
  /// `beyond` [5 x 2]: the map at these places less its bilinear part.
  explicit Bulge(const Eigen::Matrix<double, 5, 2>& beyond) {
    const auto row = [&](int k) { return beyond.row(k); };
    auto& c = coefficients;
    c.row(0) = 0.5 * (row(0) + row(2));
    c.row(1) = 0.5 * (row(2) - row(0));
    c.row(2) = 0.5 * (row(1) + row(3));
    c.row(3) = 0.5 * (row(1) - row(3));
    c.row(4) = row(4) - c.row(0) - c.row(2);
  }
  [[nodiscard]] Eigen::Vector2f at(float x, float y) const {
    const float a = 1.0F - x * x, b = 1.0F - y * y;
    Eigen::Matrix<float, 1, 5> shape;
    shape << a, a * y, b, b * x, a * b;
    return (shape * coefficients.cast<float>()).transpose();
  }
};

}  // namespace imic3d::correlation
