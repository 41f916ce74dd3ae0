#pragma once
// Entries of the inverse of a sparse matrix.

#include <Eigen/SparseCholesky>

namespace imic3d::correlation {

/// Diagonal of the inverse of the factorised matrix, by the recurrence of Takahashi, Fagan and Chin (1973) on the
/// pattern of the factor: costs about as much as the factorisation.
[[nodiscard]] Eigen::VectorXd diagonal_of_inverse(const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>>& factor);

}  // namespace imic3d::correlation
