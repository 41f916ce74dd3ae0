// Several tests of one material in one loop: two small ones with y = (1 + gain) (a x + bend x^2), and white noise.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <random>

#include "imic3d/core/error.hpp"
#include "imic3d/loop/closing.hpp"
#include "imic3d/loop/joint_experiment.hpp"
#include "imic3d/loop/recorded.hpp"

namespace imic3d::loop {
namespace test_joint {

class Line final : public Experiment {
 public:
  struct Truth {
    double gain = 0.0, bend = 0.0;
  };
  Line(int frames, unsigned seed, bool with_gain, Truth truth, double a = 10.0) : frames_(frames), seed_(seed) {
    parameters_ = {{.info = {.name = "a", .unit = "-", .description = ""}, .value = a, .step = 1e-4, .free = true},
                   {.info = {.name = "bend",
                             .unit = "-",
                             .description = "",
                             .lower = -50,
                             .upper = 50,
                             .null_value = 0.0,
                             .effect = "bend"},
                    .value = 0.0,
                    .step = 1e-4}};
    candidates_ = {{.name = "bend",
                    .link = Link::material,
                    .parameters = {1},
                    .sentence = "it bends",
                    .confused_with = "",
                    .separated_by = "",
                    .after = {}}};
    if (with_gain) {
      parameters_.push_back(
          {.info = {.name = "gain", .unit = "-", .description = "", .lower = -1, .upper = 1, .null_value = 0.0},
           .value = 0.0,
           .step = 1e-5});
      candidates_.push_back({.name = "gain",
                             .link = Link::record,
                             .parameters = {2},
                             .sentence = "the load cell is off",
                             .confused_with = "",
                             .separated_by = "",
                             .after = {}});
    }
    for (int t = 0; t < frames; ++t)
      for (int k = 0; k < 3; ++k) data_.push_back({t, 0});
    measured_ = predict(10.3, truth.bend, truth.gain) + draw(seed);
  }
  const std::vector<Parameter>& parameters() const override { return parameters_; }
  const std::vector<Candidate>& candidates() const override { return candidates_; }
  const std::vector<Datum>& data() const override { return data_; }
  int iterations = 30;
  int most_iterations() const override { return iterations; }
  std::vector<int> frame_numbers() const override {
    std::vector<int> all;
    for (int t = 0; t < frames_; ++t) all.push_back(t);
    return all;
  }
  std::vector<Eigen::VectorXd> residuals(const std::vector<std::vector<double>>& sets) override {
    std::vector<Eigen::VectorXd> all;
    for (const auto& v : sets) all.emplace_back(measured_ - predict(v[0], v[1], v.size() > 2 ? v[2] : 0.0));
    asked += static_cast<int>(sets.size());
    return all;
  }
  Eigen::MatrixXd noise(const std::vector<double>&, int draws) override {
    Eigen::MatrixXd all(measured_.size(), draws);
    for (int b = 0; b < draws; ++b) all.col(b) = draw(1000U * seed_ + 1U + static_cast<unsigned>(b));
    return all;
  }
  Eigen::VectorXd freedom() const override {
    return few > 0.0 ? Eigen::VectorXd::Constant(measured_.size(), few) : Eigen::VectorXd();
  }
  Eigen::MatrixXd noise_of_squares(const std::vector<double>&, const Eigen::MatrixXd& noise) override {
    return (few > 0.0 ? 2.0 : 1.0) * noise;
  }
  int asked = 0;
  double few = 0.0;  // degrees of freedom of its noise

