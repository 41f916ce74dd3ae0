#pragma once
// The inverse of a sparse matrix: its diagonal, and its product with many columns.

#include <Eigen/SparseCholesky>

namespace imic3d::correlation {

/// Diagonal of the inverse of the factorised matrix, by the recurrence of Takahashi, Fagan and Chin (1973) on the
/// pattern of the factor: costs about as much as the factorisation.
[[nodiscard]] Eigen::VectorXd diagonal_of_inverse(const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>>& factor);

/// Columns that lie side by side in memory [rows x columns]: what is done to one is done to all at once.
using Columns = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// A^-1 B of the factorised matrix A. Eigen's own solution takes the columns of B one after the other.
[[nodiscard]] Columns inverse_times(const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>>& factor, const Columns& B);

}  // namespace imic3d::correlation
