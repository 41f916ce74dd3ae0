// What is held out leaves no trace in what is fitted.

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>

#include "strip.hpp"

namespace imic3d::loop {
namespace test_held_out {

using testing::declared, testing::is_candidate, testing::place_of, testing::Strip;

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

/// The elastic field is that of a loaded frame, though the first one is at rest and the next one bears more than a
/// third of the load.
TEST(Scenes, AFrameAtRestIsNotTheElasticField) {
  const Strip strip(0.0);
  const auto of_frames = [&](bool rested) {
    Strip some = strip;
    const Eigen::Index rest = rested ? 1 : 0;
    some.data.displacement = Eigen::MatrixXd::Zero(strip.data.displacement.rows(), 2 + rest);
    some.data.displacement.rightCols(2) = strip.data.displacement.rightCols(2);
    some.data.driving = some.data.displacement;
    some.data.force = Eigen::VectorXd::Zero(2 + rest), some.data.force.tail(2) = strip.data.force.tail(2);
    some.data.time = Eigen::VectorXd::LinSpaced(2 + rest, 1.0, 2.0 + static_cast<double>(rest));
    some.data.frames.resize(static_cast<std::size_t>(2 + rest));
    return Eigen::VectorXd(some.experiment().scene().elastic);
  };
  const Eigen::VectorXd with = of_frames(true), without = of_frames(false);
  EXPECT_TRUE(with.allFinite());
  EXPECT_LT((with - without).norm(), 1e-6 * without.norm());
}

/// What more increments change holds no noise of the measured ends, and would be found again in the residual if it did.
TEST(Marks, OfTheNumericsHoldNoNoiseOfTheEnds) {
  const auto mark = [](double noise) {
    Strip strip(0.0);
    const Eigen::MatrixXd clean = strip.data.driving;
    for (Eigen::Index i = 0; i < clean.rows(); ++i)
      for (Eigen::Index t = 0; t < clean.cols(); ++t)
        strip.data.driving(i, t) += noise * std::sin(7.0 * static_cast<double>(i) + 3.0 * static_cast<double>(t));
    strip.data.smooth = [clean](const Eigen::MatrixXd&) { return clean; };
    FieldExperiment experiment = strip.experiment();
    std::vector<double> values = declared(experiment), more = values;
    more[static_cast<std::size_t>(place_of(experiment, "increment_error"))] = 1.0;
    const auto residuals = experiment.residuals({values, more});
    return Eigen::VectorXd(residuals[1] - residuals[0]);
  };
  const Eigen::VectorXd of_clean = mark(0.0);
  EXPECT_GT(of_clean.norm(), 0.0);
  EXPECT_LT((mark(1e-3) - of_clean).norm(), 1e-6 * of_clean.norm());
}

}  // namespace test_held_out
}  // namespace imic3d::loop
