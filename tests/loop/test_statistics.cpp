// The distributions that scores are judged by, against tables and by drawing.

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <random>

#include "imic3d/loop/statistics.hpp"

namespace imic3d::loop {
namespace test_statistics {

TEST(Statistics, TailsOfChiSquared) {
  EXPECT_NEAR(chi_squared_tail(3.841458820694124, 1), 0.05, 1e-12);
  EXPECT_NEAR(chi_squared_tail(5.991464547107979, 2), 0.05, 1e-12);
  EXPECT_NEAR(chi_squared_tail(7.814727903251179, 3), 0.05, 1e-12);
  EXPECT_NEAR(chi_squared_tail(12.591587243743977, 6), 0.05, 1e-12);
  EXPECT_NEAR(deviations(std::log(0.05)), 1.959963984540054, 1e-9);
  EXPECT_NEAR(deviations(log_chi_squared_tail(900.0, 1)), 30.0, 1e-6);
  EXPECT_NEAR(deviations(log_chi_squared_tail(1e5, 1)), std::sqrt(1e5), 1e-3);
}

TEST(Statistics, EstimatesAreToldFromZeroAt95Percent) {
  const auto alone = [](double x) {
    return told_from_zero(Eigen::VectorXd::Constant(1, x), Eigen::MatrixXd::Constant(1, 1, 4.0));
  };
  EXPECT_TRUE(alone(3.93) && alone(-3.93));
  EXPECT_FALSE(alone(3.91) || alone(-3.91));
  const Eigen::Matrix2d correlated{{1.0, 0.9}, {0.9, 1.0}};  // along (1, 1) nine tenths of the noise is common
  EXPECT_TRUE(told_from_zero(Eigen::Vector2d(0.55, -0.55), correlated));
  EXPECT_FALSE(told_from_zero(Eigen::Vector2d(0.54, -0.54), correlated));
  EXPECT_TRUE(told_from_zero(Eigen::Vector2d(2.39, 2.39), correlated));
  EXPECT_FALSE(told_from_zero(Eigen::Vector2d(2.38, 2.38), correlated));
}

TEST(Statistics, StudentsTails) {
  EXPECT_NEAR(student_as_normal(2.228, 10.0), 1.960, 3e-3);  // 2.5 %
  EXPECT_NEAR(student_as_normal(4.144, 10.0), 3.090, 5e-3);  // 0.1 %
  EXPECT_NEAR(normal_as_student(1.960, 10.0), 2.228, 3e-3);
  EXPECT_NEAR(normal_as_student(student_as_normal(-3.0, 5.0), 5.0), -3.0, 1e-12);
  EXPECT_NEAR(student_as_normal(3.0, 1e12), 3.0, 1e-9);
}

/// A mean of that length, in one of `degrees` directions, is found in 86 of 100 cases (Phi(1.1)), whatever the number
/// of degrees.
TEST(Statistics, DetectableSizesAreFoundAsOften) {
  std::mt19937_64 random(3);
  std::normal_distribution<double> normal;
  constexpr double limit = 3.6;
  double last = 0.0;
  for (const int degrees : {1, 2, 3, 6, 12, 18}) {
    const double length = detectable(limit, 1.1, degrees);
    EXPECT_GT(length, last);
    last = length;
    int found = 0;
    for (int i = 0; i < 4000; ++i) {
      double square = 0.0;
      for (int k = 0; k < degrees; ++k) square += std::pow(normal(random) + (k == 0 ? length : 0.0), 2);
      found += deviations(log_chi_squared_tail(square, degrees)) > limit ? 1 : 0;
    }
    EXPECT_NEAR(found / 4000.0, 0.864, 0.02) << degrees;
  }
  EXPECT_DOUBLE_EQ(detectable(limit, 1.1, 1), 4.7);
}

TEST(Statistics, WhatIsFittedHoldsNothingOfWhatIsHeldOut) {
  const Eigen::MatrixXd covariance = Eigen::MatrixXd::Identity(6, 6) + Eigen::MatrixXd::Constant(6, 6, 0.5);
  const Eigen::MatrixXd W = whitening(covariance, {1, 4}), white = W * covariance * W.transpose();
  const std::vector<int> fitted = {0, 2, 3, 5};
  EXPECT_LT((white(fitted, fitted) - Eigen::MatrixXd::Identity(4, 4)).norm(), 1e-12);
  EXPECT_LT((white.diagonal() - Eigen::VectorXd::Ones(6)).norm(), 1e-12);
  for (const int row : fitted)
    for (const int held : {1, 4}) EXPECT_EQ(W(row, held), 0.0);
  // What is held out is compared with all that comes before it, and nothing with what comes after.
  for (int row = 0; row < 6; ++row)
    for (int later = row + 1; later < 6; ++later) EXPECT_EQ(W(row, later), 0.0);
  for (int before = 0; before < 4; ++before) {
    EXPECT_NE(W(4, before), 0.0);
    EXPECT_LT(std::abs((W.row(4) * covariance)(before)), 1e-12);
  }
}

}  // namespace test_statistics
}  // namespace imic3d::loop
