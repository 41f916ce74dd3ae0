// Effects whose bias is known: what carries one set of parameters into another is found, its size too, beyond the first
// tangent.

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <random>

#include "imic3d/loop/explain.hpp"

namespace imic3d::loop {
namespace test_explain {

const Eigen::Vector4d pattern(17.0, 5.0, -3.0, 0.1), other(6.0, 6.0, 6.0, 0.0);
const Eigen::MatrixXd unit = Eigen::MatrixXd::Identity(4, 4);

/// Grows faster than its size: at 1 by 1.5 times what the tangent says.
std::optional<Eigen::VectorXd> curved(const Eigen::VectorXd& e) {
  return Eigen::VectorXd((e[0] + 0.5 * e[0] * e[0]) * pattern);
}

TEST(Explain, FollowsTheBiasBeyondTheTangent) {
  const auto found = explain(*curved(Eigen::VectorXd::Constant(1, 1.0)), unit, {{0.0, 1e-3, -2.0, 2.0}}, curved, 8);
  EXPECT_NEAR(found.size[0], 1.0, 2e-3);  // the tangent alone says 1.5
  EXPECT_NEAR((found.tangent.col(0) - pattern).norm(), 0.0, 0.02);
  EXPECT_LT(found.chi_squared, 1e-2);
  EXPECT_EQ(found.degrees, 3);
  EXPECT_TRUE(found.fits);
}

TEST(Explain, OtherPatternsDoNotFit) {
  const auto straight = [](const Eigen::VectorXd& e) { return std::optional<Eigen::VectorXd>(e[0] * other); };
  const auto found = explain(pattern, unit, {{0.0, 1e-3, -2.0, 2.0}}, straight);
  // The best size by hand: <other, pattern>/<other, other>.
  const double size = other.dot(pattern) / other.squaredNorm();
  EXPECT_NEAR(found.size[0], size, 1e-6);
  EXPECT_NEAR(found.chi_squared, (pattern - size * other).squaredNorm(), 1e-6);
  EXPECT_FALSE(found.fits);
}

TEST(Explain, CovarianceOfTheSetsCounts) {
  const auto straight = [](const Eigen::VectorXd& e) { return std::optional<Eigen::VectorXd>(e[0] * other); };
  // The difference leaves the pattern by 10 along a direction that the sets leave open, or by as much across it.
  Eigen::Vector4d open(1.0, -1.0, 0.0, 0.0);
  open.normalize();
  const Eigen::MatrixXd covariance = unit + 100.0 * open * open.transpose();
  EXPECT_TRUE(explain(other + 10.0 * open, covariance, {{0.0, 1e-3, -2.0, 2.0}}, straight).fits);
  EXPECT_FALSE(explain(other + 10.0 * Eigen::Vector4d::Unit(3), covariance, {{0.0, 1e-3, -2.0, 2.0}}, straight).fits);
}

TEST(Explain, RefusesTheTruthInOneOfAHundred) {
  std::mt19937_64 random(3);
  std::normal_distribution<double> normal;
  int refused = 0;
  for (int draw = 0; draw < 2000; ++draw) {
    Eigen::VectorXd difference = *curved(Eigen::VectorXd::Constant(1, 0.8));
    for (double& x : difference) x += normal(random);
    refused += explain(difference, unit, {{0.0, 1e-3, -2.0, 2.0}}, curved).fits ? 0 : 1;
  }
  EXPECT_GE(refused, 8);  // of 20 expected, standard deviation 4.4
  EXPECT_LE(refused, 34);
}

TEST(Explain, TwoSizesAndBounds) {
  const auto both = [](const Eigen::VectorXd& e) {
    return std::optional<Eigen::VectorXd>(e[0] * pattern + e[1] * other);
  };
  const Eigen::VectorXd wanted = 0.5 * pattern - 0.7 * other;
  const auto found = explain(wanted, unit, {{0.0, 1e-3, -2.0, 2.0}, {0.0, 1e-3, -2.0, 2.0}}, both);
  EXPECT_NEAR(found.size[0], 0.5, 1e-6);
  EXPECT_NEAR(found.size[1], -0.7, 1e-6);
  EXPECT_EQ(found.degrees, 2);
  const auto held = explain(wanted, unit, {{0.0, 1e-3, -2.0, 0.2}, {0.0, 1e-3, -2.0, 2.0}}, both);
  EXPECT_NEAR(held.size[0], 0.2, 1e-12);
  EXPECT_TRUE(held.on_bound);
  EXPECT_FALSE(held.fits);
}

TEST(Explain, AsManySizesAsParametersSayNothing) {
  const auto all = [](const Eigen::VectorXd& e) { return std::optional<Eigen::VectorXd>(e); };
  const auto found = explain(pattern, unit, std::vector<EffectSize>(4, {0.0, 1e-3, -100.0, 100.0}), all);
  EXPECT_EQ(found.identifications, 0);
  EXPECT_FALSE(found.fits);
}

TEST(Explain, GoesAsFarAsTheModelDoes) {
  const auto short_of = [](const Eigen::VectorXd& e) -> std::optional<Eigen::VectorXd> {
    if (e[0] > 0.6) return std::nullopt;
    return Eigen::VectorXd(e[0] * pattern);
  };
  const auto found = explain(pattern, unit, {{0.0, 1e-3, -2.0, 2.0}}, short_of);
  EXPECT_GT(found.size[0], 0.4);
  EXPECT_LE(found.size[0], 0.6);
  EXPECT_FALSE(found.message.empty());
  EXPECT_FALSE(found.failed);
}

TEST(Explain, WhatCannotBeIdentifiedIsNotJudged) {
  const auto never = [](const Eigen::VectorXd&) -> std::optional<Eigen::VectorXd> { return std::nullopt; };
  const auto found = explain(pattern, unit, {{0.0, 1e-3, -2.0, 2.0}}, never);
  EXPECT_TRUE(found.failed);
  EXPECT_FALSE(found.fits);
}

}  // namespace test_explain
}  // namespace imic3d::loop
