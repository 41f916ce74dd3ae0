// Light: images of an analytic speckle that moves in a known way, with noise, rounded to 8 bits. Each effect is planted
// by a formula of this file.

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <iostream>
#include <random>

#include "../correlation/speckle.hpp"
#include "imic3d/core/error.hpp"
#include "imic3d/loop/closing.hpp"
#include "imic3d/loop/light_experiment.hpp"
#include "imic3d/loop/statistics.hpp"

namespace imic3d::loop {
namespace test_light {

namespace made = correlation::test;
using correlation::GlobalDic;
using imaging::Image;

constexpr int width = 200, height = 240, count = 8;
constexpr double noise = 2.5, scale = 20.0;  // [grey level], [px/length]
const Communicator alone{MPI_COMM_SELF};

/// What is seen at pixel (x, y) of frame t (0: reference) of which `grey` is what there should be; `at` is the point of
/// the specimen there.
using Seen = std::function<double(double grey, int t, const Eigen::Vector2d& pixel, const Eigen::Vector2d& at)>;
const Seen as_it_is = [](double grey, int, const auto&, const auto&) { return grey; };

made::Motion motion(int t) {  // affine: the mesh follows it
  return [t](const Eigen::Vector2d& x) {
    return Eigen::Vector2d(0.23 * t - 3e-4 * t * (x[0] - 100.0), 0.41 * t + 1e-3 * t * (x[1] - 120.0));
  };
}

/// With waves of 25 px, which elements of 20 px cannot follow.
made::Motion waves(int t) {
  return [t](const Eigen::Vector2d& x) {
    return Eigen::Vector2d(motion(t)(x) + Eigen::Vector2d(0.0, 0.03 * t * std::sin(2.0 * M_PI * x[0] / 25.0)));
  };
}

/// A speckle in motion, photographed without noise once for all tests.
struct Clean {
  made::Speckle speckle, other{width, height, 1.7, 5};
  std::vector<Image> images;
  explicit Clean(const std::function<made::Motion(int)>& way = motion, double radius = 1.7, unsigned seed = 1)
      : speckle(width, height, radius, seed) {
    for (int t = 0; t <= count; ++t) {
      images.push_back(made::photograph(speckle, width, height, way(t)));
      for (float& g : images.back().grey) g = 120.0F + 70.0F * (g - 32768.0F) / 28000.0F;
      images.back().depth = 8;
    }
  }
};
const Clean& clean() {
  static const Clean one;
  return one;
}

struct Filmed {
  std::vector<Image> images;  // the reference first
  mesh::Mesh quads = made::rectangle(1.0, 1.0, 9.0, 11.0, 8, 10);
  std::shared_ptr<imaging::TelecentricCamera> camera = made::camera(scale);
  std::unique_ptr<GlobalDic> dic;
  double known_noise = noise;

  explicit Filmed(
      unsigned seed, const Seen& seen = as_it_is, const std::function<double(int)>& sigma = [](int) { return noise; },
      const Clean& from = clean()) {
    std::mt19937 random(seed);
    std::normal_distribution<double> normal;
    for (int t = 0; t <= count; ++t) {
      Image image = from.images[static_cast<std::size_t>(t)];
      for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
          const Eigen::Vector2d pixel(x, y), at = pixel - motion(t)(pixel - motion(t)(pixel));
          image(x, y) = static_cast<float>(
              std::clamp(std::round(seen(image(x, y), t, pixel, at) + sigma(t) * normal(random)), 0.0, 255.0));
        }
      images.push_back(std::move(image));
    }
  }

