#include "imic3d/loop/surface_modes.hpp"

#include <Eigen/Dense>
#include <Eigen/SparseCholesky>
#include <algorithm>
#include <random>

#include "imic3d/correlation/smoothing.hpp"

namespace imic3d::loop {

namespace {

/// The colour of each node: squares of a quarter of the narrower side.
std::vector<int> checkerboard(const mesh::Mesh& surface) {
  const Eigen::RowVector2d low = surface.nodes.leftCols<2>().colwise().minCoeff(),
                           side = surface.nodes.leftCols<2>().colwise().maxCoeff() - low;
  const double square = 0.25 * side.minCoeff() * (1.0 + 1e-9);
  std::vector<int> colour;
  for (Eigen::Index i = 0; i < surface.nodes.rows(); ++i) {
    const Eigen::RowVector2d at = (surface.nodes.row(i).head<2>() - low) / square;
    colour.push_back((static_cast<int>(at[0]) + static_cast<int>(at[1])) % 2);
  }
  return colour;
}

}  // namespace

/// Subspace iteration for the smallest eigenvalues of curvature x = lambda M x; affine motions come first. Any smooth
/// subspace serves, the modes need not be exact.
SurfaceModes::SurfaceModes(const mesh::Mesh& surface, const Eigen::SparseMatrix<double>& M, int wanted,
                           const Eigen::MatrixXd& R) {
  const auto size = M.rows();
  const auto components = size / surface.nodes.rows();
  const auto count = std::min<Eigen::Index>(
      std::max(1, wanted / 2),
      std::max<Eigen::Index>(
          1, size / 6));  // of 18 nodes and more all affine motions: which of them would be for rounding to say
  const Eigen::SparseMatrix<double> K = correlation::curvature_energy(surface, static_cast<int>(components));
  const double shift = 1e-6 * K.diagonal().sum() / M.diagonal().sum();
  const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> factor(K + shift * M);
  std::mt19937_64 random(1);
  std::normal_distribution<double> normal;
  Eigen::MatrixXd X(size, std::min<Eigen::Index>(size, count + count / 5 + 5));
  for (double& x : X.reshaped()) x = normal(random);
  for (int iteration = 0; iteration < 12; ++iteration) {
    X = factor.solve(M * X);
    const Eigen::MatrixXd MX = M * X;
    const Eigen::GeneralizedSelfAdjointEigenSolver<Eigen::MatrixXd> ritz(X.transpose() * (K * X), X.transpose() * MX);
    X = X * ritz.eigenvectors();
  }
  const Eigen::MatrixXd smooth = M * X.leftCols(count);
  const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> inverse(M);
  const std::vector<int> colour = checkerboard(surface);
  for (int c = 0; c < 2; ++c) {
    Eigen::MatrixXd A = smooth;
    for (Eigen::Index i = 0; i < size; ++i)
      if (colour[static_cast<std::size_t>(i / components)] != c) A.row(i).setZero();
    if (R.size() > 0) {
      const Eigen::ColPivHouseholderQR<Eigen::MatrixXd> moved_by(A.transpose() * R);
      const Eigen::MatrixXd Q = moved_by.householderQ();
      A = (A * Q.rightCols(count - moved_by.rank())).eval();
    }
    const Eigen::MatrixXd moved = inverse.solve(A);
    const Eigen::LLT<Eigen::MatrixXd> L(A.transpose() * moved);
    const auto before = modes_.rows(), own = A.cols();
    modes_.conservativeResize(before + own, size), shapes_.conservativeResize(size, before + own);
    modes_.bottomRows(own) = L.matrixL().solve(A.transpose());
    shapes_.rightCols(own) = L.matrixL().solve(moved.transpose()).transpose();
    sides_.insert(sides_.end(), static_cast<std::size_t>(own), c);
  }
}

}  // namespace imic3d::loop
