#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "imic3d/imaging/bspline.hpp"

namespace imic3d::imaging {
namespace test_bspline {

Image random_image(int width, int height, float largest = 255.0F) {
  Image image(width, height);
  std::mt19937 generator(7);
  std::uniform_real_distribution<float> grey(0.0F, largest);
  for (float& g : image.grey) g = grey(generator);
  return image;
}

TEST(BSpline, PassesThroughEveryPixel) {
  for (const auto& [width, height] : {std::pair{61, 47}, {16, 33}, {2, 5}, {1, 1}, {1, 9}}) {
    const Image image = random_image(width, height);
    const BSpline spline(image);
    float worst = 0.0F;
    for (int y = 0; y < height; ++y)
      for (int x = 0; x < width; ++x) worst = std::max(worst, std::abs(spline.value(x, y) - image(x, y)));
    EXPECT_LT(worst, 1e-4F) << width << " x " << height;
  }
}

TEST(BSpline, IsExactForCubicPolynomialsInside) {
  const auto cubic = [](double x, double y) {
    x = (x - 30) / 30, y = (y - 25) / 25;
    return 100.0 + 30.0 * x - 20.0 * y + 15.0 * x * y + 10.0 * x * x * x - 12.0 * x * y * y + 5.0 * y * y * y;
  };
  Image image(61, 51);
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width; ++x) image(x, y) = static_cast<float>(cubic(x, y));
  const BSpline spline(image);
  std::mt19937 generator(3);
  std::uniform_real_distribution<double> inside(12.0, 38.0);
  for (int k = 0; k < 200; ++k) {
    const double x = inside(generator), y = inside(generator);
    EXPECT_NEAR(spline.value(x, y), cubic(x, y), 1e-4);
  }
}

TEST(BSpline, CurvatureIsTheOneOfAPolynomial) {
  Image image(60, 50);
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width; ++x)
      image(x, y) = static_cast<float>(0.03 * x * x - 0.05 * y * y + 0.07 * x * y + 2.0 * x - y);
  std::vector<float> values(20 + lanes - 1);
  BSpline(image).curvature_row(20, 25, 20, 3.0F, 5.0F, 7.0F, values.data());
  for (std::size_t i = 0; i < 20; ++i) EXPECT_NEAR(values[i], 3.0 * 0.06 + 2.0 * 5.0 * 0.07 + 7.0 * -0.10, 2e-3);
}

TEST(BSpline, GradientIsTheDerivativeOfTheValue) {
  const Image image = random_image(40, 40);
  const BSpline spline(image);
  const Eigen::Vector2d place(17.37, 21.81), direction(0.6, 0.8);
  const double slope = direction.dot(spline.gradient(place.x(), place.y()).cast<double>());
  // Truncation falls with the square of the step, then rounding of the float coefficients takes over: a V.
  std::vector<double> errors;
  for (double h : {0.1, 0.03, 0.01, 1e-4, 1e-6}) {
    const Eigen::Vector2d a = place + h * direction, b = place - h * direction;
    const double difference =
        (static_cast<double>(spline.value(a.x(), a.y())) - static_cast<double>(spline.value(b.x(), b.y()))) / (2 * h);
    errors.push_back(std::abs(difference - slope));
  }
  EXPECT_LT(errors[1], 0.2 * errors[0]);
  EXPECT_LT(errors[2], 0.3 * errors[1]);
  EXPECT_GT(errors[4], errors[2]);
  EXPECT_LT(errors[2], 1e-2 * std::abs(slope) + 1e-2);
}

// Pixels side by side: cells change along the row by single steps, by jumps and at every pixel, up to a pixel from the
// borders.
TEST(BSpline, RowsAreTheValuesOfTheirPixels) {
  const Image image = random_image(90, 41);
  const BSpline spline(image);
  std::mt19937 generator(5);
  std::uniform_real_distribution<float> jump(-3.0F, 3.0F);
  for (const int kind : {0, 1, 2, 3})
    for (int count = 1; count < 60; ++count)
      for (const int row : {4, 20, 36}) {
        std::vector<float> dx(static_cast<std::size_t>(count + lanes - 1), 0.0F), dy = dx, values = dx;
        for (int i = 0; i < count; ++i) {
          auto &x = dx[static_cast<std::size_t>(i)], &y = dy[static_cast<std::size_t>(i)];
          const float t = static_cast<float>(i);
          if (kind == 0) x = 0.4F, y = -0.3F;
          if (kind == 1) x = 0.07F * t - 2.5F, y = 2.0F - 0.05F * t;
          if (kind == 2) x = jump(generator), y = jump(generator);
          if (kind == 3) x = std::floor(jump(generator)), y = std::floor(jump(generator));
        }
        const int column = row == 36 ? 86 - count : 4;
        spline.shifted_row(column, row, dx.data(), dy.data(), count, values.data());
        for (int i = 0; i < count; ++i) {
          const auto k = static_cast<std::size_t>(i);
          ASSERT_NEAR(values[k],
                      spline.value(column + i + static_cast<double>(dx[k]), row + static_cast<double>(dy[k])), 3e-4)
              << kind << ": " << i << " of " << count << ", row " << row;
        }
      }
}

TEST(BSpline, StaysInsideTheImage) {
  const Image image = random_image(12, 9);
  const BSpline spline(image);
  EXPECT_TRUE(spline.contains(0.0, 8.0));
  EXPECT_TRUE(spline.contains(11.0, 0.0));
  EXPECT_FALSE(spline.contains(11.01, 0.0));
  EXPECT_FALSE(spline.contains(3.0, -0.01));
  EXPECT_FALSE(spline.contains(std::nan(""), 1.0));
  EXPECT_NEAR(spline.value(50.0, 4.0), image(11, 4), 1e-3);
  EXPECT_NEAR(spline.value(11.0, 8.0), image(11, 8), 1e-3);
}

}  // namespace test_bspline
}  // namespace imic3d::imaging
