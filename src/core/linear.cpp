#include "imic3d/core/linear.hpp"

#include <Eigen/Dense>

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

MatrixXd cholesky(const MatrixXd& A) { return A.llt().matrixL(); }

MatrixXd inverse_cholesky(const MatrixXd& A) { return A.llt().matrixL().solve(MatrixXd::Identity(A.rows(), A.rows())); }

}  // namespace imic3d
