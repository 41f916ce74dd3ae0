#include "pixel_sums.hpp"

#include <algorithm>
#include <cmath>

#include "imic3d/core/lanes.hpp"

#pragma GCC diagnostic ignored "-Wpsabi"  // functions of vectors are inlined

namespace imic3d::correlation {
namespace {

/// In single precision only sums of so many pixels.
constexpr int block = 256;

/// Nodal sums N_i w from those of (1, xi, eta, xi eta) w, the rows of `monomials`.
Corners nodal(const double (&monomials)[4][2]) {
  Corners result;
  for (int i = 0; i < 4; ++i)
    for (int k = 0; k < 2; ++k)
      result(i, k) = 0.25 * (monomials[0][k] + corner_xi[i] * monomials[1][k] + corner_eta[i] * monomials[2][k] +
                             corner_xi[i] * corner_eta[i] * monomials[3][k]);
  return result;
}

/// Calls `add(xi, eta, f, gx, gy, g)` with pointers to `lanes` pixels at a time; what is beyond the last pixel is NaN
/// in g and zero otherwise. `after` comes after every `block` pixels.
template <class Real, class Add, class After>
IMIC3D_INLINE void by_lanes(const ElementPixels& p, const Real* g, const Add& add, const After& after) {
  int i = 0;
  while (i + lanes <= p.count) {
    const int end = std::min(p.count, i + block);
    for (; i + lanes <= end; i += lanes) add(p.xi + i, p.eta + i, p.f + i, p.gx + i, p.gy + i, g + i);
    after();
  }
  if (i == p.count) return;
  float rest[5][lanes] = {};
  Real rest_of_g[lanes];
  const float* const all[5] = {p.xi, p.eta, p.f, p.gx, p.gy};
  std::fill(rest_of_g, rest_of_g + lanes, Real(NAN));
  for (int k = 0; k < 5; ++k) std::copy(all[k] + i, all[k] + p.count, rest[k]);
  std::copy(g + i, g + p.count, rest_of_g);
  add(rest[0], rest[1], rest[2], rest[3], rest[4], rest_of_g);
  after();
}

/// Sums of (1, xi, eta, xi eta) times a vector (x, y).
template <class Real>
struct Monomials {
  using Values = Lanes<Real>;
  Values x[4] = {}, y[4] = {};
  double sums[4][2] = {};
  IMIC3D_INLINE void add(const Values& dx, const Values& dy, const Values& xi, const Values& eta, const Values& both) {
    x[0] += dx, x[1] += dx * xi, x[2] += dx * eta, x[3] += dx * both;
    y[0] += dy, y[1] += dy * xi, y[2] += dy * eta, y[3] += dy * both;
  }
  IMIC3D_INLINE void flush() {
    for (int m = 0; m < 4; ++m) sums[m][0] += total(x[m]), sums[m][1] += total(y[m]), x[m] = y[m] = Values{};
  }
};

template <class Real>
IMIC3D_INLINE void sum_residual(const ElementPixels& p, const Real* image, float level, ElementSums& result) {
  using Values = Lanes<Real>;
  Monomials<Real> of_r;
  Doubles f{}, g{}, fg{}, gg{}, squares{};
  Values seen{};
  const Values zero{}, ones = zero + Real(1);
  by_lanes(
      p, image,
      [&](const float* xi_at, const float* eta_at, const float* grey, const float* gx, const float* gy,
          const Real* here) {
        const Values value = load<Real>(here), xi = load<Real>(xi_at), eta = load<Real>(eta_at);
        const auto is_seen = value == value;  // not NaN
        const Values a = is_seen ? load<Real>(grey) - level : zero, b = is_seen ? value - level : zero, r = a - b;
        of_r.add(r * load<Real>(gx), r * load<Real>(gy), xi, eta, xi * eta);
        seen += is_seen ? ones : zero;
        const Doubles A = doubles(a), B = doubles(b), R = doubles(r);
        f += A, g += B, fg += A * B, gg += B * B, squares += R * R;
      },
      [&] { of_r.flush(); });
  result.r = nodal(of_r.sums);
  result.f = total(f), result.g = total(g), result.fg = total(fg), result.gg = total(gg);
  result.squares = total(squares), result.seen = total(seen);
}

template <class Real>
IMIC3D_INLINE void sum_light(const ElementPixels& p, const Real* image, float level, ElementSums& result) {
  using Values = Lanes<Real>;
  Monomials<Real> of_b, of_one;
  const Values zero{};
  by_lanes(
      p, image,
      [&](const float* xi_at, const float* eta_at, const float*, const float* gx, const float* gy, const Real* here) {
        const Values value = load<Real>(here), xi = load<Real>(xi_at), eta = load<Real>(eta_at);
        const auto is_seen = value == value;
        const Values b = is_seen ? value - level : zero, dx = is_seen ? load<Real>(gx) : zero,
                     dy = is_seen ? load<Real>(gy) : zero;
        of_b.add(b * dx, b * dy, xi, eta, xi * eta);
        of_one.add(dx, dy, xi, eta, xi * eta);
      },
      [&] { of_b.flush(), of_one.flush(); });
  result.b = nodal(of_b.sums), result.one = nodal(of_one.sums);
}

IMIC3D_CLONES void residual_of(const ElementPixels& p, const float* image, float level, ElementSums& result) {
  sum_residual(p, image, level, result);
}
IMIC3D_CLONES void residual_of(const ElementPixels& p, const double* image, float level, ElementSums& result) {
  sum_residual(p, image, level, result);
}
IMIC3D_CLONES void light_of(const ElementPixels& p, const float* image, float level, ElementSums& result) {
  sum_light(p, image, level, result);
}
IMIC3D_CLONES void light_of(const ElementPixels& p, const double* image, float level, ElementSums& result) {
  sum_light(p, image, level, result);
}

/// Sums of xi^m eta^n (gx gx, gx gy, gy gy, 1) for m, n = 0, 1, 2.
IMIC3D_CLONES void sum_powers(const ElementPixels& p, double (&sums)[9][4]) {
  Doubles at[9][4] = {};
  const Floats zero{}, ones = zero + 1.0F;
  by_lanes(
      p, p.f,
      [&](const float* xi, const float* eta, const float*, const float* gx, const float* gy, const float* here) {
        const Floats value = load(here);
        const Doubles one = doubles(value == value ? ones : zero), x = doubles(load(xi)), y = doubles(load(eta));
        const Doubles dx = doubles(load(gx)), dy = doubles(load(gy)), weights[4] = {dx * dx, dx * dy, dy * dy, one};
        const Doubles powers[9] = {one, y, y * y, x, x * y, x * y * y, x * x, x * x * y, x * x * y * y};
        for (int m = 0; m < 9; ++m)
          for (int w = 0; w < 4; ++w) at[m][w] += powers[m] * weights[w];
      },
      [] {});
  for (int m = 0; m < 9; ++m)
    for (int w = 0; w < 4; ++w) sums[m][w] = total(at[m][w]);
}

template <class Real>
IMIC3D_INLINE void map_values(const ElementPixels& p, const Real* c, const Real* beyond, Real* __restrict values) {
  const float* const __restrict xi = p.xi, * const __restrict eta = p.eta;
#pragma omp simd
  for (int i = 0; i < p.count; ++i) {
    const Real x = xi[i], y = eta[i];
    values[i] = c[0] + c[1] * x + y * (c[2] + c[3] * x);
  }
  if (beyond == nullptr) return;
#pragma omp simd
  for (int i = 0; i < p.count; ++i) {
    const Real x = xi[i], y = eta[i], a = Real(1) - x * x, b = Real(1) - y * y;
    values[i] += a * (beyond[0] + beyond[1] * y) + b * (beyond[2] + beyond[3] * x) + beyond[4] * (a * b);
  }
}

IMIC3D_CLONES void values_of(const ElementPixels& p, const float* c, const float* beyond, float* values) {
  map_values(p, c, beyond, values);
}
IMIC3D_CLONES void values_of(const ElementPixels& p, const double* c, const double* beyond, double* values) {
  map_values(p, c, beyond, values);
}

template <class Real>
ElementSums sums_of(const ElementPixels& pixels, const Real* g, float level, bool light) {
  ElementSums sums;
  residual_of(pixels, g, level, sums);
  if (light) light_of(pixels, g, level, sums);
  return sums;
}

}  // namespace

ElementSums sum_pixels(const ElementPixels& pixels, const float* g, float level, bool light) {
  return sums_of(pixels, g, level, light);
}
ElementSums sum_pixels(const ElementPixels& pixels, const double* g, float level, bool light) {
  return sums_of(pixels, g, level, light);
}

Gram sum_gram(const ElementPixels& pixels) {
  double sums[9][4] = {};
  sum_powers(pixels, sums);
  Gram gram{};
  std::size_t pair = 0;
  for (int i = 0; i < 4; ++i)
    for (int j = i; j < 4; ++j, ++pair) {
      // N_i N_j = (1 + xi_i xi)(1 + xi_j xi)/4 (1 + eta_i eta)(1 + eta_j eta)/4
      const double x[3] = {0.25, 0.25 * (corner_xi[i] + corner_xi[j]), 0.25 * corner_xi[i] * corner_xi[j]};
      const double y[3] = {0.25, 0.25 * (corner_eta[i] + corner_eta[j]), 0.25 * corner_eta[i] * corner_eta[j]};
      for (int m = 0; m < 3; ++m)
        for (int n = 0; n < 3; ++n)
          for (std::size_t w = 0; w < 4; ++w) gram[pair][w] += x[m] * y[n] * sums[3 * m + n][w];
    }
  return gram;
}

void map_at(const ElementPixels& pixels, const float* bilinear, const float* beyond, float* values) {
  values_of(pixels, bilinear, beyond, values);
}
void map_at(const ElementPixels& pixels, const double* bilinear, const double* beyond, double* values) {
  values_of(pixels, bilinear, beyond, values);
}

}  // namespace imic3d::correlation
