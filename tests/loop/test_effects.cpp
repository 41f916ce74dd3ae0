// Effects by themselves.

#include <gtest/gtest.h>

#include <cmath>

#include "imic3d/loop/effect.hpp"
#include "strip.hpp"

namespace imic3d::loop {
namespace test_effects {

/// Force of a test that yields between two frames, is unloaded from one and hardens: at any time.
double force_at(double time) {
  return time < 3.4    ? 100.0 * time
         : time < 8.0  ? 340.0 + 9.0 * (time - 3.4)
         : time < 10.0 ? 381.4 - 100.0 * (time - 8.0)
                       : 181.4 + 100.0 * std::min(time - 10.0, 2.0) + 8.0 * std::max(0.0, time - 12.0);
}

/// What the delayed force between two frames is, is unknown by about what it is off: not where it is straight, nor at
/// frames.
TEST(Effects, ADelayKnowsWhatItDoesNotKnowOfTheForce) {
  Scene scene;
  scene.time = Eigen::VectorXd::LinSpaced(15, 1.0, 15.0);
  scene.force = scene.time.unaryExpr([](double time) { return force_at(time); });
  for (const auto& effect : effects()) {
    if (effect->describe(scene).name != "delay of the force") {
      EXPECT_EQ(
          effect->unknown_in_record(std::vector<double>(effect->describe(scene).quantities.size(), 0.1), scene).size(),
          0);
      continue;
    }
    EXPECT_EQ(effect->unknown_in_record(std::vector{0.0}, scene).norm(), 0.0);
    EXPECT_LT(effect->unknown_in_record(std::vector{1.0}, scene).norm(), 1e-9);
    for (const double delay : {0.3, -0.6, 1.4, -1.4}) {
      Eigen::VectorXd recorded = scene.force;
      effect->record(std::vector{delay}, scene, recorded);
      const Eigen::VectorXd unknown = effect->unknown_in_record(std::vector{delay}, scene);
      for (Eigen::Index t = 0; t < unknown.size(); ++t) {
        const double time = scene.time[t] - delay, off = std::abs(recorded[t] - (time < 0.0 ? 0.0 : force_at(time)));
        EXPECT_LE(off, 3.0 * unknown[t] + 1e-9) << "delay " << delay << ", frame " << t;
        const bool straight = time > 0.0 && time < 15.0 && std::abs(time - 3.5) > 1.5;
        if (straight) {
          EXPECT_LT(unknown[t], 3.0) << "delay " << delay << ", frame " << t << ": " << off;
        }
      }
      if (delay < 0.0) {
        EXPECT_GT(unknown[14], 4.0) << "beyond the last frame";
      }
    }
  }
}

/// It is the null's: of a record that is a frame early the last frame's force.
TEST(Effects, WhatADelayLeavesUnknownIsInTheNull) {
  testing::Strip strip(0.0);
  strip.data.correlate = [](const identification::Specimen&, const Eigen::MatrixXd& U) { return U; };
  FieldExperiment experiment = strip.experiment();
  auto values = testing::declared(experiment);
  experiment.learn_bias(values);
  const Eigen::MatrixXd without = experiment.doubt().whole;
  const double interval = strip.data.time[3] - strip.data.time[2], slope = strip.data.force[3] - strip.data.force[2];
  values[static_cast<std::size_t>(testing::place_of(experiment, "force_delay"))] = -interval;
  experiment.learn_bias(values);
  const Eigen::MatrixXd with = experiment.doubt().whole;
  ASSERT_EQ(with.cols(), without.cols() + 1);
  bool there = false;  // a column of the last frame's force alone
  for (const auto column : with.colwise()) {
    double last = 0.0;
    for (std::size_t i = 0; i < experiment.data().size(); ++i)
      if (experiment.data()[i].channel == force_channel && experiment.data()[i].frame == 3)
        last = column[static_cast<Eigen::Index>(i)];
    there = there || (std::abs(last) > 0.0 && std::abs(std::abs(last) - column.norm()) < 1e-12 &&
                      std::abs(std::abs(last) - std::abs(slope) / strip.data.force_noise) < 1e-6 * std::abs(last));
  }
  EXPECT_TRUE(there);
}

}  // namespace test_effects
}  // namespace imic3d::loop
