#pragma once
// A displacement of a surface in few numbers.

#include <Eigen/Core>
#include <Eigen/SparseCore>
#include <vector>

#include "imic3d/mesh/mesh.hpp"

namespace imic3d::loop {

/// Smooth modes Phi, those of the least curvature, taken on the black and on the white squares of a checkerboard apart;
/// D_c is 1 at the nodes of colour c and 0 elsewhere:
///
///   q_c = L_c^-1 A_c^T u,  A_c = D_c M Phi,  A_c^T M^-1 A_c = L_c L_c^T,
///
/// so that noise of covariance M^-1 is white on either colour; the two share what is correlated across the squares'
/// edges. Combinations of modes that motions R would move are left out: A_c^T R = 0.
class SurfaceModes {
 public:
  SurfaceModes() = default;
  /// `surface`: quad4 [n nodes]; M [unknowns square], some components a node; about `wanted` numbers, at most a quarter
  /// of the unknowns; R [unknowns x any].
  SurfaceModes(const mesh::Mesh& surface, const Eigen::SparseMatrix<double>& M, int wanted,
               const Eigen::MatrixXd& R = {});
  /// [modes x any] of displacements [unknowns x any].
  [[nodiscard]] Eigen::MatrixXd numbers(const Eigen::MatrixXd& displacement) const { return modes_ * displacement; }
  /// The displacement of the least u^T M u on each colour that has these numbers there, added up [unknowns].
  [[nodiscard]] Eigen::VectorXd displacement(const Eigen::VectorXd& numbers) const { return shapes_ * numbers; }
  /// The colour, 0 or 1, of each number.
  [[nodiscard]] const std::vector<int>& sides() const { return sides_; }

 private:
  Eigen::MatrixXd modes_, shapes_;  // L_c^-1 A_c^T [modes x unknowns]; M^-1 modes_^T
  std::vector<int> sides_;
};

}  // namespace imic3d::loop
