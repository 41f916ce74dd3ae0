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

}  // namespace imic3d::correlation
