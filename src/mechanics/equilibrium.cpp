#include "imic3d/mechanics/equilibrium.hpp"

#include <stdexcept>
#include <utility>

#include "force_balance.hpp"
#include "imic3d/core/error.hpp"
#include "imic3d/core/memory.hpp"
#include "kept_factors.hpp"
#include "load_path.hpp"
#include "newton.hpp"
#include "path_derivatives.hpp"

namespace imic3d::mechanics {

namespace {
/// The memory that there is before any of it is taken.
EquilibriumOptions with_memory(EquilibriumOptions options, const Communicator& group) {
  if (options.memory_of_solver <= 0.0) options.memory_of_solver = group.sum(memory_of_a_rank(group));
  return options;
}
}  // namespace

struct Equilibrium::Implementation {
  const mesh::Partition& partition;
  EquilibriumOptions options;
  Work work;  // of the run at hand
  ForceBalance balance;
  KeptFactors factors;
  Newton newton;
  PathDerivatives derivatives;

  Implementation(const mesh::Partition& partition_, const mesh::Mesh& mesh,
                 const std::shared_ptr<const material::FiniteStrainLaw>& law, std::vector<int> dofs,
                 EquilibriumOptions options_)
      : partition(partition_),
        options(with_memory(std::move(options_), partition.communicator)),
        balance(partition, mesh, law, std::move(dofs), work),
        factors(balance.assembler().tangent(), partition, mesh, balance.constrained(), *law, options, work),
        newton(balance, factors, options),
        derivatives(balance, factors, law->parameters().size(), options, work) {}

  [[nodiscard]] FrameState state(bool fields) const {
    const Numbering& numbering = balance.numbering();
    FrameState state;
    state.displacement = numbering.to_natural(balance.displacement());
    state.internal = numbering.to_natural(balance.internal());
    for (const Vec& vector : derivatives.of_displacement())
      state.d_displacement.push_back(numbering.to_natural(vector));
    for (const Vec& vector : derivatives.of_forces()) state.d_internal.push_back(numbering.to_natural(vector));
    if (options.with_fields && fields) collect_fields(state);
    return state;
  }

  void collect_fields(FrameState& state) const {
    const Communicator group = partition.communicator;
    const auto cells = balance.mesh().cells.rows();
    state.cauchy_stress.setZero(cells, 6);
    state.plastic_strain.setZero(cells);
    for (std::size_t i = 0; i < partition.cells.size(); ++i) {
      const auto row = static_cast<Eigen::Index>(i);
      state.cauchy_stress.row(partition.cells[i]) = balance.assembler().cauchy_stress().row(row);
      state.plastic_strain[partition.cells[i]] = balance.assembler().plastic_strain()[row];
    }
    group.sum(std::span(state.cauchy_stress.data(), static_cast<std::size_t>(state.cauchy_stress.size())));
    group.sum(std::span(state.plastic_strain.data(), static_cast<std::size_t>(state.plastic_strain.size())));
  }

  /// Of the virgin specimen under no constraint, where the communicator has one rank.
  [[nodiscard]] Eigen::SparseMatrix<double> natural_tangent() const {
    const Numbering& numbering = balance.numbering();
    const Mat matrix = balance.assembler().tangent();
    std::vector<Eigen::Triplet<double>> entries;
    for (PetscInt row = 0; row < numbering.owned(); ++row) {
      PetscInt size = 0;
      const PetscInt* columns = nullptr;
      const PetscScalar* values = nullptr;
      IMIC3D_PETSC(MatGetRow(matrix, row, &size, &columns, &values));
      for (PetscInt k = 0; k < size; ++k)
        entries.emplace_back(numbering.natural_of_owned(row), numbering.natural_of_owned(columns[k]), values[k]);
      IMIC3D_PETSC(MatRestoreRow(matrix, row, &size, &columns, &values));
    }
    Eigen::SparseMatrix<double> tangent(numbering.natural_size(), numbering.natural_size());
    tangent.setFromTriplets(entries.begin(), entries.end());
    return tangent;
  }
};

Equilibrium::Equilibrium(const mesh::Partition& partition, const mesh::Mesh& mesh,
                         std::shared_ptr<const material::FiniteStrainLaw> law, std::vector<int> constrained_dofs,
                         EquilibriumOptions options)
    : impl_(std::make_unique<Implementation>(partition, mesh, std::move(law), std::move(constrained_dofs),
                                             std::move(options))) {}

Equilibrium::~Equilibrium() = default;

const std::vector<int>& Equilibrium::constrained_dofs() const { return impl_->balance.constrained(); }

PathStatus Equilibrium::run(const std::vector<LoadStep>& steps, std::span<const double> parameters, double start_time,
                            const std::function<void(int, const FrameState&)>& frame_done,
                            const std::function<const Eigen::VectorXd*(int)>& guess, const std::vector<int>& increments,
                            const OpticalTerm* optical, std::span<const int> free, const Accuracy& accuracy,
                            bool fields) {
  auto& s = *impl_;
  const Eigen::Index directions = steps.empty() ? 0 : steps.front().d_prescribed.cols();
  if ((!free.empty() || directions > 0) && s.balance.mesh().integration == mesh::Integration::one_point_stabilised)
    throw std::invalid_argument("Equilibrium: no direct differentiation of hex8s elements");
  s.work = {};
  s.derivatives.start(free, static_cast<std::size_t>(directions), accuracy);
  s.balance.start(parameters, optical, s.derivatives.size(),
                  steps.empty() ? Eigen::MatrixXd() : steps.front().d_section);
  LoadPath path(s.balance, s.factors, s.newton, s.derivatives, s.options, accuracy, start_time);
  PathStatus status;
  for (int frame = 0; frame < static_cast<int>(steps.size()); ++frame) {
    const int first = increments.empty() ? s.options.increments : increments[static_cast<std::size_t>(frame)];
    const int iterations =
        path.go_to(steps[static_cast<std::size_t>(frame)], guess ? guess(frame) : nullptr, first, status);
    if (!status.message.empty()) break;
    FrameState state = s.state(fields);
    state.iterations = iterations;
    ++status.frames;
    frame_done(frame, state);
  }
  status.residuals = s.newton.residuals();
  s.work.frames = status.frames;
  status.work = s.work;
  return status;
}

Eigen::VectorXd Equilibrium::internal_forces(const Eigen::VectorXd& U, std::span<const double> parameters,
                                             Eigen::SparseMatrix<double>* tangent) {
  auto& s = *impl_;
  if (!s.balance.evaluate_virgin(U, parameters, tangent != nullptr))
    throw ConvergenceError("the law cannot follow the displacement");
  if (tangent != nullptr) *tangent = s.natural_tangent();
  return s.balance.numbering().to_natural(s.balance.internal());
}

double Equilibrium::internal_work(const Eigen::VectorXd& U, std::span<const double> parameters) {
  auto& s = *impl_;
  double work = 0.0;
  if (!s.balance.evaluate_virgin(U, parameters, false))
    throw ConvergenceError("the law cannot follow a uniform strain");
  IMIC3D_PETSC(VecDot(s.balance.displacement(), s.balance.internal(), &work));
  return work;
}

}  // namespace imic3d::mechanics
