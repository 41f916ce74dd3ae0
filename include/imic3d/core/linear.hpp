#pragma once
// Dense linear algebra of small systems, compiled once: wherever one of Eigen's decompositions stands it takes the
// compiler seconds.

#include <Eigen/Core>
#include <vector>

namespace imic3d {

/// The rows of `above` [m x n], then those of `below` [k x n].
[[nodiscard]] Eigen::MatrixXd stacked(const Eigen::MatrixXd& above, const Eigen::MatrixXd& below);

/// X that makes |A X - B| least, that of least norm where A [m x n] leaves it open: complete orthogonal decomposition;
/// pivots below `threshold` of the largest count as 0 (Eigen's own threshold if 0). B [m x k], X [n x k].
[[nodiscard]] Eigen::MatrixXd least_squares(const Eigen::MatrixXd& A, const Eigen::MatrixXd& B, double threshold = 0.0);

/// Moore and Penrose's inverse [n x m] of A [m x n].
[[nodiscard]] Eigen::MatrixXd pseudo_inverse(const Eigen::MatrixXd& A);

/// Orthonormal columns [m x rank] that span those of A [m x n].
[[nodiscard]] Eigen::MatrixXd orthonormal(const Eigen::MatrixXd& A);

/// Values, ascending, and vectors (columns) of a symmetric matrix, of which the lower triangle is read.
struct SymmetricEigen {
  Eigen::VectorXd values;
  Eigen::MatrixXd vectors;
};
[[nodiscard]] SymmetricEigen symmetric_eigen(const Eigen::MatrixXd& A);

/// Singular values, descending.
[[nodiscard]] Eigen::VectorXd singular_values(const Eigen::MatrixXd& A);

/// A^-1 B of a symmetric matrix (LDL^T, pivoted). Entries that are not finite where A is singular.
[[nodiscard]] Eigen::MatrixXd solve_symmetric(const Eigen::MatrixXd& A, const Eigen::MatrixXd& B);

/// A^-1 on what normal equations A see, and which unknowns take part in what they do not: these are not determined.
/// Each unknown is scaled to a diagonal of one; an eigenvalue below `unseen` then comes from rounding, or from
/// differences that A is made of, and its combination is not seen at all.
struct SeenInverse {
  Eigen::MatrixXd inverse;
  std::vector<Eigen::Index> undetermined;
};
[[nodiscard]] SeenInverse inverse_of_seen(const Eigen::MatrixXd& A, double unseen = 1e-12);

/// `block` [p x p] into a covariance [n x n] at these places [p]; nothing (NaN) is known any more of what they have in
/// common with the others, of which an earlier stage may have told.
void put_block(Eigen::MatrixXd& covariance, const std::vector<int>& places, const Eigen::MatrixXd& block);

/// L of A = L L^T. A is positive definite.
[[nodiscard]] Eigen::MatrixXd cholesky(const Eigen::MatrixXd& A);

/// L^-1.
[[nodiscard]] Eigen::MatrixXd inverse_cholesky(const Eigen::MatrixXd& A);

}  // namespace imic3d
