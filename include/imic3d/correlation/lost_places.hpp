#pragma once
// Places of the surface that show the reference's speckle no more: paint that came off, a reflection, a mark.

#include <vector>

#include "imic3d/correlation/cameras.hpp"
#include "imic3d/correlation/global_dic.hpp"

namespace imic3d::correlation {

/// Elements on which the frames cannot rely [elements, 0 or 1], for DicOptions::left_out; empty: none.
///
/// An element is lost in a frame if, in one of the cameras, what is left of its grey levels is more than three times
/// what is left in the median element and has more variance than its speckle (f and g correlate by less than a half:
/// r^2 > var f). So are those that hang together with it and of which the former holds, and the neighbours of these
/// where one and a half times the median is left: they are spoilt in part. A frame in which more than a quarter of the
/// elements are lost, and one that is lost as a whole, tells nothing of places. What hangs together is left out if it
/// is lost in more than a fifth of the frames, and in more than one: a specimen that cracks in the last of many keeps
/// the place in all others.
[[nodiscard]] std::vector<char> lost_elements(const Cameras& cameras, const std::vector<DicFrame>& frames);

/// The marked elements of a surface [elements, 0 or 1] by what hangs together at nodes.
[[nodiscard]] std::vector<std::vector<int>> patches(const mesh::Mesh& surface, const std::vector<char>& marked);

}  // namespace imic3d::correlation
