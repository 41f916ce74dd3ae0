#pragma once
// Grey-level noise measured from frames between which nothing moved.

#include <span>

#include "imic3d/imaging/image.hpp"

namespace imic3d::imaging {

/// Standard deviation of the white noise of one frame [grey level] from at least two static frames of one size: root
/// mean square of the differences of consecutive frames over sqrt(2), their mean taken out, without the pixels that lie
/// beyond four deviations (found from the median absolute one on; a reflection, a moving edge). The rounding to
/// integers is part of it. Camera noise grows with brightness: give a `mask` (not 0 on the specimen) for the noise that
/// a correlation meets. Throws InputError (fewer than two frames, sizes that differ).
[[nodiscard]] double noise_of_static_frames(std::span<const Image> frames, const Image* mask = nullptr);

}  // namespace imic3d::imaging
