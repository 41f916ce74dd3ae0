#pragma once
// Internal forces and consistent tangent of the whole mesh, assembled in parallel.

#include <petscmat.h>
#include <petscvec.h>

#include <Eigen/Core>
#include <memory>
#include <vector>

#include "imic3d/core/parallel.hpp"
#include "imic3d/material/finite_strain_law.hpp"
#include "imic3d/mechanics/one_point.hpp"
#include "imic3d/mesh/mesh.hpp"
#include "imic3d/mesh/partition.hpp"

namespace imic3d::mechanics {

/// What the material points of this rank's cells remember, and behind them what the cell itself does (zeros when
/// virgin): a converged and a trial buffer. Evaluation reads the converged one and writes the trial one; only `commit`
/// moves trial to converged.
class HistoryField {
 public:
  HistoryField(const material::FiniteStrainLaw& law, int cells, int points_per_cell, int cell_state = 0);
  HistoryField() = default;
  /// Zeros: derivatives of a virgin state.
  HistoryField(int cells, std::size_t per_cell)
      : per_cell_(per_cell), converged_(per_cell * static_cast<std::size_t>(cells)), trial_(converged_) {}
  /// The virgin state everywhere.
  void initialise(const material::FiniteStrainLaw& law);
  /// Elastic logarithmic strain of a cell along an axis, before the test: Fp^-1 = exp(strain).
  void strain(const material::FiniteStrainLaw& law, int cell, int axis, double strain);
  void commit() { converged_.swap(trial_); }
  void save() { saved_ = converged_; }     ///< keeps the converged state, for `restore`
  void restore() { converged_ = saved_; }  ///< back to what was saved last
  /// Takes the first `entries` of every cell's own state from the trial to the converged buffer; the largest change of
  /// the first two.
  double advance(int entries);
  void take_back(int entries);  ///< undoes the last `advance`
  [[nodiscard]] std::span<const double> converged(int cell) const;
  [[nodiscard]] std::span<double> trial(int cell);

 private:
  std::size_t of_points_ = 0, per_cell_ = 0;
  std::vector<double> converged_, trial_, saved_, replaced_;
};

/// Assembles over the cells of one rank: OpenMP threads fill flat element arrays without any PETSc call, then one
/// collective insertion (MatSetValuesCOO). Degrees of freedom are axes() * node + component in the partition's global
/// order.
class Assembler {
 public:
  /// `constrained`: flag for each natural degree of freedom (3 * nodes) whose displacement is prescribed. In a plane
  /// mesh, which takes a law of plane stress, nodes have no third one and its flags say nothing.
  Assembler(const mesh::Partition& partition, const mesh::Mesh& mesh,
            std::shared_ptr<const material::FiniteStrainLaw> law, const std::vector<char>& constrained);
  ~Assembler();
  Assembler(const Assembler&) = delete;
  Assembler& operator=(const Assembler&) = delete;

  /// Degrees of freedom of a node: 3, or 2 in a plane mesh.
  [[nodiscard]] int axes() const { return axes_; }

  /// At displacement u [axes() * nodes, global order]: internal forces `force`; and, if `increment` is given, the
  /// tangent with the rows and columns of constrained degrees replaced by the identity, and `lifting`: the tangent's
  /// columns of the constrained degrees times `increment`, to be taken to the right-hand side. Collective; false on
  /// every rank if an element anywhere failed.
  [[nodiscard]] bool assemble(Vec u, double time_increment, std::span<const double> parameters, Vec force,
                              Vec increment = nullptr, Vec lifting = nullptr);

  /// Takes the material points to their state before the test, and their derivatives in `directions` directions to 0.
  /// In the last of these the cells' section moves relatively by `d_section` [cells x some]; empty: in none.
  void start(int directions = 0, const Eigen::MatrixXd& d_section = {});

