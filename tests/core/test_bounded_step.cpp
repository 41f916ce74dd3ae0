#include <gtest/gtest.h>

#include <Eigen/Dense>

#include "imic3d/core/bounded_step.hpp"

namespace imic3d {
namespace test_bounded_step {

const Eigen::MatrixXd H = (Eigen::MatrixXd(3, 3) << 4e6, 1e3, -2.0, 1e3, 3.0, 5e-4, -2.0, 5e-4, 2e-6).finished();
const Eigen::VectorXd x = Eigen::Vector3d(0.5, -2.0, 700.0), wide = Eigen::VectorXd::Constant(3, 1e9);

TEST(BoundedStep, InsideTheBoxItIsNewtons) {
  EXPECT_LT((bounded_step(H, H * x, -wide, wide) - x).cwiseQuotient(x).norm(), 1e-9);
}

TEST(BoundedStep, TheRestIsSolvedAgainForWhatStandsOnABound) {
  Eigen::VectorXd low = -wide;
  low[1] = -0.5;
  const Eigen::VectorXd g = H * x, step = bounded_step(H, g, low, wide);
  EXPECT_EQ(step[1], -0.5);
  const Eigen::VectorXd left = g - H * step;  // of the gradient: none but towards the bound
  EXPECT_LT(std::abs(left[0]), 1e-9 * g.cwiseAbs().maxCoeff());
  EXPECT_LT(std::abs(left[2]), 1e-9 * g.cwiseAbs().maxCoeff());
  EXPECT_LT(left[1], 0.0);
}

TEST(BoundedStep, OnABoundItStaysAndLeavesInwards) {
  Eigen::VectorXd low = -wide;
  low[1] = 0.0;
  EXPECT_EQ(bounded_step(H, H * x, low, wide)[1], 0.0);
  EXPECT_NEAR(bounded_step(H, -H * x, low, wide)[1], 2.0, 1e-9);
}

TEST(BoundedStep, WithoutCurvatureNothingMoves) {
  Eigen::MatrixXd flat = Eigen::MatrixXd::Zero(2, 2);
  flat(0, 0) = 2.0;
  const Eigen::VectorXd step =
      bounded_step(flat, Eigen::Vector2d(4.0, 1.0), Eigen::Vector2d(-9, -9), Eigen::Vector2d(9, 9));
  EXPECT_EQ(step[0], 2.0);
  EXPECT_EQ(step[1], 0.0);
}

TEST(BoundedStep, DampingIsRelativeToTheDiagonal) {
  Eigen::MatrixXd diagonal = Eigen::Vector2d(4e6, 1e-6).asDiagonal();
  const Eigen::VectorXd step = bounded_step(diagonal, Eigen::Vector2d(4e6, 1e-6), -wide.head(2), wide.head(2), 1.0);
  EXPECT_NEAR(step[0], 0.5, 1e-12);
  EXPECT_NEAR(step[1], 0.5, 1e-12);
}

}  // namespace test_bounded_step
}  // namespace imic3d
