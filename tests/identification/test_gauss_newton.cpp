// What a stage takes: where it begins, and how much is simulated for it.
#include <gtest/gtest.h>

#include <random>

#include "plate.hpp"

namespace imic3d::identification {
namespace test_gauss_newton {

using testing::Plate;

/// A yield stress so low that the specimen could not carry the force: the reaction of the DIC-driven simulation tells
/// what it must be.
TEST(GaussNewton, BeginsWhereTheReactionMeetsTheForce) {
  Plate plate({0.002, 0.004, 0.01, 0.02, 0.03, 0.04});
  for (const double factor : {0.6, 1.5}) {
    ForwardModel model({}, plate.specimen, plate.law, plate.record, {.with_fields = false}, 1, 1);
    auto parameters = plate.truth;
    parameters[2] *= factor;
    const auto result =
        gauss_newton({}, model, plate.images, testing::information(plate), {.free = {2}, .frames = {0, 1, 2, 3, 4, 5}},
                     {.eta = 1e-4, .sensitivities = Sensitivities::direct}, parameters);
    EXPECT_TRUE(result.converged);
    EXPECT_TRUE(result.message.empty()) << result.message;
    EXPECT_EQ(result.iterates.front().frames, 6);
    EXPECT_NEAR(result.iterates.front().parameters[2] / plate.truth[2], 1.0, 1e-3);
    EXPECT_NEAR(parameters[2] / plate.truth[2], 1.0, 1e-6);
  }
}

/// Two stages: the second begins where the first ended, and the last step of each is not simulated. Factors are made
/// where a frame is new or far from where it was.
TEST(GaussNewton, SimulatesNoMoreThanItMust) {
  Plate plate({0.002, 0.004, 0.01, 0.02, 0.03, 0.04});
  ForwardModel model({}, plate.specimen, plate.law, plate.record, {.with_fields = false}, 1, 1);
  auto parameters = plate.truth;
  parameters[0] *= 0.95, parameters[2] *= 0.9;
  int iterations = 0;
  for (const Stage& stage : {Stage{.free = {0}, .frames = {0, 1}}, Stage{.free = {2}, .frames = {0, 1, 2, 3, 4, 5}}}) {
    const auto result = gauss_newton({}, model, plate.images, testing::information(plate), stage,
                                     {.eta = 1e-4, .sensitivities = Sensitivities::direct}, parameters);
    EXPECT_TRUE(result.converged);
    iterations += static_cast<int>(result.iterates.size()) - 1;
    // What is observed after the last step, of the first order, is what a simulation shows.
    std::vector<Path> driven;
    identification::Run run{.parameters = parameters};
    const auto forces = model.distribute_forces({run}, stage.frames.back() + 1, driven);
    run.forces = &forces.front();
    auto path = model.simulate(Control::force, {run}, stage.frames.back() + 1).front();
    fit_rigid_motion(plate.specimen, Control::force, plate.images.M, plate.record.surface_displacement, path);
    double distance = 0.0;
    for (int t : stage.frames) {
      const Eigen::VectorXd gap = plate.record.surface_displacement.col(t) - path.surface.col(t);
      distance += plate.images.distance(gap, plate.images.M * gap) / static_cast<double>(stage.frames.size());
    }
    EXPECT_NEAR(result.iterates.back().displacement_rms, std::sqrt(distance), 1e-5);
  }
  const auto work = model.work();
  EXPECT_LE(iterations, 4);
  EXPECT_LE(work.frames, 70);
  EXPECT_LE(work.factorisations, work.frames);
  RecordProperty("frames", work.frames);
  RecordProperty("factorisations", work.factorisations);
}

/// By one solution what the simulations of all draws give, on any split into groups; and the next series begins where
/// it would have.
TEST(GaussNewton, NoiseOfTheReactionIsThatOfSimulatedDraws) {
  Plate plate({0.002, 0.004});
  std::mt19937 random(5);
  std::normal_distribution<double> noise(0.0, 1e-6);  // elastic
  Eigen::MatrixXd draws(plate.record.driving.rows(), 6);
  for (double& u : draws.reshaped()) u = noise(random);
  ForwardModel model({}, plate.specimen, plate.law, plate.record, {.with_fields = false}, 3, 0);
  double squares = 0.0;
  for (Eigen::Index k = 0; k < draws.cols(); ++k) {
    const Eigen::MatrixXd driving = draws.col(k);
    ForwardModel alone({}, plate.specimen, plate.law, plate.record, {.with_fields = false}, 1, 1);
    squares += std::pow(alone.simulate(Control::displacement, {{.parameters = plate.truth, .driving = &driving}}, 1)
                            .front()
                            .reaction[0],
                        2);
  }
  EXPECT_NEAR(reaction_noise({}, model, draws, plate.truth) / std::sqrt(squares / 6.0), 1.0, 1e-4);
  for (const Solution& last : model.solutions()) EXPECT_TRUE(last.displacement.empty());
}

}  // namespace test_gauss_newton
}  // namespace imic3d::identification
