#include "imic3d/core/linear.hpp"

#include <Eigen/Dense>
#include <cmath>

namespace imic3d {

using Eigen::MatrixXd;

MatrixXd stacked(const MatrixXd& above, const MatrixXd& below) {
  MatrixXd all(above.rows() + below.rows(), above.cols());
  all << above, below;
  return all;
}

MatrixXd least_squares(const MatrixXd& A, const MatrixXd& B, double threshold) {
  Eigen::CompleteOrthogonalDecomposition<MatrixXd> solver(A.rows(), A.cols());
  if (threshold > 0.0) solver.setThreshold(threshold);
  return solver.compute(A).solve(B);
}

MatrixXd pseudo_inverse(const MatrixXd& A) { return A.completeOrthogonalDecomposition().pseudoInverse(); }

MatrixXd orthonormal(const MatrixXd& A) {
  const Eigen::ColPivHouseholderQR<MatrixXd> qr(A);
  return qr.householderQ() * MatrixXd::Identity(A.rows(), qr.rank());
}

SymmetricEigen symmetric_eigen(const MatrixXd& A) {
  const Eigen::SelfAdjointEigenSolver<MatrixXd> solver(A);
  return {solver.eigenvalues(), solver.eigenvectors()};
}

Eigen::VectorXd singular_values(const MatrixXd& A) { return A.jacobiSvd().singularValues(); }

MatrixXd solve_symmetric(const MatrixXd& A, const MatrixXd& B) { return A.ldlt().solve(B); }

SeenInverse inverse_of_seen(const MatrixXd& A, double unseen) {
  const Eigen::Index n = A.rows();
  const Eigen::VectorXd scale =
      A.diagonal().unaryExpr([](double value) { return value > 0.0 ? 1.0 / std::sqrt(value) : 0.0; });
  const auto [values, vectors] = symmetric_eigen(scale.asDiagonal() * A * scale.asDiagonal());
  SeenInverse result;
  Eigen::VectorXd of_values = Eigen::VectorXd::Zero(n), unseen_part = of_values;
  for (Eigen::Index k = 0; k < n; ++k)
    if (values[k] > unseen)
      of_values[k] = 1.0 / values[k];
    else
      unseen_part += vectors.col(k).cwiseAbs2();
  for (Eigen::Index j = 0; j < n; ++j)
    if (unseen_part[j] > 1e-6) result.undetermined.push_back(j);
  result.inverse =
      result.undetermined.empty()
          ? solve_symmetric(A, MatrixXd::Identity(n, n))
          : MatrixXd(scale.asDiagonal() * vectors * of_values.asDiagonal() * vectors.transpose() * scale.asDiagonal());
  return result;
}

void put_block(MatrixXd& covariance, const std::vector<int>& places, const MatrixXd& block) {
  covariance(places, Eigen::all).setConstant(std::nan(""));
  covariance(Eigen::all, places).setConstant(std::nan(""));
  covariance(places, places) = block;
}

MatrixXd cholesky(const MatrixXd& A) { return A.llt().matrixL(); }

MatrixXd inverse_cholesky(const MatrixXd& A) { return A.llt().matrixL().solve(MatrixXd::Identity(A.rows(), A.rows())); }

}  // namespace imic3d
