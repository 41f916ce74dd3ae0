// What few load increments err by is found with more of them and taken off.
#include <gtest/gtest.h>

#include <cmath>

#include "plate.hpp"

namespace imic3d::identification {
namespace test_increments {

using testing::Plate;

/// A plate that few frames show, its record simulated with 64 increments between two of them.
struct Seldom : Plate {
  explicit Seldom(const std::vector<double>& stretch = {0.004, 0.04, 0.05, 0.06, 0.12}) : Plate(stretch) {
    ForwardModel model({}, specimen, law, record, {.increments = 64, .with_fields = false}, 1, 1);
    const Path path = model.simulate(Control::displacement, {{.parameters = truth}}, 5).front();
    record.surface_displacement = path.surface, record.force = path.reaction;
  }
};

struct Found {
  std::vector<double> parameters;
  StageResult result;
  double off = 0.0;  // largest relative error of E, S_y, H
};

/// `noise`: of the measurement, times what the functional counts on.
Found identify(Functional functional, Sensitivities sensitivities, int most_increments, int increments = 1,
               double noise = 1.0) {
  Seldom plate;
  ForwardModel model({}, plate.specimen, plate.law, plate.record, {.increments = increments, .with_fields = false}, 4,
                     1);
  Found found{.parameters = plate.truth, .result = {}};
  for (const int j : {0, 2, 3}) found.parameters[static_cast<std::size_t>(j)] *= 0.9;
  found.result =
      gauss_newton({}, model, plate.images, testing::information(plate), {.free = {0, 2, 3}, .frames = {0, 1, 2, 3, 4}},
                   {.functional = functional,
                    .eta = 1e-4,
                    .force_noise = 2.0,
                    .sensitivities = sensitivities,
                    .most_increments = most_increments,
                    .noise_model = {.image = noise * plate.images.noise, .force = noise * 2.0, .driving = {}}},
                   found.parameters);
  EXPECT_TRUE(found.result.converged);
  for (const std::size_t j : {0U, 2U, 3U})
    found.off = std::max(found.off, std::abs(found.parameters[j] / plate.truth[j] - 1.0));
  return found;
}

TEST(Increments, WhatTheyErrByIsTakenOff) {
  const Found few = identify(Functional::displacement_driven, Sensitivities::direct, 0),
              more = identify(Functional::displacement_driven, Sensitivities::direct, 32);
  std::printf("off by %.2e, with what %d increments tell %.2e\n", few.off, more.result.iterates.back().increments,
              more.off);
  EXPECT_EQ(few.result.iterates.back().increments, 1);
  EXPECT_GT(more.result.iterates.back().increments, 2);
  EXPECT_GT(few.off, 0.02);
  EXPECT_LT(more.off, 0.05 * few.off);
  EXPECT_EQ(more.result.finer.unsure.size(), 0);
  EXPECT_LT(identify(Functional::displacement_driven, Sensitivities::perturbed, 32).off, 0.05 * few.off);
}

/// Under forces, which go straight from frame to frame, it leads to where many increments do.
TEST(Increments, UnderForces) {
  for (const Functional functional : {Functional::force_driven, Functional::combined}) {
    const Found many = identify(functional, Sensitivities::direct, 0, 64),
                few = identify(functional, Sensitivities::direct, 0),
                more = identify(functional, Sensitivities::direct, 32);
    std::printf("functional %d: off by %.2e, with what %d increments tell %.2e\n", static_cast<int>(functional),
                few.off, more.result.iterates.back().increments, more.off);
    for (const std::size_t j : {0U, 2U, 3U})
      EXPECT_LT(std::abs(more.parameters[j] - many.parameters[j]),
                0.15 * std::abs(few.parameters[j] - many.parameters[j]))
          << static_cast<int>(functional) << " " << j;
  }
}

/// As many as all noise lets matter, not that of the functional alone.
TEST(Increments, AsManyAsNoiseLetsMatter) {
  const auto taken = [](double noise) {
    return identify(Functional::displacement_driven, Sensitivities::direct, 32, 1, noise)
        .result.iterates.back()
        .increments;
  };
  EXPECT_LT(taken(30.0), taken(1.0));
}

/// Where as many as are allowed are too few, it says by how much they move the parameters.
TEST(Increments, SaysWhatItIsNotSureOf) {
  const Found few = identify(Functional::displacement_driven, Sensitivities::direct, 2),
              more = identify(Functional::displacement_driven, Sensitivities::direct, 32);
  ASSERT_EQ(few.result.finer.unsure.size(), 3);
  const int of_largest = 2;
  EXPECT_GT(few.result.finer.unsure[1], 0.3 * std::abs(few.parameters[of_largest] - more.parameters[of_largest]));
}

/// From three increments it comes to the same as from one.
TEST(Increments, FromAnyNumber) {
  const Found one = identify(Functional::displacement_driven, Sensitivities::direct, 48),
              three = identify(Functional::displacement_driven, Sensitivities::direct, 48, 3);
  for (const std::size_t j : {0U, 2U, 3U}) EXPECT_NEAR(three.parameters[j] / one.parameters[j], 1.0, 1e-3);
}

}  // namespace test_increments
}  // namespace imic3d::identification
