// One integration point an element: which modes the images control, and what the identification makes of it.

#include <gtest/gtest.h>

#include <Eigen/Dense>

#include "imic3d/core/linear.hpp"
#include "plate.hpp"

namespace imic3d::identification {
namespace test_one_point {

using testing::Plate;

/// Number of displacements [3 * nodes, those of the mid-plane's symmetry held] without energy in K, and in K + P^T M P
/// with M = 1.
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
    return static_cast<long>((symmetric_eigen(A).values.array() < 1e-10).count());
  };
  return {zero(K), zero(K + Eigen::MatrixXd(specimen.projection.transpose() * specimen.projection))};
}

/// The images see all hourglass modes of the face, and with them all of the mesh but 3 a layer, however many elements
/// it has: nodes of one plane behind the face that move in turn to and fro along x, y or z (of the face itself along
/// z).
TEST(OnePoint, ModesThatTheImagesSee) {
  for (const auto& [columns, rows] : {std::pair{3, 4}, {4, 6}})
    for (int layers : {1, 2, 3}) {
      const auto modes = [&](mesh::Integration integration) {
        return modes_without_energy(integration, columns, rows, layers);
      };
      for (const auto integration : {mesh::Integration::full, mesh::Integration::one_point_stabilised}) {
        EXPECT_EQ(modes(integration).mechanics, 3);  // rigid
        EXPECT_EQ(modes(integration).with_images, 0);
      }
      const Modes one_point = modes(mesh::Integration::one_point);
      std::printf("hex8r, %d x %d x %d elements: %ld modes without energy, %ld with the images\n", columns, rows,
                  layers, one_point.mechanics, one_point.with_images);
      EXPECT_GT(one_point.mechanics, 3 * layers + 20);
      EXPECT_EQ(one_point.with_images, 3 * layers);
    }
}

/// Data and model of one kind of element: the truth is found from wrong parameters, alpha -> 0 and finite.
void finds_the_truth(mesh::Integration integration, std::initializer_list<double> alphas, Sensitivities sensitivities) {
  const Communicator world;
  for (double alpha : alphas) {
    mesh::Mesh volume = mesh::extrude(testing::strip(), 0.5, 2);
    volume.integration = integration;
    Plate plate({0.003, 0.006, 0.02, 0.06, 0.12}, make_specimen(volume, "bottom", "top", 1, true));
    ForwardModel model(world, plate.specimen, plate.law, plate.record, {.with_fields = false}, 2, 0);
    auto parameters = plate.truth;
    parameters[2] *= 0.9;
    const auto result =
        gauss_newton(world, model, plate.images, testing::information(plate), {.free = {2}, .frames = {0, 1, 2, 3, 4}},
                     {.alpha = alpha, .eta = 1e-6, .sensitivities = sensitivities}, parameters);
    EXPECT_TRUE(result.converged) << alpha << " " << result.message;
    EXPECT_NEAR(parameters[2] / plate.truth[2], 1.0, 1e-5) << alpha;
  }
}
TEST(OnePoint, StabilisedItFindsTheTruth) {
  finds_the_truth(mesh::Integration::one_point_stabilised, {0.0, 1e-3, 0.3, 0.9}, Sensitivities::perturbed);
}
TEST(OnePoint, WithoutStabilisationItFindsTheTruthWithTheImages) {
  finds_the_truth(mesh::Integration::one_point, {0.3, 0.9}, Sensitivities::direct);
}
TEST(OnePointNightly, WithoutStabilisationItFindsTheTruthWithTheImagesByPerturbation) {
  finds_the_truth(mesh::Integration::one_point, {1e-3, 0.3, 0.9}, Sensitivities::perturbed);
}
TEST(OnePoint, StabilisedItIsNotDifferentiated) {
  EXPECT_THROW(finds_the_truth(mesh::Integration::one_point_stabilised, {0.0}, Sensitivities::direct),
               std::invalid_argument);
}

}  // namespace test_one_point
}  // namespace imic3d::identification
