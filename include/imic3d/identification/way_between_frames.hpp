#pragma once
// How a displacement that is known at the frames goes on between them.

#include <Eigen/Core>
#include <array>
#include <vector>

#include "imic3d/mesh/mesh.hpp"

namespace imic3d::identification {

/// By how much a displacement [dofs x frames] changes faster at the begin and at the end of the way to each frame than
/// on a straight one, in parts of the way (mechanics::LoadStep::bend) [dofs x frames, length]. Frame by frame it lies,
/// from rest on, on the monotone cubic interpolation of each degree over the length of the way of all of them, which
/// straight ways leave where the specimen begins to yield: so no degree goes beyond what the frames have, and what
/// moves in proportion goes straight. Where the motion turns back it begins anew. After Fritsch and Butland (1984), the
/// ends as Moler (2004), Numerical Computing with MATLAB, Sec. 3.6.
[[nodiscard]] std::array<Eigen::MatrixXd, 2> bends(const Eigen::MatrixXd& displacement);

/// The same for the driven `dofs` (3 * node + component, ascending) of a mesh, whatever their rigid motion: that of the
/// nodes that are driven along x and y (least squares of each frame) goes on evenly, its mean straight and its rotation
/// in the plane at a constant rate, and the bends are those of the displacement that is left, seen by who moves with it
/// and without a tilt through the thickness. `straight`: that goes straight. What else is driven goes straight. The arc
/// of a rotation by a is met but for a^4/384 of the radius.
[[nodiscard]] std::array<Eigen::MatrixXd, 2> bends(const Eigen::MatrixXd& displacement, const std::vector<int>& dofs,
                                                   const mesh::Nodes& nodes, bool straight = false);

}  // namespace imic3d::identification
