#pragma once
// How a displacement that is known at the frames goes on between them.

#include <Eigen/Core>
#include <array>

namespace imic3d::identification {

/// By how much a displacement [dofs x frames] changes faster at the begin and at the end of the way to each frame than on a straight one, in parts of the
/// way (mechanics::LoadStep::bend) [dofs x frames, length]. Frame by frame it lies, from rest on, on the monotone cubic interpolation of each degree over the length of
/// the way of all of them, which straight ways leave where the specimen begins to yield: so no degree goes beyond what the frames have, and what moves
/// in proportion goes straight. Where the motion turns back it begins anew. After Fritsch and Butland (1984), the ends as Moler (2004), Numerical Computing with MATLAB, Sec. 3.6.
[[nodiscard]] std::array<Eigen::MatrixXd, 2> bends(const Eigen::MatrixXd& displacement);

}  // namespace imic3d::identification
