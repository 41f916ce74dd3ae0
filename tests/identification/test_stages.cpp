// What stages that found parameters one after another leave unsaid: where these would go if all were free at once, and
// how sure they are then.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "plate.hpp"

namespace imic3d::identification {
namespace test_stages {

using testing::Plate;

constexpr int E = 0, S_y = 2, H = 3;
const std::vector<double> stretch = {0.002, 0.004, 0.02, 0.05, 0.1, 0.16};
const Stage all{.free = {E, S_y, H}, .frames = {0, 1, 2, 3, 4, 5}};

/// E, S_y and H in stages of their own, H from 10 % below the truth, and what is said about them.
struct InTurn {
  Plate plate{stretch};
  ForwardModel model{{}, plate.specimen, plate.law, plate.record, {.with_fields = false}, 4, 1};
  GaussNewtonOptions options;
  std::vector<double> parameters = plate.truth;
  StageResult last;

  explicit InTurn(Functional functional, int draws = 0, int most_increments = 0) {
    options = {.functional = functional,
               .eta = 1e-5,
               .force_noise = 2.0,
               .most_increments = most_increments,
               .noise_model = {.image = plate.images.noise, .force = 2.0, .driving = {}, .draws = draws}};
    parameters[E] *= 0.95, parameters[S_y] *= 0.95, parameters[H] *= 0.9;
    for (const auto& stage : {Stage{{E}, {0, 1}}, Stage{{S_y}, {0, 1, 2, 3}}, Stage{{H}, all.frames}}) {
      last = gauss_newton({}, model, plate.images, testing::information(plate), stage, options, parameters);
      EXPECT_TRUE(last.converged);
    }
  }
};

TEST(Stages, GoOnToTheTruthAtOnce) {
  for (const Functional functional :
       {Functional::force_driven, Functional::displacement_driven, Functional::combined}) {
    InTurn in_turn(functional);
    const auto at_once = free_at_once({}, in_turn.model, in_turn.plate.images, all, in_turn.options, in_turn.parameters,
                                      in_turn.last.finer);
    ASSERT_EQ(at_once.step.size(), 3);
    double off = 0.0, then = 0.0;  // the largest relative errors
    for (int i = 0; i < 3; ++i) {
      const auto j = static_cast<std::size_t>(all.free[static_cast<std::size_t>(i)]);
      off = std::max(off, std::abs(in_turn.parameters[j] / in_turn.plate.truth[j] - 1.0));
      then = std::max(then, std::abs((in_turn.parameters[j] + at_once.step[i]) / in_turn.plate.truth[j] - 1.0));
    }
    std::printf("functional %d: off by %.2e, free at once %.2e\n", static_cast<int>(functional), off, then);
    EXPECT_GT(off, 2e-3);
    // forces beyond the yield are not linear in the parameters
    EXPECT_LT(then, (functional == Functional::displacement_driven ? 0.01 : 0.12) * off);
    EXPECT_GT(std::abs(at_once.step[1]), 3.0 * std::sqrt(at_once.noise.covariance.total(1, 1)));
  }
}

/// The standard deviations are those of a stage that frees all.
TEST(Stages, AreAsSureAsOneOfAll) {
  InTurn in_turn(Functional::force_driven, 8);
  const auto at_once = free_at_once({}, in_turn.model, in_turn.plate.images, all, in_turn.options, in_turn.parameters,
                                    in_turn.last.finer);
  const auto one = gauss_newton({}, in_turn.model, in_turn.plate.images, testing::information(in_turn.plate), all,
                                in_turn.options, in_turn.parameters);
  for (int i = 0; i < 3; ++i)
    EXPECT_NEAR(std::sqrt(at_once.noise.covariance.total(i, i) / one.covariance.total(i, i)), 1.0, 0.1) << i;
  EXPECT_GT(std::sqrt(one.covariance.total(2, 2) / in_turn.last.covariance.total(0, 0)),
            2.0);  // of H, which S_y can do much of
}

/// What load increments err by is off the step, too.
TEST(Stages, WithFinerIncrements) {
  InTurn in_turn(Functional::displacement_driven, 0, 32);
  ASSERT_GT(in_turn.last.finer.number, 1);
  const auto with = free_at_once({}, in_turn.model, in_turn.plate.images, all, in_turn.options, in_turn.parameters,
                                 in_turn.last.finer);
  const auto without =
      free_at_once({}, in_turn.model, in_turn.plate.images, all, in_turn.options, in_turn.parameters, {});
  auto parameters = in_turn.parameters;
  gauss_newton({}, in_turn.model, in_turn.plate.images, testing::information(in_turn.plate), all, in_turn.options,
               parameters);
  for (int i = 0; i < 3; ++i) {
    const auto j = static_cast<std::size_t>(all.free[static_cast<std::size_t>(i)]);
    const double moves = parameters[j] - in_turn.parameters[j];
    EXPECT_LT(std::abs(with.step[i] - moves), 0.2 * std::abs(without.step[i] - moves)) << i;
  }
}

}  // namespace test_stages
}  // namespace imic3d::identification
