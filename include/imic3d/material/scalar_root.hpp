#pragma once
// The root of one scalar equation: Newton guarded by bisection, and the root's derivatives by implicit differentiation.

#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <span>

#include "imic3d/material/dual.hpp"

namespace imic3d::material {

/// Largest number of parameters of a law.
inline constexpr int max_parameters = 72;

/// The values alone of a list of parameters.
class ParameterValues {
 public:
  template <Scalar T>
  explicit ParameterValues(std::span<const T> parameters) : size_(parameters.size()) {
    for (std::size_t i = 0; i < size_; ++i) values_[i] = value(parameters[i]);
  }
  operator std::span<const double>() const { return {values_.data(), size_}; }  // NOLINT

 private:
  std::array<double, max_parameters> values_;
  std::size_t size_;
};

/// A root between null and this is found no closer.
inline constexpr double negligible = 1e-100;

/// A value within ]lower, upper[ for a search of a root whose size is not known either: the geometric mean where the
/// ends are of one sign and apart, a thousandth of the upper one where the lower one is null, else the mean.
inline double between(double lower, double upper) noexcept {
  if (lower == 0.0 && upper > 0.0) return 1e-3 * upper;
  return lower > 0.0 && upper > 4.0 * lower ? std::sqrt(lower) * std::sqrt(upper) : 0.5 * (lower + upper);
}

/// Root of `residual`, a function of a Dual<1> that is positive at `lower` and negative at `upper`, to a few units in
/// the last place or to the noise of the residual, `scale` times a few epsilon. Newton from `lower`; a step that leaves
/// the bracket or does not shorten it enough is replaced by a bisection (`between`: a root may be 1e-40 of the
/// bracket). No value where there is no root in between.
template <class Residual>
std::optional<double> bracketed_newton(const Residual& residual, double lower, double upper, double scale) noexcept {
  constexpr double epsilon = std::numeric_limits<double>::epsilon();
  constexpr int max_iterations = 100;
  double x = lower, last_step = upper - lower;
  for (int iteration = 0; iteration < max_iterations; ++iteration) {
    const Dual<1> r = residual(Dual<1>::variable(x, 0));
    if (!std::isfinite(r.value)) return std::nullopt;
    double next = x - r.value / r.derivative[0];
    if (std::abs(r.value) <= 4.0 * epsilon * scale) return next >= lower && next <= upper ? next : x;
    if (iteration == 0 && r.value < 0.0) return std::nullopt;
    (r.value > 0.0 ? lower : upper) = x;
    // The first step may come from an infinite slope; later ones must halve what the last one did.
    if (!(next > lower && next < upper) || (iteration > 3 && std::abs(next - x) > 0.5 * last_step)) {
      next = between(lower, upper);
      if (lower == 0.0 && next < negligible) return next;
      if (iteration == 0 || next == lower || next == upper) {
        const Dual<1> at_upper = residual(Dual<1>::variable(upper, 0));
        if (!(at_upper.value <= 0.0)) return std::nullopt;
        if (next == lower || next == upper) return x;
      }
    }
    last_step = std::abs(next - x);
    x = next;
    if (last_step <= 2.0 * epsilon * std::abs(x)) return x;
  }
  return std::nullopt;
}

/// Root of an increasing function of a Dual<1> by Newton's method from `start`, to the noise of the function, `scale()`
/// times a few epsilon (asked after each evaluation), or to a few units in the last place. The sign of each value
/// narrows the interval of the root; a step that leaves it, or does not halve the value, is replaced by a bisection
/// where both ends are known. No value where the function is not finite or does not increase.
template <class Function, class Scale>
std::optional<double> increasing_newton(const Function& function, double start, const Scale& scale) noexcept {
  constexpr double epsilon = std::numeric_limits<double>::epsilon();
  constexpr int max_iterations = 100;
  double x = start, lower = -INFINITY, upper = INFINITY, last = INFINITY;
  for (int iteration = 0; iteration < max_iterations; ++iteration) {
    const Dual<1> f = function(Dual<1>::variable(x, 0));
    if (!std::isfinite(f.value) || !(f.derivative[0] > 0.0)) return std::nullopt;
    double next = x - f.value / f.derivative[0];
    if (std::abs(f.value) <= 4.0 * epsilon * scale()) return next;
    (f.value < 0.0 ? lower : upper) = x;
    const bool slow = iteration > 3 && std::abs(f.value) > 0.5 * last;
    if ((!(next > lower && next < upper) || slow) && std::isfinite(upper - lower)) next = 0.5 * (lower + upper);
    if (std::abs(next - x) <= 2.0 * epsilon * std::abs(x)) return next;
    last = std::abs(f.value);
    x = next;
  }
  return std::nullopt;
}

/// The root as a function of what the residual depends on: with r(x; q) = 0, dx = -(dr/dq dq) / (dr/dx).
/// residual_at_root: r evaluated at the root (a constant) with the derivatives of q; slope: dr/dx at the root.
template <Scalar T>
T implicit_root(double root, const T& residual_at_root, double slope) noexcept {
  if constexpr (derivatives_of<T> == 0)
    return root;
  else
    return residual_at_root.chain(root, -1.0 / slope);
}

}  // namespace imic3d::material
