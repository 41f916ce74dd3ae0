#include "imic3d/identification/equilibrium_gap.hpp"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <Eigen/SparseCholesky>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>

#include "imic3d/core/error.hpp"
#include "imic3d/core/linear.hpp"

namespace imic3d::identification {

namespace {

using Sparse = Eigen::SparseMatrix<double>;

/// In the plane: degrees of freedom 2 * node + component.
Eigen::VectorXd in_plane(const Eigen::VectorXd& natural) {
  Eigen::VectorXd plane(2 * (natural.size() / 3));
  for (Eigen::Index i = 0; i < natural.size() / 3; ++i) plane.segment<2>(2 * i) = natural.segment<2>(3 * i);
  return plane;
}

Eigen::VectorXd in_space(const Eigen::VectorXd& plane) {
  Eigen::VectorXd natural = Eigen::VectorXd::Zero(3 * (plane.size() / 2));
  for (Eigen::Index i = 0; i < plane.size() / 2; ++i) natural.segment<2>(3 * i) = plane.segment<2>(2 * i);
  return natural;
}

Sparse in_plane(const Sparse& matrix, bool rows, bool columns) {
  std::vector<Eigen::Triplet<double>> entries;
  const auto at = [](Eigen::Index dof) { return static_cast<int>(2 * (dof / 3) + dof % 3); };
  for (Eigen::Index column = 0; column < matrix.outerSize(); ++column)
    for (Sparse::InnerIterator entry(matrix, column); entry; ++entry)
      if ((!rows || entry.row() % 3 < 2) && (!columns || entry.col() % 3 < 2))
        entries.emplace_back(rows ? at(entry.row()) : static_cast<int>(entry.row()),
                             columns ? at(entry.col()) : static_cast<int>(entry.col()), entry.value());
  Sparse result(rows ? 2 * matrix.rows() / 3 : matrix.rows(), columns ? 2 * matrix.cols() / 3 : matrix.cols());
  result.setFromTriplets(entries.begin(), entries.end());
  return result;
}

/// The mechanics of one frame: F_int, its part where no external force acts, K of that part, and f.
struct Gap {
  Eigen::VectorXd internal;  // [2 nodes]
  Eigen::VectorXd F;         // 0 at the ends
  Sparse K;                  // rows of the ends are 0
  Eigen::MatrixXd f;         // [2 nodes x free]
};

class Mechanics {
 public:
  Mechanics(const Specimen& specimen, std::shared_ptr<const material::FiniteStrainLaw> law)
      : partition_(mesh::partition(specimen.volume, Communicator{MPI_COMM_SELF})),
        equilibrium_(partition_, specimen.volume, std::move(law), {}, {.with_fields = false}),
        keep_(Eigen::VectorXd::Ones(2 * specimen.volume.nodes.rows())) {
    for (const auto* end : {&specimen.held, &specimen.loaded})
      for (int node : *end) keep_.segment<2>(2 * node).setZero();
  }
  [[nodiscard]] Gap gap(const Eigen::VectorXd& U, std::vector<double> parameters, const std::vector<int>& free) {
    Gap result;
    Sparse tangent;
    const Eigen::VectorXd natural = in_space(U);
    result.internal = in_plane(equilibrium_.internal_forces(natural, parameters, &tangent));
    result.F = keep_.cwiseProduct(result.internal);
    result.K = keep_.asDiagonal() * in_plane(tangent, true, true);
    result.f.resize(U.size(), static_cast<Eigen::Index>(free.size()));
    for (std::size_t j = 0; j < free.size(); ++j) {
      double& value = parameters[static_cast<std::size_t>(free[j])];
      const double at = value, step = 1e-6 * std::max(std::abs(at), 1e-3);
      value = at + step;
      const Eigen::VectorXd above = in_plane(equilibrium_.internal_forces(natural, parameters));
      value = at - step;
      const Eigen::VectorXd below = in_plane(equilibrium_.internal_forces(natural, parameters));
      value = at;
      result.f.col(static_cast<Eigen::Index>(j)) = keep_.cwiseProduct(above - below) / (2.0 * step);
    }
    return result;
  }

