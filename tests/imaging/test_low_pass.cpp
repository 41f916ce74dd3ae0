#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "imic3d/imaging/bspline.hpp"
#include "imic3d/imaging/low_pass.hpp"

namespace imic3d::imaging {
namespace test_low_pass {

TEST(LowPass, KeepsTheMeanAndAStraightSlope) {
  Image image(60, 50);
  for (int y = 0; y < 50; ++y)
    for (int x = 0; x < 60; ++x) image(x, y) = static_cast<float>(3 * x - 2 * y);
  const Image smooth = low_pass(image, 1.5);
  for (int y = 10; y < 40; ++y)
    for (int x = 10; x < 50; ++x) EXPECT_NEAR(smooth(x, y), image(x, y), 1e-3);
  EXPECT_EQ(low_pass(image, 0.0).grey, image.grey);
}

/// Against noise itself; without smoothing the slope's variance has a closed form.
TEST(LowPass, NoiseResponseIsThatOfNoise) {
  EXPECT_NEAR(noise_response(0.0).slope, 9.0 * (2.0 / std::sqrt(3.0) - 1.0), 1e-6);
  EXPECT_NEAR(noise_response(0.0).level, 1.0, 1e-12);
  Image noise(400, 400);
  std::mt19937 random(3);
  std::normal_distribution<float> normal;
  for (float& grey : noise.grey) grey = normal(random);
  for (const double width : {0.6, 1.0, 2.0}) {
    const BSpline spline(low_pass(noise, width));
    double level = 0.0, slope = 0.0;
    for (int y = 20; y < 380; ++y)
      for (int x = 20; x < 380; ++x) {
        const auto sample = spline.sample(x, y);
        level += sample.value * sample.value;
        slope += sample.slope.x() * sample.slope.x();
      }
    EXPECT_NEAR(std::sqrt(level / (360.0 * 360.0)) / noise_response(width).level, 1.0, 0.02) << width;
    EXPECT_NEAR(slope / (360.0 * 360.0) / noise_response(width).slope, 1.0, 0.04) << width;
  }
}

}  // namespace test_low_pass
}  // namespace imic3d::imaging
