// Dense linear algebra of small systems: what each function is asked for, on full and deficient matrices.
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <random>
#include <utility>

#include "imic3d/core/linear.hpp"

namespace imic3d {
namespace test_linear {

Eigen::MatrixXd drawn(Eigen::Index rows, Eigen::Index columns) {
  std::mt19937_64 random(7);
  std::normal_distribution<double> normal;
  Eigen::MatrixXd all(rows, columns);
  for (double& x : all.reshaped()) x = normal(random);
  return all;
}

/// Three columns of which the third is the sum of the others.
Eigen::MatrixXd deficient() {
  Eigen::MatrixXd A = drawn(8, 3);
  A.col(2) = A.col(0) + A.col(1);
  return A;
}

TEST(Linear, LeastSquaresOfLeastNorm) {
  const Eigen::MatrixXd A = deficient(), B = drawn(8, 5).rightCols(2), X = least_squares(A, B);
  ASSERT_EQ(X.rows(), 3);
  ASSERT_EQ(X.cols(), 2);
  EXPECT_LT((A.transpose() * (A * X - B)).norm(), 1e-12);             // the residual is across all columns
  EXPECT_LT((Eigen::RowVector3d(1.0, 1.0, -1.0) * X).norm(), 1e-12);  // nothing of what A does not see
  Eigen::MatrixXd nearly = Eigen::Vector2d(1.0, 1e-5).asDiagonal();
  EXPECT_NEAR(least_squares(nearly, Eigen::Vector2d(1.0, 1.0))(1), 1e5, 1e-6);
  EXPECT_EQ(least_squares(nearly, Eigen::Vector2d(1.0, 1.0), 1e-4)(1), 0.0);
}

TEST(Linear, WhatNormalEquationsDoNotSeeIsNotDetermined) {
  Eigen::MatrixXd A(8, 4);
  A << deficient(), drawn(8, 4).col(3);
  A.col(1) *= 10.0;
  A.col(2) = A.col(0) + A.col(1);
  const SeenInverse of_all = inverse_of_seen(A.transpose() * A);
  EXPECT_EQ(of_all.undetermined, (std::vector<Eigen::Index>{0, 1, 2}));
  const std::vector<int> seen = {0, 1, 3};
  const Eigen::MatrixXd N = A(Eigen::all, seen).transpose() * A(Eigen::all, seen);
  const SeenInverse of_some = inverse_of_seen(N);
  EXPECT_TRUE(of_some.undetermined.empty());
  EXPECT_LT((of_some.inverse * N - Eigen::Matrix3d::Identity()).norm(), 1e-6);
}

TEST(Linear, ALaterBlockForgetsWhatAnEarlierOneTold) {
  Eigen::MatrixXd covariance = Eigen::MatrixXd::Constant(4, 4, std::nan(""));
  put_block(covariance, {0, 1}, Eigen::Matrix2d::Constant(2.0));
  put_block(covariance, {1, 3}, Eigen::Matrix2d::Constant(3.0));
  EXPECT_EQ(covariance(0, 0), 2.0);
  EXPECT_EQ(covariance(1, 3), 3.0);
  for (const auto& [i, j] : {std::pair(0, 1), {0, 3}, {2, 2}})
    EXPECT_TRUE(std::isnan(covariance(i, j)) && std::isnan(covariance(j, i)));
}

TEST(Linear, PseudoInverse) {
  const Eigen::MatrixXd A = deficient(), P = pseudo_inverse(A);
  EXPECT_LT((A * P * A - A).norm(), 1e-12);
  EXPECT_LT((P * A * P - P).norm(), 1e-12);
  EXPECT_LT((A * P - (A * P).transpose()).norm(), 1e-12);
  EXPECT_LT((P * A - (P * A).transpose()).norm(), 1e-12);
}

TEST(Linear, OrthonormalColumns) {
  const Eigen::MatrixXd A = deficient(), Q = orthonormal(A);
  ASSERT_EQ(Q.cols(), 2);
  EXPECT_LT((Q.transpose() * Q - Eigen::Matrix2d::Identity()).norm(), 1e-13);
  EXPECT_LT((A - Q * (Q.transpose() * A)).norm(), 1e-13);
}

TEST(Linear, SymmetricMatrices) {
  const Eigen::MatrixXd A = drawn(6, 4), H = A.transpose() * A;
  const SymmetricEigen eigen = symmetric_eigen(H);
  EXPECT_LT((eigen.vectors * eigen.values.asDiagonal() * eigen.vectors.transpose() - H).norm(), 1e-12 * H.norm());
  EXPECT_TRUE((eigen.values.tail(3).array() > eigen.values.head(3).array()).all());
  EXPECT_LT((eigen.values.reverse().cwiseSqrt() - singular_values(A)).norm(), 1e-12);
  EXPECT_LT((H * solve_symmetric(H, A.transpose()) - A.transpose()).norm(), 1e-11);
  const Eigen::MatrixXd L = cholesky(H);
  EXPECT_LT((L * L.transpose() - H).norm(), 1e-12 * H.norm());
  EXPECT_EQ(L(0, 3), 0.0);
  EXPECT_LT((inverse_cholesky(H) * L - Eigen::Matrix4d::Identity()).norm(), 1e-12);
}

}  // namespace test_linear
}  // namespace imic3d
