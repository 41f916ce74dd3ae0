#include "imic3d/imaging/compression.hpp"

#include <algorithm>
#include <cmath>

#include "imic3d/core/median.hpp"

namespace imic3d::imaging {
namespace {

constexpr int side = 8;  // of a block [px]

/// Sums over each column of the third difference to the right, about the border between the next two; or over rows.
std::vector<double> third_differences(const Image& image, bool of_columns) {
  const int dx = of_columns ? 1 : 0, dy = 1 - dx, width = image.width - 3 * dx, height = image.height - 3 * dy;
  std::vector<double> sums(static_cast<std::size_t>(std::max(0, of_columns ? width : height)), 0.0);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      sums[static_cast<std::size_t>(of_columns ? x : y)] +=
          std::abs(image(x, y) - 3.0F * image(x + dx, y + dy) + 3.0F * image(x + 2 * dx, y + 2 * dy) -
                   image(x + 3 * dx, y + 3 * dy));
  return sums;
}

/// Of the border that shows most, wherever the image was cut out.
double excess(const std::vector<double>& differences) {
  const std::size_t blocks = differences.size() / side;
  if (blocks < side) return 0.0;
  double largest = 0.0, deviations = 4.0;
  for (std::size_t border = 0; border < side; ++border) {
    std::vector<double> ratio;
    for (std::size_t b = 0; b < blocks; ++b) {
      double within = 0.0;
      for (std::size_t x = 0; x < side; ++x) within += x == border ? 0.0 : differences[side * b + x] / (side - 1);
      ratio.push_back(within > 0.0 ? differences[side * b + border] / within - 1.0 : 0.0);
    }
    const double middle = median(ratio);
    std::vector<double> from_it;
    for (const double one : ratio) from_it.push_back(std::abs(one - middle));
    const double deviation = 1.2533 * 1.4826 * median(from_it) / std::sqrt(static_cast<double>(blocks));  // of a median
    if (middle > deviations * deviation && deviation > 0.0) largest = middle, deviations = middle / deviation;
  }
  return largest;
}

}  // namespace

double block_excess(const Image& image) {
  return std::min(excess(third_differences(image, true)), excess(third_differences(image, false)));
}

}  // namespace imic3d::imaging