  [[nodiscard]] double image_noise() const {
    return std::sqrt(known_noise * known_noise + 1.0 / 12.0);
  }  // rounding is noise, too
  [[nodiscard]] LightExperiment experiment(correlation::DicOptions options = {.low_pass = 1.0, .border = 3.0},
                                           const std::vector<DeclaredEffect>& declared = {},
                                           const std::function<Image(int)>& synthetic = {}) {
    dic = std::make_unique<GlobalDic>(quads, *camera, images.front(), options, "mesh");
    const auto frames = dic->run(alone, count, [&](int t) { return images[static_cast<std::size_t>(t) + 1]; });
    LightCamera one{.optics = {}, .scene = {}, .frames = {}, .face = 0};
    one.scene.surface = &quads;
    measure(one.scene, quads);
    one.scene.time = Eigen::VectorXd::LinSpaced(count, 1.0, count), one.scene.force = Eigen::VectorXd::Ones(count);
    const LightStatistics statistics =
        LightStatistics::of_face(*dic, {{.camera = camera, .reference = images.front()}}, 1, {image_noise()}, one.scene)
            .front();
    one.optics = statistics.optics();
    std::vector<int> numbers;
    for (int t = 0; t < count; ++t) {
      EXPECT_TRUE(frames[static_cast<std::size_t>(t)].converged);
      one.frames.push_back(
          statistics.frame(images[static_cast<std::size_t>(t) + 1], frames[static_cast<std::size_t>(t)].displacement));
      numbers.push_back(t + 1);
    }
    LightExperiment::Synthetic learned;
    if (synthetic)
      learned = [this, statistics, synthetic] {
        std::vector<LightFrame> all;
        const auto found = dic->run(alone, count, synthetic);
        for (int t = 0; t < count; ++t)
          all.push_back(statistics.frame(synthetic(t), found[static_cast<std::size_t>(t)].displacement));
        return std::vector<std::vector<LightFrame>>{all};
      };
    return {{std::move(one)}, numbers, {2, 5}, declared, learned};
  }
};

LoopOptions quick() { return {.draws = 100, .additions = 2, .rivals = 4, .starts = {1.0}, .held_out = {2, 5}}; }

bool has(const LightExperiment& experiment, const std::vector<int>& which, const std::string& name) {
  return std::any_of(which.begin(), which.end(),
                     [&](int k) { return experiment.candidates()[static_cast<std::size_t>(k)].name == name; });
}

/// A parameter of the final model and its standard deviation.
std::pair<double, double> found(const LightExperiment& experiment, const Report& report, const std::string& name) {
  const Fit& fit = report.final.fit;
  for (std::size_t j = 0; j < fit.free.size(); ++j)
    if (const auto k = static_cast<std::size_t>(fit.free[j]); experiment.parameters()[k].info.name == name)
      return {fit.values[k],
              std::sqrt(report.final.covariance(static_cast<Eigen::Index>(j), static_cast<Eigen::Index>(j)))};
  return {std::nan(""), 0.0};
}

/// Means and variances of the numbers over many draws of the noise alone.
void numbers_of_noise_alone_are_standard_normal(double low_pass, int tests) {
  Eigen::MatrixXd z;
  for (int k = 0; k < tests; ++k) {
    Filmed test(1000 + static_cast<unsigned>(k));
    auto experiment = test.experiment({.low_pass = low_pass, .border = 3.0});
    std::vector<double> values;
    for (const auto& p : experiment.parameters()) values.push_back(p.value);
    const Eigen::VectorXd r = experiment.residuals({values}).front();
    if (z.size() == 0) z.resize(r.size(), tests);
    z.col(k) = r;
  }
  // In a frame: offset and gain of each cell, two gradients, mean squares, saturated pixels. The level of a cell's
  // noise is known to a tenth only, so the first frame's mean square says little. Smoothing and interpolation see a
  // stretched speckle with another contrast: the gains' means are not null, their variance is 1.
  const Eigen::Index per_frame = z.rows() / count, cells = (per_frame - 3) / 3, linear = 2 * cells + 2;
  const Eigen::VectorXd mean = z.rowwise().mean();
  const Eigen::VectorXd variance = (z.colwise() - mean).rowwise().squaredNorm() / (tests - 1.0);
  double of_linear = 0.0, of_squares = 0.0, of_means = 0.0;
  for (Eigen::Index t = 0; t < count; ++t) {
    of_linear += variance.segment(t * per_frame, linear).mean() / count;
    for (Eigen::Index c = 0; c < cells; ++c)
      of_means += tests * std::pow(mean[t * per_frame + 2 * c], 2) / static_cast<double>(count * cells);
    if (t > 0) of_squares += variance.segment(t * per_frame + linear, cells).mean() / (count - 1);
  }
  std::cout << "[          ] low pass " << low_pass << ": variance of the linear numbers " << of_linear
            << ", of the mean squares " << of_squares << ", mean of the offsets over its deviation, squared "
            << of_means << '\n';
  EXPECT_NEAR(of_linear, 1.0, 0.06);
  EXPECT_NEAR(of_squares, 1.0, 0.06);
  EXPECT_NEAR(of_means, 1.0, 0.6);
  EXPECT_EQ(z.row(per_frame - 1).norm(), 0.0);
}
TEST(Light, NumbersOfNoiseAloneAreStandardNormal) { numbers_of_noise_alone_are_standard_normal(1.0, 50); }
TEST(LightNightly, NumbersOfNoiseAloneAreStandardNormalWithoutLowPass) {
  numbers_of_noise_alone_are_standard_normal(0.0, 100);
}

/// 5 of a hundred are asked for; more than `at_most` come once in a thousand times.
void noise_alone_raises_no_alarm(int tests, int at_most) {
  int alarms = 0;
  Eigen::VectorXd p(tests);
  for (int k = 0; k < tests; ++k) {
    Filmed test(3000 + static_cast<unsigned>(k));
    const imaging::BSpline reference(test.images.front());
    const auto synthetic = [&](int frame) {
      Image image(width, height);
      const double t = frame + 1.0;
      for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x)
          image(x, y) = reference.value((x - 0.23 * t - 0.03 * t) / (1.0 - 3e-4 * t),
                                        (y - 0.41 * t + 0.12 * t) / (1.0 + 1e-3 * t));
      return image;
    };
    auto experiment = test.experiment({.low_pass = 1.0, .border = 3.0}, {}, synthetic);
    const Report report = close_loop(experiment, quick());
    p[k] = report.declared.scores.omnibus_p;
    if (report.verdict != Verdict::nothing_found) {
      ++alarms;
      std::cout << "[          ] test " << k << ": " << report.sentence << '\n';
    }
  }
  std::sort(p.begin(), p.end());
  double small = 0.0;
  for (int k = 0; k < tests; ++k) small = std::max(small, (k + 1.0) / tests - p[k]);
  std::cout << "[          ] " << alarms << " alarms of " << tests << "; small p-values of the energy are too many by "
            << small << ", median " << p[tests / 2] << '\n';
  EXPECT_LE(alarms, at_most);
  // Too small a variance makes the energy's alarms rarer: only small p-values that are too many are a fault.
  EXPECT_LT(small, 1.22 / std::sqrt(static_cast<double>(tests)));
}
TEST(Light, NoiseAloneRaisesNoAlarm) { noise_alone_raises_no_alarm(40, 7); }
TEST(LightNightly, NoiseAloneRaisesNoAlarm) { noise_alone_raises_no_alarm(100, 12); }

