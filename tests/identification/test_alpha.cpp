// The functional at finite alpha (Eqs 4-9 and 16).

#include <gtest/gtest.h>

#include <Eigen/Dense>

#include "plate.hpp"

namespace imic3d::identification {
namespace test_alpha {

using testing::Plate;

const std::vector<double> stretch = {0.003, 0.006, 0.02, 0.06, 0.12};

/// Force-driven path and the path at alpha, both with wrong parameters.
struct Paths {
  Path forces, pulled;
};
Paths paths_of(Plate& plate, double alpha, int increments = 1) {
  const Communicator world;
  ForwardModel model(world, plate.specimen, plate.law, plate.record, {.increments = increments, .with_fields = false},
                     1, 1);
  auto wrong = plate.truth;
  wrong[2] *= 1.05;
  Paths result;
  const int frames = static_cast<int>(stretch.size());
  std::vector<Path> driven;
  const auto distribution = model.distribute_forces({{.parameters = plate.truth}}, frames, driven).front();
  const Run run{.parameters = wrong, .forces = &distribution};
  result.forces = model.simulate(Control::force, {run}, frames).front();
  fit_rigid_motion(plate.specimen, Control::force, plate.images.M, plate.record.surface_displacement, result.forces);
  model.follow_images(plate.images, alpha, wrong);
  result.pulled = model.simulate(Control::images, {run}, frames).front();
  return result;
}

TEST(Alpha, TheLimitIsTheForceDrivenSimulation) {
  Plate plate(stretch);
  double before = INFINITY;
  for (double alpha : {1e-2, 1e-4, 1e-6}) {
    Paths paths = paths_of(plate, alpha);
    ASSERT_EQ(paths.pulled.frames, static_cast<int>(stretch.size())) << paths.pulled.message;
    // As alpha vanishes the turning of the specimen is left to the forces, which keep their direction; held by supports
    // it is left to the images (fit_rigid_motion). That difference is taken out.
    fit_rigid_motion(plate.specimen, Control::force, plate.images.M, plate.record.surface_displacement, paths.pulled);
    const double apart = (paths.pulled.surface - paths.forces.surface).norm() / paths.forces.surface.norm();
    EXPECT_LT(apart, 0.05 * before);  // proportional to alpha
    before = apart;
  }
  EXPECT_LT(before, 1e-4);
}

TEST(Alpha, NearOneTheImagesDecide) {
  Plate plate(stretch);
  const Paths paths = paths_of(plate, 1.0 - 1e-7);
  ASSERT_EQ(paths.pulled.frames, static_cast<int>(stretch.size())) << paths.pulled.message;
  const auto& dic = plate.record.surface_displacement;
  EXPECT_LT((paths.pulled.surface - dic).norm(), 1e-5 * dic.norm());
  // which the wrong parameters alone would miss
  EXPECT_GT((paths.forces.surface - dic).norm(), 1e-2 * dic.norm());
}

TEST(Alpha, BetweenFramesTheWayOfTheDicIsFollowed) {
  Plate plate(stretch);
  const Paths one = paths_of(plate, 0.5), many = paths_of(plate, 0.5, 4);
  ASSERT_EQ(many.pulled.frames, static_cast<int>(stretch.size())) << many.pulled.message;
  EXPECT_LT((one.pulled.surface - many.pulled.surface).norm(), 2e-2 * one.pulled.surface.norm());
}

/// Stationarity: with true parameters and images nothing pulls, whatever alpha is.
TEST(Alpha, TheTruthIsFoundAtEveryAlpha) {
  const Communicator world;
  for (double alpha : {0.0, 1e-3, 0.3, 0.9}) {
    Plate plate(stretch);
    ForwardModel model(world, plate.specimen, plate.law, plate.record, {.with_fields = false}, 2, 0);
    auto parameters = plate.truth;
    parameters[2] *= 0.9;
    const auto result =
        gauss_newton(world, model, plate.images, testing::information(plate), {.free = {2}, .frames = {0, 1, 2, 3, 4}},
                     {.alpha = alpha, .eta = 1e-6}, parameters);
    EXPECT_TRUE(result.converged) << alpha;
    EXPECT_NEAR(parameters[2] / plate.truth[2], 1.0, 1e-5) << alpha;
  }
}

}  // namespace test_alpha
}  // namespace imic3d::identification
