#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <ctime>
#include <random>

#include "imic3d/imaging/noise.hpp"
#include "imic3d/imaging/pinhole.hpp"
#include "imic3d/imaging/synthesis.hpp"

namespace imic3d::imaging {
namespace test_synthesis {

using Eigen::Vector2d;
using ::testing::HasSubstr;

/// n x n quads that cover [low, low + size]^2, with inner nodes shaken by `shake` of the spacing; optionally without
/// the middle quad.
struct Grid {
  PixelPoints nodes;
  Quads quads;
  Grid(int n, double low, double size, double shake, bool hole = false) {
    std::mt19937_64 random(3);
    std::uniform_real_distribution<double> uniform(-shake, shake);
    nodes.resize((n + 1) * (n + 1), 2);
    for (int j = 0; j <= n; ++j)
      for (int i = 0; i <= n; ++i) {
        const bool inner = i > 0 && j > 0 && i < n && j < n;
        const double dx = inner ? uniform(random) : 0.0, dy = inner ? uniform(random) : 0.0;
        nodes.row(j * (n + 1) + i) << low + size * (i + dx) / n, low + size * (j + dy) / n;
      }
    std::vector<int> all;
    for (int j = 0; j < n; ++j)
      for (int i = 0; i < n; ++i)
        if (!hole || i != n / 2 || j != n / 2)
          for (int node : {j * (n + 1) + i, j * (n + 1) + i + 1, (j + 1) * (n + 1) + i + 1, (j + 1) * (n + 1) + i})
            all.push_back(node);
    quads = Eigen::Map<const Quads>(all.data(), static_cast<Eigen::Index>(all.size()) / 4, 4);
  }
  /// Stretched by up to 40 % and bent.
  [[nodiscard]] PixelPoints moved() const {
    PixelPoints result = nodes;
    for (auto row : result.rowwise()) {
      const double x = row[0], y = row[1];
      row[0] = 0.85 * x + 0.03 * y + 8.0 * std::sin(y / 50.0) + 11.3;
      row[1] = 1.3 * y + 6.0 * std::cos(x / 60.0) - 20.7;
    }
    return result;
  }
};

/// A point of a bent element, moved in and out of the plane and seen through a distorting lens, is found again where it
/// was.
TEST(InverseMapping, ThroughALensIsTheInverseOfTheProjection) {
  const Grid grid(6, -6.0, 12.0, 0.3);  // [mm]
  const PinholeCamera camera(
      {.fx = 900.0, .fy = 905.0, .cx = 250.0, .cy = 240.0, .distortion = {-0.4, 0.8, 0.003, -0.002}},
      {Eigen::AngleAxisd(0.4, Eigen::Vector3d(0.3, 1.0, 0.1).normalized()).toRotationMatrix() *
           Eigen::Vector3d(1, -1, -1).asDiagonal(),
       {0.5, -0.3, 40.0}});
  Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor> moved(grid.nodes.rows(), 3);
  for (Eigen::Index i = 0; i < moved.rows(); ++i) {
    const double x = grid.nodes(i, 0), y = grid.nodes(i, 1);
    moved.row(i) << 1.1 * x + 0.2, y - 0.05 * x, 0.3 * std::sin(x) + 0.02 * y * y;
  }
  const InverseMapping mapping(camera, grid.nodes, moved, grid.quads);
  const PixelPoints corners = [&] {
    PixelPoints pixels(moved.rows(), 2);
    for (Eigen::Index i = 0; i < moved.rows(); ++i)
      pixels.row(i) = camera.project(moved.row(i).transpose()).transpose();
    return pixels;
  }();
  const InverseMapping flat(grid.nodes, corners, grid.quads);  // as if the elements were bilinear in the image
  std::mt19937_64 random(2);
  std::uniform_real_distribution<double> parent(-1.0, 1.0);
  std::uniform_int_distribution<Eigen::Index> any(0, grid.quads.rows() - 1);
  double worst = 0.0, worst_flat = 0.0;
  InverseMapping::Location at, at_flat;
  for (int k = 0; k < 20000; ++k) {
    const Eigen::Index q = any(random);
    const double xi = parent(random), eta = parent(random);
    const double N[4] = {0.25 * (1 - xi) * (1 - eta), 0.25 * (1 + xi) * (1 - eta), 0.25 * (1 + xi) * (1 + eta),
                         0.25 * (1 - xi) * (1 + eta)};
    Vector2d x = Vector2d::Zero();
    Eigen::Vector3d X = Eigen::Vector3d::Zero();
    for (int i = 0; i < 4; ++i)
      x += N[i] * grid.nodes.row(grid.quads(q, i)).transpose(), X += N[i] * moved.row(grid.quads(q, i)).transpose();
    ASSERT_TRUE(mapping.locate(camera.project(X), at));
    worst = std::max(worst, (mapping.reference(at) - x).norm());
    if (flat.locate(camera.project(X), at_flat))
      worst_flat = std::max(worst_flat, (flat.reference(at_flat) - x).norm());
  }
  EXPECT_LT(worst, 1e-9);
  EXPECT_GT(worst_flat, 1e-3);  // [mm]: the lens and the tilt do matter here
}

TEST(InverseMapping, IsTheInverseOfTheFiniteElementMapping) {
  const Grid grid(12, 20.0, 260.0, 0.35);
  const InverseMapping mapping(grid.nodes, grid.moved(), grid.quads);
  const InverseMapping back(grid.moved(), grid.nodes, grid.quads);  // locates x: an independent way to X
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> uniform(20.0, 280.0);
  double worst = 0.0;
  InverseMapping::Location at, from;
  for (int k = 0; k < 100000; ++k) {
    const Vector2d x(uniform(random), uniform(random));
    ASSERT_TRUE(back.locate(x, from));
    const Vector2d deformed = back.reference(from);
    ASSERT_TRUE(mapping.locate(deformed, at)) << x.transpose();
    worst = std::max(worst, (mapping.reference(at) - x).norm());
  }
  std::printf("[ synthesis ] inverse mapping: largest error %.2e px over 100000 points\n", worst);
  EXPECT_LT(worst, 1e-8);
  EXPECT_FALSE(mapping.locate({-500, 0}, at));
  EXPECT_FALSE(mapping.locate({1e9, std::nan("")}, at));
}

TEST(InverseMapping, FindsPointsInSlenderAndSkewQuads) {
  std::mt19937_64 random(5);
  std::uniform_real_distribution<double> uniform(0.0, 1.0);
  const Quads one = (Quads(1, 4) << 0, 1, 2, 3).finished();
  int tried = 0;
  for (int n = 0; n < 20000; ++n) {
    PixelPoints nodes(4, 2);
    for (int k = 0; k < 4; ++k) nodes.row(k) << 30 * uniform(random), 30 * uniform(random);
    double least = 1e9;
    for (int k = 0; k < 4; ++k) {
      const Vector2d a = nodes.row((k + 1) % 4) - nodes.row(k), b = nodes.row((k + 3) % 4) - nodes.row(k);
      least = std::min(least, (a.x() * b.y() - a.y() * b.x()) / (a.norm() * b.norm()));
    }
    if (least < 0.1) continue;
    ++tried;
    const InverseMapping mapping(nodes, nodes, one);
    for (int k = 0; k < 20; ++k) {
      const double s = uniform(random), t = uniform(random);
      const Vector2d x = (1 - s) * (1 - t) * nodes.row(0) + s * (1 - t) * nodes.row(1) + s * t * nodes.row(2) +
                         (1 - s) * t * nodes.row(3);
      InverseMapping::Location at;
      ASSERT_TRUE(mapping.locate(x, at)) << nodes << "\n" << s << " " << t;
      EXPECT_LT((mapping.reference(at) - x).norm(), 1e-8);
    }
  }
  EXPECT_GT(tried, 500);
}

TEST(InverseMapping, ATurnedOverElementIsRefused) {
  const Grid grid(4, 0.0, 40.0, 0.0);
  PixelPoints moved = grid.nodes;
  moved.row(6) << 25.0, 25.0;
  EXPECT_THROW(InverseMapping(grid.nodes, moved, grid.quads), InputError);
  moved.row(6) << std::nan(""), 25.0;
  EXPECT_THROW(InverseMapping(grid.nodes, moved, grid.quads), InputError);
}

TEST(Speckle, CoverageDiameterAndSeed) {
  for (double diameter : {3.0, 6.0}) {
    const Speckle speckle({0, 0}, {600, 600},
                          {.diameter = diameter, .coverage = 0.5, .edge = 0.0, .paint = 200, .disk = 0, .seed = 4});
    double bare = 0.0;
    for (int j = 0; j < 1200; ++j)
      for (int i = 0; i < 1200; ++i) bare += speckle.grey({0.5 * i, 0.5 * j}) / 200.0;
    EXPECT_NEAR(1.0 - bare / (1200.0 * 1200.0), 0.5, 0.01);
  }
  const Speckle first({0, 0}, {50, 50}, {.edge = 2.0, .seed = 1}), again({0, 0}, {50, 50}, {.edge = 2.0, .seed = 1}),
      other({0, 0}, {50, 50}, {.edge = 2.0, .seed = 2});
  int different = 0;
  for (int k = 0; k < 50; ++k) {
    const Vector2d at(k + 0.3, 0.7 * k);
    EXPECT_EQ(first.grey(at), again.grey(at));
    different += first.grey(at) != other.grey(at) ? 1 : 0;
  }
  EXPECT_GT(different, 20);
  // Drawn with the 64-bit Mersenne Twister and explicit transformations: this number is the same on every platform.
  EXPECT_NEAR(first.grey({20.5, 25.25}), 135.6367, 1e-3);
  EXPECT_THROW(Speckle({0, 0}, {50, 50}, {.coverage = 1.0}), InputError);
}

TEST(Render, ARigidShiftByWholePixelsShiftsTheImage) {
  const Grid grid(10, 30.0, 200.0, 0.3, true);
  PixelPoints shifted = grid.nodes;
  shifted.rowwise() += Eigen::RowVector2d(7, -5);
  const SynthesisOptions options{.width = 260, .height = 250, .noise = 0.0};
  const Speckle speckle({0, 0}, {260, 260});
  const Speckle black({0, 0}, {1, 1}, {.coverage = 0.1, .paint = 20.0, .disk = 20.0});
  const Image f = render(InverseMapping(grid.nodes, grid.nodes, grid.quads), speckle, black, options);
  const InverseMapping mapping(grid.nodes, shifted, grid.quads);
  const Image analytic = render(mapping, speckle, black, options);
  const Image interpolated = render(mapping, ImageTexture(f), black, options);
  double worst = 0.0, worst_interpolated = 0.0;
  int compared = 0;
  for (int y = 0; y < 245; ++y)
    for (int x = 0; x < 253; ++x) {
      worst = std::max(worst, static_cast<double>(std::abs(analytic(x + 7, y) - (y + 5 < 250 ? f(x, y + 5) : 20.0F))));
      // Beside the edges: there an interpolated image would mix in the background of its reference.
      bool inside = true;
      for (int j = -2; j <= 2; ++j)
        for (int i = -2; i <= 2; ++i) {
          InverseMapping::Location at;
          inside = inside && mapping.locate(Vector2d(x + 7 + i, y + j), at);
        }
      if (!inside) continue;
      ++compared;
      worst_interpolated =
          std::max(worst_interpolated, static_cast<double>(std::abs(interpolated(x + 7, y) - f(x, y + 5))));
    }
  EXPECT_LT(worst, 1e-3);
  EXPECT_GT(compared, 30000);
  EXPECT_LT(worst_interpolated, 0.01);
  EXPECT_EQ(record(analytic, 0, options).grey[100 * 260 + 107], std::round(f(100, 105)));
}

TEST(Render, EdgesAreAveragedOverThePixel) {
  PixelPoints nodes(4, 2);
  nodes << 10.0, 10.0, 30.25, 10.0, 30.25, 20.5, 10.0, 20.5;
  const Quads one = (Quads(1, 4) << 0, 1, 2, 3).finished();
  const SynthesisOptions options{.width = 40, .height = 40, .supersampling = 8};
  const Speckle white({0, 0}, {1, 1}, {.coverage = 0.1, .paint = 200.0, .disk = 200.0}),
      black({0, 0}, {1, 1}, {.coverage = 0.1, .paint = 0.0, .disk = 0.0});
  const Image image = render(InverseMapping(nodes, nodes, one), white, black, options);
  double light = 0.0;
  for (float grey : image.grey) light += grey / 200.0;
  EXPECT_NEAR(light, 20.25 * 10.5, 1.5);
  EXPECT_EQ(image(9, 15), 0.0F);
  EXPECT_EQ(image(10, 15), 100.0F);  // half of this pixel lies to the right of 10
  EXPECT_EQ(image(20, 15), 200.0F);
  EXPECT_EQ(image(30, 15), 150.0F);
}

TEST(Record, NoiseIsWhiteDrawnAnewAndOfTheLevelAsked) {
  for (int depth : {8, 16}) {
    const SynthesisOptions options{.depth = depth, .noise = 0.01, .seed = 9};
    const Image flat(300, 300, depth, depth == 16 ? 30000.0F : 120.0F);
    std::vector<Image> frames;
    for (int frame = 0; frame < 4; ++frame) frames.push_back(record(flat, frame, options));
    const double wanted = 0.01 * (depth == 16 ? 65535.0 : 255.0);
    EXPECT_NEAR(noise_of_static_frames(frames), std::sqrt(wanted * wanted + 1.0 / 12.0), 0.01 * wanted);
    EXPECT_EQ(record(flat, 2, options).grey, frames[2].grey);
    EXPECT_NE(frames[1].grey, frames[2].grey);
    for (float grey : frames[0].grey) ASSERT_EQ(grey, std::round(grey));
    // Neighbours are independent of each other.
    double product = 0.0, square = 0.0;
    for (std::size_t i = 1; i < frames[0].grey.size(); ++i) {
      const double a = frames[0].grey[i - 1] - flat.grey[0], b = frames[0].grey[i] - flat.grey[0];
      product += a * b, square += b * b;
    }
    EXPECT_LT(std::abs(product / square), 0.015);
  }
  const Image bright(20, 20, 8, 254.0F);
  for (float grey : record(bright, 0, {.noise = 0.2}).grey) EXPECT_LE(grey, 255.0F);
}

TEST(Render, CostAndInterpolationErrorOfTheSpeckle) {
  const Grid grid(30, -20.0, 540.0, 0.2);
  const SynthesisOptions options{.width = 512, .height = 512, .noise = 0.0};
  for (double edge : {0.0, 2.0, 3.0, 4.0}) {
    const Speckle speckle({-30, -30}, {540, 540}, {.edge = edge});
    const Speckle black = dark_background(options);
    const auto start = std::clock();
    const Image f = render(InverseMapping(grid.nodes, grid.nodes, grid.quads), speckle, black, options);
    const double seconds = static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC;
    PixelPoints shifted = grid.nodes;
    shifted.col(0).array() += 0.5;
    shifted.col(1).array() += 0.25;
    const Image g = render(InverseMapping(grid.nodes, shifted, grid.quads), speckle, black, options);
    const BSpline spline(g);
    double squares = 0.0, slopes = 0.0;
    int count = 0;
    for (int y = 20; y < 490; ++y)
      for (int x = 20; x < 490; ++x) {
        const auto sample = spline.sample(x + 0.5, y + 0.25);
        squares += std::pow(sample.value - f(x, y), 2);
        slopes += 0.5 * sample.slope.squaredNorm();
        ++count;
      }
    std::printf(
        "[ synthesis ] disks that fade over %.0f px: interpolation error %.2f grey levels, slope %.1f "
        "per px (rms); "
        "%.2f s for 512 x 512\n",
        edge, std::sqrt(squares / count), std::sqrt(slopes / count), seconds);
    EXPECT_LT(std::sqrt(squares / slopes), edge < 2.0 ? 0.3 : edge < 3.0 ? 0.12 : edge < 4.0 ? 0.06 : 0.03);
  }
}

TEST(Render, BadOptionsAreRefused) {
  const Grid grid(2, 0.0, 10.0, 0.0);
  const InverseMapping mapping(grid.nodes, grid.nodes, grid.quads);
  const Speckle speckle({0, 0}, {10, 10});
  EXPECT_THROW((void)render(mapping, speckle, speckle, {.depth = 12}), InputError);
  EXPECT_THROW((void)render(mapping, speckle, speckle, {.width = 0}), InputError);
  EXPECT_THROW((void)record(Image(4, 4), 0, {.noise = -0.1}), InputError);
}

TEST(Synthesis, WithoutTheSpecimenItsSurroundingsGoOn) {
  Image image(40, 30, 8, 10.0F);
  for (int y = 0; y < 30; ++y)
    for (int x = 0; x < 40; ++x) {
      if (x < 20) image(x, y) = 60.0F;
      if (x >= 8 && x <= 31 && y >= 8 && y <= 21) image(x, y) = 200.0F;  // the specimen, two pixels wider than its mesh
    }
  PixelPoints corners(4, 2);
  corners << 9.5, 9.5, 29.5, 9.5, 29.5, 19.5, 9.5, 19.5;
  Quads quads(1, 4);
  quads << 0, 1, 2, 3;
  const Image cleared = without(image, InverseMapping(corners, corners, quads), 4);
  EXPECT_EQ(cleared(11, 14), 60.0F);
  EXPECT_EQ(cleared(28, 14), 10.0F);
  EXPECT_EQ(cleared(8, 14), 200.0F);  // what the mesh does not cover stays
  EXPECT_EQ(cleared(2, 2), 60.0F);
  for (int y = 10; y < 20; ++y)
    for (int x = 10; x < 30; ++x) EXPECT_LT(cleared(x, y), 200.0F) << x << ", " << y;
}

}  // namespace test_synthesis
}  // namespace imic3d::imaging
