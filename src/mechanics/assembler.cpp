#include "imic3d/mechanics/assembler.hpp"

#include <algorithm>
#include <cmath>
#include <map>

#include "imic3d/core/error.hpp"
#include "imic3d/mechanics/hexahedron.hpp"
#include "imic3d/mechanics/quadrilateral.hpp"
#include "imic3d/mesh/petsc.hpp"

namespace imic3d::mechanics {

HistoryField::HistoryField(const material::FiniteStrainLaw& law, int cells, int points_per_cell, int cell_state)
    : of_points_(static_cast<std::size_t>(law.history_size() * points_per_cell)),
      per_cell_(of_points_ + static_cast<std::size_t>(cell_state)),
      converged_(per_cell_ * static_cast<std::size_t>(cells)),
      trial_(converged_.size()) {
  initialise(law);
}

void HistoryField::initialise(const material::FiniteStrainLaw& law) {
  const auto size = static_cast<std::size_t>(law.history_size());
  std::fill(converged_.begin(), converged_.end(), 0.0);
  for (std::size_t cell = 0; size > 0 && cell < converged_.size(); cell += per_cell_)
    for (std::size_t begin = cell; begin < cell + of_points_; begin += size)
      law.initialise(std::span(converged_).subspan(begin, size));
  trial_ = converged_;
}

void HistoryField::strain(const material::FiniteStrainLaw& law, int cell, int axis, double strain) {
  const auto size = static_cast<std::size_t>(law.history_size()), first = static_cast<std::size_t>(cell) * per_cell_;
  for (std::size_t begin = first; begin < first + of_points_; begin += size)
    trial_[begin + static_cast<std::size_t>(4 * axis)] = converged_[begin + static_cast<std::size_t>(4 * axis)] =
        std::exp(strain);
}

double HistoryField::advance(int entries) {
  double change = 0.0;
  replaced_ = converged_;
  for (std::size_t first = of_points_; first < converged_.size(); first += per_cell_) {
    for (std::size_t i = first; i < first + 2; ++i) change = std::max(change, std::abs(trial_[i] - converged_[i]));
    std::copy_n(trial_.begin() + static_cast<long>(first), entries, converged_.begin() + static_cast<long>(first));
  }
  return change;
}

void HistoryField::take_back(int entries) {
  for (std::size_t first = of_points_; first < converged_.size(); first += per_cell_)
    std::copy_n(replaced_.begin() + static_cast<long>(first), entries, converged_.begin() + static_cast<long>(first));
}

std::span<const double> HistoryField::converged(int cell) const {
  return std::span(converged_).subspan(static_cast<std::size_t>(cell) * per_cell_, per_cell_);
}

std::span<double> HistoryField::trial(int cell) {
  return std::span(trial_).subspan(static_cast<std::size_t>(cell) * per_cell_, per_cell_);
}

Assembler::Assembler(const mesh::Partition& partition, const mesh::Mesh& mesh,
                     std::shared_ptr<const material::FiniteStrainLaw> law, const std::vector<char>& constrained)
    : partition_(partition),
      law_(std::move(law)),
      points_per_cell_(mesh::dimension(mesh.type) == 2               ? quadrilateral_points
                       : mesh.integration == mesh::Integration::full ? hexahedron_points
                                                                     : 1),
      history_(*law_, static_cast<int>(partition.cells.size()), points_per_cell_,
               mesh.integration == mesh::Integration::one_point_stabilised ? hourglass_state : 0),
      type_(mesh.type),
      integration_(mesh.integration),
      axes_(mesh::dimension(mesh.type)),
      nodes_per_cell_(mesh::nodes_per_cell(mesh.type)),
      thickness_(mesh.thickness),
      initial_axis_(mesh.initial_axis) {
  if (integration_ != mesh::Integration::full && type_ != mesh::CellType::hex8)
    throw InputError("mesh", "one point in " + mesh::name(type_), "one point in hex8");
  if (axes_ < 2) throw InputError("mesh", mesh::name(mesh.type), "quadrilaterals or hexahedra");
  if ((axes_ == 2) != (law_->thickness_strain_index() >= 0))
    throw InputError("material", law_->name() + " on " + mesh::name(mesh.type),
                     "a law of plane stress on quadrilaterals, else on hexahedra");
  for (int cell : partition.cells) {
    if (mesh.section.size() > 0) section_.push_back(mesh.section[cell]);
    if (mesh.initial_strain.size() > 0) initial_strain_.push_back(mesh.initial_strain[cell]);
  }
  const std::size_t cells = partition.cells.size();
  const auto& global_of_natural = partition.global_of_natural;

  // The nodes of this rank's cells, in ascending global order.
  std::map<PetscInt, int> local_of_global;
  for (int cell : partition.cells)
    for (int corner = 0; corner < nodes_per_cell_; ++corner)
      local_of_global.emplace(global_of_natural[static_cast<std::size_t>(mesh.cells(cell, corner))], 0);
  std::vector<PetscInt> global_nodes;
  for (auto& [global, local] : local_of_global) {
    local = static_cast<int>(global_nodes.size());
    global_nodes.push_back(global);
  }

  const auto n = static_cast<std::size_t>(nodes_per_cell_), axes = static_cast<std::size_t>(axes_),
             cell_dofs = axes * n;
  nodes_.resize(static_cast<Eigen::Index>(cells * n), 3);
  local_nodes_.resize(static_cast<Eigen::Index>(cells), nodes_per_cell_);
  constrained_local_.assign(axes * global_nodes.size(), 0);
  std::vector<PetscInt> rows, columns, vector_rows, dofs(cell_dofs);
  rows.reserve(cells * cell_dofs * cell_dofs);
  columns.reserve(cells * cell_dofs * cell_dofs);
  vector_rows.reserve(cells * cell_dofs);
  for (std::size_t k = 0; k < cells; ++k) {
    for (std::size_t corner = 0; corner < n; ++corner) {
      const int natural = mesh.cells(partition.cells[k], static_cast<Eigen::Index>(corner));
      const PetscInt global = global_of_natural[static_cast<std::size_t>(natural)];
      const int local = local_of_global.at(global);
      nodes_.row(static_cast<Eigen::Index>(k * n + corner)) = mesh.nodes.row(natural);
      local_nodes_(static_cast<Eigen::Index>(k), static_cast<Eigen::Index>(corner)) = local;
      for (std::size_t i = 0; i < axes; ++i) {
        dofs[axes * corner + i] = axes_ * global + static_cast<PetscInt>(i);
        constrained_local_[axes * static_cast<std::size_t>(local) + i] =
            constrained[3 * static_cast<std::size_t>(natural) + i];
      }
    }
    vector_rows.insert(vector_rows.end(), dofs.begin(), dofs.end());
    for (PetscInt column : dofs) {
      for (PetscInt row : dofs) {
        rows.push_back(row);
        columns.push_back(column);
      }
    }
  }
  // One diagonal entry per owned degree of freedom carries the identity of the constrained ones.
  const PetscInt first = axes_ * partition.first_owned(), owned = axes_ * partition.owned_nodes();
  constrained_owned_.assign(static_cast<std::size_t>(owned), 0);
  for (std::size_t natural = 0; natural < global_of_natural.size(); ++natural)
    for (int i = 0; i < axes_; ++i) {
      const PetscInt dof = axes_ * global_of_natural[natural] + i;
      if (dof >= first && dof < first + owned)
        constrained_owned_[static_cast<std::size_t>(dof - first)] =
            constrained[3 * natural + static_cast<std::size_t>(i)];
    }
  for (PetscInt dof = first; dof < first + owned; ++dof) {
    rows.push_back(dof);
    columns.push_back(dof);
  }

  const MPI_Comm comm = partition.communicator.handle;
  IMIC3D_PETSC(MatCreate(comm, &tangent_));
  IMIC3D_PETSC(MatSetSizes(tangent_, owned, owned, PETSC_DETERMINE, PETSC_DETERMINE));
  IMIC3D_PETSC(MatSetType(tangent_, MATAIJ));
  IMIC3D_PETSC(MatSetBlockSize(tangent_, axes_));
  IMIC3D_PETSC(MatSetOptionsPrefix(tangent_, "mechanics_"));
  IMIC3D_PETSC(MatSetFromOptions(tangent_));
  IMIC3D_PETSC(MatSetPreallocationCOO(tangent_, static_cast<PetscCount>(rows.size()), rows.data(), columns.data()));
  if (law_->symmetric_tangent()) {
    IMIC3D_PETSC(MatSetOption(tangent_, MAT_SYMMETRIC, PETSC_TRUE));
    IMIC3D_PETSC(MatSetOption(tangent_, MAT_SYMMETRY_ETERNAL, PETSC_TRUE));
  } else {
    IMIC3D_PETSC(MatSetOption(tangent_, MAT_STRUCTURALLY_SYMMETRIC, PETSC_TRUE));
  }

  IMIC3D_PETSC(VecCreateMPI(comm, owned, PETSC_DETERMINE, &force_pattern_));
  IMIC3D_PETSC(VecSetPreallocationCOO(force_pattern_, static_cast<PetscCount>(vector_rows.size()), vector_rows.data()));

  IS from = nullptr;
  IMIC3D_PETSC(ISCreateBlock(PETSC_COMM_SELF, axes_, static_cast<PetscInt>(global_nodes.size()), global_nodes.data(),
                             PETSC_COPY_VALUES, &from));
  IMIC3D_PETSC(VecCreateSeq(PETSC_COMM_SELF, static_cast<PetscInt>(axes * global_nodes.size()), &local_));
  IMIC3D_PETSC(VecScatterCreate(force_pattern_, from, local_, nullptr, &scatter_));
  IMIC3D_PETSC(ISDestroy(&from));

  element_tangents_.assign(rows.size(), 0.0);
  for (PetscInt i = 0; i < owned; ++i)
    element_tangents_[cells * cell_dofs * cell_dofs + static_cast<std::size_t>(i)] =
        constrained_owned_[static_cast<std::size_t>(i)] != 0;
  element_forces_.resize(cells * cell_dofs);
  element_lifting_.resize(cells * cell_dofs);
  u_local_.resize(axes * global_nodes.size());
  increment_local_.resize(axes * global_nodes.size());
  stress_.setZero(static_cast<Eigen::Index>(cells), 6);
  plastic_strain_.setZero(static_cast<Eigen::Index>(cells));
}

Assembler::~Assembler() {
  VecScatterDestroy(&scatter_);
  VecDestroy(&local_);
  VecDestroy(&force_pattern_);
  MatDestroy(&tangent_);
}

void Assembler::start(int directions, const Eigen::MatrixXd& d_section) {
  history_.initialise(*law_);
  const auto count = static_cast<std::size_t>(directions);
  d_history_ = HistoryField(static_cast<int>(partition_.cells.size()),
                            count * static_cast<std::size_t>(points_per_cell_ * law_->history_size()));
  du_local_.assign(count, std::vector<double>(u_local_.size()));
  d_element_forces_.assign(count, std::vector<double>(element_forces_.size()));
  d_section_.assign(count, {});
  for (Eigen::Index k = 0; k < d_section.cols(); ++k)
    if (!d_section.col(k).isZero(0.0))
      for (int cell : partition_.cells)
        d_section_[count - static_cast<std::size_t>(d_section.cols() - k)].push_back(d_section(cell, k));
  for (std::size_t cell = 0; cell < initial_strain_.size(); ++cell)
    history_.strain(*law_, static_cast<int>(cell), initial_axis_, initial_strain_[cell]);
}

double Assembler::renew_hourglass_moduli() {
  if (integration_ != mesh::Integration::one_point_stabilised) return 0.0;
  return partition_.communicator.max(history_.advance(hourglass_moduli));
}

void Assembler::gather(Vec global, std::vector<double>& local) const {
  IMIC3D_PETSC(VecScatterBegin(scatter_, global, local_, INSERT_VALUES, SCATTER_FORWARD));
  IMIC3D_PETSC(VecScatterEnd(scatter_, global, local_, INSERT_VALUES, SCATTER_FORWARD));
  const PetscScalar* values = nullptr;
  IMIC3D_PETSC(VecGetArrayRead(local_, &values));
  std::copy_n(values, local.size(), local.begin());
  IMIC3D_PETSC(VecRestoreArrayRead(local_, &values));
}

void Assembler::insert(const std::vector<double>& element_vectors, Vec global) const {
  IMIC3D_PETSC(VecSetValuesCOO(force_pattern_, element_vectors.data(), INSERT_VALUES));
  IMIC3D_PETSC(VecCopy(force_pattern_, global));
}

template <int nodes, int axes>
bool Assembler::evaluate_cells(double time_increment, std::span<const double> parameters, bool with_tangent) {
  constexpr int dofs = axes * nodes;
  const auto cells = static_cast<int>(local_nodes_.rows());
  int failed = 0;
#pragma omp parallel for schedule(static) reduction(max : failed)
  for (int cell = 0; cell < cells; ++cell) {
    ElementVector<nodes, axes> displacement, prescribed;
    std::array<bool, dofs> fixed;
    for (int dof = 0; dof < dofs; ++dof) {
      const auto local = static_cast<std::size_t>(axes * local_nodes_(cell, dof / axes) + dof % axes);
      const bool is_fixed = fixed[static_cast<std::size_t>(dof)] = constrained_local_[local] != 0;
      displacement[dof] = u_local_[local];
      prescribed[dof] = with_tangent && is_fixed ? increment_local_[local] : 0.0;
    }
    ElementResult<nodes, axes> element;
    const ElementNodes<nodes, axes> places =
        nodes_.middleRows<nodes>(nodes * static_cast<Eigen::Index>(cell)).template leftCols<axes>();
    bool good = false;
    if constexpr (axes == 2)
      good = evaluate<nodes>(*law_, thickness_, parameters, time_increment, places, displacement,
                             history_.converged(cell), history_.trial(cell), element, with_tangent);
    else if constexpr (nodes == 8)
      good = integration_ == mesh::Integration::full
                 ? evaluate(*law_, parameters, time_increment, places, displacement, history_.converged(cell),
                            history_.trial(cell), element, with_tangent)
                 : evaluate_one_point(*law_, parameters, time_increment, places, displacement, history_.converged(cell),
                                      history_.trial(cell), element, with_tangent,
                                      integration_ == mesh::Integration::one_point_stabilised ? &elastic_ : nullptr);
    else
      good = evaluate(*law_, parameters, time_increment, places, displacement, history_.converged(cell),
                      history_.trial(cell), element, with_tangent);
    if (!good) {
      failed = 1;
      continue;
    }
    if (!section_.empty()) {
      element.force *= section_[static_cast<std::size_t>(cell)];
      if (with_tangent) element.tangent *= section_[static_cast<std::size_t>(cell)];
    }
    std::copy_n(element.force.data(), dofs, element_forces_.begin() + dofs * cell);
    stress_.row(cell) = element.cauchy_stress.transpose();
    plastic_strain_[cell] = element.plastic_strain;
    if (!with_tangent) continue;
    Eigen::Map<ElementVector<nodes, axes>> lifting(element_lifting_.data() + static_cast<long>(dofs) * cell);
    lifting.setZero();
    for (int dof = 0; dof < dofs; ++dof)
      if (prescribed[dof] != 0.0) lifting += prescribed[dof] * element.tangent.col(dof);
    for (int dof = 0; dof < dofs; ++dof)
      if (fixed[static_cast<std::size_t>(dof)]) {
        element.tangent.row(dof).setZero();
        element.tangent.col(dof).setZero();
      }
    std::copy_n(element.tangent.data(), dofs * dofs, element_tangents_.begin() + static_cast<long>(dofs) * dofs * cell);
  }
  return failed == 0;
}

bool Assembler::assemble(Vec u, double time_increment, std::span<const double> parameters, Vec force, Vec increment,
                         Vec lifting) {
  const bool with_tangent = increment != nullptr;
  const LoggedEvent logged(LoggedEvent::named(with_tangent ? "imic3dTangent" : "imic3dForces"));
  gather(u, u_local_);
  if (with_tangent) gather(increment, increment_local_);
  if (integration_ == mesh::Integration::one_point_stabilised) {
    const bool begins = elastic_.begins;
    elastic_ = elastic_moduli(*law_, parameters);
    elastic_.begins = begins;
  }

  const bool good = type_ == mesh::CellType::quad4   ? evaluate_cells<4, 2>(time_increment, parameters, with_tangent)
                    : type_ == mesh::CellType::quad8 ? evaluate_cells<8, 2>(time_increment, parameters, with_tangent)
                    : type_ == mesh::CellType::hex8  ? evaluate_cells<8, 3>(time_increment, parameters, with_tangent)
                                                     : evaluate_cells<20, 3>(time_increment, parameters, with_tangent);
  if (!partition_.communicator.all(good)) return false;
  insert(element_forces_, force);
  if (with_tangent) {
    IMIC3D_PETSC(MatSetValuesCOO(tangent_, element_tangents_.data(), INSERT_VALUES));
    insert(element_lifting_, lifting);
  }
  return true;
}

template <int nodes, int axes>
bool Assembler::differentiate_cells(double time_increment, std::span<const double> parameters,
                                    std::span<const double> d_parameters) {
  constexpr int dofs = axes * nodes;
  const auto cells = static_cast<int>(local_nodes_.rows());
  const std::size_t count = du_local_.size(),
                    of_points = static_cast<std::size_t>(points_per_cell_ * law_->history_size());
  int failed = 0;
#pragma omp parallel for schedule(static) reduction(max : failed)
  for (int cell = 0; cell < cells; ++cell) {
    const auto local = [&](int dof) {
      return static_cast<std::size_t>(axes * local_nodes_(cell, dof / axes) + dof % axes);
    };
    const double section = section_.empty() ? 1.0 : section_[static_cast<std::size_t>(cell)];
    const ElementNodes<nodes, axes> places =
        nodes_.middleRows<nodes>(nodes * static_cast<Eigen::Index>(cell)).template leftCols<axes>();
    ElementVector<nodes, axes> displacement;
    for (int dof = 0; dof < dofs; ++dof) displacement[dof] = u_local_[local(dof)];
    for (std::size_t first = 0; first < count; first += most_directions) {
      const std::size_t n = std::min<std::size_t>(most_directions, count - first);
      ElementColumns<nodes, axes> d_displacement(dofs, static_cast<Eigen::Index>(n)),
          d_force(dofs, static_cast<Eigen::Index>(n));
      for (std::size_t k = 0; k < n; ++k)
        for (int dof = 0; dof < dofs; ++dof)
          d_displacement(dof, static_cast<Eigen::Index>(k)) = du_local_[first + k][local(dof)];
      const ElementDirections along{d_parameters.subspan(first * parameters.size(), n * parameters.size()),
                                    d_history_.converged(cell).subspan(first * of_points, n * of_points),
                                    d_history_.trial(cell).subspan(first * of_points, n * of_points)};
      bool good = false;
      if constexpr (axes == 2)
        good = mechanics::differentiate<nodes>(*law_, thickness_, parameters, time_increment, places, displacement,
                                               history_.converged(cell), d_displacement, along, d_force);
      else if constexpr (nodes == 8)
        good = integration_ == mesh::Integration::full
                   ? mechanics::differentiate(*law_, parameters, time_increment, places, displacement,
                                              history_.converged(cell), d_displacement, along, d_force)
                   : differentiate_one_point(*law_, parameters, time_increment, places, displacement,
                                             history_.converged(cell), d_displacement, along, d_force);
      else
        good = mechanics::differentiate(*law_, parameters, time_increment, places, displacement,
                                        history_.converged(cell), d_displacement, along, d_force);
      if (!good) failed = 1;
      d_force *= section;
      for (std::size_t k = 0; k < n; ++k)
        if (const auto& change = d_section_[first + k]; !change.empty())
          d_force.col(static_cast<Eigen::Index>(k)) +=
              change[static_cast<std::size_t>(cell)] *
              Eigen::Map<const ElementVector<nodes, axes>>(element_forces_.data() + static_cast<long>(dofs) * cell);
      for (std::size_t k = 0; k < n; ++k)
        std::copy_n(d_force.col(static_cast<Eigen::Index>(k)).data(), dofs,
                    d_element_forces_[first + k].begin() + dofs * cell);
    }
  }
  return failed == 0;
}

bool Assembler::differentiate(const std::vector<Vec>& du, double time_increment, std::span<const double> parameters,
                              std::span<const double> d_parameters, const std::vector<Vec>& d_force) {
  const LoggedEvent logged(LoggedEvent::named("imic3dDeriv"));
  for (std::size_t k = 0; k < du.size(); ++k) gather(du[k], du_local_[k]);
  const bool good =
      type_ == mesh::CellType::quad4   ? differentiate_cells<4, 2>(time_increment, parameters, d_parameters)
      : type_ == mesh::CellType::quad8 ? differentiate_cells<8, 2>(time_increment, parameters, d_parameters)
      : type_ == mesh::CellType::hex8  ? differentiate_cells<8, 3>(time_increment, parameters, d_parameters)
                                       : differentiate_cells<20, 3>(time_increment, parameters, d_parameters);
  if (!partition_.communicator.all(good)) return false;
  for (std::size_t k = 0; k < du.size(); ++k) insert(d_element_forces_[k], d_force[k]);
  return true;
}

}  // namespace imic3d::mechanics
