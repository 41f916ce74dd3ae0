// Residuals along the derivatives of the simulation against residuals of simulations.

#include <gtest/gtest.h>

#include <Eigen/Dense>

#include "strip.hpp"

namespace imic3d::loop {
namespace test_derivatives {

using testing::declared, testing::place_of, testing::Strip;

/// Distance of residuals_near() from residuals() over the change of these, from one side of `values` to the other: what
/// is of second order in the step cancels.
double error_of(FieldExperiment& experiment, const std::vector<double>& values, int parameter, double step) {
  const auto j = static_cast<std::size_t>(parameter);
  auto more = values, less = values;
  more[j] += step, less[j] -= step;
  const auto simulated = experiment.residuals({more, less});
  const auto near = experiment.residuals_near(values, {more, less});
  EXPECT_EQ(near.size(), 3U);
  return ((near[1] - near[2]) - (simulated[0] - simulated[1])).norm() / (simulated[0] - simulated[1]).norm();
}

TEST(ResidualsNear, NumbersOfTheLaw) {
  const Strip strip(0.0);
  FieldExperiment experiment = strip.experiment();
  const auto values = declared(experiment);
  for (int j = 0; j < static_cast<int>(strip.model.values.size()); ++j)
    EXPECT_LT(error_of(experiment, values, j, 1e-3 * std::abs(values[static_cast<std::size_t>(j)])), 1e-3)
        << experiment.parameters()[static_cast<std::size_t>(j)].info.name;
}

TEST(ResidualsNear, WhatTheCameraAddsMovesTheEnds) {
  const Strip strip(0.0);
  FieldExperiment experiment = strip.experiment();
  const auto values = declared(experiment);
  for (const char* name : {"magnification_drift", "inverse_distance"}) {
    const int j = place_of(experiment, name);
    ASSERT_GE(j, 0) << name;
    EXPECT_LT(error_of(experiment, values, j, experiment.parameters()[static_cast<std::size_t>(j)].step), 1e-3) << name;
  }
}

/// From the declared section, and from one that is another already.
TEST(ResidualsNear, WhatActsOnTheSection) {
  const Strip strip(0.0);
  FieldExperiment experiment = strip.experiment();
  const auto at = [&](const char* name) { return static_cast<std::size_t>(place_of(experiment, name)); };
  for (const char* name : {"region", "taper_x", "taper_y"})
    EXPECT_LT(error_of(experiment, declared(experiment), static_cast<int>(at(name)), 2e-4), 1e-3) << name;
  auto values = declared(experiment);
  values[at("region")] = -0.2, values[at("region_y")] = 0.3, values[at("taper_y")] = 0.01;
  for (const char* name : {"region", "region_x", "region_y", "region_radius", "taper_x", "taper_y"}) {
    EXPECT_FALSE(experiment.takes_simulations(static_cast<int>(at(name)))) << name;
    EXPECT_LT(error_of(experiment, values, static_cast<int>(at(name)), 2e-4), 1e-3) << name;
  }
  const int before = experiment.simulations();
  auto moved = values;
  moved[at("region_x")] += 1e-3;
  (void)experiment.residuals_near(values, {moved, moved, moved});
  EXPECT_EQ(experiment.simulations() - before, 1) << "derivatives of one series";
}

TEST(ResidualsNear, WhatHasNoDerivativeIsSimulated) {
  const Strip strip(0.0);
  FieldExperiment experiment = strip.experiment();
  const auto values = declared(experiment);
  auto finer = values;
  finer[static_cast<std::size_t>(place_of(experiment, "increment_error"))] = 1.0;  // the series with more increments
  const auto simulated = experiment.residuals({values, finer});
  ASSERT_GT((simulated[1] - simulated[0]).norm(), 1e-3);
  const auto near = experiment.residuals_near(values, {finer});
  EXPECT_LT((near[1] - simulated[1]).norm(), 1e-6 * (simulated[1] - simulated[0]).norm());
  EXPECT_LT((near[0] - simulated[0]).norm(), 1e-6 * (simulated[1] - simulated[0]).norm());
}

TEST(ResidualsNear, ALawEffectThatIsThereIsDifferentiated) {
  Strip strip(0.0);
  const auto extended = [](const std::vector<std::string>& effects, bool /*in_space*/ = false) {
    return material::make_law({.law = "j2",
                               .hardening = "power_linear",
                               .tie_initial_modulus = true,
                               .effects = effects,
                               .table_strain = {}});
  };
  strip.model.extended = extended;
  const auto law = extended({"voce_term"});
  for (auto info : law->parameters()) {
    if (info.effect.empty()) continue;
    info.scale = usual_size(info, 198e3);
    strip.model.lacking.push_back(info);
  }
  ASSERT_EQ(strip.model.lacking.size(), 2U);
  FieldExperiment experiment = strip.experiment();
  auto values = declared(experiment);
  for (std::size_t j = strip.model.values.size(); j < strip.model.values.size() + 2; ++j) {
    if (!experiment.parameters()[j].info.shape) values[j] = 20.0;  // MPa
  }
  for (std::size_t j = strip.model.values.size(); j < strip.model.values.size() + 2; ++j)
    EXPECT_LT(error_of(experiment, values, static_cast<int>(j), 1e-3 * values[j]), 1e-3)
        << experiment.parameters()[j].info.name;
}

}  // namespace test_derivatives
}  // namespace imic3d::loop
