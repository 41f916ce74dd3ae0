// What is held out leaves no trace in what is fitted.

#include <gtest/gtest.h>

#include <Eigen/Dense>

#include "strip.hpp"

namespace imic3d::loop {
namespace {

using testing::declared, testing::is_candidate, testing::Strip;

TEST(HeldOut, AFrameThatIsOffMovesNoOther) {
  Strip strip(0.0);
  strip.data.references = 2;  // whose noise all frames have in common
  strip.data.held_out = {1};
  FieldExperiment experiment = strip.experiment();
  const Eigen::VectorXd r = experiment.residuals({declared(experiment)}).front();
  strip.data.displacement.col(1).array() += 0.1;
  FieldExperiment blurred = strip.experiment();
  const Eigen::VectorXd changed = blurred.residuals({declared(blurred)}).front() - r;
  double others = 0.0, own = 0.0;
  for (std::size_t i = 0; i < experiment.data().size(); ++i) {
    const double x = std::abs(changed[static_cast<Eigen::Index>(i)]);
    (experiment.data()[i].frame == 1 ? own : others) = std::max(experiment.data()[i].frame == 1 ? own : others, x);
  }
  EXPECT_EQ(others, 0.0);
  EXPECT_GT(own, 0.01);
}

/// Neither face of half a specimen moves otherwise than the other.
TEST(Scenes, HalfASpecimenIsNotBent) {
  FieldExperiment experiment = Strip(0.0).experiment();  // with a plane of symmetry
  EXPECT_FALSE(is_candidate(experiment, "misalignment"));
  EXPECT_FALSE(is_candidate(experiment, "grip slip"));
}

/// The elastic field is that of a loaded frame, whatever the first one is.
TEST(Scenes, AFrameAtRestIsNotTheElasticField) {
  const Strip strip(0.0);
  Strip rested = strip;
  const auto frames = strip.data.force.size();
  rested.data.displacement.resize(strip.data.displacement.rows(), frames + 1);
  rested.data.displacement << Eigen::VectorXd::Zero(strip.data.displacement.rows()), strip.data.displacement;
  rested.data.driving = rested.data.displacement;
  rested.data.force.resize(frames + 1), rested.data.force << 0.0, strip.data.force;
  rested.data.time.resize(frames + 1), rested.data.time << 0.0, strip.data.time.array() + 1.0;
  rested.data.frames.insert(rested.data.frames.begin(), rested.data.frames.front() - 1);
  const Eigen::VectorXd with = rested.experiment().scene().elastic, without = strip.experiment().scene().elastic;
  EXPECT_TRUE(with.allFinite());
  EXPECT_LT((with - without).norm(), 1e-6 * without.norm());
}

}  // namespace
}  // namespace imic3d::loop
