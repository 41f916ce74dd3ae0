// The covariance of the parameters against the scatter of identifications from noisy data, each source of noise alone
// and all together (Eq. 14 and its extension).

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <random>

#include "plate.hpp"

namespace imic3d::identification {
namespace test_covariance {

using testing::Plate;

const std::vector<double> stretch = {0.003, 0.005, 0.008, 0.02, 0.06, 0.12};
const Stage stage{.free = {0, 2}, .frames = {0, 1, 2, 3, 4, 5}};
constexpr double sigma = 1.0, force_sigma = 1.5;  // grey levels, N (forces reach 1.5 kN)
constexpr int references = 2;
const std::vector<double> frame_noise = {1.0, 2.0, 1.0, 1.0, 3.0, 1.0};  // of each frame, over sigma

Plate plate_with_frame_noise() {
  Plate plate(stretch);
  plate.images.frame_noise =
      Eigen::Map<const Eigen::VectorXd>(frame_noise.data(), static_cast<Eigen::Index>(frame_noise.size()));
  return plate;
}

struct Sources {
  bool image = false, boundary = false, force = false;
};

GaussNewtonOptions options_with(Functional functional, int draws) {
  GaussNewtonOptions options{.functional = functional, .eta = 1e-3, .force_noise = 20.0};
  options.noise_model = {
      .image = sigma, .references = references, .force = force_sigma, .driving = {}, .draws = draws, .seed = 5};
  return options;
}

/// Errors of E and S_y (rms) over identifications with that noise, each with its own draws of it.
Eigen::Vector2d scatter(Functional functional, const Sources& sources, int draws, int own_draws) {
  const Communicator world;
  const Plate clean = plate_with_frame_noise();
  std::mt19937_64 random(3);
  std::normal_distribution<double> normal;
  const Eigen::VectorXd root = clean.images.M.diagonal().cwiseSqrt();
  Eigen::MatrixXd found(2, draws);
  for (int d = 0; d < draws; ++d) {
    Plate noisy = plate_with_frame_noise();
    Eigen::VectorXd of_reference(root.size());
    for (double& value : of_reference) value = sigma / std::sqrt(references) * normal(random);
    for (Eigen::Index t = 0; t < noisy.record.force.size(); ++t) {
      Eigen::VectorXd moved = of_reference;
      for (double& value : moved) value += sigma * frame_noise[static_cast<std::size_t>(t)] * normal(random);
      moved = moved.cwiseQuotient(root);  // M^-1 b, b b^T = sigma^2 M
      if (sources.image) noisy.record.surface_displacement.col(t) += moved;
      if (sources.boundary) noisy.record.driving.col(t) += moved;
      const double load = force_sigma * normal(random);
      if (sources.force) noisy.record.force[t] += load;
    }
    ForwardModel model(world, noisy.specimen, noisy.law, noisy.record, {.with_fields = false}, 3, 0);
    auto parameters = noisy.truth;
    const auto result = gauss_newton(world, model, noisy.images, testing::information(noisy), stage,
                                     options_with(functional, own_draws), parameters);
    EXPECT_TRUE(result.converged);
    found.col(d) << parameters[0], parameters[2];
  }
  const Eigen::Vector2d truth(clean.truth[0], clean.truth[2]);
  return (found.colwise() - truth).rowwise().squaredNorm().cwiseSqrt() / std::sqrt(draws);
}

void compare(Functional functional, int draws, bool each_alone) {
  const Communicator world;
  Plate plate = plate_with_frame_noise();
  ForwardModel model(world, plate.specimen, plate.law, plate.record, {.with_fields = false}, 3, 0);
  auto parameters = plate.truth;
  const auto predicted = gauss_newton(world, model, plate.images, testing::information(plate), stage,
                                      options_with(functional, 400), parameters)
                             .covariance;
  const auto check = [&](const char* name, const Eigen::MatrixXd& covariance, const Sources& sources) {
    const Eigen::Vector2d measured =
                              scatter(functional, sources, draws, functional == Functional::force_driven ? 0 : 24),
                          expected = covariance.diagonal().cwiseSqrt();
    for (int j = 0; j < 2; ++j) {
      EXPECT_GT(expected[j], 0.0) << name;
      EXPECT_NEAR(measured[j] / expected[j], 1.0, 0.15) << name << ", parameter " << j;
      std::printf("%-9s parameter %d: measured %.4g, predicted %.4g, ratio %.3f\n", name, j, measured[j], expected[j],
                  measured[j] / expected[j]);
    }
  };
  if (each_alone) {
    check("images", predicted.image, {.image = true});
    check("boundary", predicted.boundary, {.boundary = true});
    check("force", predicted.force, {.force = true});
  }
  check("all", predicted.total, {.image = true, .boundary = true, .force = true});
}

/// The response to noise by direct differentiation is that of simulations with the noise.
TEST(Covariance, DirectlyAndByDifferences) {
  for (const Functional functional :
       {Functional::force_driven, Functional::displacement_driven, Functional::combined}) {
    std::vector<Covariance> both;
    std::vector<Eigen::MatrixXd> errors;
    for (int d = 0; d < 2; ++d)
      errors.emplace_back(1e-6 * Eigen::MatrixXd::Random(Plate(stretch).record.surface_displacement.rows(), 6));
    for (const Sensitivities sensitivities : {Sensitivities::direct, Sensitivities::perturbed}) {
      Plate plate(stretch);
      ForwardModel model({}, plate.specimen, plate.law, plate.record, {.with_fields = false}, 3, 0);
      auto parameters = plate.truth;
      GaussNewtonOptions options{
          .functional = functional, .force_noise = 20.0, .sensitivities = sensitivities, .perturbation = 1e-5};
      options.noise_model = {.image = 0.01 * sigma,
                             .references = references,
                             .force = 0.01 * force_sigma,
                             .driving = [](const Eigen::MatrixXd& error) -> Eigen::MatrixXd { return 0.5 * error; },
                             .calibration = errors,
                             .draws = 6,
                             .seed = 5};
      both.push_back(
          gauss_newton({}, model, plate.images, testing::information(plate), stage, options, parameters).covariance);
    }
    const std::vector<std::pair<const char*, Eigen::MatrixXd Covariance::*>> parts = {
        {"images", &Covariance::image},
        {"force", &Covariance::force},
        {"boundary", &Covariance::boundary},
        {"calibration", &Covariance::calibration},
        {"total", &Covariance::total}};
    for (const auto& [name, part] : parts)
      for (int j = 0; j < 2; ++j) {
        EXPECT_GT((both[0].*part)(j, j), 0.0);
        EXPECT_NEAR((both[1].*part)(j, j) / (both[0].*part)(j, j), 1.0, 0.02)
            << name << " of parameter " << j << ", functional " << static_cast<int>(functional);
      }
  }
}

/// Noise that no simulation carries costs its own share of the standard deviations, not what was identified.
TEST(Covariance, WithoutNoiseThatCannotBeSimulated) {
  Plate plate(stretch);
  ForwardModel model({}, plate.specimen, plate.law, plate.record, {.with_fields = false}, 3, 0);
  auto parameters = plate.truth;
  parameters[0] *= 1.05;
  GaussNewtonOptions options{
      .functional = Functional::displacement_driven, .force_noise = 20.0, .sensitivities = Sensitivities::perturbed};
  options.noise_model = {
      .image = 1e6 * sigma, .references = references, .force = force_sigma, .driving = {}, .draws = 2, .seed = 5};
  const auto result = gauss_newton({}, model, plate.images, testing::information(plate), stage, options, parameters);
  EXPECT_TRUE(result.converged);
  EXPECT_NEAR(parameters[0] / plate.truth[0], 1.0, 1e-3);
  EXPECT_FALSE(result.unknown_noise.empty());
  EXPECT_GT(result.covariance.image(0, 0), 0.0);
  EXPECT_EQ(result.covariance.boundary.norm(), 0.0);
}

/// The force is weighed by what noisy ends do to it in each frame: little where the specimen flows.
TEST(Covariance, OfTheForceOfEachFrame) {
  Plate plate(stretch);
  ForwardModel model({}, plate.specimen, plate.law, plate.record, {.with_fields = false}, 3, 0);
  auto parameters = plate.truth;
  parameters[0] *= 1.05, parameters[2] *= 0.95;
  const auto start = parameters;
  auto options = options_with(Functional::displacement_driven, 100);
  const auto result = gauss_newton({}, model, plate.images, testing::information(plate), stage, options, parameters);
  const Eigen::VectorXd& difference = result.difference;
  // What changes in place is no step: as many as it took are enough.
  options.max_iterations = steps_taken(result.iterates);
  EXPECT_LT(options.max_iterations, static_cast<int>(result.iterates.size()) - 1);
  ForwardModel anew({}, plate.specimen, plate.law, plate.record, {.with_fields = false}, 3, 0);
  auto again = start;
  EXPECT_TRUE(gauss_newton({}, anew, plate.images, testing::information(plate), stage, options, again).converged);
  EXPECT_EQ(again, parameters);
  ASSERT_EQ(difference.size(), 6);
  std::mt19937_64 random(3);
  std::normal_distribution<double> normal;
  const Eigen::VectorXd root = plate.images.M.diagonal().cwiseSqrt();
  Eigen::VectorXd squares = Eigen::VectorXd::Zero(6);
  constexpr int draws = 60;
  for (int d = 0; d < draws; ++d) {
    Eigen::MatrixXd driving = plate.record.driving;
    Eigen::VectorXd of_reference(root.size());
    for (double& value : of_reference) value = sigma / std::sqrt(references) * normal(random);
    for (auto frame : driving.colwise())
      for (Eigen::Index i = 0; i < root.size(); ++i) frame[i] += (of_reference[i] + sigma * normal(random)) / root[i];
    const auto path =
        model.simulate(Control::displacement, {{.parameters = plate.truth, .driving = &driving}}, 6).front();
    for (int t = 0; t < 6; ++t)
      squares[t] += std::pow(path.reaction[t] - plate.record.force[t], 2) + force_sigma * force_sigma;
  }
  for (int t = 0; t < 6; ++t) EXPECT_NEAR(difference[t] / std::sqrt(squares[t] / draws), 1.0, 0.25) << "frame " << t;
  EXPECT_LT(difference[5], 0.5 * difference[0]);
  for (int t = 0; t < 6; ++t)
    std::printf("frame %d: %.3g N, simulated %.3g\n", t, difference[t], std::sqrt(squares[t] / draws));
}

TEST(Covariance, OfTheForceDrivenFunctional) { compare(Functional::force_driven, 100, false); }
TEST(CovarianceNightly, OfTheForceDrivenFunctional) { compare(Functional::force_driven, 400, true); }
TEST(CovarianceNightly, OfTheDisplacementDrivenFunctional) { compare(Functional::displacement_driven, 400, true); }

}  // namespace test_covariance
}  // namespace imic3d::identification