struct Planted {
  const char *effect, *quantity;
  double size;
  Seen seen;
};

class PlantedLight : public ::testing::TestWithParam<int> {};

std::vector<Planted> planted() {
  const auto clock = [](int t) { return static_cast<double>(t) / count; };
  return {{"light gain", "gain_drift", -0.01,
           [=](double grey, int t, const auto&, const auto&) { return grey * (1.0 - 0.01 * clock(t)); }},
          {"light offset", "offset_drift", 1.5,
           [=](double grey, int t, const auto&, const auto&) { return grey + 1.5 * clock(t); }},
          {"light gradient", "gradient_x", 0.002,
           [=](double grey, int t, const auto& pixel, const auto&) {
             return grey * (1.0 + 0.002 * clock(t) * (pixel[0] / scale - 5.0));
           }},
          {"noise level", "noise_drift", 0.3, as_it_is}};
}

TEST_P(PlantedLight, IsNamedWithItsSize) {
  const Planted one = planted()[static_cast<std::size_t>(GetParam())];
  int named = 0, covered = 0;
  constexpr int tests = 5;
  for (int k = 0; k < tests; ++k) {
    Filmed test(5000 + static_cast<unsigned>(k), one.seen, [&](int t) {
      return std::string(one.quantity) == "noise_drift" ? noise * (1.0 + one.size * t / count) : noise;
    });
    auto experiment = test.experiment();
    const Report report = close_loop(experiment, quick());
    const auto [size, deviation] = found(experiment, report, one.quantity);
    std::cout << "[          ] " << one.effect << ": " << name(report.verdict) << ", " << report.sentence << '\n';
    if (has(experiment, report.set, one.effect)) ++named;
    if (std::abs(size - one.size) < 2.6 * deviation) ++covered;
  }
  EXPECT_GE(named, 4);
  EXPECT_GE(covered, 4);
}
INSTANTIATE_TEST_SUITE_P(Effects, PlantedLight, ::testing::Range(0, 4));

