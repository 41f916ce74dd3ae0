#include "imic3d/loop/statistics.hpp"

#include <algorithm>
#include <cmath>

namespace imic3d::loop {

double log_chi_squared_tail(double value, int degrees) {
  // Q(a + 1, x) = Q(a, x) + x^a e^-x / Gamma(a + 1), from Q(1/2, x) = erfc(sqrt x) or Q(1, x) = e^-x; e^-x taken out of the sum.
  const double x = 0.5 * std::max(0.0, value);
  if (x == 0.0) return 0.0;
  double a = degrees % 2 == 1 ? 0.5 : 1.0;
  // e^x erfc(sqrt x), by its asymptotic series where erfc underflows.
  double scaled = degrees % 2 == 0 ? 1.0 : x < 600.0 ? std::exp(x) * std::erfc(std::sqrt(x)) : (1.0 - 0.5 / x) / std::sqrt(M_PI * x);
  for (; a < 0.5 * degrees - 0.25; a += 1.0) scaled += std::exp(a * std::log(x) - std::lgamma(a + 1.0));
  return std::min(0.0, std::log(scaled) - x);
}

double chi_squared_tail(double value, int degrees) { return std::exp(log_chi_squared_tail(value, degrees)); }

double deviations(double log_p) {
  double low = 0.0, high = std::sqrt(std::max(1.0, -2.0 * log_p)) + 2.0;
  for (int i = 0; i < 60; ++i) {
    const double middle = 0.5 * (low + high);
    (log_chi_squared_tail(middle * middle, 1) > log_p ? low : high) = middle;
  }
  return 0.5 * (low + high);
}

double student_as_normal(double t, double freedom) {
  return std::copysign((8.0 * freedom + 1.0) / (8.0 * freedom + 3.0) * std::sqrt(freedom * std::log1p(t * t / freedom)), t);
}

double normal_as_student(double z, double freedom) {
  const double scaled = z * (8.0 * freedom + 3.0) / (8.0 * freedom + 1.0);
  return std::copysign(std::sqrt(freedom * std::expm1(scaled * scaled / freedom)), z);
}

double upper_quantile(Eigen::VectorXd values, double level) {
  std::sort(values.begin(), values.end());
  const auto place = static_cast<Eigen::Index>(std::ceil((1.0 - level) * static_cast<double>(values.size() + 1) - 1e-9));  // counted from 1
  return values[std::clamp<Eigen::Index>(place, 1, values.size()) - 1];
}

double quantile(Eigen::VectorXd values, double level) {
  std::sort(values.begin(), values.end());
  const double place = level * static_cast<double>(values.size() - 1);
  const auto below = static_cast<Eigen::Index>(place);
  const auto above = std::min(below + 1, values.size() - 1);
  return values[below] + (place - static_cast<double>(below)) * (values[above] - values[below]);
}

}  // namespace imic3d::loop
