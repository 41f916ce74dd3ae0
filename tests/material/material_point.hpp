#pragma once
// A material point that is led along a path, the laws under test with admissible parameters, and derivative checks.

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <functional>
#include <memory>
#include <random>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "imic3d/material/finite_strain_law.hpp"

namespace imic3d::material::testing {

using LawPointer = std::shared_ptr<const FiniteStrainLaw>;

/// A law and parameter values, so that every test can run over all of them.
struct Case {
  std::string name;
  LawPointer law;
  std::vector<double> parameters;
};

inline LawPointer j2_law(const std::string& hardening, bool tied = false, std::vector<double> table = {}) {
  return make_law({.law = "j2", .hardening = hardening, .tie_initial_modulus = tied, .table_strain = std::move(table)});
}

/// Every law of the registry; steel-like numbers in MPa, Eq. (18) with the values of the paper's Sec. 4.1.
inline std::vector<Case> plastic_cases() {
  return {{"power_linear", j2_law("power_linear"), {198e3, 0.25, 284, 1480, 0.042, 7.16e-5}},
          {"power_linear_tied", j2_law("power_linear", true), {198e3, 0.25, 284, 1480, 0.042}},
          {"linear", j2_law("linear"), {200e3, 0.3, 300, 2000}},
          {"voce", j2_law("voce"), {206.9e3, 0.29, 450, 715, 16.93, 129.24}},
          {"swift", j2_law("swift"), {70e3, 0.33, 500, 0.01, 0.2}},
          {"table", j2_law("table", false, {0, 0.01, 0.05, 0.2}), {200e3, 0.3, 300, 360, 420, 500}}};
}
inline std::vector<Case> all_cases() {
  std::vector<Case> cases = plastic_cases();
  cases.push_back({"elastic", make_law({.law = "elastic"}), {200e3, 0.3}});
  return cases;
}

inline Matrix3 tensor_of(const Vector6& v) {
  Matrix3 A;
  A << v[0], v[3], v[5], v[3], v[1], v[4], v[5], v[4], v[2];
  return A;
}
inline Vector6 vector_of(const Matrix3& A) {
  return Vector6(A(0, 0), A(1, 1), A(2, 2), 0.5 * (A(0, 1) + A(1, 0)), 0.5 * (A(1, 2) + A(2, 1)),
                 0.5 * (A(0, 2) + A(2, 0)));
}
/// Symmetric part with engineering shears.
inline Vector6 engineering_strain(const Matrix3& A) {
  Vector6 v = vector_of(A);
  v.tail<3>() *= 2.0;
  return v;
}

class Random {
 public:
  explicit Random(unsigned seed) : engine_(seed) {}
  double uniform(double low, double high) { return std::uniform_real_distribution<double>(low, high)(engine_); }
  Matrix3 matrix(double size) {
    return Matrix3::NullaryExpr([&] { return uniform(-size, size); });
  }
  Matrix3 rotation() {
    const Eigen::Vector4d q =
        Eigen::Vector4d::NullaryExpr([&] { return std::normal_distribution<double>()(engine_); }).normalized();
    return Eigen::Quaterniond(q[0], q[1], q[2], q[3]).toRotationMatrix();
  }

 private:
  std::mt19937 engine_;
};

/// A point with its converged history.
class MaterialPoint {
 public:
  MaterialPoint(const FiniteStrainLaw& law, std::vector<double> parameters)
      : law_(&law), parameters_(std::move(parameters)), history_(static_cast<std::size_t>(law.history_size())) {
    law.initialise(history_);
  }