/// Of two cameras the light of one may change alone, or that of both alike.
TEST(Light, OfOneCameraOfTwoIsNamed) {
  const auto filmed = [](const Planted& one, bool with, unsigned seed) {
    return Filmed(seed, with ? one.seen : as_it_is, [&one, with](int t) {
      return with && std::string(one.quantity) == "noise_drift" ? noise * (1.0 + one.size * t / count) : noise;
    });
  };
  std::vector<int> numbers;
  for (int t = 1; t <= count; ++t) numbers.push_back(t);
  unsigned seed = 5200;
  for (const Planted& one : planted())
    for (const bool both : {false, true}) {
      Filmed left = filmed(one, both, ++seed), right = filmed(one, true, ++seed);
      std::vector<LightCamera> cameras{left.experiment().cameras().front(), right.experiment().cameras().front()};
      cameras[0].optics.camera = "left", cameras[1].optics.camera = "right";
      cameras[1].face = 1;  // each correlated for itself
      LightExperiment experiment(std::move(cameras), numbers, {2, 5});
      const Report report = close_loop(experiment, quick());
      const std::string whose = both ? "" : "right ";
      const auto [size, deviation] = found(experiment, report, (both ? "" : "right_") + std::string(one.quantity));
      std::cout << "[          ] " << whose << one.effect << ": " << name(report.verdict) << ", " << report.sentence
                << '\n';
      EXPECT_TRUE(has(experiment, report.set, whose + one.effect)) << one.effect;
      EXPECT_FALSE(has(experiment, report.set, "left " + std::string(one.effect))) << one.effect;
      EXPECT_EQ(has(experiment, report.set, one.effect), both) << one.effect;
      EXPECT_NEAR(size, one.size, 4.0 * deviation) << one.effect;
    }
}

/// Two cameras on one face, correlated together; the light of the right one fades.
struct FadingRight {
  static constexpr double fade = -0.06;
  Filmed left{5300},
      right{5301, [](double grey, int t, const auto&, const auto&) { return grey * (1.0 + fade * t / count); },
            [](int) { return noise; }, elsewhere()};

  static const Clean& elsewhere() {
    static const Clean one(motion, 1.7, 9);
    return one;
  }
  [[nodiscard]] LightExperiment experiment(const std::vector<DeclaredEffect>& declared = {}, bool brightness = false,
                                           bool local_brightness = false) const {
    const std::vector<correlation::View> views{{.camera = left.camera, .reference = left.images.front()},
                                               {.camera = right.camera, .reference = right.images.front()}};
    const GlobalDic dic(
        left.quads, views, 2,
        {.low_pass = 1.0, .border = 3.0, .brightness = brightness, .local_brightness = local_brightness});
    const auto image = [&](int t, int camera) {
      return (camera == 0 ? left : right).images[static_cast<std::size_t>(t) + 1];
    };
    const auto frames = dic.run(alone, count, image);
    Scene scene;
    scene.surface = &left.quads;
    measure(scene, left.quads);
    scene.time = Eigen::VectorXd::LinSpaced(count, 1.0, count), scene.force = Eigen::VectorXd::Ones(count);
    std::vector<LightCamera> cameras;
    for (const auto& statistics :
         LightStatistics::of_face(dic, views, 1, {left.image_noise(), right.image_noise()}, scene)) {
      const int camera = static_cast<int>(cameras.size());
      cameras.push_back({statistics.optics(), scene, {}});
      cameras.back().optics.camera = camera == 0 ? "left" : "right";
      for (int t = 0; t < count; ++t)
        cameras.back().frames.push_back(
            statistics.frame(image(t, camera), frames[static_cast<std::size_t>(t)].displacement));
    }
    std::vector<int> numbers;
    for (int t = 1; t <= count; ++t) numbers.push_back(t);
    return {std::move(cameras), numbers, {2, 5}, declared};
  }
};

