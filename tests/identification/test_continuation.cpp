// A stage that is taken up at any of its iterations, by a model that knows nothing else, ends as if it had not been
// left.
#include <gtest/gtest.h>

#include <random>

#include "plate.hpp"

namespace imic3d::identification {
namespace test_continuation {

using testing::Plate;

struct Kept {
  StagePoint point;
  Solutions solutions;
};

TEST(Continuation, EndsWhereTheStageWouldHave) {
  const Communicator world;
  struct Way {
    Functional functional;
    double alpha;
    Sensitivities sensitivities;
    int most_increments = 0;
  };
  for (const auto& [functional, alpha, sensitivities, most_increments] :
       {Way{Functional::force_driven, 0.0, Sensitivities::perturbed},
        {Functional::combined, 0.0, Sensitivities::direct},
        {Functional::displacement_driven, 0.0, Sensitivities::direct, 16},
        {Functional::force_driven, 0.0, Sensitivities::direct, 4},
        {Functional::force_driven, 0.3, Sensitivities::perturbed}}) {
    Plate plate({0.002, 0.004, 0.01, 0.02, 0.03, 0.04});
    std::mt19937 random(3);
    std::normal_distribution<double> noise(0.0, 2e-4);
    for (double& u : plate.record.surface_displacement.reshaped()) u += noise(random);
    const Stage stage{.free = {0, 2}, .frames = {0, 1, 2, 3, 4, 5}};
    GaussNewtonOptions options{.functional = functional,
                               .alpha = alpha,
                               .eta = 1e-6,
                               .force_noise = 5.0,
                               .sensitivities = sensitivities,
                               .most_increments = most_increments};
    options.noise_model.image = 2.0;
    auto start = plate.truth;
    start[0] *= 1.1, start[2] *= 0.85;
    std::vector<Kept> kept;
    auto whole = start;
    ForwardModel model(world, plate.specimen, plate.law, plate.record, {.with_fields = false}, 3, 0);
    const auto expected = gauss_newton(world, model, plate.images, testing::information(plate), stage, options, whole,
                                       {}, {.from = nullptr, .reached = [&](const StagePoint& point) {
                                              kept.push_back({point, model.solutions()});
                                            }});
    ASSERT_TRUE(expected.converged);
    ASSERT_GT(expected.covariance.total.norm(), 0.0);
    ASSERT_GE(kept.size(), 4U);
    for (const Kept& at : kept) {
      ForwardModel fresh(world, plate.specimen, plate.law, plate.record, {.with_fields = false}, 3, 0);
      fresh.start_from(at.solutions);
      auto found = plate.truth;  // are replaced by the point's
      const auto result = gauss_newton(world, fresh, plate.images, testing::information(plate), stage, options, found,
                                       {}, {.from = &at.point, .reached = {}});
      EXPECT_EQ(result.iterates.size(), expected.iterates.size());
      EXPECT_TRUE(result.converged);
      for (const std::size_t j : {0U, 2U})
        EXPECT_NEAR(found[j] / whole[j], 1.0, 1e-9)
            << "from iteration " << at.point.iterates.size() - 1 << " parameter " << j;
      EXPECT_LT((result.covariance.total - expected.covariance.total).norm(), 1e-6 * expected.covariance.total.norm());
    }
  }
}

}  // namespace test_continuation
}  // namespace imic3d::identification
