// dU/dLambda of the surface and dR/dLambda of the reaction by direct differentiation, as the identification uses them.
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <random>

#include "plate.hpp"

namespace imic3d::identification {
namespace test_sensitivities {

using testing::Plate;

const std::vector<double> stretch = {0.003, 0.006, 0.02, 0.06, 0.12, 0.118};  // the last unloads
constexpr int frames = 6;
const std::vector<int> free_parameters = {0, 1, 2, 3, 4};

const char* name(Control control) {
  return control == Control::displacement ? "displacement" : control == Control::force ? "force" : "images";
}

/// Against central differences of simulations under the same forces, by every parameter: error below 1e-6 at its least.
void expect_derivatives(Control control) {
  const Communicator world;
  Plate plate(stretch);
  const mechanics::EquilibriumOptions tight{.max_iterations = 40, .tolerance = 1e-13, .derivative_tolerance = 1e-11};
  ForwardModel model(world, plate.specimen, plate.law, plate.record, tight, 1, 1);
  auto parameters = plate.truth;
  parameters[2] *= 1.03;
  std::vector<Path> driven;
  std::vector<Eigen::VectorXd> plastic(frames);
  const auto distribution = model.distribute_forces({{.parameters = plate.truth}}, frames, driven).front();
  if (control == Control::images) model.follow_images(plate.images, 0.3, parameters);
  const Run run{.parameters = parameters, .forces = &distribution, .free = free_parameters};
  const auto keep = [&](int, int t, const mechanics::FrameState& state) {
    plastic[static_cast<std::size_t>(t)] = state.plastic_strain;
  };
  const Path path = model.simulate(control, {run}, frames, keep).front();
  ASSERT_EQ(path.frames, frames) << path.message;
  EXPECT_GT(plastic[4].minCoeff(), 1e-3) << name(control) << " must yield";
  EXPECT_LT((plastic[5] - plastic[4]).minCoeff(), 1e-9) << name(control) << " must unload";
  for (std::size_t j = 0; j < free_parameters.size(); ++j) {
    std::vector<double> errors;
    std::string table;
    for (const double h : {1e-2, 1e-3, 1e-4, 1e-5, 1e-8}) {
      Run plus{.parameters = parameters, .forces = &distribution}, minus = plus;
      plus.parameters[j] += h * parameters[j], minus.parameters[j] -= h * parameters[j];
      const auto both = model.simulate(control, {plus, minus}, frames);
      if (both[0].increments != path.increments) continue;  // another function
      const auto error = [&](const auto& a, const auto& b, const auto& derivative) {
        return ((a - b) / (2.0 * h * parameters[j]) - derivative).norm() / derivative.norm();
      };
      errors.push_back(error(both[0].surface, both[1].surface, path.d_surface[j]));
      if (control == Control::displacement)
        errors.back() = std::max(errors.back(), error(both[0].reaction, both[1].reaction, path.d_reaction[j]));
      char line[60];
      std::snprintf(line, sizeof line, "\n  %.0e  %.2e", h, errors.back());
      table += line;
    }
    const std::string what = std::string(name(control)) + ", " + plate.law->parameters()[j].name + table;
    ASSERT_GE(errors.size(), 3U) << what;
    const double best = *std::min_element(errors.begin(), errors.end());
    EXPECT_LE(best, 1e-6) << what;
    EXPECT_GT(best, 0.0) << what;
    EXPECT_GT(errors.front(), 10.0 * best) << what;
    EXPECT_GT(errors.back(), 10.0 * best) << what;
  }
}

TEST(DirectSensitivities, AreDerivativesOfThePathUnderEveryControl) {
  for (const Control control : {Control::displacement, Control::force, Control::images}) expect_derivatives(control);
}

/// As the ends' displacement moves: against central differences, with yielding and unloading.
void expect_derivatives_in_directions() {
  const Communicator world;
  Plate plate(stretch);
  ForwardModel model(world, plate.specimen, plate.law, plate.record,
                     {.max_iterations = 40, .tolerance = 1e-13, .derivative_tolerance = 1e-11}, 1, 1);
  std::mt19937 random(5);
  std::normal_distribution<double> noise;
  Run run{.parameters = plate.truth, .free = {2}};
  std::vector<Eigen::MatrixXd> of_surface(2, plate.record.driving);
  for (auto& direction : of_surface) {
    for (double& u : direction.reshaped()) u = noise(random);
    run.directions.push_back({.prescribed = plate.specimen.from_surface(Control::displacement) * direction});
  }
  const Path path = model.simulate(Control::displacement, {run}, frames).front();
  ASSERT_EQ(path.frames, frames) << path.message;
  ASSERT_EQ(path.d_surface.size(), 3U);
  for (std::size_t k = 0; k < 2; ++k) {
    std::vector<double> errors;
    for (const double h : {1e-3, 1e-5, 1e-6, 1e-7, 1e-11}) {
      const Eigen::MatrixXd more = plate.record.driving + h * of_surface[k],
                            less = plate.record.driving - h * of_surface[k];
      const auto both = model.simulate(
          Control::displacement,
          {Run{.parameters = plate.truth, .driving = &more}, Run{.parameters = plate.truth, .driving = &less}}, frames);
      if (both[0].increments != path.increments) continue;
      errors.push_back(std::max(
          ((both[0].surface - both[1].surface) / (2 * h) - path.d_surface[1 + k]).norm() / path.d_surface[1 + k].norm(),
          ((both[0].reaction - both[1].reaction) / (2 * h) - path.d_reaction[1 + k]).norm() /
              path.d_reaction[1 + k].norm()));
    }
    ASSERT_GE(errors.size(), 3U);
    const double best = *std::min_element(errors.begin(), errors.end());
    EXPECT_LE(best, 1e-6);
    EXPECT_GT(errors.front(), 10.0 * best);
    EXPECT_GT(errors.back(), 10.0 * best);
  }
}

TEST(DirectSensitivities, AreDerivativesInDirectionsOfTheDrivenEnds) { expect_derivatives_in_directions(); }

/// With noise in the data, so that the derivatives decide where the minimum is.
TEST(DirectSensitivities, IdentifyWhatPerturbedOnesDo) {
  const Communicator world;
  struct Way {
    Functional functional;
    double alpha;
  };
  for (const auto& [functional, alpha] : {Way{Functional::displacement_driven, 0.0},
                                          {Functional::force_driven, 0.0},
                                          {Functional::combined, 0.0},
                                          {Functional::force_driven, 0.3}}) {
    Plate plate(stretch);
    std::mt19937 random(3);
    std::normal_distribution<double> noise(0.0, 2e-4);
    for (double& u : plate.record.surface_displacement.reshaped()) u += noise(random);
    const auto identified = [&](Sensitivities sensitivities) {
      ForwardModel model(world, plate.specimen, plate.law, plate.record, {.with_fields = false}, 3, 0);
      auto parameters = plate.truth;
      parameters[0] *= 1.05, parameters[2] *= 0.95;
      const auto result = gauss_newton(world, model, plate.images, testing::information(plate),
                                       {.free = {0, 2}, .frames = {0, 1, 2, 3, 4, 5}},
                                       {.functional = functional,
                                        .alpha = alpha,
                                        .eta = 1e-8,
                                        .force_noise = 5.0,
                                        .sensitivities = sensitivities,
                                        .perturbation = 1e-5},
                                       parameters);
      EXPECT_TRUE(result.converged) << result.message;
      return parameters;
    };
    const auto direct = identified(Sensitivities::direct), perturbed = identified(Sensitivities::perturbed);
    for (const int j : {0, 2}) {
      const auto k = static_cast<std::size_t>(j);
      EXPECT_NEAR(direct[k] / perturbed[k], 1.0, 1e-6) << static_cast<int>(functional) << " " << alpha << " " << j;
      EXPECT_GT(std::abs(direct[k] / plate.truth[k] - 1.0), 1e-5) << "the noise must show";
    }
  }
}

/// A step of few eta_c behind one that left little is not simulated, and leads to the same parameters.
TEST(DirectSensitivities, SpareTheSimulationOfAStraightStep) {
  const Communicator world;
  Plate plate(stretch);
  std::mt19937 random(3);
  std::normal_distribution<double> noise(0.0, 2e-4);
  for (double& u : plate.record.surface_displacement.reshaped()) u += noise(random);
  struct Found {
    std::vector<double> parameters, eta;
    int frames;
  };
  const auto identified = [&](double eta) {
    ForwardModel model(world, plate.specimen, plate.law, plate.record, {.with_fields = false}, 3, 0);
    Found found{.parameters = plate.truth, .eta = {}, .frames = 0};
    found.parameters[0] *= 1.2, found.parameters[2] *= 0.85;
    const auto result = gauss_newton(
        world, model, plate.images, testing::information(plate), {.free = {0, 2}, .frames = {0, 1, 2, 3, 4, 5}},
        {.functional = Functional::displacement_driven,
         .eta = eta,
         .force_noise = 5.0,
         .sensitivities = Sensitivities::direct},
        found.parameters, [&](const Iterate& iterate) { found.eta.push_back(iterate.eta); });
    EXPECT_TRUE(result.converged) << result.message;
    found.frames = model.work().frames;
    return found;
  };
  const Found near = identified(1e-8);
  ASSERT_GE(near.eta.size(), 5U);
  const double eta = 0.9 * near.eta[3];  // above which the third step is
  const Found found = identified(eta);
  EXPECT_EQ(found.eta.size(), 5U);
  EXPECT_EQ(found.frames, 3 * 6) << "the start and what the first two steps lead to";
  for (const std::size_t j : {0U, 2U}) EXPECT_NEAR(found.parameters[j] / near.parameters[j], 1.0, 0.01 * eta);
}

}  // namespace test_sensitivities
}  // namespace imic3d::identification
