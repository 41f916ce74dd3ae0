#pragma once
// Coarser versions of an image.

#include <vector>

#include "imic3d/imaging/image.hpp"

namespace imic3d::imaging {

/// Half-size image by a step of a Gaussian pyramid (OpenCV pyrDown): its pixel (x, y) lies at (2x, 2y) of the original.
[[nodiscard]] Image half_size(const Image& image);
[[nodiscard]] std::vector<Image> half_sizes(const std::vector<Image>& images);

}  // namespace imic3d::imaging
