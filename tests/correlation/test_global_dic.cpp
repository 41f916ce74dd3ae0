#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <map>

#include "imic3d/correlation/covariance.hpp"
#include "imic3d/correlation/global_dic.hpp"
#include "imic3d/correlation/lost_places.hpp"
#include "imic3d/correlation/smoothing.hpp"
#include "speckle.hpp"

namespace imic3d::correlation {
namespace test_global_dic {

using namespace test;
using imaging::BSpline;
using imaging::Image;

const Communicator alone{MPI_COMM_SELF};

/// Errors of the nodes' displacement [px]: root mean square and largest.
struct Miss {
  double rms, largest;
};
Miss miss(const Eigen::VectorXd& U, const mesh::Mesh& quads, const imaging::TelecentricCamera& eye,
          const Motion& motion) {
  const Eigen::VectorXd error = U - nodal(quads, eye, motion);
  const double scale = std::sqrt(std::abs(eye.linear.leftCols<2>().determinant()));
  return {scale * error.norm() / std::sqrt(static_cast<double>(error.size())), scale * error.cwiseAbs().maxCoeff()};
}

struct Scene {
  int width, height;
  Speckle speckle{width, height};
  Image reference = photograph(speckle, width, height);
};

const Scene& scene() {
  static const Scene made{180, 160};
  return made;
}

class KnownMotion : public ::testing::TestWithParam<std::pair<const char*, Motion>> {};

TEST_P(KnownMotion, IsMeasuredToThousandthsOfAPixel) {
  const auto eye = camera(20.0, 10.0, 150.0, true, 0.02);
  const mesh::Mesh quads = rectangle(0.8, 0.8, 7.2, 6.0, 8, 7);
  const auto& [name, motion] = GetParam();
  // As the paper has it, and as a case file has it if it does not say otherwise.
  for (const auto& options : {DicOptions{}, DicOptions{.low_pass = 1.0, .border = 3.0}}) {
    const GlobalDic dic(quads, *eye, scene().reference, options, "mesh");
    const std::vector<DicFrame> frames =
        dic.run(alone, 1, [&](int) { return photograph(scene().speckle, 180, 160, motion); });
    const Miss error = miss(frames[0].displacement, quads, *eye, motion);
    EXPECT_TRUE(frames[0].converged);
    EXPECT_FALSE(frames[0].lost);
    EXPECT_LT(error.rms, 0.003) << name;
    std::cout << "[          ] " << name << (options.low_pass > 0.0 ? ", smoothed" : "") << ": rms error " << error.rms
              << " px, largest " << error.largest << " px, " << frames[0].iterations << " iterations, rms residual "
              << frames[0].rms << " of 65535\n";
  }
}

INSTANTIATE_TEST_SUITE_P(Dic, KnownMotion,
                         ::testing::Values(std::pair<const char*, Motion>{"nothing", at_rest},
                                           std::pair<const char*, Motion>{
                                               "shift of 0.25 px",
                                               [](const Eigen::Vector2d&) { return Eigen::Vector2d(0.25, -0.1); }},
                                           std::pair<const char*, Motion>{
                                               "shift of 0.5 px",
                                               [](const Eigen::Vector2d&) { return Eigen::Vector2d(0.5, 0.5); }},
                                           std::pair<const char*, Motion>{
                                               "shift of 7.3 px",
                                               [](const Eigen::Vector2d&) { return Eigen::Vector2d(-3.7, 7.3); }},
                                           std::pair<const char*, Motion>{"1 % stretch",
                                                                          [](const Eigen::Vector2d& x) {
                                                                            return Eigen::Vector2d(0.01 * x.x() - 0.7,
                                                                                                   -0.003 * x.y());
                                                                          }},
                                           std::pair<const char*, Motion>{"rotation of 3 degrees",
                                                                          [](const Eigen::Vector2d& x) {
                                                                            const double c = std::cos(0.0524) - 1.0,
                                                                                         s = std::sin(0.0524);
                                                                            const Eigen::Vector2d r =
                                                                                x - Eigen::Vector2d(90, 80);
                                                                            return Eigen::Vector2d(
                                                                                c * r.x() - s * r.y(),
                                                                                s * r.x() + c * r.y());
                                                                          }},
                                           std::pair<const char*, Motion>{
                                               "quadratic field", [](const Eigen::Vector2d& x) {
                                                 const Eigen::Vector2d r = x - Eigen::Vector2d(90, 80);
                                                 return Eigen::Vector2d(4e-5 * r.x() * r.x() + 3e-5 * r.x() * r.y(),
                                                                        -4e-5 * r.y() * r.y());
                                               }}));

/// A row of elements of 3.5 px along one edge, of which a border of 3 px leaves hardly a pixel: its outer nodes
/// continue their neighbours.
TEST(GlobalDic, NodesWithoutPixelsOfTheirOwnContinueTheirNeighbours) {
  const Motion motion = [](const Eigen::Vector2d& x) {
    return Eigen::Vector2d(0.4 + 0.004 * x.x(), 0.003 * x.y() - 0.2);
  };
  mesh::Mesh quads = rectangle(20, 20, 140, 140, 10, 10);
  for (int i = 0; i < 11; ++i) quads.nodes(i, 1) = 32.0 - 3.5;  // the first row of nodes
  ASSERT_EQ(quads.nodes.col(1).minCoeff(), 28.5);
  std::mt19937 generator(7);
  Image f = scene().reference;
  add_noise(f, 0.01 * 65535, generator);
  const GlobalDic dic(quads, *camera(), f, {.low_pass = 1.0, .border = 3.0}, "mesh");
  for (int draw = 0; draw < 5; ++draw) {
    Image g = photograph(scene().speckle, 180, 160, motion);
    add_noise(g, 0.01 * 65535, generator);
    const DicFrame frame = dic.run(alone, 1, [&](int) { return g; })[0];
    EXPECT_TRUE(frame.converged);
    EXPECT_LE(frame.iterations, 6);
    EXPECT_LT(miss(frame.displacement, quads, *camera(), motion).largest, 0.5);  // well inside a speckle
  }
}

/// Regularisation moves nodes that no pixel tells of; what the pixels tell of the ends is smoothed, and drawn, without
/// it.
TEST(GlobalDic, PixelsAloneMeasureWithRegularisationToo) {
  mesh::Mesh quads = rectangle(20, 20, 140, 140, 10, 10);
  for (int i = 0; i < 11; ++i) quads.nodes(i, 1) = 32.0 - 2.5;  // a border of 3 px leaves this row nothing
  const Image f = scene().reference;
  for (const double regularisation : {0.0, 30.0}) {
    DicOptions options{.low_pass = 1.0, .border = 3.0};
    options.regularisation = regularisation;
    const GlobalDic dic(quads, *camera(), f, options, "mesh");
    const Measure measure = measured_by(dic.cameras(), dic.held());
    const Eigen::MatrixXd noise = noise_draws(measure, 0.01 * 65535, 50);
    EXPECT_LT(noise.cwiseAbs().maxCoeff(), 3.0) << regularisation;  // [px]
    const auto cut_offs =
        cut_offs_of_least_error(measure, noise, {0, 1, 2, 60}, Eigen::VectorXd::Constant(50, 0.01 * 65535), 60.0);
    EXPECT_EQ(cut_offs.size(), 50U) << regularisation;
  }
}

/// Measured over predicted standard deviation of the displacement over 100 draws.
void noise_is_the_one_predicted(double low_pass) {
  const Speckle speckle(110, 110, 1.7, 5);
  const Motion motion = [](const Eigen::Vector2d& x) { return Eigen::Vector2d(0.3 + 0.002 * x.x(), -0.2); };
  const Image f = photograph(speckle, 110, 110), g = photograph(speckle, 110, 110, motion);
  const mesh::Mesh quads = rectangle(14, 14, 94, 94, 4, 4);
  constexpr int draws = 100;
  std::mt19937 generator(11);
  for (const double part : {0.01, 0.035}) {  // of the dynamic; the latter is a fifth of the contrast
    const double sigma = part * 65535;
    Eigen::MatrixXd measured(50, draws);
    Eigen::VectorXd predicted = Eigen::VectorXd::Zero(50);
    for (int draw = 0; draw < draws; ++draw) {
      Image noisy_f = f, noisy_g = g;
      add_noise(noisy_f, sigma, generator);
      add_noise(noisy_g, sigma, generator);
      const GlobalDic dic(quads, *camera(), noisy_f, {.pyramid_levels = 0, .low_pass = low_pass}, "mesh");
      const DicFrame frame = dic.correlate(noisy_g, nodal(quads, *camera(), motion), 0, 0, alone);
      EXPECT_TRUE(frame.converged);
      measured.col(draw) = frame.displacement;
      predicted += dic.standard_deviation(sigma, 1) / draws;
    }
    const Eigen::MatrixXd centred = measured.colwise() - measured.rowwise().mean();
    const double deviation = std::sqrt(centred.squaredNorm() / (50.0 * (draws - 1)));
    const double expected = std::sqrt(predicted.squaredNorm() / 50.0);
    std::cout << "[          ] noise of " << 100 * part << " % of the dynamic: measured " << deviation
              << " px, predicted " << expected << " px, ratio " << deviation / expected << '\n';
    EXPECT_NEAR(deviation / expected, 1.0, 0.1);
  }
}

TEST(GlobalDic, NoiseOfTheDisplacementIsTheOnePredicted) { noise_is_the_one_predicted(0.0); }
TEST(GlobalDic, NoiseOfTheDisplacementIsTheOnePredictedWithSmoothedImages) { noise_is_the_one_predicted(1.0); }

/// Twelve by twelve elements of ten pixels under noise, and the nodes of two of the edges.
struct Smoothed {
  Speckle speckle{150, 150, 1.7, 5};
  mesh::Mesh quads = rectangle(15, 15, 135, 135, 12, 12);
  Cameras correlation{
      {std::make_shared<Correlation>(quads, camera(), imaging::BSpline(photograph(speckle, 150, 150)))}};
  Measure measure = measured_by(correlation);
  double sigma = 0.02 * 65535;
  std::vector<int> nodes;
  Smoothed() {
    for (int i = 0; i <= 12; ++i) nodes.push_back(i), nodes.push_back(12 * 13 + i);
  }
  [[nodiscard]] Eigen::VectorXd field(const std::function<Eigen::Vector2d(const Eigen::Vector2d&)>& u) const {
    return nodal(quads, *camera(), u);
  }
  /// At the nodes, but for one.
  [[nodiscard]] double square_error(const Eigen::MatrixXd& U, const Eigen::VectorXd& truth, int but_for = -1) const {
    double sum = 0.0;
    for (int node : nodes)
      if (node != but_for) sum += (U.middleRows(2 * node, 2).colwise() - truth.segment<2>(2 * node)).squaredNorm();
    return sum;
  }
  [[nodiscard]] std::vector<double> cut_offs(const Eigen::MatrixXd& measured, double longest) const {
    return cut_offs_of_least_error(measure, measured, nodes, Eigen::VectorXd::Constant(measured.cols(), sigma),
                                   longest);
  }
  /// Errors with the cut-offs that are chosen for every frame over those with the best one for all frames.
  [[nodiscard]] double over_the_least_error(const Eigen::MatrixXd& noise, const Eigen::VectorXd& truth,
                                            double* cut_off_of_least_error, int but_for = -1) const {
    constexpr double longest = 60.0;
    const Eigen::MatrixXd measured = noise.colwise() + truth;
    double least = square_error(measured, truth, but_for);
    *cut_off_of_least_error = 0.0;
    for (double cut_off = longest; cut_off > 3.7; cut_off /= std::sqrt(2.0))
      if (const double error = square_error(smooth(measure, measured, cut_off), truth, but_for); error < least)
        least = error, *cut_off_of_least_error = cut_off;
    return square_error(smooth(measure, measured, cut_offs(measured, longest)), truth, but_for) / least;
  }
};

/// The truth, which would tell the best cut-off, is not known to it.
TEST(Smoothing, CutOffsAreThoseOfLeastError) {
  const Smoothed test;
  const Eigen::MatrixXd noise = noise_draws(test.measure, test.sigma, 100);
  const struct {
    const char* name;
    Eigen::VectorXd field;
    double most;
  } fields[] = {
      {"straight", test.field([](const Eigen::Vector2d& x) { return Eigen::Vector2d(0.01 * x.x(), 0.0); }), 60.0},
      {"slightly curved",
       test.field([](const Eigen::Vector2d& x) { return Eigen::Vector2d(0.0, 0.6 * std::sin(0.08 * x.x())); }), 59.0},
      {"curved",
       test.field([](const Eigen::Vector2d& x) { return Eigen::Vector2d(0.0, 0.5 * std::sin(0.16 * x.x())); }), 25.0}};
  for (const auto& [name, field, most] : fields) {
    double best = 0.0;
    const double ratio = test.over_the_least_error(noise, field, &best);
    std::cout << "[          ] " << name << ": error " << ratio << " of that with the best cut-off, " << best << '\n';
    EXPECT_LT(ratio, 1.1) << name;
    EXPECT_LE(best, most) << name;
  }
  EXPECT_LT(
      test.square_error(smooth(test.measure, noise, test.cut_offs(noise, 60.0)), Eigen::VectorXd::Zero(noise.rows())),
      0.3 * test.square_error(noise, Eigen::VectorXd::Zero(noise.rows())));
}

/// What smoothing bends of a curve falls by more than the noise that it leaves grows.
TEST(Smoothing, AStepShorterBendsHalfAsMuch) {
  const Smoothed test;
  const Eigen::VectorXd curved = test.field(
                            [](const Eigen::Vector2d&x) { return Eigen::Vector2d(0.0, 0.5 * std::sin(0.16 * x.x())); }),
                        zero = Eigen::VectorXd::Zero(curved.size());
  const Eigen::MatrixXd noise = noise_draws(test.measure, test.sigma, 100);
  const auto least = test.cut_offs(noise.colwise() + curved, 60.0), shorter = undersmoothed(least, 60.0);
  const auto bent = [&](const std::vector<double>& cut_offs) {
    return test.square_error(smooth(test.measure, curved.replicate(1, 100), cut_offs), curved);
  };
  const auto left = [&](const std::vector<double>& cut_offs) {
    return test.square_error(smooth(test.measure, noise, cut_offs), zero);
  };
  std::cout << "[          ] bent " << std::sqrt(bent(least) / bent(shorter)) << " times less, noise "
            << std::sqrt(left(shorter) / left(least)) << " times as large, bent over noise "
            << std::sqrt(bent(least) / left(least)) << " -> " << std::sqrt(bent(shorter) / left(shorter)) << '\n';
  EXPECT_LT(bent(shorter), 0.25 * bent(least));
  EXPECT_LT(left(shorter), 2.0 * left(least));
  EXPECT_EQ(undersmoothed({60.0, 30.0, 0.0}, 60.0), (std::vector<double>{60.0, 30.0 / std::sqrt(2.0), 0.0}));
}

/// Waves longer than the mesh: of a uniform strain little noise is left, and a curve is not bent by more.
TEST(Smoothing, WavesLongerThanTheEndsLeaveAnAffineMotion) {
  const Smoothed test;
  const Eigen::MatrixXd noise = noise_draws(test.measure, test.sigma, 100);
  const auto error = [&](const Eigen::VectorXd& field, double longest) {
    return std::sqrt(test.square_error(
        smooth(test.measure, noise.colwise() + field, test.cut_offs(noise.colwise() + field, longest)), field));
  };
  const Eigen::VectorXd strained =
      test.field([](const Eigen::Vector2d& x) { return Eigen::Vector2d(0.01 * x.x(), 0.03 * x.y()); });
  const Eigen::VectorXd curved =
      test.field([](const Eigen::Vector2d& x) { return Eigen::Vector2d(0.0, 0.5 * std::sin(0.16 * x.x())); });
  const double straight = error(strained, 480.0) / error(strained, 60.0),
               bent = error(curved, 480.0) / error(curved, 60.0);
  std::cout
      << "[          ] waves up to four times the mesh's width, in place of half of it: error of a uniform strain "
      << straight << ", of a curve " << bent << '\n';
  EXPECT_LT(straight, 0.7);
  EXPECT_LT(bent, 1.02);
}

/// Frames of unequal noise, such as one out of focus: each has the cut-off that its own asks for.
TEST(Smoothing, EachFrameIsJudgedByItsOwnNoise) {
  const Smoothed test;
  const Eigen::VectorXd curved =
      test.field([](const Eigen::Vector2d& x) { return Eigen::Vector2d(0.0, 0.5 * std::sin(0.16 * x.x())); });
  constexpr int half = 20;
  const double sizes[] = {1.0, 8.0};
  Eigen::MatrixXd measured = noise_draws(test.measure, test.sigma, 2 * half);
  Eigen::VectorXd sigma(2 * half);
  for (int k = 0; k < 2; ++k)
    measured.middleCols(half * k, half) *= sizes[k], sigma.segment(half * k, half).setConstant(sizes[k] * test.sigma);
  measured.colwise() += curved;
  const auto chosen = cut_offs_of_least_error(test.measure, measured, test.nodes, sigma, 60.0);
  for (int k = 0; k < 2; ++k) {
    const auto by_itself = cut_offs_of_least_error(test.measure, measured.middleCols(half * k, half), test.nodes,
                                                   sigma.segment(half * k, half), 60.0);
    for (int t = 2; t < half - 2; ++t)
      EXPECT_EQ(chosen[static_cast<std::size_t>(half * k + t)], by_itself[static_cast<std::size_t>(t)])
          << "frame " << half * k + t;
  }
  EXPECT_LT(chosen[half / 2], chosen[half + half / 2]);
}

/// A node of the ends that is hardly seen has most of the noise: it must not decide for the others.
TEST(Smoothing, ANodeThatIsHardlySeenDoesNotOutweighTheOthers) {
  Smoothed test;
  constexpr int hardly_seen = 6;
  Eigen::VectorXd seen = Eigen::VectorXd::Ones(test.measure.M.rows());
  seen.segment<2>(2 * hardly_seen).setConstant(0.05);
  test.measure.M = seen.asDiagonal() * test.measure.M * seen.asDiagonal();
  const Eigen::VectorXd curved =
      test.field([](const Eigen::Vector2d& x) { return Eigen::Vector2d(0.0, 0.5 * std::sin(0.16 * x.x())); });
  double best = 0.0;
  EXPECT_LT(test.over_the_least_error(noise_draws(test.measure, test.sigma, 100), curved, &best, hardly_seen), 1.1);
}

/// Of a wave at the cut-off, of which least squares leave half, three quarters are left; of one of half that length
/// nearly nothing, of one of twice that length nearly all.
TEST(Smoothing, LeavesThreeQuartersOfAWaveAtTheCutOff) {
  const Speckle speckle(510, 510, 1.7, 5);
  const mesh::Mesh quads = rectangle(15, 15, 495, 495, 48, 48);
  const Cameras correlation(
      {std::make_shared<Correlation>(quads, camera(), imaging::BSpline(photograph(speckle, 510, 510)))});
  const Measure measure = measured_by(correlation);
  for (const auto& [part, expected] : {std::pair(1.0, 0.75), std::pair(0.5, 1.0 - std::pow(16.0 / 17.0, 2)),
                                       std::pair(2.0, 1.0 - std::pow(1.0 / 17.0, 2))}) {
    const double wave = 80.0;
    const Eigen::VectorXd U = nodal(quads, *camera(), [&](const Eigen::Vector2d& x) {
      return Eigen::Vector2d(0.0, std::sin(2.0 * M_PI * x.x() / wave));
    });
    const Eigen::VectorXd left = smooth(measure, U, wave / part);
    double with = 0.0, of = 0.0;  // away from the edges
    for (Eigen::Index i = 0; i < quads.nodes.rows(); ++i)
      if ((quads.nodes.row(i).head<2>().array() - 255.0).abs().maxCoeff() < 120.0)
        with += left[2 * i + 1] * U[2 * i + 1], of += U[2 * i + 1] * U[2 * i + 1];
    std::cout << "[          ] wave of " << part << " times the cut-off: " << with / of << " left, " << expected
              << " expected\n";
    EXPECT_NEAR(with / of, expected, 0.06);
  }
}

TEST(GlobalDic, FollowsAHundredPixelsAndFortyPercentStrain) {
  const Communicator world;
  constexpr int width = 400, height = 200, count = 10;
  const Speckle speckle(width, height, 1.7, 3);
  const Image reference = photograph(speckle, width, height);
  const mesh::Mesh quads = rectangle(30, 30, 190, 170, 8, 7);
  const auto motion = [](int frame) {
    return [s = (frame + 1.0) / count](const Eigen::Vector2d& x) {
      const double r = x.x() - 30.0, middle = x.y() - 100.0;
      return Eigen::Vector2d(100.0 * s + 0.4 * s * r, -0.15 * s * middle + 0.0002 * s * r * middle);
    };
  };
  const GlobalDic dic(quads, *camera(), reference, {}, "mesh");
  const std::vector<DicFrame> frames =
      dic.run(world, count, [&](int frame) { return photograph(speckle, width, height, motion(frame)); });
  for (int frame = 0; frame < count; ++frame) {
    const DicFrame& found = frames[static_cast<std::size_t>(frame)];
    const Miss error = miss(found.displacement, quads, *camera(), motion(frame));
    EXPECT_TRUE(found.converged && !found.lost) << frame;
    EXPECT_LT(error.rms, 0.02) << frame;
    if (world.is_root())
      std::cout << "[          ] frame " << frame << ": rms error " << error.rms << " px, " << found.iterations
                << " iterations\n";
  }
}

/// The low pass smooths the deformed image over lengths of the deformed specimen.
void large_strain_is_the_same_in_smoothed_images(double along, double across, double worse) {
  constexpr int width = 240, height = 200;
  const Speckle speckle(width, height, 1.7, 5);
  const Image reference = photograph(speckle, width, height);
  const mesh::Mesh quads = rectangle(50, 40, 190, 160, 14, 12);
  const Eigen::Matrix2d F = Eigen::Rotation2Dd(0.2).toRotationMatrix() * Eigen::Matrix2d{{along, 0.05}, {0.05, across}};
  const Eigen::Vector2d middle(120, 100);
  const Motion motion = [&](const Eigen::Vector2d& x) {
    return Eigen::Vector2d((F - Eigen::Matrix2d::Identity()) * (x - middle));
  };
  const Image deformed = photograph(speckle, width, height, motion);
  Eigen::VectorXd start = nodal(quads, *camera(), motion);
  std::map<double, std::pair<Miss, double>> found;  // of the low pass: error, residual in parts of the contrast
  for (const double low_pass : {0.0, 1.0}) {
    const GlobalDic dic(quads, *camera(), reference, {.low_pass = low_pass}, "mesh");
    const DicFrame frame = dic.correlate(deformed, start, 0, 0, alone);
    EXPECT_TRUE(frame.converged);
    const std::vector<float>& f = dic.correlation().quadrature().f;
    const Eigen::ArrayXf grey = Eigen::Map<const Eigen::ArrayXf>(f.data(), static_cast<Eigen::Index>(f.size()));
    found[low_pass] = {miss(frame.displacement, quads, *camera(), motion),
                       frame.rms / static_cast<double>(std::sqrt((grey - grey.mean()).square().mean()))};
    std::cout << "[          ] low pass " << low_pass << ": rms error " << found[low_pass].first.rms << " px, residual "
              << found[low_pass].second << " of the contrast\n";
  }
  EXPECT_LT(found[1.0].first.rms, worse * found[0.0].first.rms);
  EXPECT_LT(found[1.0].second, worse * found[0.0].second);
}

TEST(GlobalDic, LargeStrainIsTheSameInSmoothedImages) { large_strain_is_the_same_in_smoothed_images(1.18, 0.90, 1.5); }
TEST(GlobalDic, LargeCompressionIsFollowedInSmoothedImages) {
  large_strain_is_the_same_in_smoothed_images(1.15, 0.62, 5.0);
}

/// Where it reaches as far as half of an element, noise of an element's strain would drive the strain itself.
TEST(GlobalDic, AWideLowPassDoesNotFollowNoise) {
  constexpr int width = 200, height = 160;
  const Speckle speckle(width, height, 1.7, 5);
  const Motion motion = [](const Eigen::Vector2d& x) { return Eigen::Vector2d(0.3 + 0.06 * x.x(), -0.03 * x.y()); };
  std::mt19937 generator(3);
  Image reference = photograph(speckle, width, height), deformed = photograph(speckle, width, height, motion);
  add_noise(reference, 0.01 * 65535, generator), add_noise(deformed, 0.01 * 65535, generator);
  const mesh::Mesh quads = rectangle(20, 20, 170, 140, 18, 15);
  const GlobalDic dic(quads, *camera(), reference, {.low_pass = 2.0}, "mesh");
  const DicFrame frame = dic.correlate(deformed, nodal(quads, *camera(), motion), 0, 0, alone);
  EXPECT_TRUE(frame.converged);
  std::cout << "[          ] rms error " << miss(frame.displacement, quads, *camera(), motion).rms << " px, "
            << frame.iterations << " iterations\n";
  EXPECT_LE(frame.iterations, 7);
}

TEST(GlobalDic, FindsALargeJumpAndSaysWhatIsLost) {
  const Communicator world;
  constexpr int width = 300, height = 220;
  const Speckle speckle(width, height, 1.7, 9), other(width, height, 1.7, 10);
  const mesh::Mesh quads = rectangle(20, 20, 160, 140, 7, 6);
  const Motion jump = [](const Eigen::Vector2d& x) {
    return Eigen::Vector2d(95.0 + 0.03 * (x.x() - 90), 55.0 - 0.02 * (x.y() - 80));
  };
  const GlobalDic dic(quads, *camera(), photograph(speckle, width, height), {}, "mesh");
  const std::vector<DicFrame> frames = dic.run(world, 3, [&](int frame) {
    return frame == 1 ? photograph(other, width, height) : photograph(speckle, width, height, jump);
  });
  EXPECT_TRUE(frames[0].converged && !frames[0].lost);
  EXPECT_LT(miss(frames[0].displacement, quads, *camera(), jump).rms, 0.01);
  EXPECT_TRUE(frames[1].lost);
  EXPECT_FALSE(frames[2].lost);
  EXPECT_LT(miss(frames[2].displacement, quads, *camera(), jump).rms, 0.01);
}

TEST(GlobalDic, RanksAndGroupsDoNotChangeTheResult) {
  const Communicator world;
  const mesh::Mesh quads = rectangle(20, 20, 150, 140, 6, 5);
  const auto image = [&](int frame) {
    return photograph(scene().speckle, 180, 160, [frame](const Eigen::Vector2d& x) {
      return Eigen::Vector2d(0.6 * frame + 0.002 * frame * x.x(), 0.3 * frame);
    });
  };
  const GlobalDic dic(quads, *camera(), scene().reference, {}, "mesh");
  const std::vector<DicFrame> mine = dic.run(alone, 3, image), side_by_side = dic.run(world, 3, image);
  const GlobalDic one_group(quads, *camera(), scene().reference, {.groups = 1}, "mesh");
  const std::vector<DicFrame> together = one_group.run(world, 3, image);
  for (std::size_t frame = 0; frame < 3; ++frame) {
    const double size = std::max(1.0, mine[frame].displacement.norm());
    EXPECT_LT((mine[frame].displacement - side_by_side[frame].displacement).norm(), 1e-8 * size);
    EXPECT_LT((mine[frame].displacement - together[frame].displacement).norm(), 1e-8 * size);
    EXPECT_EQ(mine[frame].iterations, together[frame].iterations);
    EXPECT_NEAR(mine[frame].rms, together[frame].rms, 1e-8 * mine[frame].rms);
  }
}

/// Paint that comes off in two of four frames is left out, and then they converge: where no pixel tells, the motion
/// continues its neighbours'.
TEST(GlobalDic, PlacesWithoutTheReferencesSpeckleAreLeftOut) {
  const mesh::Mesh quads = rectangle(20, 20, 150, 140, 13, 12);
  const Speckle beneath(180, 160, 1.7, 9);
  const Eigen::Vector2d middle(70.0, 90.0);
  constexpr double radius = 13.0;
  const Motion motion = [](const Eigen::Vector2d& x) {
    return Eigen::Vector2d(0.8 + 0.003 * x.x(), -0.4 - 0.002 * x.y());
  };
  std::mt19937 generator(3);
  const auto photo = [&](bool loose, double noise) {
    Image g = photograph(scene().speckle, 180, 160, motion);
    const Image below = photograph(beneath, 180, 160);
    for (int y = 0; loose && y < 160; ++y)
      for (int x = 0; x < 180; ++x)
        if ((Eigen::Vector2d(x, y) - middle - motion(middle)).norm() < radius) g(x, y) = below(x, y);
    add_noise(g, noise * 65535, generator);
    return g;
  };
  Image f = scene().reference;
  add_noise(f, 0.01 * 65535, generator);
  const DicOptions options{.low_pass = 1.0, .border = 3.0};
  const GlobalDic dic(quads, *camera(), f, options, "mesh");
  const std::vector<Image> images = {photo(false, 0.01), photo(false, 0.01), photo(true, 0.01), photo(true, 0.01)};
  const auto of = [](const std::vector<Image>& series) {
    return [&series](int frame) { return series[static_cast<std::size_t>(frame)]; };
  };
  const auto before = dic.run(alone, 4, of(images));
  EXPECT_GT(before[3].rms, 3.0 * before[0].rms);
  DicOptions without = options;
  without.left_out = lost_elements(dic.cameras(), before);
  ASSERT_EQ(without.left_out.size(), 156U);
  int wrong = 0;
  for (Eigen::Index e = 0; e < 156; ++e) {
    double nearest = INFINITY, farthest = 0.0;
    for (int i = 0; i < 4; ++i) {
      const double distance = (quads.nodes.row(quads.cells(e, i)).head<2>().transpose() - middle).norm();
      nearest = std::min(nearest, distance), farthest = std::max(farthest, distance);
    }
    const bool left_out = without.left_out[static_cast<std::size_t>(e)] != 0;
    wrong += left_out ? nearest > radius + 28.3 : farthest < radius;  // neighbours of those on its edge at most
  }
  EXPECT_EQ(wrong, 0);
  const GlobalDic rest(quads, *camera(), f, without, "mesh");
  const auto after = rest.run(alone, 4, of(images));
  for (const DicFrame& frame : after) {
    EXPECT_TRUE(frame.converged);
    EXPECT_NEAR(frame.rms, after[0].rms, 0.05 * after[0].rms);
    double largest = 0.0;  // of the nodes in and around the place
    const Eigen::VectorXd error = frame.displacement - nodal(quads, *camera(), motion);
    for (Eigen::Index i = 0; i < quads.nodes.rows(); ++i)
      if ((quads.nodes.row(i).head<2>().transpose() - middle).norm() < radius + 20.0)
        largest = std::max(largest, error.segment<2>(2 * i).norm());
    std::cout << "[          ] around the place the motion is off by up to " << largest << " px\n";
    EXPECT_LT(largest, 0.13);
  }
  // Two frames of ten, as when a specimen breaks, are worth less than the place; a picture that is spoilt as a whole
  // tells of no place.
  std::vector<DicFrame> many(8, before[0]);
  many.insert(many.end(), 2, before[3]);
  EXPECT_TRUE(lost_elements(dic.cameras(), many).empty());
  const auto spoilt = dic.run(alone, 2, of({photo(false, 0.4), photo(false, 0.4)}));
  EXPECT_TRUE(lost_elements(dic.cameras(), spoilt).empty());
}

/// What tells of a lost place: more than the speckle's own contrast is left, in enough pixels, and not all over the
/// picture.
TEST(GlobalDic, APlaceIsLostByItsContrastItsPixelsAndItsSize) {
  mesh::Mesh quads = rectangle(20, 20, 140, 140, 10, 10);
  for (int i = 0; i < 11; ++i)
    quads.nodes(i, 1) = 32.0 - 4.2;  // a border of 3 px leaves the first row of elements few pixels
  const GlobalDic dic(quads, *camera(), scene().reference, {.low_pass = 1.0, .border = 3.0}, "mesh");
  const auto& q = dic.correlation().quadrature();
  const double contrast = std::sqrt(variance_of_elements(q)[55]);
  const auto lost = [&](const std::vector<int>& elements, double left) {
    Eigen::VectorXd rms = Eigen::VectorXd::Constant(100, 0.02 * contrast);
    for (const int e : elements) rms[e] = left * contrast;
    DicFrame frame;
    frame.cameras.push_back({.element_rms = rms});
    return lost_elements(dic.cameras(), std::vector<DicFrame>(4, frame));
  };
  ASSERT_GT(q.pixels_of(55), 100U);
  ASSERT_LT(q.pixels_of(5), 16U);
  ASSERT_GT(q.pixels_of(5), 0U);
  std::vector<char> one(100, 0);
  one[55] = 1;
  EXPECT_EQ(lost({55}, 2.0), one);
  EXPECT_TRUE(lost({55}, 0.5).empty()) << "25 times the median, but the speckle is there";
  EXPECT_TRUE(lost({5}, 2.0).empty()) << "a few pixels";
  std::vector<int> many;
  for (int e = 30; e < 60; ++e) many.push_back(e);
  EXPECT_TRUE(lost(many, 2.0).empty()) << "a picture that is spoilt";
}

TEST(GlobalDic, ASeriesIsTakenUpWhereItWasLeft) {
  const Communicator world;
  constexpr int count = 5;
  const mesh::Mesh quads = rectangle(20, 20, 150, 140, 6, 5);
  std::vector<int> read(count, 0);
  const auto image = [&](int frame) {
    ++read[static_cast<std::size_t>(frame)];
    return photograph(scene().speckle, 180, 160, [frame](const Eigen::Vector2d& x) {
      return Eigen::Vector2d(0.6 * frame + 0.002 * frame * x.x(), 0.3 * frame);
    });
  };
  const auto of = [&](const GlobalDic::Source& source) { return [&source](int frame, int) { return source(frame); }; };
  const GlobalDic::Source source = image;
  const GlobalDic dic(quads, *camera(), scene().reference, {.brightness = true}, "mesh");
  std::vector<DicSeries> kept;
  const auto whole = dic.run(world, count, GlobalDic::SourceOfAll(of(source)), {}, {},
                             [&](const DicSeries& known) { kept.push_back(known); });
  ASSERT_GE(kept.size(), 2U);
  EXPECT_LT(kept.front().starts.size(), static_cast<std::size_t>(count + 1));
  EXPECT_TRUE(kept.front().frames.empty());
  EXPECT_EQ(kept.back().frames.size(), static_cast<std::size_t>(count));
  for (const DicSeries& known : kept) {
    std::fill(read.begin(), read.end(), 0);
    std::vector<int> done;
    const auto again = dic.run(
        world, count, GlobalDic::SourceOfAll(of(source)), [&](int frame, const DicFrame&) { done.push_back(frame); },
        known);
    EXPECT_THAT(done, ::testing::ElementsAre(0, 1, 2, 3, 4));
    for (std::size_t frame = 0; frame < known.frames.size(); ++frame) EXPECT_EQ(read[frame], 0) << "is known";
    for (std::size_t frame = 0; frame < count; ++frame) {
      EXPECT_EQ(numbers_of(again[frame]).size(), numbers_of(whole[frame]).size());
      EXPECT_LT((numbers_of(again[frame]) - numbers_of(whole[frame])).norm(), 1e-9 * numbers_of(whole[frame]).norm());
    }
  }
}

TEST(GlobalDic, BrightnessThatChangesIsNotTakenForMotion) {
  const mesh::Mesh quads = rectangle(20, 20, 150, 140, 6, 5);
  const Motion motion = [](const Eigen::Vector2d& x) { return Eigen::Vector2d(0.4 + 0.003 * x.x(), 0.2); };
  const auto image = [&](int) {
    Image dark = photograph(scene().speckle, 180, 160, motion);
    for (float& g : dark.grey) g = 0.9F * g + 1500.0F;
    return dark;
  };
  const GlobalDic dic(quads, *camera(), scene().reference, {.brightness = true}, "mesh");
  const DicFrame frame = dic.run(alone, 1, image).front();
  EXPECT_LT(miss(frame.displacement, quads, *camera(), motion).rms, 0.003);
  EXPECT_NEAR(frame.gain, 1.0 / 0.9, 1e-3);
}

TEST(GlobalDic, NoiseIsNotTakenForBrightness) {
  const mesh::Mesh quads = rectangle(20, 20, 150, 140, 6, 5);
  std::mt19937 generator(2);
  Image f = scene().reference, g = f;
  add_noise(f, 0.06 * 65535, generator);
  add_noise(g, 0.06 * 65535, generator);
  const Eigen::VectorXd zero = Eigen::VectorXd::Zero(2 * quads.nodes.rows());
  const DicFrame fitted = GlobalDic(quads, *camera(), f, {.brightness = true}, "mesh").correlate(g, zero, 0, 0, alone);
  const DicFrame plain = GlobalDic(quads, *camera(), f, {}, "mesh").correlate(g, zero, 0, 0, alone);
  EXPECT_NEAR(fitted.gain, 1.0, 0.02);
  EXPECT_LT((fitted.displacement - plain.displacement).norm(), 0.1 * plain.displacement.norm());
}

TEST(GlobalDic, SmoothingLeavesUniformStrainAlone) {
  const mesh::Mesh quads = rectangle(20, 20, 150, 140, 6, 5);
  const Motion stretch = [](const Eigen::Vector2d& x) { return Eigen::Vector2d(0.05 * x.x() - 3.0, -0.02 * x.y()); };
  const GlobalDic dic(quads, *camera(), scene().reference, {.regularisation = 100.0}, "mesh");
  const DicFrame frame = dic.run(alone, 1, [&](int) { return photograph(scene().speckle, 180, 160, stretch); }).front();
  EXPECT_LT(miss(frame.displacement, quads, *camera(), stretch).rms, 0.003);
  // Smoothing halves the noise at least.
  const GlobalDic plain(quads, *camera(), scene().reference, {}, "mesh");
  EXPECT_LT(dic.standard_deviation(1.0, 1).norm(), 0.5 * plain.standard_deviation(1.0, 1).norm());
}

TEST(GlobalDic, MistakesAreExplained) {
  const mesh::Mesh quads = rectangle(20, 20, 150, 140, 6, 5);
  try {
    const GlobalDic dic(quads, *camera(), Image(180, 160, 8, 100.0F), {}, "camera.place");
    FAIL();
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(), ::testing::HasSubstr("too little speckle"));
  }
  const GlobalDic dic(quads, *camera(), scene().reference, {}, "camera.place");
  EXPECT_THROW((void)dic.run(Communicator{}, 1, [](int) { return Image(100, 100); }), InputError);
  EXPECT_THROW((void)dic.run(Communicator{}, {"absent.tif"}), InputError);
}

TEST(Smoothing, AffineMotionIsFreeAndAWaveCostsItsCurvature) {
  mesh::Mesh quads = rectangle(0, 0, 8, 6, 40, 30);
  for (Eigen::Index n = 0; n < quads.nodes.rows(); ++n) quads.nodes(n, 0) += 0.05 * quads.nodes(n, 1);
  const Eigen::SparseMatrix<double> C = curvature_energy(quads, 2);
  const Eigen::VectorXd affine = nodal(
      quads, *camera(), [](const Eigen::Vector2d& x) { return Eigen::Vector2d(1 + 2 * x.x() - x.y(), 3 * x.y()); });
  EXPECT_LT(affine.dot(C * affine), 1e-18 * C.norm() * affine.squaredNorm());
  const double k = 2 * M_PI / 2.0;
  const Eigen::VectorXd wave =
      nodal(quads, *camera(), [&](const Eigen::Vector2d& x) { return Eigen::Vector2d(std::sin(k * x.y()), 0.0); });
  EXPECT_NEAR(wave.dot(C * wave) / (0.5 * std::pow(k, 4) * 48.0), 1.0, 0.1);
}

TEST(Covariance, DiagonalOfTheInverse) {
  const Correlation correlation(rectangle(20, 20, 150, 140, 6, 5), camera(), BSpline(scene().reference));
  const Eigen::SparseMatrix<double> M = correlation.M();
  const Eigen::VectorXd dense = Eigen::MatrixXd(M).inverse().diagonal();
  const Eigen::VectorXd sparse = diagonal_of_inverse(Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>>(M));
  EXPECT_LT((dense - sparse).norm(), 1e-10 * dense.norm());
}

TEST(Covariance, InverseTimesManyColumns) {
  const Correlation correlation(rectangle(20, 20, 150, 140, 6, 5), camera(), BSpline(scene().reference));
  const Eigen::SparseMatrix<double> M = correlation.M();
  const Columns B = Columns::Random(M.rows(), 7);
  const Columns X = inverse_times(Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>>(M), B);
  EXPECT_LT((M * X - B).norm(), 1e-10 * B.norm());
}

}  // namespace test_global_dic
}  // namespace imic3d::correlation
