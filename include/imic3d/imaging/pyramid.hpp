#pragma once
// Coarser versions of an image.

#include "imic3d/imaging/image.hpp"

namespace imic3d::imaging {

/// Half-size image by a step of a Gaussian pyramid (OpenCV pyrDown): its pixel (x, y) lies at (2x, 2y) of the original.
[[nodiscard]] Image half_size(const Image& image);

}  // namespace imic3d::imaging
