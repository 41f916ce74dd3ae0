#include "imic3d/imaging/noise.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "imic3d/core/median.hpp"

namespace imic3d::imaging {
namespace {

// Variance of a - b over two.
double half_variance_of_difference(const Image& a, const Image& b, const Image* mask) {
  std::vector<float> difference;
  difference.reserve(a.grey.size());
  double mean = 0.0;
  for (std::size_t i = 0; i < a.grey.size(); ++i) {
    if (mask != nullptr && mask->grey[i] == 0.0F) continue;
    difference.push_back(a.grey[i] - b.grey[i]);
    mean += difference.back();
  }
  if (difference.empty()) return 0.0;
  mean /= static_cast<double>(difference.size());
  std::vector<float> magnitude(difference.size());
  for (std::size_t i = 0; i < difference.size(); ++i) magnitude[i] = std::abs(difference[i] - static_cast<float>(mean));
  // The median of integers is too coarse, for the deviation and for what lies outside too: it is where the search for
  // both begins.
  double scale = 1.4826 * static_cast<double>(median(magnitude)), sum = 0.0, count = 0.0;
  for (int round = 0; round < 5; ++round) {
    const auto within = static_cast<float>(4.0 * std::max(scale, 1.0));  // one grey level at least
    sum = 0.0, count = 0.0;
    for (const float m : magnitude)
      if (m <= within) sum += static_cast<double>(m) * m, count += 1.0;
    const double last = std::exchange(scale, std::sqrt(sum / std::max(1.0, count)));
    if (std::abs(scale - last) < 1e-3 * scale) break;
  }
  return count > 0.0 ? 0.5 * sum / count : 0.0;
}

}  // namespace

double noise_of_static_frames(std::span<const Image> frames, const Image* mask) {
  if (frames.size() < 2)
    throw InputError("static frames", fmt::format("{} frame", frames.size()), "at least two frames without motion");
  if (mask != nullptr && (mask->width != frames[0].width || mask->height != frames[0].height))
    throw InputError("mask", "another size than the frames", "the same");
  double variance = 0.0;
  for (std::size_t k = 1; k < frames.size(); ++k) {
    if (frames[k].header() != frames[0].header())
      throw InputError(frames[k].path.string(), "another size or depth than the first static frame", "the same");
    variance += half_variance_of_difference(frames[k - 1], frames[k], mask);
  }
  return std::sqrt(variance / static_cast<double>(frames.size() - 1));
}

}  // namespace imic3d::imaging
