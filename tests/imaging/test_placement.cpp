#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <cstdlib>
#include <functional>
#include <random>

#include "imic3d/imaging/placement.hpp"
#include "imic3d/mesh/mesh.hpp"

namespace imic3d::imaging {
namespace test_placement {

using Eigen::Vector2d;
using ::testing::HasSubstr;
using Contours = std::vector<std::vector<Vector2d>>;

constexpr double pi = 3.14159265358979323846;

/// A plate of 20 x `length` with a hole of 5 (if `hole`), as a mesh has it: corners and `n` points on the hole.
Contours plate(double length, bool hole, int n = 40) {
  const double h = length / 2;
  Contours contours{{{-10, -h}, {0, -h}, {10, -h}, {10, 0}, {10, h}, {0, h}, {-10, h}, {-10, 0}}};
  if (!hole) return contours;
  contours.emplace_back();
  for (int i = 0; i < n; ++i) contours[1].emplace_back(2.5 * std::cos(2 * pi * i / n), -2.5 * std::sin(2 * pi * i / n));
  return contours;
}

/// A picture of a speckled strip 20 wide and much longer than the mesh, with a hole of 5.
Image picture(const TelecentricCamera& camera, int width, int height, bool hole, float background, float paint,
              float speckle, double noise) {
  std::mt19937_64 random(7);
  std::uniform_real_distribution<double> uniform(0.0, 1.0);
  std::vector<char> dark(static_cast<std::size_t>(4 * width) * static_cast<std::size_t>(4 * height), 0);
  const int disks = width * height / 30;  // about half of the area
  for (int d = 0; d < disks; ++d) {
    const double x = 4 * width * uniform(random), y = 4 * height * uniform(random), r = 8.0 + 6.0 * uniform(random);
    for (int j = std::max(0, static_cast<int>(y - r)); j < std::min(4.0 * height, y + r); ++j)
      for (int i = std::max(0, static_cast<int>(x - r)); i < std::min(4.0 * width, x + r); ++i)
        if (std::hypot(i - x, j - y) < r)
          dark[static_cast<std::size_t>(j) * static_cast<std::size_t>(4 * width) + static_cast<std::size_t>(i)] = 1;
  }
  const Eigen::Matrix2d inverse = camera.linear.leftCols<2>().inverse();
  std::normal_distribution<double> normal(0.0, noise);
  Image image(width, height);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      double sum = 0.0;
      for (int j = 0; j < 4; ++j)
        for (int i = 0; i < 4; ++i) {
          const Vector2d at = inverse * (Vector2d(x + (i - 1.5) / 4, y + (j - 1.5) / 4) - camera.offset);
          const bool material = std::abs(at.x()) < 10.0 && (!hole || at.norm() > 2.5);
          const bool spot = dark[static_cast<std::size_t>(4 * y + j) * static_cast<std::size_t>(4 * width) +
                                 static_cast<std::size_t>(4 * x + i)] != 0;
          sum += material ? (spot ? speckle : paint) : background;
        }
      image(x, y) = static_cast<float>(sum / 16 + normal(random));
    }
  return image;
}

/// The largest distance between where two cameras see the corners of a box of 20 x 24.
double distance(const Camera& a, const Camera& b) {
  double largest = 0.0;
  for (double x : {-10.0, 10.0})
    for (double y : {-12.0, 12.0}) largest = std::max(largest, (a.project({x, y, 0}) - b.project({x, y, 0})).norm());
  return largest;
}

TEST(Placement, PoseHasYUpwardsAndTurnsCounterClockwise) {
  const auto straight = camera_from_pose(0.5, {100, 50});
  EXPECT_LT((straight.project({1, 2, 9}) - Vector2d(102, 46)).norm(), 1e-12);
  const auto turned = camera_from_pose(0.5, {100, 50}, 90.0);
  EXPECT_LT((turned.project({1, 0, 0}) - Vector2d(100, 48)).norm(), 1e-12);
  const auto mirrored = camera_from_pose(0.5, {100, 50}, 0.0, true);
  EXPECT_LT((mirrored.project({1, 2, 0}) - Vector2d(98, 46)).norm(), 1e-12);
  EXPECT_THROW((void)camera_from_pose(0.0, {0, 0}), InputError);
}

TEST(Placement, PointsGiveASimilarityOrAnAffineMap) {
  for (bool flip : {false, true}) {
    const auto truth = camera_from_pose(0.02, {400, 300}, 12.0, flip);
    std::vector<std::array<double, 4>> points;
    for (const Vector2d& at : {Vector2d(-3, 1), Vector2d(4, 2), Vector2d(0, -5), Vector2d(2, 7)}) {
      const Vector2d pixel = truth.project({at.x(), at.y(), 0});
      points.push_back({at.x(), at.y(), pixel.x(), pixel.y()});
    }
    for (std::size_t count : {2U, 3U, 4U}) {
      const auto found = place_by_points({points.data(), count}, flip);
      EXPECT_LT(distance(found.camera, truth), 1e-9);
      EXPECT_NEAR(found.rotation, 12.0, 1e-9);
      EXPECT_NEAR(found.pixel_size, 0.02, 1e-12);
      EXPECT_LT(found.rms, 1e-9);
    }
    EXPECT_THROW((void)place_by_points({points.data(), 3}, !flip), InputError);  // mirrored, or not
    points[3][2] += 4.0;                                                         // a point that is off by four pixels
    EXPECT_GT(place_by_points(points, flip).rms, 0.5);
    points[1] = points[0];
    EXPECT_THROW((void)place_by_points({points.data(), 1}), InputError);
    EXPECT_THROW((void)place_by_points({points.data(), 2}), InputError);
    points[2] = points[0];
    EXPECT_THROW((void)place_by_points({points.data(), 3}, flip), InputError);
  }
}

TEST(Placement, OutlineOfGeneratedPictures) {
  struct {
    double pixel_size, rotation;
    bool flip, known, affine;
    float background, paint, speckle;
  } const cases[] = {{0.05, 3.0, false, true, false, 30, 200, 60},     //
                     {0.05, 3.0, false, false, false, 30, 200, 60},    //
                     {0.046, -8.0, true, false, false, 20, 180, 20},   // speckles as dark as the background
                     {0.05, 1.0, false, true, true, 30, 200, 60},      //
                     {0.05, 0.0, false, false, false, 230, 150, 40}};  // bright background
  for (const auto& test : cases) {
    const auto truth = camera_from_pose(test.pixel_size, {305.3, 321.7}, test.rotation, test.flip);
    const Image image = picture(truth, 620, 660, true, test.background, test.paint, test.speckle, 2.5);
    OutlineOptions options{.flip = test.flip, .affine = test.affine};
    if (test.known) options.pixel_size = test.pixel_size;
    const Placement found = place_by_outline(image, plate(24, true), options);
    // Of an affine fit, only the hole holds the magnification along the plate: at its corners five times the error.
    EXPECT_LT(distance(found.camera, truth), test.affine ? 1.5 : 0.3) << test.rotation;
    EXPECT_NEAR(found.rotation, test.rotation, test.affine ? 0.1 : 0.03);
    std::printf("[ placement ] rotation %g: off by %.3f px, rms %.3f px, %d of %d visible agree (%d tried)\n",
                test.rotation, distance(found.camera, truth), found.rms, found.agreeing, found.visible, found.tried);
  }
}

std::string message_of(const std::function<void()>& work) {
  try {
    work();
  } catch (const InputError& error) {
    return error.what();
  }
  return "no error";
}

TEST(Placement, OutlineNearAPlaceThatIsOff) {
  for (const bool bright_background : {false, true}) {
    const auto truth = camera_from_pose(0.05, {305.3, 321.7}, 3.0);
    const Image image =
        picture(truth, 600, 640, true, bright_background ? 230 : 30, bright_background ? 150 : 200, 60, 2.0);
    for (const auto& off : {camera_from_pose(0.05, {305.3, 321.7}, 3.0), camera_from_pose(0.0525, {305.3, 321.7}, 3.0),
                            camera_from_pose(0.048, {300.0, 330.0}, 2.0)}) {
      const auto found = outline_near(image, plate(24, true), off, 40.0);
      ASSERT_TRUE(found.has_value());
      EXPECT_LT(distance(found->camera, truth), 1.0);
      EXPECT_NEAR(found->pixel_size, 0.05, 1e-4);
    }
    EXPECT_FALSE(outline_near(image, plate(24, false), truth, 40.0).has_value())
        << "no hole, no ends: the mesh could slide";
  }
  const Image nothing = picture(camera_from_pose(0.05, {305.3, 321.7}), 600, 640, false, 200, 200, 60, 2.0);
  EXPECT_FALSE(outline_near(nothing, plate(24, true), camera_from_pose(0.05, {305.3, 321.7}), 40.0).has_value())
      << "no hole in the image";
}

TEST(Placement, WhatCannotBePlacedIsRefused) {
  const auto camera = camera_from_pose(0.05, {305, 320}, 0.0);
  const Image strip = picture(camera, 620, 660, false, 30, 200, 60, 2.5);
  EXPECT_THAT(message_of([&] { (void)place_by_outline(strip, plate(24, false), {.pixel_size = 0.05}); }),
              HasSubstr("can slide"));
  EXPECT_NE(message_of([&] { (void)place_by_outline(strip, plate(24, true), {.pixel_size = 0.05}); }), "no error");
  const Image holed = picture(camera, 620, 660, true, 30, 200, 60, 2.5);
  EXPECT_THAT(message_of([&] { (void)place_by_outline(holed, plate(24, true), {.pixel_size = 0.01}); }),
              HasSubstr("2000 x 2400 px (by pixel_size) on an image of 620 x 660"));
  EXPECT_NE(message_of([&] { (void)place_by_outline(holed, plate(24, true), {.pixel_size = 0.1}); }), "no error");
  const Image flat(620, 660, 8, 100.0F);
  EXPECT_THAT(message_of([&] { (void)place_by_outline(flat, plate(24, true), {}); }), HasSubstr("no place"));

  const std::vector<Eigen::Vector3d> points{{0, 0, 0}, {0, 20, 0}};
  const auto mistakes = check_on_image(camera, points, holed.header(), "plate.msh");
  ASSERT_EQ(mistakes.size(), 1U);
  EXPECT_THAT(mistakes[0].message(), HasSubstr("does not lie on the image: 1 of 2 nodes are outside"));
  EXPECT_TRUE(check_on_image(camera, {points.data(), 1}, holed.header(), "plate.msh").empty());
}

/// The folder of measured data, or an empty path.
std::filesystem::path data_directory() {
  const char* variable = std::getenv("IMIC3D_DATA");
  const std::filesystem::path path = variable != nullptr
                                         ? std::filesystem::path(variable)
                                         : std::filesystem::path(IMIC3D_SOURCE_DIRECTORY) / "../shared/data";
  return std::filesystem::is_directory(path) ? path : std::filesystem::path();
}

TEST(Placement, MeasuredDataPlateIndependent) {
  if (data_directory().empty()) GTEST_SKIP() << "measured data not found (IMIC3D_DATA)";
  const mesh::Mesh mesh = mesh::read(data_directory() / "plate_independent" / "mesh.msh");
  Contours contours;
  for (const auto& contour : mesh::contours(mesh)) {
    contours.emplace_back();
    for (int node : contour) contours.back().emplace_back(mesh.nodes(node, 0), mesh.nodes(node, 1));
  }
  const Image image = read_image(data_directory() / "plate_independent" / "images" / "frame_002.png");
  const auto truth = camera_from_pose(0.025, {(image.width - 1) / 2.0, (image.height - 1) / 2.0});
  for (bool known : {true, false})
    for (bool affine : {false, true}) {
      OutlineOptions options{.affine = affine};
      if (known) options.pixel_size = 0.025;
      const Placement found = place_by_outline(image, contours, options);
      EXPECT_LT((found.camera.project({0, 0, 0}) - truth.project({0, 0, 0})).norm(), 0.3);
      EXPECT_LT(distance(found.camera, truth), affine ? 2.0 : 0.3);
      std::printf(
          "[ placement ] plate_independent: off by %.3f px (hole %.3f), pixel size %.6f, rms %.3f px, %d of %d agree "
          "(%d tried)\n",
          distance(found.camera, truth), (found.camera.project({0, 0, 0}) - truth.project({0, 0, 0})).norm(),
          found.pixel_size, found.rms, found.agreeing, found.visible, found.tried);
    }
}

TEST(Placement, MeasuredDataPcabsTension) {
  if (data_directory().empty()) GTEST_SKIP() << "measured data not found (IMIC3D_DATA)";
  // The dumbbell of that test between x = -17 and 17 mm: waist 12 x 12, fillets of radius 20.
  std::vector<Vector2d> outline;
  const auto half_width = [](double x) {
    return std::abs(x) <= 6 ? 6.0 : 26 - std::sqrt(400 - std::pow(std::abs(x) - 6, 2));
  };
  for (int i = -17; i <= 17; ++i) outline.emplace_back(i, -half_width(i));
  for (int i = 17; i >= -17; --i) outline.emplace_back(i, half_width(i));
  const Image image = read_image(data_directory() / "pcabs_tension" / "images" / "frame_000.png");
  const Placement known = place_by_outline(image, {outline}, {.pixel_size = 0.03929});
  const Placement free = place_by_outline(image, {outline}, {});
  std::printf(
      "[ placement ] pcabs_tension: origin (%.2f, %.2f), rms %.2f px, %d of %d agree; pixel size found %.5f, rms %.2f "
      "px\n",
      known.camera.offset.x(), known.camera.offset.y(), known.rms, known.agreeing, known.visible, free.pixel_size,
      free.rms);
  EXPECT_LT(known.rms, 1.0);
  EXPECT_GT(known.agreeing, 0.8 * known.visible);
  EXPECT_NEAR(free.pixel_size, 0.03929, 0.005 * 0.03929);  // the laboratory's own
  EXPECT_LT((free.camera.offset - known.camera.offset).norm(), 1.0);
}

}  // namespace test_placement
}  // namespace imic3d::imaging
