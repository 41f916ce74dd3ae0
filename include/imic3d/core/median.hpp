#pragma once
// The median of some values.

#include <algorithm>

namespace imic3d {

/// The upper one where their number is even; there is one at least. The values are put into another order.
template <class Values>
[[nodiscard]] auto median(Values&& values) {
  const auto middle = values.begin() + (values.end() - values.begin()) / 2;
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

}  // namespace imic3d
