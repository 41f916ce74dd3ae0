// Effects of the material are identified with images and force like any other parameter, from their null values.
#include <gtest/gtest.h>

#include "plate.hpp"

namespace imic3d::identification {
namespace test_effects {

using testing::Plate;

TEST(Effects, AreFoundFromTheirNullValues) {
  const auto law = material::make_law({.law = "j2", .hardening = "linear", .effects = {"kinematic", "hill", "rate"}});
  ASSERT_FALSE(law->symmetric_tangent());
  //                              E      nu    S_y  H     C_1    gamma R_22 R_33  R_12 angle C_rate rate_0
  const std::vector<double> truth = {198e3, 0.25, 250, 1500, 15e3, 120, 1.0, 0.93, 1.0, 0, 0.02, 0.01};
  Plate plate({0.003, 0.02, 0.05, 0.02, -0.02, 0.03, 0.08}, law, truth);
  plate.record.time << 1, 2, 3, 4, 5, 6, 6.05;
  {  // the last frame is a hundred times faster: its force again
    ForwardModel model({}, plate.specimen, law, plate.record, {.with_fields = false}, 1, 1);
    const Path path = model.simulate(Control::displacement, {{.parameters = truth}}, 7).front();
    ASSERT_EQ(path.frames, 7) << path.message;
    plate.record.force = path.reaction, plate.record.surface_displacement = plate.record.driving = path.surface;
  }
  ForwardModel model({}, plate.specimen, law, plate.record, {.with_fields = false}, 5, 0);
  auto parameters = truth;
  parameters[2] = 270, parameters[4] = 0, parameters[7] = 1, parameters[10] = 0;
  GaussNewtonOptions options{
      .functional = Functional::displacement_driven, .eta = 1e-7, .max_iterations = 40, .force_noise = 1.0};
  for (const auto& info : law->parameters())
    options.scale.push_back(info.effect.empty() ? 0.0 : usual_size(info, truth[0]));
  const auto result = gauss_newton({}, model, plate.images, law->parameters(),
                                   {.free = {2, 4, 7, 10}, .frames = {0, 1, 2, 3, 4, 5, 6}}, options, parameters);
  EXPECT_TRUE(result.converged);
  for (const std::size_t j : {2U, 4U, 7U, 10U})
    EXPECT_NEAR(parameters[j] / truth[j], 1.0, 1e-4) << law->parameters()[j].name;
}

}  // namespace test_effects
}  // namespace imic3d::identification
