#include "imic3d/loop/statistics.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>

#include "imic3d/core/linear.hpp"

namespace imic3d::loop {

double log_chi_squared_tail(double value, int degrees) {
  // Q(a + 1, x) = Q(a, x) + x^a e^-x / Gamma(a + 1), from Q(1/2, x) = erfc(sqrt x) or Q(1, x) = e^-x; e^-x taken out of
  // the sum.
  const double x = 0.5 * std::max(0.0, value);
  if (x == 0.0) return 0.0;
  double a = degrees % 2 == 1 ? 0.5 : 1.0;
  // e^x erfc(sqrt x), by its asymptotic series where erfc underflows.
  double scaled = degrees % 2 == 0 ? 1.0
                  : x < 600.0      ? std::exp(x) * std::erfc(std::sqrt(x))
                                   : (1.0 - 0.5 / x) / std::sqrt(M_PI * x);
  for (; a < 0.5 * degrees - 0.25; a += 1.0) scaled += std::exp(a * std::log(x) - std::lgamma(a + 1.0));
  return std::min(0.0, std::log(scaled) - x);
}

double chi_squared_tail(double value, int degrees) { return std::exp(log_chi_squared_tail(value, degrees)); }

bool told_from_zero(const Eigen::VectorXd& estimates, const Eigen::MatrixXd& covariance) {
  return chi_squared_tail(estimates.dot(least_squares(covariance, estimates).col(0)),
                          static_cast<int>(estimates.size())) <= 0.05;
}

double deviations(double log_p) {
  double low = 0.0, high = std::sqrt(std::max(1.0, -2.0 * log_p)) + 2.0;
  for (int i = 0; i < 60; ++i) {
    const double middle = 0.5 * (low + high);
    (log_chi_squared_tail(middle * middle, 1) > log_p ? low : high) = middle;
  }
  return 0.5 * (low + high);
}

double student_as_normal(double t, double freedom) {
  return std::copysign((8.0 * freedom + 1.0) / (8.0 * freedom + 3.0) * std::sqrt(freedom * std::log1p(t * t / freedom)),
                       t);
}

double normal_as_student(double z, double freedom) {
  const double scaled = z * (8.0 * freedom + 3.0) / (8.0 * freedom + 1.0);
  return std::copysign(std::sqrt(freedom * std::expm1(scaled * scaled / freedom)), z);
}

double detectable(double limit, double beyond, int degrees) {
  if (degrees == 1) return limit + beyond;
  const double log_p = log_chi_squared_tail(limit * limit, 1), power = 0.5 * std::erfc(-beyond / std::sqrt(2.0));
  const auto where = [](double high, auto&& below) {
    double low = 0.0;
    for (int i = 0; i < 50; ++i) {
      const double middle = 0.5 * (low + high);
      (below(middle) ? low : high) = middle;
    }
    return 0.5 * (low + high);
  };
  const double critical = where(std::pow(limit + 3.0, 2) + 4.0 * degrees,
                                [&](double value) { return log_chi_squared_tail(value, degrees) > log_p; });
  // The non-central one is a mixture: degrees + 2 i with Poisson's probability of i.
  std::map<int, double> tails;
  const auto tail = [&](double shift) {
    double sum = 0.0;
    const double mean = 0.5 * shift;
    for (int i = 0; i < 10 + static_cast<int>(mean + 8.0 * std::sqrt(mean)); ++i) {
      const auto [known, made] = tails.try_emplace(i, 0.0);
      if (made) known->second = chi_squared_tail(critical, degrees + 2 * i);
      sum += std::exp(i * std::log(std::max(mean, 1e-300)) - mean - std::lgamma(i + 1.0)) * known->second;
    }
    return sum;
  };
  return std::sqrt(where(2.0 * critical + 20.0, [&](double shift) { return tail(shift) < power; }));
}

Eigen::MatrixXd whitening(const Eigen::MatrixXd& covariance, const std::vector<int>& held_out) {
  const auto count = static_cast<int>(covariance.rows());
  std::vector<int> fitted;
  for (int i = 0; i < count; ++i)
    if (std::find(held_out.begin(), held_out.end(), i) == held_out.end()) fitted.push_back(i);
  Eigen::MatrixXd result = inverse_cholesky(covariance);
  result(fitted, Eigen::all).setZero();
  result(fitted, fitted) = inverse_cholesky(covariance(fitted, fitted));
  return result;
}

double upper_quantile(Eigen::VectorXd values, double level) {
  std::sort(values.begin(), values.end());
  // counted from 1
  const auto place =
      static_cast<Eigen::Index>(std::ceil((1.0 - level) * static_cast<double>(values.size() + 1) - 1e-9));
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
