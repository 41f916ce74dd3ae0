// Numbers with noise of their own and errors that they share.
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <random>

#include "imic3d/core/whitening.hpp"

namespace imic3d {
namespace test_whitening {

TEST(Whitening, MakesIndependentNumbersAndKeepsTheFirstApart) {
  std::mt19937_64 random(3);
  std::normal_distribution<double> normal;
  constexpr Eigen::Index count = 9;
  Eigen::MatrixXd shared(count, 3);
  for (double& x : shared.reshaped()) x = normal(random);
  shared.col(2) = shared.col(0) - shared.col(1);
  const Eigen::VectorXd deviation = Eigen::VectorXd::LinSpaced(count, 0.5, 2.0);
  Eigen::MatrixXd covariance = shared * shared.transpose();
  covariance.diagonal() += deviation.cwiseAbs2();
  const std::vector<Eigen::Index> last = {1, 4, 8};
  for (const auto& held : {std::vector<Eigen::Index>{}, last}) {
    const Eigen::MatrixXd W = Whitening(deviation, shared, held)(Eigen::MatrixXd::Identity(count, count));
    EXPECT_LT((W * covariance * W.transpose() - Eigen::MatrixXd::Identity(count, count)).norm(), 1e-12);
    EXPECT_GT(W.row(0).tail(count - 1).norm(), 0.01);
    for (const Eigen::Index i : {0, 2, 3, 5, 6, 7})
      for (const Eigen::Index j : held) EXPECT_EQ(W(i, j), 0.0);
    EXPECT_GT(std::abs(W(1, 0)), 1e-3);
  }
  const Eigen::MatrixXd none(count, 0);
  EXPECT_LT((Whitening(deviation, none, last)(covariance) - deviation.cwiseInverse().asDiagonal() * covariance).norm(),
            1e-12);
}

}  // namespace test_whitening
}  // namespace imic3d
