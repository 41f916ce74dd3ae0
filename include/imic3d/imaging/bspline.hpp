#pragma once
// Cubic B-spline interpolation of an image.

#include <Eigen/Core>
#include <algorithm>
#include <vector>

#include "imic3d/core/lanes.hpp"
#include "imic3d/imaging/image.hpp"

namespace imic3d::imaging {

/// The interpolating cubic B-spline of an image: passes through every pixel, twice continuously differentiable, exact
/// for cubic polynomials away from the border. Prefilter by the recursive filter of Unser, Aldroubi and Eden (IEEE
/// Trans. Signal Process. 41, 1993) with mirror boundaries; coefficients in float. Positions in pixels, the centre of
/// the upper left pixel is (0, 0). A position outside the image is moved to the nearest one inside: ask `contains`
/// first.
class BSpline {
 public:
  struct Sample {
    float value;            ///< [grey level]
    Eigen::Vector2f slope;  ///< d/dx, d/dy [grey level/px]
  };

  BSpline() = default;
  explicit BSpline(const Image& image);

  [[nodiscard]] int width() const { return width_; }
  [[nodiscard]] int height() const { return height_; }
  [[nodiscard]] bool contains(double x, double y) const {
    return x >= 0.0 && y >= 0.0 && x <= width_ - 1 && y <= height_ - 1;
  }

  template <class Real = float>
  [[nodiscard]] Real value(double x, double y) const {
    return interpolate<Real>(locate(x, y));
  }
  /// values[i] at (column + i + dx[i], row + dy[i]) for i < count, without any check: all positions at least one pixel
  /// inside. For the pixel loops: neighbours that share their integer shift are interpolated side by side. dx, dy and
  /// values have `lanes` - 1 elements beyond `count`, which are read and overwritten.
  void shifted_row(int column, int row, const float* dx, const float* dy, int count, float* values) const;
  void shifted_row(int column, int row, const double* dx, const double* dy, int count, double* values) const;
  /// values[i] = xx d2/dx2 + 2 xy d2/dxdy + yy d2/dy2 at the pixel (column + i, row) for i < count, without any check.
  /// values has `lanes` - 1 elements beyond `count`, which are overwritten.
  void curvature_row(int column, int row, int count, float xx, float xy, float yy, float* values) const;
  /// (d/dx, d/dy) [grey level/px].
  [[nodiscard]] Eigen::Vector2f gradient(double x, double y) const { return sample(x, y).slope; }
  /// Value and gradient together.
  [[nodiscard]] Sample sample(double x, double y) const {
    const Cell cell = locate(x, y);
    const auto tx = static_cast<float>(cell.tx), ty = static_cast<float>(cell.ty);
    const Four wx = weights(tx), wy = weights(ty), dx = slopes(tx), dy = slopes(ty);
    const Four c0 = line(cell, 0), c1 = line(cell, 1), c2 = line(cell, 2), c3 = line(cell, 3);
    const Four across = wy[0] * c0 + wy[1] * c1 + wy[2] * c2 + wy[3] * c3;
    const Four down = dy[0] * c0 + dy[1] * c1 + dy[2] * c2 + dy[3] * c3;
    return {(wx * across).sum(), Eigen::Vector2f((dx * across).sum(), (wx * down).sum())};
  }

 private:
  using Four = Eigen::Array4f;
  // coefficients kept beyond each edge, so that no evaluation asks where it is
  static constexpr int border = 2;

  struct Cell {
    const float* corner;  // coefficient (column - 1, row - 1)
    double tx, ty;
  };
  [[nodiscard]] Cell locate(double x, double y) const {
    x = std::clamp(x, 0.0, static_cast<double>(width_ - 1));
    y = std::clamp(y, 0.0, static_cast<double>(height_ - 1));
    const int column = static_cast<int>(x), row = static_cast<int>(y);
    return {corner(column, row), x - column, y - row};
  }
  [[nodiscard]] const float* corner(int column, int row) const {
    return coefficients_.data() + (row + border - 1) * stride_ + column + border - 1;
  }
  template <class Real>
  [[nodiscard]] Real interpolate(const Cell& cell) const {
    const auto wx = weights(static_cast<Real>(cell.tx)), wy = weights(static_cast<Real>(cell.ty));
    const auto row = [&](int j) { return line(cell, j).template cast<Real>().eval(); };
    return (wx * (wy[0] * row(0) + wy[1] * row(1) + wy[2] * row(2) + wy[3] * row(3))).sum();
  }
  [[nodiscard]] Four line(const Cell& cell, int j) const { return Eigen::Map<const Four>(cell.corner + j * stride_); }
  // The four cubic B-splines that reach the cell, as polynomials of t in [0, 1).
  template <class Real>
  [[nodiscard]] static Eigen::Array<Real, 4, 1> weights(Real t) {
    static const Eigen::Array<Real, 4, 1> a(Real(1) / 6, Real(2) / 3, Real(1) / 6, 0), b(-0.5, 0, 0.5, 0),
        c(0.5, -1, 0.5, 0), d(-Real(1) / 6, 0.5, -0.5, Real(1) / 6);
    return a + t * (b + t * (c + t * d));
  }
  [[nodiscard]] static Four slopes(float t) {
    static const Four b(-0.5F, 0.0F, 0.5F, 0.0F), c(1.0F, -2.0F, 1.0F, 0.0F), d(-0.5F, 1.5F, -1.5F, 0.5F);
    return b + t * (c + t * d);
  }

  int width_ = 0, height_ = 0;
  std::ptrdiff_t stride_ = 0;
  std::vector<float> coefficients_;
};

}  // namespace imic3d::imaging
