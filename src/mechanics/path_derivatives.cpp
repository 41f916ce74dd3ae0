#include "path_derivatives.hpp"

#include <cmath>

namespace imic3d::mechanics {

namespace {
/// So many solutions with the factor at hand an unbalanced derivative may still need before the converged tangent is
/// assembled,
constexpr double solutions_of_a_tangent = 7.0;
/// or, where there are so many derivatives that one of their passes costs two corrections, factorised;
constexpr std::size_t directions_of_a_factor = 3;
/// of so many before the first: each is then one solution.
constexpr std::size_t directions_of_a_factor_at_once = 10;
/// Derivatives in more directions are not accelerated: 16 vectors each.
constexpr std::size_t most_accelerated = 16;
/// So many are corrected at once: the factor is read once.
constexpr std::size_t block_size = 32;
}  // namespace

PathDerivatives::PathDerivatives(ForceBalance& balance, KeptFactors& factors, std::size_t parameters,
                                 const EquilibriumOptions& options, Work& work)
    : balance_(balance), factors_(factors), parameters_(parameters), options_(options), work_(work) {
  IMIC3D_PETSC(VecDuplicate(balance_.displacement(), correction_.put()));
}

PathDerivatives::~PathDerivatives() { release(); }

void PathDerivatives::release() {
  for (auto* vectors : {&du_, &d_force_, &d_external_})
    for (Vec& vector : *vectors) VecDestroy(&vector);
}

void PathDerivatives::start(std::span<const int> free, std::size_t directions, const Accuracy& accuracy) {
  const std::size_t all = free.size() + directions;
  directions_ = directions;
  tolerance_ = accuracy.derivatives > 0.0 ? accuracy.derivatives : options_.derivative_tolerance;
  acceleration_.clear();
  if (all <= most_accelerated)
    for (std::size_t k = 0; k < all; ++k) acceleration_.emplace_back(7);
  release();
  for (auto* vectors : {&du_, &d_force_}) {
    vectors->assign(all, nullptr);
    for (Vec& vector : *vectors) IMIC3D_PETSC(VecDuplicate(balance_.displacement(), &vector));
  }
  d_external_.assign(all, nullptr);
  d_parameters_.assign(all * parameters_, 0.0);
  for (std::size_t k = 0; k < free.size(); ++k)
    d_parameters_[k * parameters_ + static_cast<std::size_t>(free[k])] = 1.0;
}

double PathDerivatives::reduction() const {
  return du_.empty() || du_.size() >= directions_of_a_factor_at_once ? 1.0 : tolerance_;
}

bool PathDerivatives::differentiate(const Eigen::MatrixXd& d_prescribed, const Eigen::SparseMatrix<double>& d_external,
                                    int& corrections) {
  if (balance_.optical() != nullptr) balance_.add_optical_stiffness();
  factors_.begin_derivatives();
  for (Anderson& accelerated : acceleration_) accelerated.restart();
  begin_with(d_prescribed, d_external);
  const bool balanced = balance_all(corrections);
  factors_.end_derivatives();
  return balanced;
}

/// The displacement moves where it is prescribed, and nowhere else yet.
void PathDerivatives::begin_with(const Eigen::MatrixXd& d_prescribed, const Eigen::SparseMatrix<double>& d_external) {
  const std::size_t free = du_.size() - directions_;
  const auto& constrained = balance_.constrained();
  for (std::size_t k = 0; k < du_.size(); ++k) {
    IMIC3D_PETSC(VecZeroEntries(du_[k]));
    if (k < free) continue;
    Eigen::VectorXd given = Eigen::VectorXd::Zero(balance_.numbering().natural_size());
    for (std::size_t i = 0; i < constrained.size(); ++i)
      given[constrained[i]] = d_prescribed(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(k - free));
    balance_.numbering().to_global(given, du_[k]);
    const auto direction = static_cast<Eigen::Index>(k - free);
    if (d_external.size() == 0 || d_external.col(direction).nonZeros() == 0) continue;
    if (d_external_[k] == nullptr) IMIC3D_PETSC(VecDuplicate(balance_.displacement(), &d_external_[k]));
    balance_.numbering().to_global(Eigen::VectorXd(d_external.col(direction)), d_external_[k]);
  }
}

/// |dF_int/dLambda + dF_int/dxi . dxi/dLambda| + |dF_ext/dLambda| where the displacement moves at most where it is
/// prescribed.
double PathDerivatives::given_force(std::size_t k) const {
  double internal = 0.0, external = 0.0;
  IMIC3D_PETSC(VecNorm(d_force_[k], NORM_2, &internal));
  if (d_external_[k] != nullptr) IMIC3D_PETSC(VecNorm(d_external_[k], NORM_2, &external));
  return internal + external;
}

bool PathDerivatives::balance_all(int& corrections) {
  constexpr int most = 30;
  bool by_factor = factors_.may_be_kept() && balance_.optical() == nullptr;  // else with the converged tangent
  const bool many = du_.size() >= directions_of_a_factor;
  bool renewed = by_factor && du_.size() >= directions_of_a_factor_at_once;
  if (renewed && !(balance_.assemble_tangent() && factors_.renew())) return false;
  std::vector<double> scale(du_.size()), last(du_.size(), INFINITY);
  for (int pass = 0; pass <= most; ++pass) {
    ++work_.derivative_passes;
    if (!balance_.differentiate(du_, d_parameters_, d_force_)) return false;
    bool balanced = true;
    for (std::size_t k = 0; k < du_.size(); ++k) {
      if (pass == 0) scale[k] = given_force(k);
      const double norm = balance_.unbalanced_derivative(du_[k], d_force_[k], d_external_[k]);
      if (norm <= tolerance_ * scale[k]) continue;
      balanced = false;
      const double wanted = tolerance_ * scale[k] / norm;
      const auto takes_more = [&](double solutions) {
        return norm >= last[k] || std::log(wanted) < solutions * std::log(norm / last[k]);
      };
      if (by_factor && many && !renewed && takes_more(0.5 * factors_.corrections_of_a_factor())) {
        renewed = true;
        if (!(balance_.assemble_tangent() && factors_.renew())) return false;
        for (Anderson& accelerated : acceleration_) accelerated.restart();
      } else if (by_factor && takes_more(solutions_of_a_tangent)) {
        by_factor = false;
        if (!balance_.assemble_tangent()) return false;
      }
      last[k] = norm;
      if (by_factor) {
        correct_together(k);
        continue;
      }
      factors_.refine(balance_.residual(), correction_, 0.1 * wanted);
      IMIC3D_PETSC(VecAXPY(du_[k], 1.0, correction_));
    }
    correct_block();
    if (balanced) return true;
    ++corrections;
  }
  return false;
}

/// What is unbalanced of derivative k joins the block, which is corrected when it is full.
void PathDerivatives::correct_together(std::size_t k) {
  if (unbalanced_.size() == block_.size())
    for (auto* vectors : {&unbalanced_, &corrections_})
      IMIC3D_PETSC(VecDuplicate(balance_.displacement(), vectors->emplace_back().put()));
  IMIC3D_PETSC(VecCopy(balance_.residual(), unbalanced_[block_.size()]));
  block_.push_back(k);
  if (block_.size() == block_size) correct_block();
}

void PathDerivatives::correct_block() {
  if (block_.empty()) return;
  std::vector<Vec> right, solution;
  for (std::size_t i = 0; i < block_.size(); ++i) right.push_back(unbalanced_[i]), solution.push_back(corrections_[i]);
  factors_.substitute(right, solution);
  for (std::size_t i = 0; i < block_.size(); ++i) {
    if (!acceleration_.empty()) acceleration_[block_[i]].accelerate(solution[i]);
    IMIC3D_PETSC(VecAXPY(du_[block_[i]], 1.0, solution[i]));
  }
  block_.clear();
}

}  // namespace imic3d::mechanics
