// A mesh that lies beside the specimen: what it measures, to first order.

#include <gtest/gtest.h>

#include <Eigen/Geometry>

#include "../../src/loop/effects/effects.hpp"
#include "../mesh/meshes.hpp"

namespace imic3d::loop {
namespace test_placement {

/// The specimen is shifted and turned against the mesh; its own field is linear, so that gradients at the nodes are
/// exact.
double worst(double scale, int components) {
  const mesh::Mesh surface = mesh::grid(6, 9);
  Scene scene;
  scene.surface = &surface, scene.components = components, scene.low = {0.0, 0.0}, scene.high = {6.0, 9.0},
  scene.pixels = 20.0 * Eigen::Matrix2d::Identity();
  const std::array<double, 3> values{0.3 * scale, -0.2 * scale, 0.1 * scale};
  Eigen::Matrix<double, 3, 2> gradient;
  gradient << 0.01, 0.03, -0.02, 0.05, 0.04, -0.01;
  const auto own = [&](const Eigen::Vector2d& X) -> Eigen::Vector3d {
    return Eigen::Vector3d(0.1, 0.2, -0.3) + gradient * X;
  };
  const Eigen::Matrix2d R = Eigen::Rotation2Dd(values[2]).toRotationMatrix();
  const auto nodes = surface.nodes.rows();
  Eigen::VectorXd U(components * nodes), error = Eigen::VectorXd::Zero(components * nodes),
                                         expected(components * nodes);
  for (Eigen::Index i = 0; i < nodes; ++i) {
    const Eigen::Vector2d X = surface.nodes.row(i).head<2>().transpose(),
                          there = scene.middle() +
                                  R.transpose() * (X - scene.middle() - Eigen::Vector2d(values[0], values[1]));
    Eigen::Vector3d u = own(there);
    u.head<2>() = R * u.head<2>();
    U.segment(components * i, components) = own(X).head(components);
    expected.segment(components * i, components) = (u - own(X)).head(components);
  }
  placement()->see(values, scene, 0, U, error);
  EXPECT_GT(expected.norm(), 0.0);
  return (error - expected).cwiseAbs().maxCoeff();
}

TEST(Placement, IsWhatAMeshBesideTheSpecimenMeasures) {
  for (const int components : {2, 3}) {
    const double at_hundredth = worst(1e-2, components), at_thousandth = worst(1e-3, components);
    EXPECT_LT(at_hundredth, 1e-5) << components;                          // of displacements up to 1
    EXPECT_NEAR(at_hundredth / at_thousandth, 100.0, 2.0) << components;  // second order is what is left
  }
}

}  // namespace test_placement
}  // namespace imic3d::loop
