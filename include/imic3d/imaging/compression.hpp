#pragma once
// What was lost when an image was saved.

#include "imic3d/imaging/image.hpp"

namespace imic3d::imaging {

/// By how much more grey levels change across the borders of blocks of 8 x 8 px than within them [-], as JPEG
/// compression leaves them: third differences along rows and columns, medians over the blocks, the smaller of the two.
/// 0 where either is within four standard deviations, or the image has fewer than eight blocks either way. After Wang,
/// Bovik and Evans (2000), who look for the period of 8 px in the spectrum.
[[nodiscard]] double block_excess(const Image& image);

}  // namespace imic3d::imaging
