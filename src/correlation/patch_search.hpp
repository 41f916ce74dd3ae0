#pragma once
// A first guess of the displacement, from patches that are looked for all over the image.

#include <optional>

#include "imic3d/correlation/correlation.hpp"
#include "imic3d/imaging/image.hpp"

namespace imic3d::correlation {

/// Looks for patches of the reference, deformed as `U` says, within `reach` pixels of where U puts them. Returns where
/// the nodes are then [nodes x 2, px from their place in the reference]: as U says and moved by the affine motion that
/// most patches agree on, or by a quadratic one if clearly more agree on that. Nothing if fewer than a third of the
/// patches agree.
[[nodiscard]] std::optional<InImage> search_patches(const Correlation& correlation, const imaging::BSpline& reference,
                                                    const imaging::Image& image, const Eigen::VectorXd& U,
                                                    double reach);

}  // namespace imic3d::correlation
