#include "imic3d/imaging/bspline.hpp"

#include <fmt/format.h>

#include <array>
#include <cmath>

namespace imic3d::imaging {
namespace {

const double pole = std::sqrt(3.0) - 2.0;
constexpr double gain = 6.0;
constexpr int lanes = 16;  // signals filtered side by side

using Lanes = Eigen::Array<double, lanes, 1>;

int mirrored(int i, int n) {
  if (n == 1) return 0;
  const int period = 2 * (n - 1);
  i = std::abs(i) % period;
  return i < n ? i : period - i;
}

// Samples to B-spline coefficients, in place, for `lanes` signals of the same length (Unser et al. 1993, Eqs 2.5-2.7).
void prefilter(std::vector<Lanes>& signal) {
  const int n = static_cast<int>(signal.size());
  if (n == 1) return;
  constexpr int horizon = 30;  // 0.268^30 is below the rounding of a double
  Lanes start = Lanes::Zero();
  for (int k = horizon; k >= 0; --k) start = signal[static_cast<std::size_t>(mirrored(k, n))] + pole * start;
  for (Lanes& s : signal) s *= gain;
  signal.front() = gain * start;
  for (std::size_t k = 1; k < signal.size(); ++k) signal[k] += pole * signal[k - 1];
  signal.back() = (pole / (pole * pole - 1.0)) * (signal.back() + pole * signal[signal.size() - 2]);
  for (std::size_t k = signal.size() - 1; k-- > 0;) signal[k] = pole * (signal[k + 1] - signal[k]);
}

}  // namespace

BSpline::BSpline(const Image& image) : width_(image.width), height_(image.height), stride_(image.width + 2 * border) {
  if (width_ < 1 || height_ < 1)
    throw InputError(image.path.empty() ? "image" : image.path.string(), fmt::format("{} x {} pixels", width_, height_),
                     "at least one pixel");
  const int rows = height_ + 2 * border;
  coefficients_.resize(static_cast<std::size_t>(stride_) * static_cast<std::size_t>(rows));
  const auto at = [this](int x, int y) -> float& {
    return coefficients_[static_cast<std::size_t>(static_cast<std::ptrdiff_t>(y + border) * stride_ + x + border)];
  };
#pragma omp parallel
  {
    std::vector<Lanes> signal(static_cast<std::size_t>(height_));
#pragma omp for schedule(static)
    for (int first = 0; first < width_; first += lanes) {
      const int count = std::min(lanes, width_ - first);
      for (int y = 0; y < height_; ++y)
        for (int lane = 0; lane < lanes; ++lane)
          signal[static_cast<std::size_t>(y)][lane] = image(first + std::min(lane, count - 1), y);
      prefilter(signal);
      for (int y = 0; y < height_; ++y)
        for (int lane = 0; lane < count; ++lane)
          at(first + lane, y) = static_cast<float>(signal[static_cast<std::size_t>(y)][lane]);
    }
    signal.resize(static_cast<std::size_t>(width_));
#pragma omp for schedule(static)
    for (int first = 0; first < height_; first += lanes) {
      const int count = std::min(lanes, height_ - first);
      for (int lane = 0; lane < lanes; ++lane)
        for (int x = 0; x < width_; ++x)
          signal[static_cast<std::size_t>(x)][lane] = at(x, first + std::min(lane, count - 1));
      prefilter(signal);
      for (int lane = 0; lane < count; ++lane) {
        for (int x = 0; x < width_; ++x)
          at(x, first + lane) = static_cast<float>(signal[static_cast<std::size_t>(x)][lane]);
        for (int k = 1; k <= border; ++k) {
          at(-k, first + lane) = at(mirrored(-k, width_), first + lane);
          at(width_ - 1 + k, first + lane) = at(mirrored(width_ - 1 + k, width_), first + lane);
        }
      }
    }
  }
  for (int k = 1; k <= border; ++k) {
    std::copy_n(&at(-border, mirrored(-k, height_)), stride_, &at(-border, -k));
    std::copy_n(&at(-border, mirrored(height_ - 1 + k, height_)), stride_, &at(-border, height_ - 1 + k));
  }
}

}  // namespace imic3d::imaging