/// What the correlation of both takes for motion of the light of one is in the images of the other, too.
TEST(Light, OfOneCameraIsPassedOnToTheOtherAsMotion) {
  auto experiment = FadingRight().experiment();
  const Report report = close_loop(experiment, quick());
  const auto [size, deviation] = found(experiment, report, "right_gain_drift");
  std::cout << "[          ] " << name(report.verdict) << ", " << report.sentence << '\n';
  EXPECT_EQ(report.verdict, Verdict::attributed);
  EXPECT_TRUE(has(experiment, report.set, "right light gain"));
  EXPECT_NEAR(size, FadingRight::fade, 4.0 * deviation);
}

/// Nothing is missing where it is declared, whether the correlation fits a gain, of each frame or element, or not.
TEST(Light, OfOneCameraIsDeclared) {
  const std::vector<DeclaredEffect> declared{
      {.effect = "right_light_gain", .quantity = "gain_drift", .value = FadingRight::fade, .lower = {}, .upper = {}}};
  for (const auto& [brightness, local] : {std::pair{false, false}, std::pair{true, false}, std::pair{false, true}}) {
    auto experiment = FadingRight().experiment(declared, brightness, local);
    const Report report = close_loop(experiment, quick());
    std::cout << "[          ] "
              << (local        ? "fitted element by element: "
                  : brightness ? "fitted: "
                               : "")
              << name(report.verdict) << ", " << report.sentence << '\n';
    EXPECT_EQ(report.verdict, Verdict::nothing_found);
  }
}

TEST(Light, TheNoiseOfEachFrameIsMeasured) {
  const auto planted = [](int t) { return t == 3 ? 2.5 : t == 6 ? 0.5 : 1.0; };
  Filmed test(5100, as_it_is, [&](int t) { return noise * planted(t); });
  const Eigen::MatrixXd found = test.experiment().frame_noise();
  ASSERT_EQ(found.cols(), count);
  for (int t = 0; t < count; ++t) EXPECT_NEAR(found(0, t), planted(t + 1), 0.05 * planted(t + 1)) << "frame " << t + 1;
}

/// Blobs of so many pixels, integrated over whole pixels: what is beyond half a wave per pixel is not planted by the
/// effect's formula. Taken for noise, it doubles it.
TEST(Light, FineSpeckleIsAliased) {
  double before = 1.0;
  for (const double radius : {0.5, 0.8, 1.0}) {
    const Clean fine(motion, radius);
    Filmed test(
        6500, as_it_is, [](int) { return noise; }, fine);
    auto experiment = test.experiment({.low_pass = 0.0, .border = 3.0});
    const Report report = close_loop(experiment, quick());
    const auto [size, deviation] = found(experiment, report, "aliased");
    std::cout << "[          ] blobs of " << radius << " px: " << name(report.verdict) << ", " << report.sentence
              << '\n';
    EXPECT_EQ(report.verdict, Verdict::attributed);
    EXPECT_TRUE(has(experiment, report.set, "aliasing"));
    EXPECT_GT(size, 5.0 * deviation);
    EXPECT_LT(size, 0.5 * before);
    EXPECT_NEAR(found(experiment, report, "noise").first, std::sqrt(noise * noise + 1.0 / 12.0), 0.15);
    before = size;
  }
}

/// Where each element's gain is the correlation's, the squares alone are left, and nothing tells the contrast.
TEST(Light, FineSpeckleIsAliasedUnderLocalBrightnessToo) {
  const Clean fine(motion, 0.8);
  Filmed test(
      6500, as_it_is, [](int) { return noise; }, fine);
  auto experiment = test.experiment({.low_pass = 0.0, .border = 3.0, .local_brightness = true});
  const Report report = close_loop(experiment, quick());
  std::cout << "[          ] " << report.sentence << '\n';
  EXPECT_EQ(report.verdict, Verdict::attributed);
  EXPECT_TRUE(has(experiment, report.set, "aliasing"));
  const auto [size, deviation] = found(experiment, report, "aliased");
  EXPECT_NEAR(size, 0.002, 0.0003);  // as with its gain known
  EXPECT_TRUE(std::isnan(found(experiment, report, "contrast_lost").first));
}

