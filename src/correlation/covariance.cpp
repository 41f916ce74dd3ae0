#include "imic3d/correlation/covariance.hpp"

#include <vector>

namespace imic3d::correlation {

Eigen::VectorXd diagonal_of_inverse(const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>>& factor) {
  // P A P^T = L D L^T; Z = (L D L^T)^-1 on the pattern of L, last column first.
  const auto triangle = factor.matrixL();
  const Eigen::SparseMatrix<double> L = triangle.nestedExpression();  // strictly below the diagonal
  const Eigen::VectorXd D = factor.vectorD();
  const Eigen::Index size = L.cols();
  const int* const first = L.outerIndexPtr();
  const int* const row = L.innerIndexPtr();
  const double* const l = L.valuePtr();
  std::vector<double> Z(static_cast<std::size_t>(L.nonZeros()), 0.0), column(static_cast<std::size_t>(size), 0.0);
  std::vector<char> inside(static_cast<std::size_t>(size), 0);
  Eigen::VectorXd diagonal(size);
  for (Eigen::Index j = size - 1; j >= 0; --j) {
    for (int p = first[j]; p < first[j + 1]; ++p) {
      inside[static_cast<std::size_t>(row[p])] = 1;
      column[static_cast<std::size_t>(row[p])] = 0.0;
    }
    // Z_ij = -sum_k Z_ik L_kj over the column's pattern, where Z_ik is known already.
    for (int p = first[j]; p < first[j + 1]; ++p) {
      const int k = row[p];
      double sum = l[p] * diagonal[k];
      // L_ij is needed beside L_kj: the pattern of column j below k runs along with that of column k.
      int q = p + 1;
      for (int s = first[k]; s < first[k + 1]; ++s) {
        const int i = row[s];
        if (inside[static_cast<std::size_t>(i)] == 0) continue;
        while (row[q] < i) ++q;
        column[static_cast<std::size_t>(i)] -= l[p] * Z[static_cast<std::size_t>(s)];
        sum += l[q] * Z[static_cast<std::size_t>(s)];
      }
      column[static_cast<std::size_t>(k)] -= sum;
    }
    double value = 1.0 / D[j];
    for (int p = first[j]; p < first[j + 1]; ++p) {
      const auto i = static_cast<std::size_t>(row[p]);
      Z[static_cast<std::size_t>(p)] = column[i];
      value -= l[p] * column[i];
      inside[i] = 0;
    }
    diagonal[j] = value;
  }
  Eigen::VectorXd result(size);
  const auto& order = factor.permutationP().indices();
  for (Eigen::Index i = 0; i < size; ++i) result[i] = diagonal[order.size() > 0 ? order[i] : i];
  return result;
}

Columns inverse_times(const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>>& factor, const Columns& B) {
  const auto triangle = factor.matrixL();
  const Eigen::SparseMatrix<double>& L = triangle.nestedExpression();  // strictly below the diagonal
  const Eigen::VectorXd D = factor.vectorD();
  using Entry = Eigen::SparseMatrix<double>::InnerIterator;
  Columns X = factor.permutationP() * B;
  for (Eigen::Index j = 0; j < L.cols(); ++j)
    for (Entry entry(L, j); entry; ++entry) X.row(entry.row()) -= entry.value() * X.row(j);
  for (Eigen::Index j = L.cols() - 1; j >= 0; --j) {
    X.row(j) /= D[j];
    for (Entry entry(L, j); entry; ++entry) X.row(j) -= entry.value() * X.row(entry.row());
  }
  return factor.permutationPinv() * X;
}

}  // namespace imic3d::correlation
