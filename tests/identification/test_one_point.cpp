// One integration point an element: which modes the images control, and what the identification makes of it.

#include <gtest/gtest.h>

#include <Eigen/Dense>

#include "plate.hpp"

namespace imic3d::identification {
namespace {

/// Number of displacements [3 * nodes, those of the mid-plane's symmetry held] without energy in K, and in K + P^T M P with M = 1.
struct Modes {
  long mechanics, with_images;
};
Modes modes_without_energy(mesh::Integration integration, int columns, int rows, int layers) {
  mesh::Mesh volume = mesh::extrude(testing::strip(columns, rows), 0.5 * layers, layers);
  volume.integration = integration;
  const Specimen specimen = make_specimen(volume, "bottom", "top", 1, true);
  const Communicator alone(MPI_COMM_SELF);
  const mesh::Partition partition = mesh::partition(specimen.volume, alone);
  mechanics::Equilibrium equilibrium(partition, specimen.volume, material::make_law({.law = "elastic"}), {}, {});
  const std::vector<double> parameters = {198e3, 0.3};
  Eigen::SparseMatrix<double> tangent;
  const Eigen::Index dofs = 3 * specimen.volume.nodes.rows();
  (void)equilibrium.internal_forces(Eigen::VectorXd::Zero(dofs), parameters, &tangent);
  Eigen::MatrixXd K = Eigen::MatrixXd(tangent) / tangent.diagonal().maxCoeff();
  for (int node : specimen.volume.node_groups.at("back")) K(3 * node + 2, 3 * node + 2) += 1.0;
  const auto zero = [](const Eigen::MatrixXd& A) {
    const Eigen::VectorXd values = Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(A, Eigen::EigenvaluesOnly).eigenvalues();
    return static_cast<long>((values.array() < 1e-10).count());
  };
  return {zero(K), zero(K + Eigen::MatrixXd(specimen.projection.transpose() * specimen.projection))};
}

TEST(OnePoint, ModesThatTheImagesSee) {
  for (const auto integration : {mesh::Integration::full, mesh::Integration::one_point_stabilised, mesh::Integration::one_point})
    for (const auto& [columns, rows] : {std::pair{3, 4}, {4, 6}})
      for (int layers : {1, 2, 3}) {
        const Modes modes = modes_without_energy(integration, columns, rows, layers);
        std::printf("%d: %d x %d x %d elements: %ld modes without energy, %ld with the images\n", static_cast<int>(integration), columns,
                    rows, layers, modes.mechanics, modes.with_images);
      }
}

}  // namespace
}  // namespace imic3d::identification