 private:
  mesh::Partition partition_;
  mechanics::Equilibrium equilibrium_;
  Eigen::VectorXd keep_;
};

/// A parameter that multiplies F_int: dF/dlnLambda = n F for any displacement; here for a bent and stretched one.
void require_ratios(Mechanics& mechanics, const Specimen& specimen, const std::vector<ParameterInfo>& information,
                    const Stage& stage, const std::vector<double>& parameters) {
  const auto& nodes = specimen.volume.nodes;
  const double length = nodes.leftCols<2>().maxCoeff() - nodes.leftCols<2>().minCoeff();
  Eigen::VectorXd U(2 * nodes.rows());
  for (Eigen::Index i = 0; i < nodes.rows(); ++i) {
    const Eigen::Vector2d x = nodes.row(i).head<2>().transpose() / length;
    U.segment<2>(2 * i) << 1e-4 * length * (x[0] * x[1] + x[1] * x[1]), 1e-4 * length * (x[1] - x[0] * x[0] * x[1]);
  }
  const Gap at = mechanics.gap(U, parameters, stage.free);
  for (std::size_t j = 0; j < stage.free.size(); ++j) {
    const Eigen::VectorXd f = at.f.col(static_cast<Eigen::Index>(j));
    const double share = at.F.dot(f) / at.F.squaredNorm();
    if (f.norm() > 0.0 && (f - share * at.F).norm() < 1e-6 * f.norm())
      throw InputError(
          "identify.stages.free",
          fmt::format("{} with functional: equilibrium_gap", information[static_cast<std::size_t>(stage.free[j])].name),
          "parameters that change ratios of stiffness, as nu: this one multiplies all internal forces, and Eq. 2 knows "
          "no force");
  }
}

}  // namespace

EquilibriumGapResult equilibrium_gap(Communicator world, const Specimen& specimen,
                                     std::shared_ptr<const material::FiniteStrainLaw> law, const Record& record,
                                     const ImageData& images, const std::vector<ParameterInfo>& information,
                                     const Stage& stage, const GaussNewtonOptions& options,
                                     std::vector<double>& parameters,
                                     const std::function<void(const Iterate&)>& report) {
  if (mesh::dimension(specimen.volume.type) != 2)
    throw InputError("identify.functional", "equilibrium_gap in 3D", "specimen.kinematics: plane_stress");
  if (law->plastic_strain_index() >= 0)
    throw InputError("identify.functional", "equilibrium_gap with law: " + law->name(), "law: elastic");
  const auto unknowns = static_cast<Eigen::Index>(stage.free.size());
  const auto frames = static_cast<Eigen::Index>(stage.frames.size());
  const Sparse P = in_plane(specimen.projection, false, true), M = P.transpose() * images.M * P;
  std::optional<Mechanics> mechanics;
  collectively(world, [&] {
    mechanics.emplace(specimen, law), require_ratios(*mechanics, specimen, information, stage, parameters);
  });

  // m_0 and k_0, of a wave across the axis.
  const auto& nodes = specimen.volume.nodes;
  const double low = nodes.col(specimen.axis).minCoeff(), length = nodes.col(specimen.axis).maxCoeff() - low;
  Eigen::VectorXd v = Eigen::VectorXd::Zero(M.rows());
  for (Eigen::Index i = 0; i < nodes.rows(); ++i)
    v[2 * i + 1 - specimen.axis] = std::sin(2.0 * std::numbers::pi * (nodes(i, specimen.axis) - low) / length);
  const double m0 = v.dot(M * v);
  const double k0 = (mechanics->gap(Eigen::VectorXd::Zero(M.rows()), parameters, {}).K * v).squaredNorm();
  const double c = (1.0 / options.alpha - 1.0) / k0;

  Eigen::MatrixXd U = Eigen::MatrixXd::Zero(M.rows(), frames), dU(M.rows(), frames), G(M.rows(), frames * unknowns);
  std::vector<Eigen::MatrixXd> sensitivity(static_cast<std::size_t>(frames));  // A^-1 B
  const auto mine = [&](Eigen::Index i) { return i % world.size() == world.rank(); };
  EquilibriumGapResult result;
  result.surface.setZero(images.M.rows(), frames);
  result.reaction.setZero(frames);
  result.gap.setZero(frames);

  double eta = 0.0, moved = INFINITY;
  for (int iteration = 0;; ++iteration) {
    Eigen::VectorXd sums = Eigen::VectorXd::Zero(unknowns * unknowns + unknowns + 4);
    Eigen::Map<Eigen::MatrixXd> matrix(sums.data(), unknowns, unknowns);
    Eigen::Map<Eigen::VectorXd> right(sums.data() + unknowns * unknowns, unknowns);
    auto scalars = sums.tail<4>();
    dU.setZero(), G.setZero(), result.surface.setZero(), result.reaction.setZero(), result.gap.setZero();
    collectively(world, [&] {
      for (Eigen::Index i = 0; i < frames; ++i) {
        if (!mine(i)) continue;
        const int t = stage.frames[static_cast<std::size_t>(i)];
        const Gap at = mechanics->gap(U.col(i), parameters, stage.free);
        const Eigen::VectorXd u = P * U.col(i), apart = record.surface_displacement.col(t) - u,
                              Mapart = images.M * apart;
        const double distance = images.distance(apart, Mapart);
        const ImageEvaluation seen = images.evaluate(t, u, Communicator{MPI_COMM_SELF});
        const Eigen::VectorXd b = P.transpose() * (std::sqrt(distance) < images.reach ? seen.b : Mapart);
        Eigen::SimplicialLDLT<Sparse> A(Sparse(M / m0 + c * Sparse(at.K.transpose() * at.K)));
        if (A.info() != Eigen::Success) throw ConvergenceError("Eq. 2: the images do not fix every node");
        const Eigen::MatrixXd B = c * (at.K.transpose() * at.f), S = A.solve(B);
        dU.col(i) = A.solve(b / m0 - c * (at.K.transpose() * at.F));
        matrix += c * (at.f.transpose() * at.f) - B.transpose() * S;
        right += -c * (at.f.transpose() * at.F) - B.transpose() * dU.col(i);
        sensitivity[static_cast<std::size_t>(i)] = S;
        G.middleCols(i * unknowns, unknowns) = S;
        scalars[0] += seen.squares, scalars[1] += seen.pixels, scalars[2] += distance;
        scalars[3] += seen.squares / m0 + c * at.F.squaredNorm();
        result.surface.col(i) = u;
        for (int node : specimen.loaded) result.reaction[i] += at.internal[2 * node + specimen.axis];
        result.gap[i] = at.F.norm() / std::max(at.internal.norm(), 1e-300);
      }
    });
    world.sum(std::span(sums.data(), static_cast<std::size_t>(sums.size())));
    result.stage.iterates.push_back({.parameters = parameters,
                                     .eta = eta,
                                     .displacement_rms = std::sqrt(scalars[2] / static_cast<double>(frames)),
                                     .image_rms = std::sqrt(scalars[0] / std::max(1.0, scalars[1])),
                                     .force_rms = 0.0,
                                     .cost = scalars[3] / static_cast<double>(frames),
                                     .frames = static_cast<int>(frames),
                                     .message = {}});
    if (report) report(result.stage.iterates.back());
    result.stage.converged = iteration > 1 && eta < options.eta && moved < options.eta;
    if (result.stage.converged || iteration == options.max_iterations) {
      // Noise of b through the solution, dLambda = -A_Lambda^-1 sum_t S^T b_t/m_0: of the frames, and of the common
      // reference.
      world.sum(std::span(G.data(), static_cast<std::size_t>(G.size())));
      Eigen::MatrixXd of_frames = Eigen::MatrixXd::Zero(unknowns, unknowns),
                      common = Eigen::MatrixXd::Zero(M.rows(), unknowns);
      for (Eigen::Index i = 0; i < frames; ++i) {
        const auto S = G.middleCols(i * unknowns, unknowns);
        of_frames += S.transpose() * (M * S);
        common += S;
      }
      const Eigen::MatrixXd inverse = solve_symmetric(matrix, Eigen::MatrixXd::Identity(unknowns, unknowns));
      auto& covariance = result.stage.covariance;
      covariance.image = std::pow(options.noise_model.image / m0, 2) * inverse *
                         (of_frames + common.transpose() * (M * common) / options.noise_model.references) * inverse;
      covariance.total = covariance.image;
      covariance.force = covariance.boundary = covariance.calibration = Eigen::MatrixXd::Zero(unknowns, unknowns);
      break;
    }

    // The first step brings the displacement alone: from U = 0 the gap says nothing of the parameters.
    Eigen::VectorXd step = Eigen::VectorXd::Zero(unknowns);
    if (iteration > 0) step = solve_symmetric(matrix, right);
    double shortened = 1.0;
    for (Eigen::Index j = 0; j < unknowns; ++j) {
      const auto k = static_cast<std::size_t>(stage.free[static_cast<std::size_t>(j)]);
      const double room =
          0.5 * (step[j] > 0.0 ? information[k].upper - parameters[k] : parameters[k] - information[k].lower);
      if (std::abs(step[j]) > room) shortened = std::min(shortened, room / std::abs(step[j]));
    }
    step *= shortened;
    eta = 0.0;  // Eq. (13)
    for (Eigen::Index j = 0; j < unknowns; ++j) {
      double& value = parameters[static_cast<std::size_t>(stage.free[static_cast<std::size_t>(j)])];
      value += step[j];
      eta = std::max(eta, std::abs(step[j]) / std::max(std::abs(value), 1e-300));
    }
    double largest = 0.0, whole = 0.0;
    for (Eigen::Index i = 0; i < frames; ++i) {
      if (!mine(i)) continue;
      const Eigen::VectorXd change = dU.col(i) - sensitivity[static_cast<std::size_t>(i)] * step;
      U.col(i) += change;
      largest = std::max(largest, change.norm());
      whole = std::max(whole, U.col(i).norm());
    }
    moved = world.max(largest) / std::max(world.max(whole), 1e-300);
  }
  world.sum(std::span(result.surface.data(), static_cast<std::size_t>(result.surface.size())));
  for (Eigen::VectorXd* part : {&result.reaction, &result.gap})
    world.sum(std::span(part->data(), static_cast<std::size_t>(part->size())));
  result.reaction *= specimen.section_factor;
  if (!result.stage.converged) result.stage.message = "not converged";
  return result;
}

}  // namespace imic3d::identification