/// Of a wave of k per pixel cubic splines take 1 - h, and h is that of k - 1: h = sinc(k - 1)^4 / (sinc(k - 1)^4 +
/// sinc(k)^4 + ...).
TEST(Light, WavesThatSplinesLoseHaveTheirShare) {
  const auto sinc4 = [](double x) { return std::pow(std::sin(M_PI * x) / (M_PI * x), 4); };
  for (const auto& [k, amplitude] : {std::pair{0.65, 2.5}, std::pair{0.45, 8.0}}) {
    const auto wave = [k = k, amplitude = amplitude](double x) {
      return amplitude * std::cos(2.0 * M_PI * k * x + 0.4);
    };
    Filmed test(6600, [&](double grey, int, const auto&, const auto& at) { return grey + wave(at[0]) + wave(at[1]); });
    auto experiment = test.experiment({.low_pass = 0.0, .border = 3.0});
    const Report report = close_loop(experiment, quick());
    std::cout << "[          ] " << k << " per pixel: " << report.sentence << '\n';
    EXPECT_EQ(report.verdict, Verdict::attributed);
    const double h = sinc4(k - 1.0) / (sinc4(k - 2.0) + sinc4(k - 1.0) + sinc4(k) + sinc4(k + 1.0));
    const double planted = h * h * amplitude * amplitude / experiment.cameras().front().optics.variance.mean();
    const auto [share, deviation] = found(experiment, report, "aliased");
    EXPECT_NEAR(share, planted, std::min(3.0 * deviation, 0.1 * planted));
    const auto [lost, its_deviation] = found(experiment, report, "contrast_lost");
    EXPECT_NEAR(lost, 1.0 / h, std::min(3.0 * its_deviation, 0.5));
  }
}

/// Little noise tells a gain of 1e-4, which need not be the lamp's.
TEST(Light, NoLightIsSteadyToATenThousandth) {
  for (const double drift : {0.0, 2e-4, 4e-3}) {
    Filmed test(
        6050, [&](double grey, int t, const auto&, const auto&) { return (1.0 + drift * t / count) * grey; },
        [](int) { return 0.5; });
    test.known_noise = 0.5;
    auto experiment = test.experiment();
    const Report report = close_loop(experiment, quick());
    std::cout << "[          ] " << drift << ": " << report.sentence << '\n';
    EXPECT_EQ(has(experiment, report.set, "light gain"), drift > 1e-3);
    EXPECT_EQ(report.verdict, drift > 1e-3 ? Verdict::attributed : Verdict::nothing_found);
  }
}

/// The camera's largest level need not be that of the file.
TEST(Light, SaturationIsNamedWithItsShare) {
  for (const auto& [gain, largest] : {std::pair{1.45, 255.0F}, std::pair{1.0, 170.0F}}) {
    Filmed test(6000, [gain = gain](double grey, int, const auto&, const auto&) { return gain * grey; });
    for (Image& image : test.images)
      for (float& grey : image.grey) grey = std::min(grey, largest);
    auto experiment = test.experiment();
    const Report report = close_loop(experiment, quick());
    std::cout << "[          ] " << name(report.verdict) << ": " << report.sentence << '\n';
    EXPECT_TRUE(has(experiment, report.set, "saturation"));
    EXPECT_FALSE(has(experiment, report.set, "aliasing"));
    double share = 0.0, pixels = 0.0;  // of the reference, within the mesh
    for (int y = 23; y < 217; ++y)
      for (int x = 23; x < 177; ++x) share += test.images.front()(x, y) >= largest ? 1.0 : 0.0, pixels += 1.0;
    const auto [size, deviation] = found(experiment, report, "saturated");
    EXPECT_GT(share / pixels, 0.01);
    EXPECT_NEAR(size, share / pixels, std::max(3.0 * deviation, 0.05 * share / pixels));
  }
}

TEST(Light, DebondingIsNamedWithItsPlaceAndOnset) {
  const Eigen::Vector2d centre(95.0, 88.0);
  constexpr double radius = 9.0;
  constexpr int from = 4;
  Filmed test(7000, [&](double grey, int t, const Eigen::Vector2d& pixel, const Eigen::Vector2d& at) {
    return t >= from && (at - centre).norm() < radius ? 120.0 + 70.0 * clean().other.texture(pixel) : grey;
  });
  auto experiment = test.experiment();
  const Report report = close_loop(experiment, quick());
  std::cout << "[          ] " << name(report.verdict) << ": " << report.sentence << '\n';
  EXPECT_TRUE(has(experiment, report.named, "speckle debonding") || has(experiment, report.set, "speckle debonding"));
  const auto& scene = experiment.cameras().front().scene;
  const Places places(scene);
  const auto loose = [&](int k) { return found(experiment, report, "loose_" + std::to_string(k + 1)).first; };
  int largest = 0;
  for (int k = 0; k < places.count(); ++k)
    if (loose(k) > loose(largest)) largest = k;
  EXPECT_EQ(largest, places.of(centre / scale));
  const double area = M_PI * radius * radius / (scale * scale), place = places.size[0] * places.size[1];
  std::cout << "[          ] loose " << loose(largest) << " of its place, the patch is " << area / place << "\n";
  // Beyond its edge the correlation is led astray: up to an element around it.
  EXPECT_GT(loose(largest), 0.3 * area / place);
  EXPECT_LT(loose(largest), 3.0 * area / place);
  for (const auto& p : experiment.parameters())
    if (p.info.name == "onset") {
      EXPECT_NEAR(p.value, (from - 0.5) / count, 1e-9);
    }
}

