// Displacements in few numbers: noise becomes white, and what has these numbers is found again.

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <Eigen/SparseCholesky>
#include <random>

#include "../identification/plate.hpp"
#include "imic3d/loop/surface_modes.hpp"

namespace imic3d::loop {
namespace test_surface_modes {

/// Of neighbours that share pixels, as those of an image do: the mass matrix of a bilinear square in each cell.
Eigen::SparseMatrix<double> mass(const mesh::Mesh& surface) {
  std::vector<Eigen::Triplet<double>> entries;
  for (Eigen::Index cell = 0; cell < surface.cells.rows(); ++cell)
    for (int a = 0; a < 4; ++a)
      for (int b = 0; b < 4; ++b)
        entries.emplace_back(surface.cells(cell, a), surface.cells(cell, b),
                             a == b             ? 4e6
                             : (a + b) % 2 == 1 ? 2e6
                                                : 1e6);
  Eigen::SparseMatrix<double> M(surface.nodes.rows(), surface.nodes.rows());
  M.setFromTriplets(entries.begin(), entries.end());
  return identification::of_components(M);
}

struct Modes : ::testing::Test {
  const mesh::Mesh surface = identification::testing::Plate({0.001}).specimen.surface.mesh;
  const Eigen::SparseMatrix<double> M = mass(surface);
  const SurfaceModes modes{surface, M, 12};
  const Eigen::Index count = static_cast<Eigen::Index>(modes.sides().size());

  [[nodiscard]] std::vector<Eigen::Index> of_side(int side) const {
    std::vector<Eigen::Index> rows;
    for (Eigen::Index i = 0; i < count; ++i)
      if (modes.sides()[static_cast<std::size_t>(i)] == side) rows.push_back(i);
    return rows;
  }
};

TEST_F(Modes, NoiseIsWhiteOnEitherColour) {
  const Eigen::SimplicialLLT<Eigen::SparseMatrix<double>> factor(M);
  const Eigen::MatrixXd inverse = factor.solve(Eigen::MatrixXd(Eigen::MatrixXd::Identity(M.rows(), M.rows())));
  const Eigen::MatrixXd numbers = modes.numbers(Eigen::MatrixXd::Identity(M.rows(), M.rows()));
  const Eigen::MatrixXd covariance = numbers * inverse * numbers.transpose();
  for (int side : {0, 1}) {
    const auto rows = of_side(side);
    ASSERT_FALSE(rows.empty());
    const Eigen::MatrixXd block = covariance(rows, rows);
    EXPECT_LT((block - Eigen::MatrixXd::Identity(block.rows(), block.cols())).cwiseAbs().maxCoeff(), 1e-8);
  }
}

TEST_F(Modes, NumbersOfAColourAreFoundAgain) {
  std::mt19937_64 random(3);
  std::normal_distribution<double> normal;
  for (int side : {0, 1}) {
    const auto rows = of_side(side);
    Eigen::VectorXd q = Eigen::VectorXd::Zero(count);
    for (Eigen::Index i : rows) q[i] = normal(random);
    const Eigen::VectorXd again = modes.numbers(modes.displacement(q));
    EXPECT_LT((again(rows) - q(rows)).norm(), 1e-8 * q.norm());
  }
}

TEST_F(Modes, MotionsThatAreToLeaveNoTraceLeaveNone) {
  Eigen::MatrixXd R = Eigen::MatrixXd::Zero(M.rows(), 3);
  for (Eigen::Index i = 0; i < surface.nodes.rows(); ++i) {
    R(2 * i, 0) = R(2 * i + 1, 1) = 1.0;
    R(2 * i, 2) = -surface.nodes(i, 1), R(2 * i + 1, 2) = surface.nodes(i, 0);
  }
  const SurfaceModes blind(surface, M, 12, R);
  EXPECT_EQ(blind.sides().size(), modes.sides().size() - 6);  // three on either colour
  EXPECT_LT(blind.numbers(R).norm(), 1e-9 * modes.numbers(R).norm());
  Eigen::VectorXd stretch = Eigen::VectorXd::Zero(M.rows());
  for (Eigen::Index i = 0; i < surface.nodes.rows(); ++i) stretch[2 * i + 1] = surface.nodes(i, 1);
  EXPECT_GT(blind.numbers(stretch).norm(), 0.1 * modes.numbers(stretch).norm());
  const Eigen::SimplicialLLT<Eigen::SparseMatrix<double>> factor(M);
  const Eigen::MatrixXd numbers = blind.numbers(Eigen::MatrixXd::Identity(M.rows(), M.rows()));
  const Eigen::MatrixXd covariance = numbers * factor.solve(Eigen::MatrixXd(numbers.transpose()));
  const auto half = covariance.rows() / 2;
  EXPECT_LT((covariance.topLeftCorner(half, half) - Eigen::MatrixXd::Identity(half, half)).cwiseAbs().maxCoeff(), 1e-8);
}

}  // namespace test_surface_modes
}  // namespace imic3d::loop
