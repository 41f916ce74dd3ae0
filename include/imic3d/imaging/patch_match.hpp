#pragma once
// Where a small patch lies in a larger image.

#include "imic3d/imaging/image.hpp"

namespace imic3d::imaging {

/// The best place of a patch: centre of the patch in the image [px], and the zero-mean normalised correlation there.
struct PatchMatch {
  double x = 0.0, y = 0.0;
  double score = -1.0;  ///< 1: identical up to gain and offset; -1: nothing was found
};

/// Searches `patch` in `image` with its centre within `reach` pixels of (x, y), by zero-mean normalised
/// cross-correlation; the peak is refined by a parabola. Score -1 if no part of the image that large lies within reach.
[[nodiscard]] PatchMatch match_patch(const Image& patch, const Image& image, double x, double y, double reach);

}  // namespace imic3d::imaging