 private:
  Eigen::VectorXd predict(double a, double bend, double gain) const {
    Eigen::VectorXd y(3 * frames_);
    for (Eigen::Index i = 0; i < y.size(); ++i) {
      const double x = static_cast<double>(i + 1) / static_cast<double>(y.size());
      y[i] = (1.0 + gain) * (a * x + bend * x * x) / 0.05;
    }
    return y;
  }
  Eigen::VectorXd draw(unsigned seed) const {
    std::mt19937 random(seed);
    std::normal_distribution<double> normal;
    Eigen::VectorXd e(3 * frames_);
    for (double& x : e) x = normal(random);
    return e;
  }
  int frames_;
  unsigned seed_;
  std::vector<Parameter> parameters_;
  std::vector<Candidate> candidates_;
  std::vector<Datum> data_;
  Eigen::VectorXd measured_;
};

Report close(Experiment& experiment, const std::vector<int>& held_out) {
  return close_loop(experiment, {.draws = 60, .starts = {1.0}, .held_out = held_out}, {});
}

std::vector<std::string> names(const JointExperiment& joint, const std::vector<int>& which) {
  std::vector<std::string> all;
  for (int k : which) all.push_back(joint.candidates()[static_cast<std::size_t>(k)].name);
  return all;
}

TEST(Joint, AnotherTestShowsWhatOneCannot) {
  Line alone(24, 1, true, {.gain = 0.05});
  const auto without = close(alone, held_out_blocks(24));
  EXPECT_EQ(without.verdict, Verdict::nothing_found);
  EXPECT_EQ(without.invisible, std::vector<int>{1});

  Line images(24, 1, true, {.gain = 0.05}), curves(16, 2, false, {});
  JointExperiment joint({{"plate", &images, held_out_blocks(24)}, {"bars", &curves, held_out_blocks(16)}});
  const auto report = close(joint, joint.held_out());
  EXPECT_EQ(report.verdict, Verdict::attributed);
  EXPECT_THAT(names(joint, report.named), ::testing::ElementsAre("gain (plate)"));
  const auto& values = report.final.fit.values;
  EXPECT_NEAR(joint.values_of(0, values)[2], 0.05, 0.003);
  EXPECT_NEAR(joint.values_of(1, values)[0], 10.3, 0.03);
  EXPECT_EQ(joint.values_of(0, values)[0], joint.values_of(1, values)[0]);
  // The same in the terms of each test.
  const Report plate = joint.report_of(0, report), bars = joint.report_of(1, report);
  EXPECT_EQ(plate.named, std::vector<int>{1});
  EXPECT_TRUE(bars.named.empty());
  EXPECT_EQ(plate.final.fit.values, joint.values_of(0, values));
  EXPECT_EQ(plate.final.fit.free, (std::vector<int>{0, 2}));
  EXPECT_EQ(bars.final.fit.free, std::vector<int>{0});
  EXPECT_EQ(bars.final.covariance(0, 0), report.final.covariance(0, 0));
  EXPECT_EQ(bars.final.misfit.frames.size(), 16);
  EXPECT_EQ(bars.final.misfit.frames[0], report.final.misfit.frames[24]);
  EXPECT_EQ(bars.held_out.size(), 16U);
}

/// Each frame is of one test, also where the answers are kept for a restart; a fit has the iterations that the dearest
/// of the tests lets be.
TEST(Joint, AFrameIsOfItsTest) {
  Line images(24, 1, true, {}), curves(16, 2, false, {});
  images.iterations = 12, curves.iterations = 200;
  JointExperiment joint({{"plate", &images, held_out_blocks(24)}, {"bars", &curves, held_out_blocks(16)}});
  const RecordedExperiment recorded(joint, {}, [](const Answer&) {});
  for (const Experiment* one : {static_cast<const Experiment*>(&joint), static_cast<const Experiment*>(&recorded)}) {
    EXPECT_EQ(one->test_of(23), std::pair(0, 23));
    EXPECT_EQ(one->test_of(24), std::pair(24, 39));
    EXPECT_EQ(one->most_iterations(), 12);
  }
}

TEST(Joint, ATestsBaselinesAreOfItsOwnCandidates) {
  Line images(24, 1, true, {}), curves(16, 2, true, {.gain = 0.05});
  JointExperiment joint({{"plate", &images, held_out_blocks(24)}, {"bars", &curves, held_out_blocks(16)}});
  const auto report = close(joint, joint.held_out());
  const auto first_name = [](const Report& its, const Experiment& experiment) {
    return experiment
        .candidates()[static_cast<std::size_t>(
            its.declared.others.at(static_cast<std::size_t>(its.declared.baselines.bic.at(0))))]
        .name;
  };
  ASSERT_FALSE(report.declared.baselines.bic.empty());
  const std::string name = first_name(report, joint);
  ASSERT_THAT(name, ::testing::AnyOf("gain (plate)", "gain (bars)"));  // both at once: the law is free
  const Report plate = joint.report_of(0, report), bars = joint.report_of(1, report);
  const Report& its = name == "gain (plate)" ? plate : bars;
  EXPECT_EQ(first_name(its, curves), "gain");
  for (const Report* own : {&plate, &bars}) {
    EXPECT_EQ(own->declared.baselines.cosine.size(), own->declared.others.size());
    for (int i : own->declared.baselines.bic) EXPECT_LT(i, static_cast<int>(own->declared.others.size()));
  }
  for (std::size_t i = 0; i < bars.declared.others.size(); ++i)
    for (std::size_t k = 0; k < report.declared.others.size(); ++k) {
      const auto& all = joint.candidates()[static_cast<std::size_t>(report.declared.others[k])].name;
      const auto& own = curves.candidates()[static_cast<std::size_t>(bars.declared.others[i])].name;
      if (all == own || all == own + " (bars)") {
        EXPECT_EQ(bars.declared.baselines.cosine[i], report.declared.baselines.cosine[k]);
      }
    }
}

TEST(Joint, AnEffectOfTheLawIsOneForAll) {
  Line images(24, 3, true, {.bend = 2.0}), curves(16, 4, true, {.bend = 2.0});
  JointExperiment joint({{"plate", &images, held_out_blocks(24)}, {"bars", &curves, held_out_blocks(16)}});
  ASSERT_EQ(joint.parameters().size(), 4U);  // a, bend, and the gain of each
  const auto report = close(joint, joint.held_out());
  EXPECT_EQ(report.verdict, Verdict::attributed);
  EXPECT_THAT(names(joint, report.named), ::testing::ElementsAre("bend"));
  EXPECT_NEAR(report.final.fit.values[1], 2.0, 0.15);
  EXPECT_EQ(joint.frame_name(24), "bars, frame 0");
  EXPECT_EQ(joint.channel_name(0), "camera 0");
}

TEST(Joint, EachTestKnowsHowItsNoiseWasFound) {
  Line first(4, 1, false, {}), second(3, 2, false, {});
  second.few = 7.0;
  JointExperiment joint({{"first", &first, {1}}, {"second", &second, {1}}});
  const Eigen::VectorXd freedom = joint.freedom();
  ASSERT_EQ(freedom.size(), 21);
  EXPECT_TRUE(std::isinf(freedom[0]) && std::isinf(freedom[11]));
  EXPECT_EQ(freedom.tail(9), Eigen::VectorXd::Constant(9, 7.0));
  const Eigen::MatrixXd squares = joint.noise_of_squares({10.0, 0.0}, Eigen::MatrixXd::Ones(21, 2));
  EXPECT_EQ(squares.col(1).head(12), Eigen::VectorXd::Ones(12));
  EXPECT_EQ(squares.col(1).tail(9), 2.0 * Eigen::VectorXd::Ones(9));
}

TEST(Joint, ATestIsAskedOnceForEachOfItsOwnSets) {
  Line images(24, 5, true, {}), curves(16, 6, true, {});
  JointExperiment joint({{"plate", &images}, {"bars", &curves}});
  std::vector<double> here{10.0, 0.0, 0.0, 0.0}, moved = here;
  moved[3] = 0.1;  // a gain of the bars
  const auto residuals = joint.residuals({here, moved});
  EXPECT_EQ(images.asked, 1);
  EXPECT_EQ(curves.asked, 2);
  EXPECT_EQ((residuals[0] - residuals[1]).head(72).norm(), 0.0);
  EXPECT_GT((residuals[0] - residuals[1]).tail(48).norm(), 1.0);
}

TEST(Joint, TheLawIsDeclaredAlike) {
  Line images(24, 5, true, {}), curves(16, 6, true, {}, 12.0);
  EXPECT_THROW(JointExperiment({{"plate", &images}, {"bars", &curves}}), InputError);
}

}  // namespace test_joint
}  // namespace imic3d::loop
