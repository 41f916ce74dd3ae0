// The pixel pass against a plain one: every pixel by itself, in double precision, from the formulas (Eqs 5-9). Local
// coordinates are found by Newton's method on the camera's projection of the surface, positions are projected, not
// interpolated.
#include <gtest/gtest.h>

#include <Eigen/LU>

#include "imic3d/correlation/cameras.hpp"
#include "imic3d/imaging/low_pass.hpp"
#include "stereo_scene.hpp"

namespace imic3d::correlation {
namespace test_pixel_pass {

using namespace test;
using imaging::BSpline;
using imaging::Image;

const Communicator alone{MPI_COMM_SELF};
constexpr double sign_xi[4] = {-1, 1, 1, -1}, sign_eta[4] = {-1, -1, 1, 1};

struct Scene {
  mesh::Mesh quads;
  std::shared_ptr<const imaging::Camera> eye;
  Image reference, deformed;
  CorrelationOptions options;
};

struct PlainPixel {
  int element;
  std::array<double, 4> N;
  double f, g;
  Eigen::Vector2d slope;  // of f
};
struct Plain {
  std::vector<PlainPixel> pixels;  // in the order of the quadrature, without those that left the image
  double dropped = 0.0, gain = 1.0, offset = 0.0, squares = 0.0;
  Eigen::VectorXd b, element_squares;
};

double variance(const std::vector<double>& values) {
  double mean = 0.0, sum = 0.0;
  for (const double v : values) mean += v / static_cast<double>(values.size());
  for (const double v : values) sum += (v - mean) * (v - mean);
  return sum / static_cast<double>(values.size());
}

Plain plain(const Scene& scene, const Correlation& of, const BSpline& f, const BSpline& g, const Eigen::VectorXd& U,
            bool transported) {
  const int dofs = of.dofs_per_node();
  const auto corner = [&](int e, int i, bool moved) {
    const int node = scene.quads.cells(e, i);
    Eigen::Vector3d X = scene.quads.nodes.row(node).transpose();
    for (int a = 0; moved && a < dofs; ++a) X[a] += U[node * dofs + a];
    return X;
  };
  const auto shapes = [](const Eigen::Vector2d& at) {
    std::array<double, 4> N{};
    for (std::size_t i = 0; i < 4; ++i) N[i] = 0.25 * (1 + sign_xi[i] * at.x()) * (1 + sign_eta[i] * at.y());
    return N;
  };
  const auto seen_at = [&](int e, const Eigen::Vector2d& at, bool moved) {
    const auto N = shapes(at);
    Eigen::Vector3d X(0, 0, 0);
    for (int i = 0; i < 4; ++i) X += N[static_cast<std::size_t>(i)] * corner(e, i, moved);
    return scene.eye->project(X);
  };
  Plain result;
  for (int e = 0; e < of.elements(); ++e)
    for (const PixelRow& run : of.quadrature().rows_of(e))
      for (int k = 0; k < run.count; ++k) {
        const Eigen::Vector2d pixel(run.column + k, run.row);
        Eigen::Vector2d at(0, 0);
        constexpr double h = 1e-5;
        for (int iteration = 0; iteration < 30; ++iteration) {
          const Eigen::Vector2d miss = pixel - seen_at(e, at, false);
          if (miss.norm() < 1e-10) break;
          Eigen::Matrix2d tangent;
          for (int c = 0; c < 2; ++c)
            tangent.col(c) = (seen_at(e, at + h * Eigen::Vector2d::Unit(c), false) -
                              seen_at(e, at - h * Eigen::Vector2d::Unit(c), false)) /
                             (2 * h);
          at += tangent.inverse() * miss;
        }
        const Eigen::Vector2d x = seen_at(e, at, true);
        if (!g.contains(x.x(), x.y())) {
          ++result.dropped;
          continue;
        }
        const auto of_f = f.sample(pixel.x(), pixel.y());
        result.pixels.push_back({e, shapes(at), static_cast<double>(of_f.value),
                                 static_cast<double>(g.sample(x.x(), x.y()).value), of_f.slope.cast<double>()});
      }
  // f = gain g + offset: same mean and standard deviation, of all pixels or of each element's (64 for a gain, 4 for an
  // offset).
  const auto light = [](const std::vector<double>& a, const std::vector<double>& b, double gain) {
    double difference = 0.0;
    for (std::size_t i = 0; i < a.size(); ++i) difference += (a[i] - gain * b[i]) / static_cast<double>(a.size());
    return difference;
  };
  std::vector<double> all_f, all_g;
  for (const auto& p : result.pixels) all_f.push_back(p.f), all_g.push_back(p.g);
  if (scene.options.brightness || scene.options.local_brightness) {
    result.gain = std::sqrt(variance(all_f) / variance(all_g));
    result.offset = light(all_f, all_g, result.gain);
  }
  result.b = Eigen::VectorXd::Zero(of.unknowns());
  result.element_squares = Eigen::VectorXd::Zero(of.elements());
  const auto F = of.deformation_gradient(U);
  std::size_t end = 0;  // the pixels stand element by element
  for (int e = 0; e < of.elements(); ++e) {
    const std::size_t begin = end;
    std::vector<double> own_f, own_g;
    for (; end < result.pixels.size() && result.pixels[end].element == e; ++end)
      own_f.push_back(result.pixels[end].f), own_g.push_back(result.pixels[end].g);
    double gain = result.gain, offset = result.offset;
    if (scene.options.local_brightness && own_f.size() >= 64) gain = std::sqrt(variance(own_f) / variance(own_g));
    if (scene.options.local_brightness && own_f.size() >= 4) offset = light(own_f, own_g, gain);
    for (std::size_t k = begin; k < end; ++k) {
      const PlainPixel& p = result.pixels[k];
      const double r = p.f - gain * p.g - offset;
      result.element_squares[e] += r * r;
      const Eigen::Vector2d slope =
          transported ? Eigen::Vector2d(F[static_cast<std::size_t>(e)].inverse().transpose() * p.slope) : p.slope;
      for (int i = 0; i < 4; ++i) {
        const Eigen::Vector3d force =
            scene.eye->jacobian(corner(e, i, true)).transpose() * slope * (r * p.N[static_cast<std::size_t>(i)]);
        for (int a = 0; a < dofs; ++a) result.b[scene.quads.cells(e, i) * dofs + a] += force[a];
      }
    }
  }
  result.squares = result.element_squares.sum();
  return result;
}

/// The largest errors of b and of the elements' squares, relative to the largest entries.
void compare(const char* name, const Scene& scene, const Eigen::VectorXd& U, double tolerance) {
  const BSpline f(scene.reference), g(scene.deformed);
  const Correlation correlation(scene.quads, scene.eye, f, scene.options);
  ASSERT_EQ(U.size(), correlation.unknowns());
  for (const bool transported : {false, true}) {
    const Plain truth = plain(scene, correlation, f, g, U, transported);
    const Evaluation seen =
        correlation.evaluate(g, U, alone, transported ? Gradient::transported : Gradient::reference);
    EXPECT_EQ(seen.pixels, static_cast<double>(truth.pixels.size())) << name;
    EXPECT_EQ(seen.dropped, truth.dropped) << name;
    EXPECT_NEAR(seen.gain, truth.gain, 1e-6 * truth.gain) << name;
    EXPECT_NEAR(seen.offset, truth.offset, 1e-6 * 65535) << name;
    const double of_b = (seen.b - truth.b).cwiseAbs().maxCoeff() / truth.b.cwiseAbs().maxCoeff();
    const double of_squares =
        (seen.element_squares - truth.element_squares).cwiseAbs().maxCoeff() / truth.element_squares.maxCoeff();
    std::printf("[          ] %s%s: %zu pixels, %.0f left the image; b %.1e, squares %.1e\n", name,
                transported ? ", transported" : "", truth.pixels.size(), truth.dropped, of_b, of_squares);
    EXPECT_LT(of_b, tolerance) << name;
    EXPECT_LT(of_squares, tolerance) << name;
    // Pixel by pixel.
    const std::vector<float> residual = correlation.residual(g, U);
    double worst = 0.0, largest = 0.0;
    std::size_t p = 0;
    for (const float r : residual) {
      if (std::isnan(r)) continue;
      const auto& pixel = truth.pixels[p++];
      const double gain = seen.element_gain[pixel.element], offset = seen.element_offset[pixel.element];
      const double expected = pixel.f - gain * pixel.g - offset;
      worst = std::max(worst, std::abs(static_cast<double>(r) - expected)),
      largest = std::max(largest, std::abs(expected));
    }
    EXPECT_EQ(p, truth.pixels.size()) << name;
    EXPECT_LT(worst, tolerance * std::max(largest, 65535.0)) << name;
  }
}

const Motion bent = [](const Eigen::Vector2d& x) {
  return Eigen::Vector2d(3.3 + 0.02 * x.x() + 0.01 * x.y(), -2.6 + 0.015 * std::sin(0.2 * x.x()) - 0.01 * x.y());
};

const Speckle& pattern() {
  static const Speckle made(160, 140);
  return made;
}

Eigen::VectorXd some(Eigen::Index size, double amount) {
  Eigen::VectorXd U(size);
  for (Eigen::Index i = 0; i < size; ++i) U[i] = amount * std::sin(1.7 * static_cast<double>(i) + 0.3);
  return U;
}

Scene flat(mesh::Mesh quads, double pixels_per_length, double column, double row, double angle,
           CorrelationOptions options = {}) {
  return {std::move(quads), camera(pixels_per_length, column, row, true, angle), photograph(pattern(), 160, 140),
          photograph(pattern(), 160, 140, bent), std::move(options)};
}

constexpr double rounding = 1e-6;  // a float's, over a few operations

TEST(PixelPass, OfElementsOfAllSizesIsThePlainOne) {
  for (const int n : {1, 3, 8, 30}) {  // about 9000, 1000, 140 and 10 pixels an element
    const Scene scene = flat(rectangle(1.0, 1.2, 10.8, 10.4, n, n), 10.0, 15.0, 128.0, 0.05);
    compare(("elements " + std::to_string(n * n)).c_str(), scene, some(2 * (n + 1) * (n + 1), 0.1), rounding);
  }
}

TEST(PixelPass, OfLightIsThePlainOne) {
  for (const bool local : {false, true}) {
    Scene scene = flat(rectangle(1.0, 1.2, 10.8, 10.4, 7, 5), 10.0, 15.0, 128.0, -0.03,
                       {.brightness = true, .local_brightness = local});
    for (int y = 0; y < 140; ++y)
      for (int x = 0; x < 160; ++x)
        scene.deformed(x, y) = (0.8F + 0.001F * static_cast<float>(x)) * scene.deformed(x, y) + 2000.0F;
    compare(local ? "light of each element" : "light of all", scene, some(2 * 8 * 6, 0.1), rounding);
  }
}

TEST(PixelPass, AtTheBordersIsThePlainOne) {
  // Elements that reach beyond the reference, pixels that leave the deformed image on all sides, a hole in the mask.
  Image mask(160, 140, 8, 255.0F);
  for (int y = 40; y < 70; ++y)
    for (int x = 50; x < 90; ++x)
      if ((x - 70) * (x - 70) + (y - 55) * (y - 55) < 200 || (x + y) % 7 == 0) mask(x, y) = 0.0F;
  Scene scene = flat(rectangle(0.0, 0.0, 16.5, 14.5, 9, 8), 10.0, -3.0, 142.0, 0.0,
                     {.quadrature = {.mask = &mask, .clip = true}});
  compare("borders", scene, some(2 * 10 * 9, 0.3), rounding);
  scene.options.local_brightness = true;
  compare("borders, local light", scene, some(2 * 10 * 9, 0.3), rounding);
  scene = flat(rectangle(2.0, 2.0, 14.0, 12.0, 6, 5), 10.0, 0.0, 140.0, 0.02, {.quadrature = {.border = 4.0}});
  compare("margin left out", scene, some(2 * 7 * 6, 0.1), rounding);
}

TEST(PixelPass, OfSmoothedImagesIsThePlainOne) {
  Scene scene = flat(rectangle(1.0, 1.2, 10.8, 10.4, 6, 6), 10.0, 15.0, 128.0, 0.05);
  scene.reference = imaging::low_pass(scene.reference, 1.0), scene.deformed = imaging::low_pass(scene.deformed, 1.0);
  compare("smoothed", scene, some(2 * 49, 0.1), rounding);
}

// At large strain neighbours do not share their integer shift; far motions must not cost digits.
TEST(PixelPass, OfLargeStrainAndFarMotionIsThePlainOne) {
  const Scene scene = flat(rectangle(1.0, 1.2, 10.8, 10.4, 6, 6), 5.0, 15.0, 68.0, 0.0);
  Eigen::VectorXd U(98);
  for (Eigen::Index n = 0; n < 49; ++n)
    U.segment<2>(2 * n) << 4.1 + 0.9 * scene.quads.nodes(n, 0) + 0.2 * scene.quads.nodes(n, 1),
        -3.0 + 0.4 * scene.quads.nodes(n, 1);
  compare("far and strained", scene, U, rounding);
}

// Differences over 1e-7 px against those over 1e-3 px: of what is known to 6e-8 px only nothing would be left.
TEST(PixelPass, InFullPrecisionIsSmooth) {
  const auto compare_differences = [](const char* name, const Scene& scene, const Eigen::VectorXd& U,
                                      double pixels_per_length) {
    const BSpline f(scene.reference), g(scene.deformed);
    const Correlation correlation(scene.quads, scene.eye, f, scene.options);
    const Eigen::VectorXd direction = some(U.size(), 1.0).reverse();
    const auto slope = [&](double step, Precision precision) -> Eigen::VectorXd {
      const Eigen::VectorXd dU = step / pixels_per_length * direction;
      return (correlation.evaluate(g, U + dU, alone, Gradient::reference, precision).b -
              correlation.evaluate(g, U - dU, alone, Gradient::reference, precision).b) /
             (2.0 * step);
    };
    const Eigen::VectorXd truth = slope(1e-3, Precision::full);
    const auto error = [&](Precision precision) { return (slope(1e-7, precision) - truth).norm() / truth.norm(); };
    const double single = error(Precision::single), full = error(Precision::full);
    std::printf("[          ] %s: single %.1e, full %.1e\n", name, single, full);
    EXPECT_LT(full, 1e-5) << name;
    EXPECT_GT(single, 1e-2) << name;  // else the test tells nothing
    const Evaluation coarse = correlation.evaluate(g, U, alone),
                     fine = correlation.evaluate(g, U, alone, Gradient::reference, Precision::full);
    EXPECT_LT((coarse.b - fine.b).norm(), 1e-6 * fine.b.norm()) << name;
    EXPECT_NEAR(coarse.squares, fine.squares, 1e-6 * fine.squares) << name;
    EXPECT_EQ(coarse.dropped, fine.dropped) << name;
  };
  const Scene scene = flat(rectangle(1.0, 1.2, 10.8, 10.4, 7, 6), 10.0, 15.0, 128.0, 0.05, {.local_brightness = true});
  compare_differences("telecentric", scene, some(2 * 8 * 7, 0.1), 10.0);
  const Scene border = flat(rectangle(0.0, 0.0, 16.5, 14.5, 9, 8), 10.0, -3.0, 142.0, 0.0,
                            {.brightness = true, .quadrature = {.clip = true}});
  compare_differences("borders", border, some(2 * 10 * 9, 0.3), 10.0);
  const Scene tilted{rectangle(-3.5, -3.0, 3.5, 3.0, 15, 13),
                     std::make_shared<imaging::PinholeCamera>(looking_from(15.0, 160, 140)),
                     photograph(pattern(), 160, 140),
                     photograph(pattern(), 160, 140, bent),
                     {.dofs_per_node = 3, .quadrature = {.clip = true}}};
  compare_differences("perspective", tilted, some(3 * tilted.quads.nodes.rows(), 0.02), 20.0);
}

// The biquadratic map of the elements is not the projection itself, which is what is projected here, but of elements of
// 7 px it is nearly so.
TEST(PixelPass, OfPerspectiveCamerasIsThePlainOne) {
  std::vector<std::shared_ptr<const Correlation>> correlations;
  std::vector<BSpline> splines;
  Eigen::VectorXd b, U;
  const std::vector<double> noise{1.0, 2.0};
  int c = 0;
  for (const double angle : {-12.0, 15.0}) {
    Scene scene{rectangle(-3.5, -3.0, 3.5, 3.0, 15, 13),
                std::make_shared<imaging::PinholeCamera>(looking_from(angle, 160, 140)),
                photograph(pattern(), 160, 140),
                photograph(pattern(), 160, 140, bent),
                {.dofs_per_node = 3, .quadrature = {.clip = true}}};
    for (Eigen::Index n = 0; n < scene.quads.nodes.rows(); ++n)
      scene.quads.nodes(n, 2) = 0.02 * scene.quads.nodes(n, 0) * scene.quads.nodes(n, 0);
    U = some(3 * scene.quads.nodes.rows(), 0.02);
    compare("perspective", scene, U, 3e-6);
    const BSpline f(scene.reference);
    correlations.push_back(std::make_shared<Correlation>(scene.quads, scene.eye, f, scene.options));
    splines.emplace_back(scene.deformed);
    // Weights 1/sigma^2 whose inverse has the mean 1: 1.6 and 0.4.
    const Eigen::VectorXd own =
        (c++ == 0 ? 1.6 : 0.4) * plain(scene, *correlations.back(), f, splines.back(), U, false).b;
    b = b.size() == 0 ? own : Eigen::VectorXd(b + own);
  }
  const Cameras cameras(correlations, noise);
  EXPECT_LT((cameras.evaluate(splines, U, alone).b - b).cwiseAbs().maxCoeff(), 3e-6 * b.cwiseAbs().maxCoeff());
}

// M of Eq. 8, pixel by pixel.
TEST(PixelPass, MatrixIsThePlainOne) {
  for (const int n : {1, 8, 30}) {
    const Scene scene = flat(rectangle(1.0, 1.2, 10.8, 10.4, n, n), 10.0, 15.0, 128.0, 0.05);
    const BSpline f(scene.reference);
    const Correlation correlation(scene.quads, scene.eye, f, scene.options);
    const Eigen::VectorXd still = Eigen::VectorXd::Zero(correlation.unknowns());
    Eigen::MatrixXd M = Eigen::MatrixXd::Zero(still.size(), still.size());
    const Eigen::Matrix2d J = scene.eye->jacobian(Eigen::Vector3d::Zero()).leftCols<2>();
    for (const auto& p : plain(scene, correlation, f, f, still, false).pixels)
      for (int i = 0; i < 4; ++i)
        for (int j = 0; j < 4; ++j)
          M.block<2, 2>(2 * scene.quads.cells(p.element, i), 2 * scene.quads.cells(p.element, j)) +=
              p.N[static_cast<std::size_t>(i)] * p.N[static_cast<std::size_t>(j)] * (J.transpose() * p.slope) *
              (J.transpose() * p.slope).transpose();
    EXPECT_LT((Eigen::MatrixXd(correlation.M()) - M).cwiseAbs().maxCoeff(), rounding * M.cwiseAbs().maxCoeff());
  }
}

}  // namespace test_pixel_pass
}  // namespace imic3d::correlation
