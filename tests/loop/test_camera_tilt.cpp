// A camera that looks at the specimen from the side, against a lens in space.

#include <gtest/gtest.h>

#include <cmath>

#include "../../src/loop/effects/effects.hpp"
#include "../mesh/meshes.hpp"

namespace imic3d::loop {
namespace test_camera_tilt {

/// Where a lens at `distance` shows a point of the plane z = 0 that is turned by (a, b) [rad] about y and x, in lengths
/// on the specimen.
Eigen::Vector2d seen(const Eigen::Vector2d& x, const Eigen::Vector2d& turn, double distance) {
  const double nearer = x[0] * std::sin(turn[0]) + x[1] * std::cos(turn[0]) * std::sin(turn[1]);
  return Eigen::Vector2d(x[0] * std::cos(turn[0]), x[1] * std::cos(turn[1])) / (1.0 - nearer / distance);
}

/// Largest error of the effect [length] on a bar that is stretched along y, its displacement linear.
double worst(double scale) {
  const mesh::Mesh surface = mesh::grid(6, 9);
  Scene scene;
  scene.surface = &surface, scene.components = 2, scene.low = {0.0, 0.0}, scene.high = {6.0, 9.0},
  scene.axis_of_lens = {2.5, 4.0};
  const Eigen::Vector2d turn = scale * Eigen::Vector2d(0.5, -0.3);
  const double distance = 40.0;
  Eigen::Matrix2d gradient;
  gradient << -0.02, 0.01, 0.0, 0.05;
  const auto nodes = surface.nodes.rows();
  Eigen::VectorXd U(2 * nodes), error = Eigen::VectorXd::Zero(2 * nodes), expected(2 * nodes);
  for (Eigen::Index i = 0; i < nodes; ++i) {
    const Eigen::Vector2d X = surface.nodes.row(i).head<2>().transpose() - scene.axis_of_lens, shift(0.1, 0.4);
    U.segment<2>(2 * i) = shift + gradient * X;
    Eigen::Vector2d there = X;  // the point of the specimen that the reference shows at X
    for (int k = 0; k < 50; ++k) there += X - seen(there, turn, distance);
    expected.segment<2>(2 * i) = seen(there + shift + gradient * there, turn, distance) - X - U.segment<2>(2 * i);
  }
  const std::vector<double> values{std::sin(turn[0]) / distance, std::sin(turn[1]) / distance};
  camera_tilt()->see(values, scene, 0, U, error);
  EXPECT_GT(expected.cwiseAbs().maxCoeff(), 2e-3 * scale);
  return (error - expected).cwiseAbs().maxCoeff();
}

TEST(CameraTilt, IsWhatALensThatLooksFromTheSideMakesOfAMotion) {
  const double at_tenth = worst(1e-1), at_hundredth = worst(1e-2);
  EXPECT_LT(at_tenth, 1e-3);
  EXPECT_NEAR(at_tenth / at_hundredth, 100.0, 10.0);  // second order is what is left
}

}  // namespace test_camera_tilt
}  // namespace imic3d::loop
