#pragma once
// A sparse matrix of smaller ones on its diagonal.

#include <Eigen/SparseCore>
#include <vector>

namespace imic3d {

/// block(face) of each face, one after the other on the diagonal [sum of rows x sum of columns].
template <typename Faces, typename Block>
Eigen::SparseMatrix<double> blocks(const Faces& faces, Block&& block) {
  std::vector<Eigen::Triplet<double>> entries;
  Eigen::Index rows = 0, columns = 0;
  for (const auto& face : faces) {
    const Eigen::SparseMatrix<double> own = block(face);
    for (int j = 0; j < own.outerSize(); ++j)
      for (Eigen::SparseMatrix<double>::InnerIterator entry(own, j); entry; ++entry)
        entries.emplace_back(static_cast<int>(rows + entry.row()), static_cast<int>(columns) + j, entry.value());
    rows += own.rows(), columns += own.cols();
  }
  Eigen::SparseMatrix<double> all(rows, columns);
  all.setFromTriplets(entries.begin(), entries.end());
  return all;
}

}  // namespace imic3d