/// With the brightness fitted by the correlation, a drift of the light is no data any more, whatever its course.
TEST(Light, WhatTheCorrelationHasFittedIsNoData) {
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  std::vector<double> gain(count + 1, 1.0), offset(count + 1, 0.0);
  for (int t = 1; t <= count; ++t)
    gain[static_cast<std::size_t>(t)] += 0.02 * normal(random),
        offset[static_cast<std::size_t>(t)] += 2.0 * normal(random);
  Filmed test(8000, [&](double grey, int t, const auto&, const auto&) {
    return gain[static_cast<std::size_t>(t)] * grey + offset[static_cast<std::size_t>(t)];
  });
  auto flickering = test.experiment();
  EXPECT_GT(flickering.share_of_gain_and_offset(), 0.95);
  EXPECT_NE(close_loop(flickering, quick()).verdict, Verdict::nothing_found);
  for (const bool local : {false, true}) {
    auto fitted = test.experiment({.low_pass = 1.0, .border = 3.0, .brightness = true, .local_brightness = local});
    EXPECT_EQ(fitted.share_of_gain_and_offset(), 0.0);
    const Report report = close_loop(fitted, quick());
    std::cout << "[          ] " << report.sentence << '\n';
    EXPECT_EQ(report.verdict, Verdict::nothing_found);
  }
}

/// What the mesh cannot follow is no light: learned on images that are made of the reference, it raises no alarm.
TEST(Light, WhatTheMeshCannotFollowIsLearned) {
  const Clean wavy(waves);
  int alarms = 0;
  for (unsigned k = 0; k < 5; ++k) {
    Filmed test(
        8500 + k, as_it_is, [](int) { return noise; }, wavy);
    auto plain = test.experiment();
    EXPECT_NE(close_loop(plain, quick()).verdict, Verdict::nothing_found);
    const imaging::BSpline reference(test.images.front());
    const auto synthetic = [&](int t) {
      Image image(width, height);
      const auto way = waves(t + 1);
      for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
          const Eigen::Vector2d at = made::inverted(way, {x, y}, {x, y});
          image(x, y) = reference.value(at.x(), at.y());
        }
      return image;
    };
    auto experiment = test.experiment({.low_pass = 1.0, .border = 3.0}, {}, synthetic);
    const Report report = close_loop(experiment, quick());
    std::cout << "[          ] " << report.sentence << '\n';
    if (report.verdict != Verdict::nothing_found) ++alarms;
    // Nor is it noise: of the last frame, where the waves are largest.
    EXPECT_GT(plain.frame_noise()(0, count - 1), 1.15);
    EXPECT_NEAR(experiment.frame_noise()(0, count - 1), 1.0, 0.1);  // to which the level is known
  }
  EXPECT_LE(alarms, 1);
}

/// A known size is in the prediction.
TEST(Light, ADeclaredSizeIsNoCandidate) {
  Filmed test(9000);
  const auto experiment = test.experiment(
      {.low_pass = 1.0}, {{.effect = "light_gain", .quantity = "gain_drift", .value = 0.01, .lower = {}, .upper = {}}});
  for (const auto& one : experiment.candidates()) EXPECT_NE(one.name, "light gain");
  EXPECT_THROW((void)test.experiment(
                   {.low_pass = 1.0},
                   {{.effect = "light_gain", .quantity = "gain_drift", .value = 5.0, .lower = {}, .upper = {}}}),
               InputError);
}

}  // namespace test_light
}  // namespace imic3d::loop
