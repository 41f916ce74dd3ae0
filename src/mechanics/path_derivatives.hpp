#pragma once
// Direct differentiation of an equilibrium path.

#include <Eigen/Core>
#include <Eigen/SparseCore>
#include <cstddef>
#include <deque>
#include <span>
#include <vector>

#include "anderson.hpp"
#include "force_balance.hpp"
#include "kept_factors.hpp"

namespace imic3d::mechanics {

/// Derivatives of the path by parameters of the law, then in directions of the prescribed displacement and the external
/// forces: at every converged increment
///     K dU/dLambda = dF_ext/dLambda - (dF_int/dLambda + dF_int/dxi_n . dxi_n/dLambda)
/// What is left unbalanced is solved for with the factor at hand while that shrinks it fast, else with the converged
/// tangent; of many derivatives with the factor of the converged tangent, in blocks.
class PathDerivatives {
 public:
  /// `parameters`: how many the law has.
  PathDerivatives(ForceBalance& balance, KeptFactors& factors, std::size_t parameters,
                  const EquilibriumOptions& options, Work& work);
  ~PathDerivatives();
  PathDerivatives(const PathDerivatives&) = delete;
  PathDerivatives& operator=(const PathDerivatives&) = delete;

  /// By which of the law's parameters the path is differentiated, and in how many directions of what drives the
  /// specimen.
  void start(std::span<const int> free, std::size_t directions, const Accuracy& accuracy);
  /// By how much the factor at hand is to reduce what is unbalanced of them; 1 where it is not asked to.
  [[nodiscard]] double reduction() const;
  [[nodiscard]] int size() const { return static_cast<int>(du_.size()); }

  /// Where an increment has just converged: its derivatives, and those of the new history. `d_prescribed` [constrained
  /// degrees x directions], `d_external` [3 * nodes x directions; empty: forces do not move]; `corrections` grows by
  /// the passes over the elements beyond one. False if they are not found; every rank gets the same answer. Collective.
  [[nodiscard]] bool differentiate(const Eigen::MatrixXd& d_prescribed, const Eigen::SparseMatrix<double>& d_external,
                                   int& corrections);
  /// Of the displacement and of the internal forces, there.
  [[nodiscard]] const std::vector<Vec>& of_displacement() const { return du_; }
  [[nodiscard]] const std::vector<Vec>& of_forces() const { return d_force_; }

 private:
  void release();
  void begin_with(const Eigen::MatrixXd& d_prescribed, const Eigen::SparseMatrix<double>& d_external);
  [[nodiscard]] double given_force(std::size_t k) const;
  [[nodiscard]] bool balance_all(int& corrections);
  void correct_together(std::size_t k);
  void correct_block();

  ForceBalance& balance_;
  KeptFactors& factors_;
  std::size_t parameters_, directions_ = 0;
  const EquilibriumOptions& options_;
  Work& work_;
  double tolerance_ = 0.0;
  OwnedVec correction_;
  // of each free parameter and direction; the last of those alone in which forces move, else null
  std::vector<Vec> du_, d_force_, d_external_;
  std::vector<double> d_parameters_;  // unit vectors [free x number of parameters], then 0
  std::deque<Anderson> acceleration_;
  // of a block of derivatives that the factor at hand corrects at once
  std::vector<OwnedVec> unbalanced_, corrections_;
  std::vector<std::size_t> block_;  // which these are
};

}  // namespace imic3d::mechanics
