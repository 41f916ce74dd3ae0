#pragma once
// The forces on a specimen at a displacement, and Newton's equations for what is unbalanced of them.

#include <petscvec.h>

#include <Eigen/Core>
#include <memory>
#include <span>
#include <vector>

#include "imic3d/mechanics/assembler.hpp"
#include "imic3d/mechanics/equilibrium.hpp"
#include "imic3d/mesh/petsc.hpp"
#include "numbering.hpp"

namespace imic3d::mechanics {

using OwnedVec = PetscOwner<Vec, VecDestroy>;

/// What acts at the end of an increment. Natural vectors [3 * nodes].
struct Load {
  Eigen::VectorXd prescribed;  // displacement; 0 at free degrees
  Eigen::VectorXd force;
  double time_increment = 0.0;
  int frame = 0;
  double fraction = 1.0;  // of the way from the frame before to `frame`
};

/// The discrete specimen, its displacement u and what acts on it. Whoever solves moves u; the other vectors are as
/// `evaluate` left them. Collective.
class ForceBalance {
 public:
  /// `constrained`: natural degrees of freedom whose displacement is prescribed, ascending. `work` counts the passes
  /// over the elements.
  ForceBalance(const mesh::Partition& partition, const mesh::Mesh& mesh,
               const std::shared_ptr<const material::FiniteStrainLaw>& law, std::vector<int> constrained, Work& work);

  [[nodiscard]] const std::vector<int>& constrained() const { return constrained_; }
  [[nodiscard]] const mesh::Mesh& mesh() const { return mesh_; }
  [[nodiscard]] const Numbering& numbering() const { return numbering_; }
  [[nodiscard]] Assembler& assembler() { return assembler_; }
  [[nodiscard]] const Assembler& assembler() const { return assembler_; }
  [[nodiscard]] const OpticalTerm* optical() const { return optical_; }

  [[nodiscard]] Vec displacement() const { return u_; }
  [[nodiscard]] Vec internal() const { return force_; }
  [[nodiscard]] Vec external() const { return external_; }
  [[nodiscard]] Vec residual() const {
    return residual_;
  }  ///< what is unbalanced, or the right-hand side of Newton's equations
  [[nodiscard]] Vec missing() const { return missing_; }  ///< prescribed - u at constrained degrees, 0 elsewhere

  /// Begins a run with the virgin specimen at U = 0. `parameters` and `optical` (null: none) are those of the run, and
  /// outlive it.
  void start(std::span<const double> parameters, const OpticalTerm* optical, int directions,
             const Eigen::MatrixXd& d_section = {});
  /// What acts from now on.
  void apply(const Load& load);

  /// u <- prescribed at constrained degrees, exactly.
  void impose();
  /// Where u misses the prescribed displacement by round-off only, none is left.
  void settle_prescribed();

  /// Norm of the unbalanced forces at u, infinite where an element fails; `residual` is left as external - internal (+
  /// optical) at free degrees, 0 elsewhere. With the tangent and its lifting or without.
  [[nodiscard]] double evaluate(bool with_tangent);
  /// Work of the unbalanced forces, where `evaluate` was asked last, along a displacement.
  [[nodiscard]] double work_along(Vec displacement) const;
  /// Makes of the tangent, assembled by the last `evaluate`, and of the residual Newton's equations for the correction
  /// of u.
  void linearise();

  /// Derivatives `d_force` of the internal forces at u, where `evaluate` succeeded (Assembler::differentiate).
  [[nodiscard]] bool differentiate(const std::vector<Vec>& du, std::span<const double> d_parameters,
                                   const std::vector<Vec>& d_force);
  /// `residual` <- what the derivatives `d_force` of the internal and `d_external` (null: 0) of the external forces
  /// leave unbalanced at free degrees when u moves by `du`, 0 elsewhere; its norm.
  [[nodiscard]] double unbalanced_derivative(Vec du, Vec d_force, Vec d_external);
  /// The tangent at u once more, where nothing prescribed is missing. False if an element fails.
  [[nodiscard]] bool assemble_tangent();
  /// Adds the optical stiffness to the tangent.
  void add_optical_stiffness();

  /// Internal forces of the virgin specimen at the displacement U [3 * nodes]; with the tangent or without. False if an
  /// element fails.
  [[nodiscard]] bool evaluate_virgin(const Eigen::VectorXd& U, std::span<const double> parameters, bool with_tangent);

 private:
  void attach_near_null_space();
  void assemble_optical_stiffness();
  void find_missing();
  [[nodiscard]] double norm_at_free_degrees();

  const mesh::Mesh& mesh_;
  std::vector<int> constrained_;
  Work& work_;
  Assembler assembler_;
  Numbering numbering_;
  PetscOwner<Mat, MatDestroy> optical_stiffness_;  // as the tangent; of the run
  OwnedVec u_, optical_force_, force_, external_, residual_, missing_, lifting_, prescribed_;
  // Of the run and of the increment at hand.
  std::span<const double> parameters_;
  const OpticalTerm* optical_ = nullptr;
  double time_increment_ = 0.0;
  int frame_ = 0;
  double fraction_ = 1.0;
};

}  // namespace imic3d::mechanics
