#pragma once
// Forward-mode dual numbers: a value and its derivatives in N directions, carried through every operation.

#include <array>
#include <cmath>
#include <concepts>
#include <type_traits>

namespace imic3d::material {

/// A value with its derivatives in N directions. The default constructor leaves the numbers unset, like `double x;`.
template <int N>
struct Dual {
  double value;
  std::array<double, N> derivative;

  Dual() = default;
  Dual(double constant) : value(constant), derivative{} {}  // NOLINT: a number is a dual number without derivative

  /// The i-th independent variable.
  static Dual variable(double at, int i, double seed = 1.0) {
    Dual x(at);
    x.derivative[static_cast<std::size_t>(i)] = seed;
    return x;
  }

  /// f(x) from f and df/dx at x.value.
  [[nodiscard]] Dual chain(double f, double slope) const {
    Dual y;
    y.value = f;
    for (std::size_t i = 0; i < N; ++i) y.derivative[i] = slope * derivative[i];
    return y;
  }

  /// f(x, y) from f and its two partial derivatives.
  [[nodiscard]] static Dual chain(double f, double slope_x, const Dual& x, double slope_y, const Dual& y) {
    Dual z;
    z.value = f;
    for (std::size_t i = 0; i < N; ++i) z.derivative[i] = slope_x * x.derivative[i] + slope_y * y.derivative[i];
    return z;
  }

  Dual& operator+=(const Dual& y) { return *this = *this + y; }
  Dual& operator-=(const Dual& y) { return *this = *this - y; }
  Dual& operator*=(const Dual& y) { return *this = *this * y; }
  Dual& operator/=(const Dual& y) { return *this = *this / y; }

  friend Dual operator-(const Dual& x) { return x.chain(-x.value, -1.0); }
  friend Dual operator+(const Dual& x, const Dual& y) { return chain(x.value + y.value, 1.0, x, 1.0, y); }
  friend Dual operator-(const Dual& x, const Dual& y) { return chain(x.value - y.value, 1.0, x, -1.0, y); }
  friend Dual operator*(const Dual& x, const Dual& y) { return chain(x.value * y.value, y.value, x, x.value, y); }
  friend Dual operator/(const Dual& x, const Dual& y) {
    const double quotient = x.value / y.value;
    return chain(quotient, 1.0 / y.value, x, -quotient / y.value, y);
  }
  friend Dual operator+(const Dual& x, double y) { return x.chain(x.value + y, 1.0); }
  friend Dual operator+(double x, const Dual& y) { return y + x; }
  friend Dual operator-(const Dual& x, double y) { return x.chain(x.value - y, 1.0); }
  friend Dual operator-(double x, const Dual& y) { return y.chain(x - y.value, -1.0); }
  friend Dual operator*(const Dual& x, double y) { return x.chain(x.value * y, y); }
  friend Dual operator*(double x, const Dual& y) { return y * x; }
  friend Dual operator/(const Dual& x, double y) { return x.chain(x.value / y, 1.0 / y); }
  friend Dual operator/(double x, const Dual& y) { return y.chain(x / y.value, -x / (y.value * y.value)); }

  friend bool operator<(const Dual& x, const Dual& y) { return x.value < y.value; }
  friend bool operator>(const Dual& x, const Dual& y) { return x.value > y.value; }
  friend bool operator<=(const Dual& x, const Dual& y) { return x.value <= y.value; }
  friend bool operator>=(const Dual& x, const Dual& y) { return x.value >= y.value; }

  friend Dual sqrt(const Dual& x) {
    const double root = std::sqrt(x.value);
    return x.chain(root, 0.5 / root);
  }
  friend Dual exp(const Dual& x) {
    const double f = std::exp(x.value);
    return x.chain(f, f);
  }
  friend Dual expm1(const Dual& x) { return x.chain(std::expm1(x.value), std::exp(x.value)); }
  friend Dual log(const Dual& x) { return x.chain(std::log(x.value), 1.0 / x.value); }
  friend Dual sin(const Dual& x) { return x.chain(std::sin(x.value), std::cos(x.value)); }
  friend Dual cos(const Dual& x) { return x.chain(std::cos(x.value), -std::sin(x.value)); }
  friend Dual abs(const Dual& x) { return x.value < 0.0 ? -x : x; }
  friend Dual pow(const Dual& x, double exponent) {
    const double f = std::pow(x.value, exponent);
    return x.chain(f, exponent == 0.0 ? 0.0 : exponent * power_slope(f, x.value, exponent));
  }
  friend Dual pow(const Dual& x, const Dual& exponent) {
    const double f = std::pow(x.value, exponent.value);
    const double slope = exponent.value == 0.0 ? 0.0 : exponent.value * power_slope(f, x.value, exponent.value);
    return chain(f, slope, x, f == 0.0 ? 0.0 : f * std::log(x.value), exponent);
  }
  friend Dual pow(double x, const Dual& exponent) {
    const double f = std::pow(x, exponent.value);
    return exponent.chain(f, f == 0.0 ? 0.0 : f * std::log(x));
  }

 private:
  static double power_slope(double f, double x, double exponent) {
    return x != 0.0 ? f / x : std::pow(x, exponent - 1.0);
  }
};

/// The value alone, of a number or a dual number.
inline double value(double x) { return x; }
template <int N>
double value(const Dual<N>& x) {
  return x.value;
}

/// `double` or a dual number.
template <class T>
concept Scalar = std::same_as<T, double> || requires(T x) {
  { x.derivative[0] } -> std::convertible_to<double>;
};

/// Number of derivatives that a scalar carries: 0 for double, N for Dual<N>.
template <class T>
inline constexpr int derivatives_of = 0;
template <int N>
inline constexpr int derivatives_of<Dual<N>> = N;

}  // namespace imic3d::material
