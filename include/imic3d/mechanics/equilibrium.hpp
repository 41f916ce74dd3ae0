#pragma once
// The equilibrium path of a specimen over a series of frames.

#include <Eigen/Core>
#include <Eigen/SparseCore>
#include <array>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "imic3d/core/parallel.hpp"
#include "imic3d/material/finite_strain_law.hpp"
#include "imic3d/mesh/mesh.hpp"
#include "imic3d/mesh/partition.hpp"

namespace imic3d::mechanics {

/// What drives the specimen at one frame. All vectors are in natural numbering, the same on every rank, with three
/// degrees of freedom for each node; the third one of a plane mesh (plane stress) is 0.
struct LoadStep {
  double time = 0.0;
  /// displacement of the constrained degrees, in the order of Constraints::dofs [length]
  Eigen::VectorXd prescribed;
  /// By how much `prescribed` changes faster at the begin and at the end of the way from the step before than on a
  /// straight one, in parts of the way [constrained degrees, length]; empty: straight. With u0, u1 at its ends u(s) =
  /// u0 + s (u1 - u0) + s (1 - s) ((1 - s) bend[0] - s bend[1]).
  std::array<Eigen::VectorXd, 2> bend{};
  Eigen::VectorXd force;  ///< external nodal forces [3 * nodes, force]; empty if there are none
  /// directions in which `prescribed` moves [constrained degrees x directions], as many in every step
  Eigen::MatrixXd d_prescribed{};
  std::array<Eigen::MatrixXd, 2> d_bend{};  ///< and in which `bend` does; empty where that is
  /// and in which `force` does, the same ones [3 * nodes x directions]; empty if it does not
  Eigen::SparseMatrix<double> d_force{};
  /// and in which the cells' section does, relatively (mesh::Mesh::section) [cells x directions]; that of the first
  /// step holds for all; empty if it does not
  Eigen::MatrixXd d_section{};
};

/// The state at one converged frame. U and reactions in natural numbering, the same on every rank.
struct FrameState {
  Eigen::VectorXd displacement;  ///< [3 * nodes, length]
  /// internal nodal forces [3 * nodes]; at constrained degrees minus F_ext: the reaction
  Eigen::VectorXd internal;
  /// [cells x 6, stress], natural order
  Eigen::Matrix<double, Eigen::Dynamic, 6, Eigen::RowMajor> cauchy_stress;
  Eigen::VectorXd plastic_strain;  ///< [cells]
  int iterations = 0;              ///< Newton iterations, summed over increments
  /// derivatives of `displacement` and `internal`, by the free parameters, then in the steps' directions
  std::vector<Eigen::VectorXd> d_displacement, d_internal;
};

struct EquilibriumOptions {
  int increments = 1;       ///< load increments between two frames
  int max_iterations = 20;  ///< Newton iterations per increment
  int max_cuts = 6;         ///< doublings of a frame's increments before giving up
  /// residual relative to the norm of the internal forces; where images take part, to that of the optical ones if it is
  /// larger
  double tolerance = 1e-10;
  /// unbalanced derivative of the forces, relative to that at fixed displacement
  double derivative_tolerance = 1e-9;
  /// a direct solver's factors serve while their corrections converge fast; else Newton's method takes the tangent anew
  /// in every iteration
  bool keep_factors = true;
  /// that a solver may spend on factors of frames that are simulated again, on each rank [MB]; one is always kept
  double memory_of_factors = 500.0;
  /// that all its ranks together may take, which decides between a direct solver and an iterative one [bytes]; 0: what
  /// their machines have available
  double memory_of_solver = 0.0;
  /// one series without derivatives: no factor of a direct solver is of use again
  bool once = false;
  bool with_fields = true;            ///< gather stress and plastic strain per frame
  std::string prefix = "mechanics_";  ///< PETSc options: -mechanics_ksp_type, -mechanics_pc_type …
};

/// How far one run is solved; 0: as EquilibriumOptions say.
struct Accuracy {
  /// `tolerance` where no images take part; given and no smaller, corrections with a kept factor end there, not at
  /// round-off
  double forces = 0.0;
  double derivatives = 0.0;  ///< `derivative_tolerance`
  int cuts = 0;              ///< `max_cuts`
};

/// The optical part of Eq. 7 beside the forces, multiplied by k_0/(1/alpha - 1): (K + stiffness) dU = F_ext - F_int +
/// force.
struct OpticalTerm {
  /// c P^T M_DIC P [3 * nodes x 3 * nodes, natural], symmetric; couples only nodes of the same cell.
  Eigen::SparseMatrix<double> stiffness;
  /// c P^T b_DIC [3 * nodes] at the displacement U [3 * nodes] and the given fraction of the way from the frame before
  /// to `frame`; 1 at the frame itself. Collective over the group that solves.
  std::function<Eigen::VectorXd(int frame, double fraction, const Eigen::VectorXd& U)> force;
  /// Derivative of `force` as U moves by dU [3 * nodes].
  std::function<Eigen::VectorXd(int frame, double fraction, const Eigen::VectorXd& U, const Eigen::VectorXd& dU)>
      d_force;
};

/// What simulations took.
struct Work {
  int frames = 0;
  int passes = 0, tangents = 0;  ///< over the elements, and those of them with the tangent
  int factorisations = 0, solutions = 0;
  int derivative_passes = 0, derivative_solutions = 0;
  Work& operator+=(const Work& other) {
    frames += other.frames, passes += other.passes, tangents += other.tangents, factorisations += other.factorisations,
        solutions += other.solutions;
    derivative_passes += other.derivative_passes, derivative_solutions += other.derivative_solutions;
    return *this;
  }
};

/// How a series ended.
struct PathStatus {
  int frames = 0;                 ///< frames that converged, in order
  bool limit_point = false;       ///< the tangent lost its positive definiteness under prescribed forces
  std::string message;            ///< why it stopped, empty if all frames converged
  std::vector<int> increments;    ///< load increments that each frame took
  std::vector<double> residuals;  ///< relative residuals of the last increment's Newton iterations
  int total_iterations = 0;       ///< corrections of the displacement, with a new factor or a kept one
  Work work;
  int derivative_corrections = 0;  ///< passes over the elements for the derivatives, beyond one per increment
};

/// Finite-strain equilibrium by Newton's method (consistent tangent, step cutting). A direct solver's factor serves as
/// long as it pays (modified Newton), and that of a frame which is simulated once more, from a displacement that is
/// offered, is at hand then, as far as memory allows. One object per group of ranks; collective over the partition's
/// communicator.
class Equilibrium {
 public:
  /// constrained_dofs: natural degrees of freedom (3 * node + component), ascending.
  Equilibrium(const mesh::Partition& partition, const mesh::Mesh& mesh,
              std::shared_ptr<const material::FiniteStrainLaw> law, std::vector<int> constrained_dofs,
              EquilibriumOptions options);
  ~Equilibrium();
  Equilibrium(const Equilibrium&) = delete;
  Equilibrium& operator=(const Equilibrium&) = delete;

