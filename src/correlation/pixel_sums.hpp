#pragma once
// Sums over the pixels of one element: what the pixels tell of a deformed image (b of Eq. 9) and of the reference (M of
// Eq. 8).

#include "bilinear.hpp"
#include "imic3d/correlation/correlation.hpp"

namespace imic3d::correlation {

/// Values of the pixels of an element, one after the other [count].
struct ElementPixels {
  int count;
  const float *xi, *eta;  ///< local coordinates
  const float* f;         ///< grey level of the reference
  const float *gx, *gy;   ///< gradient
};

/// The deformed image in an element. Grey levels are counted from some level, so that the moments keep their digits: a
/// of the reference, b of the deformed image, r = a - b.
struct ElementSums {
  /// sum of N_i (r, b, 1) gradient; b and one only if they are asked for
  Corners r = Corners::Zero(), b = r, one = r;
  double f = 0.0, g = 0.0, fg = 0.0, gg = 0.0, squares = 0.0;  ///< sums of a, b, ab, b^2, r^2
  /// pixels that are not NaN in g: the others are in no sum
  double seen = 0.0;
};
/// `g` [count]: the deformed image at the pixels; its precision is that of the sums.
[[nodiscard]] ElementSums sum_pixels(const ElementPixels& pixels, const float* g, float level, bool light);
[[nodiscard]] ElementSums sum_pixels(const ElementPixels& pixels, const double* g, float level, bool light);

/// Sums of N_i N_j (gx gx, gx gy, gy gy, 1) for i <= j.
[[nodiscard]] Gram sum_gram(const ElementPixels& pixels);

/// A map of the element at every pixel: c0 + c1 xi + c2 eta + c3 xi eta, `bilinear` [4], and what it has beyond that
/// (Bulge) [5], if not null.
void map_at(const ElementPixels& pixels, const float* bilinear, const float* beyond, float* values);
void map_at(const ElementPixels& pixels, const double* bilinear, const double* beyond, double* values);

}  // namespace imic3d::correlation