  /// Takes the step and keeps the new state.
  Response advance(const Matrix3& F, double time_increment = 1.0) {
    std::vector<double> next(history_.size());
    Response response = evaluate(F, next, parameters_, time_increment);
    history_ = next;
    return response;
  }
  /// The response to a step that is not kept.
  [[nodiscard]] Response at(const Matrix3& F) const { return at(F, parameters_); }
  [[nodiscard]] Response at(const Matrix3& F, const std::vector<double>& parameters) const {
    std::vector<double> next(history_.size());
    return evaluate(F, next, parameters, 1.0);
  }
  [[nodiscard]] double plastic_strain_after(const Matrix3& F) const {
    std::vector<double> next(history_.size());
    (void)evaluate(F, next, parameters_, 1.0);
    return next[static_cast<std::size_t>(law_->plastic_strain_index())];
  }
  [[nodiscard]] bool has_plastic_strain() const { return law_->plastic_strain_index() >= 0; }
  [[nodiscard]] double plastic_strain() const {
    return history_[static_cast<std::size_t>(law_->plastic_strain_index())];
  }
  [[nodiscard]] Matrix3 plastic_inverse() const {
    return Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(history_.data());
  }
  [[nodiscard]] const std::vector<double>& history() const { return history_; }
  [[nodiscard]] const std::vector<double>& parameters() const { return parameters_; }
  [[nodiscard]] const FiniteStrainLaw& law() const { return *law_; }

 private:
  Response evaluate(const Matrix3& F, std::vector<double>& next, const std::vector<double>& parameters,
                    double time_increment) const {
    const std::vector<double> before = history_;
    Response response;
    if (!law_->update(F, time_increment, parameters, history_, next, response, true))
      throw std::runtime_error("the law could not follow");
    if (before != history_) throw std::runtime_error("the old history was changed");
    return response;
  }

  const FiniteStrainLaw* law_;
  std::vector<double> parameters_;
  std::vector<double> history_;
};

/// Errors of central differences against a derivative, relative to `scale`, for steps 1e-1 … 1e-12 times `size`.
struct DifferenceErrors {
  std::vector<double> step, error;
  [[nodiscard]] std::size_t best() const {
    return static_cast<std::size_t>(std::min_element(error.begin(), error.end()) - error.begin());
  }
  [[nodiscard]] std::string table() const {
    std::ostringstream text;
    for (std::size_t i = 0; i < step.size(); ++i) text << "\n  step " << step[i] << "  error " << error[i];
    return text.str();
  }
};

inline double norm(const std::vector<double>& v) {
  double sum = 0.0;
  for (double x : v) sum += x * x;
  return std::sqrt(sum);
}
inline std::vector<double> listed(const Vector6& v) { return {v.data(), v.data() + 6}; }

/// f: the differenced function of the signed step; derivative: df/dstep at 0; steps from largest * size downwards.
inline DifferenceErrors difference_errors(const std::function<std::vector<double>(double)>& f,
                                          const std::vector<double>& derivative, double size, double largest = 0.1) {
  DifferenceErrors result;
  for (double h = largest; h > 2e-13; h /= 10.0) {
    const std::vector<double> plus = f(h * size), minus = f(-h * size);
    std::vector<double> error(derivative.size());
    for (std::size_t i = 0; i < error.size(); ++i) error[i] = (plus[i] - minus[i]) / (2.0 * h * size) - derivative[i];
    result.step.push_back(h * size);
    result.error.push_back(norm(error) / norm(derivative));
  }
  return result;
}

/// A derivative passes if its error falls with the step until rounding makes it rise: V-shaped, with a deep minimum.
/// Along a direction in which the function is linear (error below 1e-9 at the largest step) there is only the rise.
inline void expect_v_shaped(const DifferenceErrors& errors, const std::string& what, double deepest = 1e-7) {
  const std::size_t best = errors.best();
  EXPECT_LT(errors.error[best], deepest) << what << errors.table();
  EXPECT_GT(errors.error[best], 0.0) << what << ": an error of exactly zero is suspicious" << errors.table();
  EXPECT_GT(errors.error.back(), 10.0 * errors.error[best]) << what << ": no rise from rounding" << errors.table();
  const bool falls = errors.error.front() > 10.0 * errors.error[best], linear = errors.error.front() < 1e-9;
  EXPECT_TRUE(falls || linear) << what << ": no fall with the step" << errors.table();
}

}  // namespace imic3d::material::testing
