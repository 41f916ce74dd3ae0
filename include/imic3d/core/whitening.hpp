#pragma once
// Numbers with noise of their own and errors that they share, made independent.

#include <Eigen/Core>
#include <vector>

namespace imic3d {

/// W with W (diag(deviation^2) + S S^T) W^T = 1, in memory and time of n r: of numbers that are not `last` the
/// symmetric root W = (1 - A V diag(1/(g (g + 1))) V^T A^T) diag(1/deviation), A = diag(1/deviation) S, A^T A = V
/// diag(g^2 - 1) V^T. Rows of W for numbers that are not `last` hold nothing of those that are; these are compared with
/// what the others tell of the shared errors.
class Whitening {
 public:
  /// deviation [n], > 0; shared: S [n x r], r may be 0; last: places, ascending.
  Whitening(const Eigen::VectorXd& deviation, const Eigen::MatrixXd& shared,
            const std::vector<Eigen::Index>& last = {});

  /// W `values` [n x k].
  [[nodiscard]] Eigen::MatrixXd operator()(const Eigen::MatrixXd& values) const;

 private:
  struct Part {
    Part(std::vector<Eigen::Index> rows, const Eigen::VectorXd& deviation, const Eigen::MatrixXd& shared);
    [[nodiscard]] Eigen::MatrixXd whitened(const Eigen::MatrixXd& values) const;  // [own x k]
    std::vector<Eigen::Index> rows;
    Eigen::VectorXd weight;  // 1/deviation [own]
    Eigen::MatrixXd A, V;    // [own x r], [r x r]
    Eigen::ArrayXd g;        // [r]
  };
  Part first_, last_;
  // shared errors from the first's numbers over their deviations [r x own of the first]; [own of the last x r]
  Eigen::MatrixXd told_, shared_by_last_;
};

}  // namespace imic3d