  /// Where `assemble` succeeded at u: the derivatives of the internal forces, `d_force[k]`, when the displacement moves
  /// by `du[k]`, the parameters by `d_parameters` [directions x number of parameters], the section as `start` was told,
  /// and the old history by its derivatives. Leaves those of the new history behind. Collective; false on every rank if
  /// an element anywhere failed.
  [[nodiscard]] bool differentiate(const std::vector<Vec>& du, double time_increment,
                                   std::span<const double> parameters, std::span<const double> d_parameters,
                                   const std::vector<Vec>& d_force);

  /// While `begins`, the tangent is that of the beginning of a step (ElasticModuli::begins).
  void predict(bool begins) { elastic_.begins = begins; }
  /// Lets the elements work with the hourglass moduli that the last evaluation found (one_point.hpp); the largest
  /// change of G_t/G and G_s/G, 0 where nothing is stabilised. Collective.
  [[nodiscard]] double renew_hourglass_moduli();
  void restore_hourglass_moduli() { history_.take_back(hourglass_moduli); }  ///< those before the last renewal

  [[nodiscard]] Mat tangent() const { return tangent_; }
  /// The state and its derivatives: the trial one becomes the converged one; is kept for `restore`; is what was kept.
  void commit() { history_.commit(), d_history_.commit(); }
  void save() { history_.save(), d_history_.save(); }
  void restore() { history_.restore(), d_history_.restore(); }
  /// Cell averages at the last evaluation, for this rank's cells in the order of partition.cells:
  /// Cauchy stress [cells x 6], accumulated plastic strain [cells].
  [[nodiscard]] const Eigen::Matrix<double, Eigen::Dynamic, 6, Eigen::RowMajor>& cauchy_stress() const {
    return stress_;
  }
  [[nodiscard]] const Eigen::VectorXd& plastic_strain() const { return plastic_strain_; }
  [[nodiscard]] const std::vector<char>& constrained_owned() const { return constrained_owned_; }

 private:
  void gather(Vec global, std::vector<double>& local) const;
  void insert(const std::vector<double>& element_vectors, Vec global) const;
  /// Fills the element arrays; false if an element of this rank failed.
  template <int nodes, int axes>
  [[nodiscard]] bool evaluate_cells(double time_increment, std::span<const double> parameters, bool with_tangent);
  /// Fills the arrays of the derivatives; false if an element of this rank failed.
  template <int nodes, int axes>
  [[nodiscard]] bool differentiate_cells(double time_increment, std::span<const double> parameters,
                                         std::span<const double> d_parameters);

  const mesh::Partition& partition_;
  std::shared_ptr<const material::FiniteStrainLaw> law_;
  int points_per_cell_;
  HistoryField history_, d_history_;  // of the latter most_directions after most_directions, point by point
  mesh::CellType type_;
  mesh::Integration integration_;
  ElasticModuli elastic_;  // of the parameters at hand, where the hourglass modes are stabilised
  int axes_, nodes_per_cell_;
  double thickness_;                              // of a plane mesh
  std::vector<double> section_, initial_strain_;  // of each local cell; empty: all of it, none
  // of each direction, relative; empty: the section does not move
  std::vector<std::vector<double>> d_section_;
  int initial_axis_;
  mesh::Nodes nodes_;        // reference positions, cell by cell [local cells * nodes per cell x 3]
  mesh::Cells local_nodes_;  // of each local cell, into local arrays
  std::vector<char> constrained_local_, constrained_owned_;
  std::vector<double> element_tangents_, element_forces_, element_lifting_;
  std::vector<double> u_local_, increment_local_;
  std::vector<std::vector<double>> du_local_, d_element_forces_;  // of each direction
  Eigen::Matrix<double, Eigen::Dynamic, 6, Eigen::RowMajor> stress_;
  Eigen::VectorXd plastic_strain_;
  Mat tangent_ = nullptr;
  Vec local_ = nullptr;
  Vec force_pattern_ = nullptr;  // holds the COO pattern of the element vectors
  VecScatter scatter_ = nullptr;
};

}  // namespace imic3d::mechanics
