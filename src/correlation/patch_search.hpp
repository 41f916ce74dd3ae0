#pragma once
// A first guess of the displacement, from patches that are looked for all over the image.

#include <optional>

#include "imic3d/correlation/correlation.hpp"
#include "imic3d/imaging/image.hpp"

namespace imic3d::correlation {

/// Looks for patches of the reference, deformed as `U` says, within `reach` pixels of where U puts them, and adds to U
/// the affine motion that most of them agree on. Nothing if fewer than a third of the patches agree.
[[nodiscard]] std::optional<Eigen::VectorXd> search_patches(const Correlation& correlation,
                                                            const imaging::BSpline& reference,
                                                            const imaging::Image& image, const Eigen::VectorXd& U,
                                                            double reach);

}  // namespace imic3d::correlation
