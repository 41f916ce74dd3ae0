// Stress-strain curves: closed forms as data, noise, scatter, bounds, and what the covariance says.
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <numeric>
#include <random>

#include "imic3d/core/linear.hpp"
#include "imic3d/identification/curves.hpp"

namespace imic3d::identification {
namespace test_curves {

// E nu S_y S_inf b H C_rate rate_0
const std::vector<double> truth = {200e3, 0.3, 250, 450, 12, 0, 0.015, 1e-3};
const std::vector<std::string> rate = {"rate"};

std::shared_ptr<const material::FiniteStrainLaw> voce(std::vector<std::string> effects = rate) {
  return material::make_law({.law = "j2", .hardening = "voce", .effects = std::move(effects)});
}

/// A bar in the closed form: sigma = (S_inf - (S_inf - S_y) e^{-b p}) (1 + C ln(1 + p'/rate_0)), strain = p + sigma/E,
/// p' constant.
Curve bar(const std::string& group, double speed, double noise, unsigned seed, double strength = 1.0, int rows = 120) {
  std::mt19937 engine(seed);
  std::normal_distribution<double> normal;
  Curve curve{.name = group + " " + std::to_string(seed),
              .group = group,
              .history = {},
              .stress = Eigen::VectorXd(rows),
              .engineering = seed % 2 == 0,
              .deviation = noise,
              .use = {}};
  curve.history.time.resize(rows), curve.history.strain.resize(rows);
  for (Eigen::Index i = 0; i < rows; ++i) {
    const double p = 1.5e-3 * static_cast<double>(i);
    const double stress = strength * (450 - 200 * std::exp(-12 * p)) * (1 + 0.015 * std::log(1 + speed / 1e-3));
    const double strain = i == 0 ? 0.0 : p + stress / 200e3;
    curve.history.strain[i] = strain;
    curve.history.time[i] = p / speed;
    curve.stress[i] = i == 0 ? 0.0 : stress * (curve.engineering ? std::exp(-strain) : 1.0) + noise * normal(engine);
    curve.use.push_back(i < 3 ? Curve::not_judged : i >= 100 ? Curve::held_out : Curve::fitted);
  }
  return curve;
}

const std::vector<int> free_parameters = {2, 3, 4, 6};

TEST(Curves, PredictTheClosedForm) {
  // One step a row: its rate is then the closed form's, also in the first one, which is elastic in part.
  const CurveSet set(voce(), {bar("slow", 1e-3, 0.0, 1), bar("fast", 10.0, 0.0, 2)},
                     {.largest_step = 0.01, .given_steps = true});
  const Eigen::VectorXd predicted = set.predict(truth);
  ASSERT_EQ(predicted.size(), 2 * 117);
  EXPECT_LT((predicted - set.measured()).cwiseAbs().maxCoeff(), 1e-7);
  EXPECT_EQ(set.places()[117].curve, 1);
  EXPECT_EQ(set.places()[117].row, 3);
  EXPECT_TRUE(set.is_fitted(0));
  EXPECT_FALSE(set.is_fitted(116));
  EXPECT_EQ(misfit(set, predicted, "slow", false).rows, 20);
}

TEST(Curves, WithEveryEffectAtItsNullValueAreThoseOfTheDeclaredLaw) {
  const CurveSet declared(voce({}), {bar("slow", 1e-3, 0.0, 1)}), all = declared.with(voce(material::known_effects()));
  std::vector<double> parameters(truth.begin(), truth.begin() + 6);
  const Eigen::VectorXd expected = declared.predict(parameters);
  for (std::size_t i = 6; i < all.parameters().size(); ++i) parameters.push_back(*all.parameters()[i].null_value);
  std::vector<int> every(parameters.size());
  std::iota(every.begin(), every.end(), 0);
  Eigen::MatrixXd derivatives;
  EXPECT_LT((all.predict(parameters, every, derivatives) - expected).norm(), 1e-10 * expected.norm());
  EXPECT_TRUE(derivatives.allFinite());
  for (std::size_t j = 6; j < parameters.size(); ++j) {
    const auto& info = all.parameters()[j];
    const double slope = derivatives.col(static_cast<Eigen::Index>(j)).norm();
    if (info.shape) {
      EXPECT_LT(slope * info.scale, 1e-9) << info.name << ": a shape without size";
    } else if (info.name != "dilatancy" &&
               info.effect != "hill") {  // which a bar along axis 1 shows in its width alone
      EXPECT_GT(slope * usual_size(info, 200e3), 1e-2) << info.name << ": the signature of an effect";
    }
  }
}

TEST(Curves, FitFindsTheParametersWithinTheirNoise) {
  double chi_squares = 0.0;
  int count = 0;
  for (unsigned seed = 1; seed < 13; ++seed) {
    const CurveSet set(voce(), {bar("slow", 1e-3, 3.0, 10 * seed), bar("fast", 10.0, 3.0, 10 * seed + 1)});
    const CurveFit result =
        fit(set, set.parameters(), {200e3, 0.3, 180, 600, 30, 0, 0.0, 1e-3}, free_parameters, {.eta = 1e-6});
    ASSERT_TRUE(result.converged);
    EXPECT_NEAR(result.iterates.back().chi, 1.0, 0.2);
    EXPECT_TRUE(result.at_bounds.empty());
    Eigen::VectorXd error(4);
    for (Eigen::Index j = 0; j < 4; ++j)
      error[j] = result.parameters[static_cast<std::size_t>(free_parameters[static_cast<std::size_t>(j)])] -
                 truth[static_cast<std::size_t>(free_parameters[static_cast<std::size_t>(j)])];
    chi_squares += error.dot(solve_symmetric(result.noise_covariance, error).col(0)), count += 4;
  }
  // chi^2 with 48 degrees of freedom: 1 +- 0.204.
  EXPECT_NEAR(chi_squares / count, 1.0, 3 * std::sqrt(2.0 / count));
  std::printf("error of the fitted parameters over their covariance: chi^2/N = %.2f over %d\n", chi_squares / count,
              count);
}

TEST(Curves, CovarianceKnowsThatBarsDiffer) {
  // Bars of strengths that scatter by 4 %: white noise alone makes S_inf far too sure, the scatter of the bars does
  // not.
  std::mt19937 engine(3);
  std::normal_distribution<double> normal(1.0, 0.04);
  std::vector<double> S_inf;
  double between = 0.0, white = 0.0;
  for (int draw = 0; draw < 30; ++draw) {
    std::vector<Curve> curves;
    for (unsigned k = 0; k < 8; ++k)
      curves.push_back(bar("bars", 1e-3, 3.0, 100U * static_cast<unsigned>(draw) + k, normal(engine), 80));
    const CurveSet set(voce(), curves);
    const CurveFit result = fit(set, set.parameters(), truth, {2, 3, 4});
    S_inf.push_back(result.parameters[3]);
    between += result.covariance(1, 1) / 30, white += result.noise_covariance(1, 1) / 30;
  }
  const Eigen::Map<const Eigen::VectorXd> all(S_inf.data(), 30);
  const double scattered = std::sqrt((all.array() - all.mean()).square().sum() / 29);
  EXPECT_NEAR(std::sqrt(between) / scattered, 1.0, 0.35);
  EXPECT_LT(std::sqrt(white), 0.4 * scattered);
  std::printf("S_inf of 30 sets of 8 bars scatters by %.2f; expected %.2f, white noise %.2f\n", scattered,
              std::sqrt(between), std::sqrt(white));
}

/// Strengths of a sheet at 0, 45 and 90 degrees to its rolling direction say R_22, and of R_33 and R_12 the sum
/// 1/R_33^2 + 3/R_12^2 alone.
TEST(Curves, WhatIsSeenAsACombinationAloneIsNotDetermined) {
  std::vector<Curve> bars;
  for (unsigned k = 0; k < 3; ++k) {
    bars.push_back(bar("sheet " + std::to_string(k), 1e-3, 1.0, 1 + 2 * k));
    bars.back().history.direction = 45.0 * k;
  }
  CurveSet set(voce({"hill"}), bars);
  const std::vector<double> start = {200e3, 0.3, 250, 450, 12, 0, 1.0, 1.0, 1.0, 0.0};  // the last one is the angle
  ASSERT_EQ(set.parameters().size(), start.size());
  std::vector<int> free;
  for (const char* name : {"S_y", "R_22", "R_33", "R_12"})
    for (std::size_t j = 0; j < set.parameters().size(); ++j)
      if (set.parameters()[j].name == name) free.push_back(static_cast<int>(j));
  ASSERT_EQ(free.size(), 4U);
  const CurveFit all = fit(set, set.parameters(), start, free);
  for (const Eigen::MatrixXd* part : {&all.covariance, &all.noise_covariance}) {
    EXPECT_TRUE(part->topLeftCorner(2, 2).allFinite());
    EXPECT_TRUE(std::isinf((*part)(2, 2)) && std::isinf((*part)(3, 3))) << *part;
  }
  free.pop_back();  // one of them held
  const CurveFit held = fit(set, set.parameters(), start, free);
  EXPECT_TRUE(held.covariance.allFinite());
  EXPECT_LT(std::sqrt(held.covariance(2, 2)), 0.05);
}

TEST(Curves, BoundsHoldAndAreNamed) {
  const CurveSet set(voce(), {bar("slow", 1e-3, 1.0, 1), bar("fast", 10.0, 1.0, 2)});
  auto information = set.parameters();
  information[6].upper = 0.01;  // the truth is 0.015
  const CurveFit result = fit(set, information, {200e3, 0.3, 200, 500, 20, 0, 0.005, 1e-3}, free_parameters);
  EXPECT_TRUE(result.converged);
  EXPECT_EQ(result.parameters[6], 0.01);
  EXPECT_EQ(result.at_bounds, std::vector<int>{6});
  EXPECT_TRUE(std::isnan(result.noise_covariance(3, 3)));
  EXPECT_TRUE(std::isfinite(result.noise_covariance(0, 0)));
}

TEST(Curves, NoiseIsReadFromThePointsAndFromRepetitions) {
  EXPECT_NEAR(point_noise(bar("one", 1e-3, 2.0, 5, 1.0, 2000)), 2.0, 0.2);
  std::vector<Curve> curves;
  std::vector<const Curve*> pointers;
  std::mt19937 engine(1);
  std::normal_distribution<double> normal(1.0, 0.05);
  for (unsigned k = 0; k < 40; ++k) curves.push_back(bar("bars", 1e-3, 0.0, 2 * k, normal(engine), 80));
  for (const auto& curve : curves) pointers.push_back(&curve);
  const double mean = 0.05 * 380;  // engineering stresses of 280 to 430, 5 % of their rms
  EXPECT_NEAR(scatter(pointers), mean, 0.2 * mean);
  EXPECT_EQ(scatter({&curves[0]}), 0.0);
}

/// An extensometer's noise is E times as much stress where the bar is elastic, and next to nothing where it flows.
TEST(Curves, NoiseOfTheStrainWeighsWhereTheCurveIsSteep) {
  constexpr double of_stress = 1.0, of_strain = 3e-5;
  double without = 0.0, with = 0.0, seen = 0.0;
  constexpr int count = 60;
  for (int seed = 0; seed < count; ++seed) {
    for (const double noise : {0.0, of_strain}) {
      std::mt19937 engine(static_cast<unsigned>(seed) + 100U);
      std::normal_distribution<double> normal;
      Curve curve{.name = "bar",
                  .group = "bar",
                  .history = {},
                  .stress = Eigen::VectorXd::Zero(400),
                  .engineering = true,
                  .deviation = of_stress,
                  .estimated = true,
                  .use = std::vector<char>(400, Curve::fitted)};
      curve.history.strain = Eigen::VectorXd::LinSpaced(400, 0.0, 0.05),
      curve.history.time = curve.history.strain / 1e-3;
      const CurveSet exact(voce({}), {curve});
      curve.stress = exact.predict({truth.begin(), truth.begin() + 6});
      for (Eigen::Index row = 1; row < 400; ++row)
        curve.stress[row] += of_stress * normal(engine), curve.history.strain[row] += noise * normal(engine);
      CurveSet set(voce({}), {curve});
      const std::vector<int> free = {0, 2, 3, 4};
      CurveFit result = fit(set, set.parameters(), {190e3, 0.3, 230, 470, 14, 0}, free);
      const auto off = [&] { return std::pow((result.parameters[0] - truth[0]), 2) / result.covariance(0, 0); };
      const double z = off();
      const double of_this = set.weigh(result.parameters).front();
      if (noise == 0.0) {
        EXPECT_LT(of_this, 1.5e-5);  // chance
        continue;
      }
      without += z / count, seen += of_this / count;
      result = fit(set, set.parameters(), result.parameters, free);
      with += off() / count;
    }
  }
  EXPECT_NEAR(seen, of_strain, 0.15 * of_strain);
  EXPECT_GT(std::sqrt(without), 3.0);
  EXPECT_LT(std::sqrt(with), 1.6);
  std::printf("E off by %.2f standard deviations, %.2f with the strain's noise, which is seen as %.2g\n",
              std::sqrt(without), std::sqrt(with), seen);
}

/// Rows that are closer than the strain's noise, and a bar that is unloaded between two of them: the simulated bar
/// would unload whenever the strain seems to, flow by the largest of many numbers, and be off all along each branch.
TEST(Curves, NoiseOfTheStrainOfAnUnloadedBar) {
  constexpr Eigen::Index count = 2000;
  const auto course = [](double t) { return 1e-3 * (t < 10.013 ? t : t < 12.507 ? 20.026 - t : t - 4.988); };
  double recorded = 0.0, read = 0.0;
  constexpr unsigned seeds = 8;
  for (unsigned seed = 0; seed < seeds; ++seed) {
    std::mt19937 engine(seed);
    std::normal_distribution<double> normal;
    Curve curve{.name = "bar",
                .group = "bar",
                .history = {},
                .stress = Eigen::VectorXd::Zero(count),
                .engineering = true,
                .deviation = 1.0,
                .estimated = true,
                .use = std::vector<char>(count, Curve::fitted)};
    curve.history.time = Eigen::VectorXd::LinSpaced(count, 0.0, 40.0),
    curve.history.strain = curve.history.time.unaryExpr(course);
    curve.history.turns = {
        {static_cast<Eigen::Index>(std::ceil(10.013 / 40.0 * (count - 1))), true, 10.013, course(10.013)},
        {static_cast<Eigen::Index>(std::ceil(12.507 / 40.0 * (count - 1))), true, 12.507, course(12.507)}};
    curve.stress = CurveSet(voce({}), {curve}).predict({truth.begin(), truth.begin() + 6});
    for (Eigen::Index row = 1; row < count; ++row)
      curve.stress[row] += normal(engine), curve.history.strain[row] += 2e-5 * normal(engine);
    curve.history.turns.clear();
    const std::vector<int> free = {0, 2, 3, 4};
    const auto off = [&](const Curve& one) {
      CurveSet set(voce({}), {one});
      CurveFit result = fit(set, set.parameters(), {190e3, 0.3, 230, 470, 14, 0}, free);
      set.weigh(result.parameters);
      result = fit(set, set.parameters(), result.parameters, free);
      double squares = 0.0;
      for (Eigen::Index j = 0; j < 4; ++j)
        squares += std::pow(result.parameters[static_cast<std::size_t>(free[static_cast<std::size_t>(j)])] -
                                truth[static_cast<std::size_t>(free[static_cast<std::size_t>(j)])],
                            2) /
                   result.covariance(j, j);
      return squares / (4.0 * seeds);
    };
    recorded += off(curve);
    read_gauge(curve);
    read += off(curve);
  }
  EXPECT_GT(std::sqrt(recorded), 5.0);
  EXPECT_LT(std::sqrt(read), 1.6);
  std::printf("E, S_y, S_inf and b off by %.2f standard deviations, %.2f with the strain's course and turns\n",
              std::sqrt(recorded), std::sqrt(read));
}

/// A law without back-stress turns its corners elsewhere than the bar does: what that leaves on the steep rows is no
/// noise of the strain.
TEST(Curves, WhatTheLawErrsByIsNoNoiseOfTheStrain) {
  std::mt19937 engine(1);
  std::normal_distribution<double> normal;
  constexpr Eigen::Index rows = 400;
  Curve curve{.name = "cycles",
              .group = "cycles",
              .history = {},
              .stress = Eigen::VectorXd::Zero(rows),
              .engineering = true,
              .deviation = 1.0,
              .estimated = true,
              .use = std::vector<char>(rows, Curve::fitted)};
  curve.history.strain.resize(rows), curve.history.time = Eigen::VectorXd::LinSpaced(rows, 0.0, rows - 1.0);
  for (Eigen::Index i = 0; i < rows; ++i)
    curve.history.strain[i] = 0.01 * std::asin(std::sin(2.0 * M_PI * static_cast<double>(i) / 80.0)) / (0.5 * M_PI);
  const CurveSet truly(voce({"kinematic"}), {curve});
  curve.stress = truly.predict({200e3, 0.3, 250, 300, 12, 0, 40e3, 250});
  for (double& stress : curve.stress) stress += normal(engine);
  CurveSet set(voce({}), {curve});
  const CurveFit result = fit(set, set.parameters(), {190e3, 0.3, 230, 470, 14, 0}, {0, 2, 3, 4});
  EXPECT_GT(result.iterates.back().chi, 5.0);
  EXPECT_EQ(set.weigh(result.parameters).front(), 0.0);
}

TEST(Curves, NoiseOfThePointsVariesAsItsFreedomSays) {
  std::mt19937 engine(1);
  std::normal_distribution<double> normal;
  constexpr int draws = 2000, points = 150;
  const Eigen::VectorXd x = Eigen::VectorXd::LinSpaced(points, 0.0, 1.0);
  Eigen::ArrayXd squares(draws);
  for (double& square : squares) {
    Eigen::VectorXd y = 3.0 * x;
    for (double& value : y) value += 2.0 * normal(engine);
    square = std::pow(point_noise(x, y) / 2.0, 2);
  }
  EXPECT_NEAR(squares.mean(), 1.0, 0.01);
  const double freedom = 2.0 / (squares - squares.mean()).square().mean();
  EXPECT_NEAR(freedom / freedom_of_point_noise(points), 1.0, 0.1);
}

}  // namespace test_curves
}  // namespace imic3d::identification