  [[nodiscard]] const std::vector<int>& constrained_dofs() const;

  /// Runs the whole series from the virgin state (U = 0 at time `start_time`) and calls `frame_done(i, state)` after
  /// each frame. `guess(i)` may offer a displacement [3 * nodes] near frame i's solution (empty: none), from which, or
  /// on the way to which, its increments begin. Else, and where that fails, they go on like the last increment while
  /// the load does. A frame that fails is begun anew with twice as many, equal increments; if that fails too often the
  /// frames so far stand and the status says why. `increments`: the number to begin each frame with (empty:
  /// options.increments). With an `optical` term Newton's method is a modified one (grad F for grad G): it converges
  /// linearly, and `options.tolerance` is relative to the optical forces of the whole displacement, if these are
  /// larger. The term has to be smooth to that.
  ///
  /// `free`: the law's parameters by which the path is differentiated, directly: with the history's derivatives carried
  /// at the points,
  ///     K dU/dLambda = -(dF_int/dLambda + dF_int/dxi_n . dxi_n/dLambda)
  /// at every converged increment. The right-hand side is exact (dual numbers), whatever the tangent: the equation is
  /// solved again for what a dU leaves unbalanced, with the factor at hand or, where that contracts slowly, the
  /// converged tangent, until that vanishes. Where a point turns from elastic to plastic the derivative is that of the
  /// side it is on. The same in the directions of the steps' d_prescribed, in which dU is given at the constrained
  /// degrees. Throws std::invalid_argument for hex8s elements. `fields`: whether stress and plastic strain are
  /// gathered, where the options have them.
  PathStatus run(const std::vector<LoadStep>& steps, std::span<const double> parameters, double start_time,
                 const std::function<void(int, const FrameState&)>& frame_done,
                 const std::function<const Eigen::VectorXd*(int)>& guess = {}, const std::vector<int>& increments = {},
                 const OpticalTerm* optical = nullptr, std::span<const int> free = {}, const Accuracy& accuracy = {},
                 bool fields = true);

  /// Internal forces [3 * nodes] of the virgin specimen under the displacement U [3 * nodes], and if `tangent` is given
  /// K there [3 * nodes x 3 * nodes], as if nothing were constrained. Where the communicator has one rank and
  /// `constrained_dofs` is empty.
  [[nodiscard]] Eigen::VectorXd internal_forces(const Eigen::VectorXd& U, std::span<const double> parameters,
                                                Eigen::SparseMatrix<double>* tangent = nullptr);

  /// U . F_int(U) of the virgin specimen under the displacement U [3 * nodes]: twice the elastic energy where U is
  /// small.
  [[nodiscard]] double internal_work(const Eigen::VectorXd& U, std::span<const double> parameters);

 private:
  struct Implementation;
  std::unique_ptr<Implementation> impl_;
};

}  // namespace imic3d::mechanics
