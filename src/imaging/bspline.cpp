#include "imic3d/imaging/bspline.hpp"

#include <fmt/format.h>

#include <array>
#include <cmath>

#pragma GCC diagnostic ignored "-Wpsabi"  // functions of vectors are inlined

namespace imic3d::imaging {
namespace {

const double pole = std::sqrt(3.0) - 2.0;
constexpr double gain = 6.0;

int mirrored(int i, int n) {
  if (n == 1) return 0;
  const int period = 2 * (n - 1);
  i = std::abs(i) % period;
  return i < n ? i : period - i;
}

constexpr int most_together = 256;  // signals filtered side by side

// Samples to B-spline coefficients (Unser et al. 1993, Eqs 2.5-2.7) of `count` signals of n samples; sample k of all
// signals stands in a row, samples + k samples_stride. May be done in place.
IMIC3D_CLONES void prefilter(const float* samples, std::ptrdiff_t samples_stride, float* c, std::ptrdiff_t stride,
                             int n, int count) {
  if (n == 1) {
    std::copy_n(samples, count, c);
    return;
  }
  const double z = pole, last = z / (z * z - 1.0);
  double state[most_together] = {};
  constexpr int horizon = 30;  // 0.268^30 is below the rounding of a double
  for (int k = horizon; k >= 0; --k) {
    const float* const row = samples + mirrored(k, n) * samples_stride;
    for (int i = 0; i < count; ++i) state[i] = static_cast<double>(row[i]) + z * state[i];
  }
  for (int i = 0; i < count; ++i) state[i] *= gain, c[i] = static_cast<float>(state[i]);
  for (int k = 1; k < n; ++k) {
    const float* const row = samples + k * samples_stride;
    float* const to = c + k * stride;
    for (int i = 0; i < count; ++i)
      state[i] = gain * static_cast<double>(row[i]) + z * state[i], to[i] = static_cast<float>(state[i]);
  }
  float* const end = c + (n - 1) * stride;
  for (int i = 0; i < count; ++i) {
    state[i] = last * (state[i] + z * static_cast<double>(end[i - stride]));
    end[i] = static_cast<float>(state[i]);
  }
  for (int k = n - 2; k >= 0; --k) {
    float* const to = c + k * stride;
    for (int i = 0; i < count; ++i)
      state[i] = z * (state[i] - static_cast<double>(to[i])), to[i] = static_cast<float>(state[i]);
  }
}

/// The four cubic B-splines that reach a cell, times 6, at t in [0, 1].
template <class Real>
struct Weights {
  Lanes<Real> w[4];
  IMIC3D_INLINE explicit Weights(const Lanes<Real>& t) {
    const Lanes<Real> s = Real(1) - t;
    w[0] = s * s * s, w[3] = t * t * t;
    w[1] = Real(4) + t * t * (Real(3) * t - Real(6));
    w[2] = Real(6) - w[0] - w[1] - w[3];
  }
};

// `corner`: coefficient (column - 1, row - 1).
template <class Real>
IMIC3D_INLINE void interpolate_row(const float* corner, std::ptrdiff_t stride, const Real* dx, const Real* dy,
                                   int count, Real* values) {
  for (int i = 0; i < count;) {
    const Real whole_x = std::floor(dx[i]), whole_y = std::floor(dy[i]);
    const float* const c =
        corner + i + static_cast<std::ptrdiff_t>(whole_x) + static_cast<std::ptrdiff_t>(whole_y) * stride;
    const Lanes<Real> tx = load<Real>(dx + i) - whole_x, ty = load<Real>(dy + i) - whole_y;
    const Weights<Real> x(tx), y(ty);
    Lanes<Real> sum{};
    for (int j = 0; j < 4; ++j) {
      const float* const line = c + j * stride;
      sum += y.w[j] * (x.w[0] * load<Real>(line) + x.w[1] * load<Real>(line + 1) + x.w[2] * load<Real>(line + 2) +
                       x.w[3] * load<Real>(line + 3));
    }
    store<Real>(sum * (Real(1) / Real(36)), values + i);
    // Those that lie in another cell are done in the next turn.
    const auto own = (tx >= Real(0)) & (tx <= Real(1)) & (ty >= Real(0)) & (ty <= Real(1));
    int done = 0;
    auto all = own[0];
    for (int l = 1; l < lanes; ++l) all &= own[l];
    if (all != 0)
      done = lanes;
    else
      while (done < lanes && own[done] != 0) ++done;
    i += std::max(1, done);
  }
}

IMIC3D_CLONES void row_of(const float* corner, std::ptrdiff_t stride, const float* dx, const float* dy, int count,
                          float* values) {
  interpolate_row(corner, stride, dx, dy, count, values);
}
IMIC3D_CLONES void row_of(const float* corner, std::ptrdiff_t stride, const double* dx, const double* dy, int count,
                          double* values) {
  interpolate_row(corner, stride, dx, dy, count, values);
}

// `above`: coefficient (column - 1, row - 1). At a pixel the splines are 1/6, 2/3, 1/6, their slopes -1/2, 0, 1/2 and
// their second derivatives 1, -2, 1.
IMIC3D_CLONES void curvature_of(const float* above, std::ptrdiff_t stride, int count, float xx, float xy, float yy,
                                float* values) {
  const float side_x = (4.0F * xx - 2.0F * yy) / 6.0F, side_y = (4.0F * yy - 2.0F * xx) / 6.0F,
              middle = -8.0F * (xx + yy) / 6.0F;
  const float falling = (xx + yy) / 6.0F + 0.5F * xy, rising = (xx + yy) / 6.0F - 0.5F * xy;
  const float *const at = above + stride, *const below = at + stride;
  for (int i = 0; i < count; i += lanes)
    store(falling * (load(above + i) + load(below + i + 2)) + rising * (load(above + i + 2) + load(below + i)) +
              side_x * (load(at + i) + load(at + i + 2)) + side_y * (load(above + i + 1) + load(below + i + 1)) +
              middle * load(at + i + 1),
          values + i);
}

}  // namespace

void BSpline::shifted_row(int column, int row, const float* dx, const float* dy, int count, float* values) const {
  row_of(corner(column, row), stride_, dx, dy, count, values);
}
void BSpline::shifted_row(int column, int row, const double* dx, const double* dy, int count, double* values) const {
  row_of(corner(column, row), stride_, dx, dy, count, values);
}

void BSpline::curvature_row(int column, int row, int count, float xx, float xy, float yy, float* values) const {
  curvature_of(corner(column, row), stride_, count, xx, xy, yy, values);
}

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
#pragma omp for schedule(static)
    for (int first = 0; first < width_; first += most_together)
      prefilter(image.grey.data() + first, width_, &at(first, 0), stride_, height_,
                std::min(most_together, width_ - first));
    // Rows of the image, turned so that they lie side by side.
    constexpr int rows_together = 16;
    std::vector<float> turned(static_cast<std::size_t>(width_) * rows_together);
#pragma omp for schedule(static)
    for (int first = 0; first < height_; first += rows_together) {
      const int count = std::min(rows_together, height_ - first);
      const auto turn = [&](const auto& copy) {  // by squares that stay in the cache
        for (int x0 = 0; x0 < width_; x0 += rows_together)
          for (int k = 0; k < count; ++k)
            for (int x = x0; x < std::min(width_, x0 + rows_together); ++x)
              copy(turned[static_cast<std::size_t>(x) * rows_together + static_cast<std::size_t>(k)], at(x, first + k));
      };
      turn([](float& here, const float& there) { here = there; });
      prefilter(turned.data(), rows_together, turned.data(), rows_together, width_, count);
      turn([](const float& here, float& there) { there = here; });
      for (int y = first; y < first + count; ++y)
        for (int k = 1; k <= border; ++k) {
          at(-k, y) = at(mirrored(-k, width_), y);
          at(width_ - 1 + k, y) = at(mirrored(width_ - 1 + k, width_), y);
        }
    }
  }
  for (int k = 1; k <= border; ++k) {
    std::copy_n(&at(-border, mirrored(-k, height_)), stride_, &at(-border, -k));
    std::copy_n(&at(-border, mirrored(height_ - 1 + k, height_)), stride_, &at(-border, height_ - 1 + k));
  }
}

}  // namespace imic3d::imaging
