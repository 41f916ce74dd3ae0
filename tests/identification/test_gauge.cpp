// What a gauge recorded: where it turned, its noise, and the course between.
#include <gtest/gtest.h>

#include <cmath>
#include <iostream>
#include <random>

#include "../material/effect_cases.hpp"
#include "imic3d/identification/curves.hpp"
#include "imic3d/identification/gauge.hpp"

namespace imic3d::identification {
namespace test_gauge {

std::vector<material::BarTurn> between_rows(const Eigen::VectorXd& time, const Eigen::VectorXd& strain,
                                            const Eigen::VectorXd& stress) {
  auto turns = find_turns(time, strain, stress);
  std::erase_if(turns, [](const material::BarTurn& turn) { return !turn.between; });
  return turns;
}

TEST(Gauge, TurnsBetweenRowsAreWhereTheLinesMeet) {
  // turns at 1, 3, 5 ...
  const auto triangle = [](double t) { return 0.01 * (1.0 - std::abs(std::fmod(t + 1.0, 4.0) - 2.0)); };
  const auto sampled = [](double spacing, double until, const auto& course) {
    material::BarHistory history{.time = Eigen::VectorXd::LinSpaced(static_cast<Eigen::Index>(until / spacing) + 1, 0.0,
                                                                    std::floor(until / spacing) * spacing),
                                 .strain = {}};
    history.strain = history.time.unaryExpr([&](double t) { return course(t); });
    return history;
  };
  material::BarHistory rows = sampled(0.07, 6.0, triangle);
  const auto c = material::testing::with_effects("kinematic", {"kinematic"}, {20e3, 150});
  const auto stress_of = [&](const material::BarHistory& history) {
    return material::pull_bar(*c.made().law, c.parameters, history).kirchhoff;
  };
  const material::BarHistory all = sampled(0.01, 6.0, triangle), met = sampled(0.05, 6.0, triangle);
  const Eigen::VectorXd full = stress_of(all)(Eigen::seqN(0, rows.strain.size(), 7));
  EXPECT_TRUE(between_rows(met.time, met.strain, stress_of(met)).empty());  // each turn is a row
  // the stress is that of a bar that turned at a row
  EXPECT_TRUE(between_rows(rows.time, rows.strain, stress_of(rows)).empty());
  // Where the rate changes the lines do not meet where the test turned.
  const auto wave = [](double t) { return 0.01 * std::sin(t); };
  const material::BarHistory fine = sampled(0.01, 12.0, wave);
  const Eigen::VectorXd of_wave = stress_of(fine);
  for (int apart = 10; apart <= 45; ++apart) {
    const material::BarHistory few = sampled(0.01 * apart, 12.0, wave);
    EXPECT_TRUE(between_rows(few.time, few.strain, of_wave(Eigen::seqN(0, few.strain.size(), apart))).empty()) << apart;
  }
  rows.turns = between_rows(rows.time, rows.strain, full);
  ASSERT_EQ(rows.turns.size(), 3U);
  for (std::size_t k = 0; k < 3; ++k) {
    EXPECT_NEAR(rows.turns[k].time, 1.0 + 2.0 * static_cast<double>(k), 1e-9);
    EXPECT_NEAR(rows.turns[k].strain, k % 2 == 0 ? 0.01 : -0.01, 1e-11);
    EXPECT_EQ(rows.turns[k].row, static_cast<Eigen::Index>(std::ceil(rows.turns[k].time / 0.07)));
  }
  const Eigen::VectorXd known = stress_of(rows);
  rows.turns.clear();
  const Eigen::VectorXd straight = stress_of(rows);
  const auto off = [&](const Eigen::VectorXd& stress) {
    return (stress - full).cwiseAbs().maxCoeff() / full.maxCoeff();
  };
  std::cout << "[          ] stress off by " << off(known) << " of the largest, without turns " << off(straight)
            << "\n";
  EXPECT_LT(off(known), 1e-3);
  EXPECT_GT(off(straight), 0.05);
}

/// A load train that gives way has the gauge go half as fast again as the bar while that is elastic, which may be four
/// rows.
TEST(Gauge, TurnsBetweenRowsWhereAnElasticBranchIsShort) {
  // turns at 1, 3
  const auto triangle = [](double t) { return 0.01 * (1.0 - std::abs(std::fmod(t + 1.0, 4.0) - 2.0)); };
  material::BarHistory fine{.time = Eigen::VectorXd::LinSpaced(4001, 0.0, 4.0), .strain = {}};
  fine.strain = fine.time.unaryExpr(triangle);
  const auto c = material::testing::with_effects("kinematic", {"kinematic"}, {20e3, 150});
  const Eigen::VectorXd stress = material::pull_bar(*c.made().law, c.parameters, fine).kirchhoff;
  const Eigen::VectorXd strain = fine.strain + 2.5e-6 * stress;
  const auto rows = Eigen::seqN(30, 57, 70);
  const auto turns = between_rows(fine.time(rows), strain(rows), stress(rows));
  ASSERT_EQ(turns.size(), 2U);
  EXPECT_NEAR(turns[0].time, 1.0, 0.002);
  EXPECT_NEAR(turns[1].time, 3.0, 0.002);
}

/// A hundredth of a row's way beyond the row: it is passed through.
TEST(Gauge, ATurnJustBeyondARowIsPassedThrough) {
  const auto triangle = [](double t) { return 0.01 * (1.0 - std::abs(std::fmod(t + 1.0, 4.0) - 2.0)); };
  material::BarHistory fine{.time = Eigen::VectorXd::LinSpaced(4201, 0.0, 4.2), .strain = {}};
  fine.strain = fine.time.unaryExpr(triangle);
  const auto c = material::testing::with_effects("kinematic", {"kinematic"}, {20e3, 150});
  const auto rows = Eigen::seqN(99, 42, 100);  // 0.099, 0.199 ...
  const auto turns = between_rows(fine.time(rows), fine.strain(rows),
                                  material::pull_bar(*c.made().law, c.parameters, fine).kirchhoff(rows));
  ASSERT_EQ(turns.size(), 2U);
  EXPECT_NEAR(turns[0].strain, 0.01, 1e-9);
  EXPECT_NEAR(turns[1].strain, -0.01, 1e-9);
}

Eigen::VectorXd drawn(Eigen::Index count, double deviation, unsigned seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  return Eigen::VectorXd(count).unaryExpr([&](double) { return deviation * normal(random); });
}

/// A twentieth of a row's way beyond the row (5 MPa of the branch behind it) noise hides; the other turns tell, between
/// rows or at them.
TEST(Gauge, TurnsInDoubtAreAsTheOthers) {
  const auto triangle = [](double t) { return 0.01 * (1.0 - std::abs(std::fmod(t + 1.0, 4.0) - 2.0)); };
  material::BarHistory fine{.time = Eigen::VectorXd::LinSpaced(12001, 0.0, 6.0), .strain = {}};
  fine.strain = fine.time.unaryExpr(triangle);
  const auto c = material::testing::with_effects("kinematic", {"kinematic"}, {20e3, 150});
  const auto rows = Eigen::seqN(33, 84, 140);  // 0.0165, 0.0865 ... 0.9965
  material::BarHistory seen{.time = fine.time(rows), .strain = fine.strain(rows)};
  const Eigen::VectorXd between = material::pull_bar(*c.made().law, c.parameters, fine).kirchhoff(rows),
                        at_rows = material::pull_bar(*c.made().law, c.parameters, seen).kirchhoff;
  for (const auto& [stress, expected] : {std::pair(between, 3U), std::pair(at_rows, 0U)})
    for (unsigned seed = 0; seed < 40; ++seed)
      EXPECT_EQ(between_rows(seen.time, seen.strain, stress + drawn(seen.strain.size(), 2.0, seed)).size(), expected)
          << seed;
}

/// A course that bends from row to row, and one of which most rows were put on the line between two others.
TEST(Gauge, NoiseOfABentCourse) {
  const Eigen::VectorXd strain = Eigen::VectorXd::LinSpaced(300, 0.0, 0.3), noise = drawn(300, 1.0, 4);
  const Eigen::VectorXd bent = (200.0 * strain.array()).sin() * 300.0;
  EXPECT_GT(point_noise(strain, bent + noise), 1.5);
  EXPECT_NEAR(noise_of_course(strain, bent + noise), 1.0, 0.2);
  Eigen::VectorXd filled = bent + noise;
  for (Eigen::Index row = 0; row < 300; ++row)
    if (const Eigen::Index from = row - row % 6; row % 6 != 0 && from + 6 < 300)
      filled[row] = filled[from] + (filled[from + 6] - filled[from]) * static_cast<double>(row % 6) / 6.0;
  EXPECT_EQ(noise_of_course(strain, filled), point_noise(strain, filled));
}

/// Not where the rate changes from row to row, nor where the bar moved so, which the stress tells.
TEST(Gauge, NoiseIsWhatGoesAgainstItsNeighbours) {
  constexpr Eigen::Index count = 800;
  constexpr double noise = 2e-5;
  const Eigen::VectorXd time = Eigen::VectorXd::LinSpaced(count, 0.0, 80.0), of_strain = drawn(count, noise, 1),
                        of_stress = drawn(count, 1.0, 2);
  const Eigen::VectorXd ramp = 1e-4 * time, wave = (0.3 * time.array()).sin() * 0.01;
  EXPECT_NEAR(strain_noise(time, ramp + of_strain, 200e3 * ramp + of_stress), noise, 0.1 * noise);
  EXPECT_EQ(strain_noise(time, ramp + of_strain, 200e3 * (ramp + of_strain) + of_stress), 0.0);
  EXPECT_LT(strain_noise(time, wave, 200e3 * wave + of_stress), 1e-7);
  EXPECT_NEAR(strain_noise(time, wave + of_strain, 200e3 * wave + of_stress), noise, 0.15 * noise);
  EXPECT_EQ(strain_noise(time, ramp, 200e3 * ramp + of_stress), 0.0);
  // Forty rows a cycle: a tenth of them beside a turn.
  const Eigen::VectorXd cycles = (0.5 * M_PI * time.array()).sin().asin() * 0.02 / M_PI;
  EXPECT_NEAR(strain_noise(time, cycles + 0.2 * of_strain, 200e3 * cycles + of_stress), 0.2 * noise, 0.06 * noise);
}

/// Rows closer than the noise: the turn is found where it was, with the deviation that it has, and the course between
/// goes by the noise of many.
TEST(Gauge, TurnsAndCourseOfANoisyStrain) {
  constexpr Eigen::Index count = 1200;
  constexpr double noise = 2e-5;
  const auto course = [](double t) { return 1e-3 * (t < 10.013 ? t : t < 11.507 ? 20.026 - t : t - 2.988); };
  const Eigen::VectorXd time = Eigen::VectorXd::LinSpaced(count, 0.0, 17.0), truth = time.unaryExpr(course);
  Eigen::VectorXd flows = truth;  // flow as far as the bar has been pulled, elastic below
  for (Eigen::Index i = 1; i < count; ++i)
    flows[i] = std::max(flows[i - 1], i * time[1] < 10.013 ? truth[i] : std::max(10.013e-3, truth[i]));
  double square = 0.0, rows = 0.0;
  for (unsigned seed = 0; seed < 20; ++seed) {
    const Eigen::VectorXd strain = truth + drawn(count, noise, 10 + seed),
                          stress = (400.0 + 2e3 * flows.array() - 200e3 * (flows - truth).array()).matrix() +
                                   drawn(count, 1.0, 50 + seed);
    const auto turns = find_turns(time, strain, stress, noise);
    ASSERT_EQ(turns.size(), 2U);
    for (const auto& turn : turns)
      square += std::pow(turn.strain - course(turn.time > 10.7 ? 11.507 : 10.013), 2) /
                (std::pow(turn.deviation, 2) + (turn.between ? 0.0 : noise * noise)) / 40.0;
    const Eigen::VectorXd smooth = smooth_strain(time, strain, turns, noise);
    rows += (smooth - truth).squaredNorm() / (20.0 * count);
    EXPECT_LE(smooth.head(700).maxCoeff(), turns[0].strain + 1e-15);
  }
  EXPECT_LT(std::sqrt(square), 1.5);
  EXPECT_GT(std::sqrt(square), 0.5);
  EXPECT_LT(std::sqrt(rows), 0.5 * noise);
  const Eigen::VectorXd apart = Eigen::VectorXd::LinSpaced(40, 0.0, 0.02) + drawn(40, noise, 5);
  EXPECT_EQ(smooth_strain(Eigen::VectorXd::LinSpaced(40, 0.0, 20.0), apart, {}, noise), apart);
}

/// Where the rate changes it went further by the parabola through three rows; with too few rows, by half of a corner;
/// between the rows or not, by half of the way where the stress tells neither.
TEST(Gauge, TurnsAreInDoubtByWhatTheyMayHaveGoneFurther) {
  const Eigen::VectorXd time = Eigen::VectorXd::LinSpaced(41, 0.0, 4.0);
  const Eigen::VectorXd parabola = (0.01 - 1e-3 * (time.array() - 2.03).square()).matrix();
  auto turns = find_turns(time, parabola, 200e3 * parabola);
  ASSERT_EQ(turns.size(), 1U);
  EXPECT_FALSE(turns[0].between);
  EXPECT_EQ(turns[0].row, 20);
  EXPECT_NEAR(turns[0].deviation, 1e-3 * 0.03 * 0.03, 1e-12);

  // a corner between the last two lies 0.3e-3 further
  const Eigen::Vector3d few_times(0.0, 1.0, 2.0), few(0.0, 1e-3, 0.6e-3);
  turns = find_turns(few_times, few, 200e3 * few);
  ASSERT_EQ(turns.size(), 1U);
  EXPECT_NEAR(turns[0].deviation, 0.15e-3, 1e-12);

  const Eigen::VectorXd triangle = time.unaryExpr([](double t) { return 1e-3 * (t < 2.04 ? t : 4.08 - t); });
  const Eigen::VectorXd flowed = time.binaryExpr(triangle, [](double t, double strain) {
    return t < 2.04 ? 2e3 * strain : 2e3 * 2.04e-3 + 200e3 * (strain - 2.04e-3);
  });
  turns = find_turns(time, triangle, flowed + drawn(41, 20.0, 3));  // 0.04e-3 further, 8 MPa
  ASSERT_EQ(turns.size(), 1U);
  EXPECT_NEAR(turns[0].deviation, 0.5 * 0.04e-3, 1e-9);
  turns = find_turns(time, triangle, flowed);  // the stress tells
  ASSERT_EQ(turns.size(), 1U);
  EXPECT_TRUE(turns[0].between);
  EXPECT_NEAR(turns[0].strain, 2.04e-3, 1e-12);
  EXPECT_NEAR(turns[0].deviation, 0.1 * 0.04e-3, 1e-9);
}

/// The way from the row before a turn to the one after it is no slope; the strain's noise weighs where it moves the
/// stress.
TEST(Gauge, SlopesAndNoiseOfTheRows) {
  material::BarHistory history{.time = Eigen::VectorXd::LinSpaced(6, 0.0, 5.0), .strain = Eigen::VectorXd(6)};
  history.strain << 0.0, 1e-3, 2e-3, 1.8e-3, 0.8e-3, -0.2e-3;
  Eigen::VectorXd stress(6);
  stress << 0.0, 200.0, 210.0, 113.0, -87.0, -287.0;
  EXPECT_GT(slopes(history, stress)[3], 400e3);
  history.turns = {{3, true, 2.5, 2.3e-3, 0.0}};
  EXPECT_NEAR(slopes(history, stress)[3], 200e3, 1e-6);
  EXPECT_EQ(slopes(history, stress, 190e3)[4], 190e3);
  history.turns[0].back = false;  // a corner alone
  EXPECT_GT(slopes(history, stress)[3], 400e3);
  history.turns = {{5, true, 4.5, -0.2e-3, 0.0}};
  EXPECT_NEAR(slopes(history, stress)[5], 200e3, 1e-6);  // there is no row after it

  const Eigen::VectorXd strain = Eigen::VectorXd::LinSpaced(200, 0.0, 0.02),
                        slope = strain.unaryExpr([](double e) { return e < 2e-3 ? 200e3 : 2e3; }),
                        residual = drawn(200, 3.0, 7);
  EXPECT_EQ(point_noise(strain, residual, slope, 3.0, 1e-6).strain, 0.0);
  EXPECT_EQ(point_noise(strain, residual, slope, 3.0, 1e-5).strain, 1e-5);
}

/// Pulled, held and unloaded: the rows of a hold are those of a strain that stands still, next to its corners, too.
TEST(Gauge, AHoldHasCorners) {
  constexpr Eigen::Index count = 251;
  constexpr double noise = 3e-6;
  const Eigen::VectorXd time = Eigen::VectorXd::LinSpaced(count, 0.0, 30.0), truth = time.unaryExpr([](double t) {
    return 3e-3 * std::min({t, 2.4, 30.0 - t});
  });
  for (unsigned seed = 0; seed < 10; ++seed) {
    const Eigen::VectorXd smooth = smooth_strain(time, truth + drawn(count, noise, seed), {}, noise);
    EXPECT_LT((smooth - truth).cwiseAbs().maxCoeff(), 4.0 * noise) << seed;
    EXPECT_LT((smooth - truth).segment(30, 190).norm(), 0.5 * noise * std::sqrt(190.0)) << seed;
  }
}

/// From a ramp to a hold, and on: found between rows, with noise, too; not where a row has it, nor where the rate
/// changes slowly.
TEST(Gauge, CornersBetweenRowsAreWhereTheLinesMeet) {
  const auto course = [](double t) { return 1e-3 * (std::min(t, 10.25) + 0.2 * std::max(0.0, t - 30.4)); };
  const Eigen::VectorXd time = Eigen::VectorXd::LinSpaced(51, 0.0, 50.0), truth = time.unaryExpr(course);
  for (const double noise : {0.0, 3e-6}) {
    const auto corners = find_corners(time, truth + drawn(51, noise, 2), {}, noise);
    ASSERT_EQ(corners.size(), 2U) << noise;
    const double moments[] = {10.25, 30.4};
    for (std::size_t k = 0; k < 2; ++k) {
      EXPECT_NEAR(corners[k].time, moments[k], 1e-9 + 3e4 * noise);
      EXPECT_NEAR(corners[k].strain, 10.25e-3, 1e-12 + 4.0 * noise);
      EXPECT_EQ(corners[k].row, static_cast<Eigen::Index>(std::ceil(moments[k])));
      EXPECT_TRUE(corners[k].between && !corners[k].back);
    }
    // beside turns
    EXPECT_TRUE(find_corners(time, truth, {{11, false, 11.0, 10.25e-3}, {30, false, 30.0, 10.25e-3}}, noise).empty());
  }
  EXPECT_TRUE(find_corners(time, time.unaryExpr([](double t) { return 1e-3 * std::min(t, 10.0); }), {}).empty());
  for (int apart = 10; apart <= 45; ++apart) {
    const Eigen::VectorXd few = Eigen::VectorXd::LinSpaced(60, 0.0, 0.01 * apart * 59);
    EXPECT_TRUE(find_corners(few, few.array().sin().matrix() * 0.01, {}).empty()) << apart;
  }
}

/// A clock of whole seconds beside three rows a second, one that steps over a hold, and one that is fine enough.
TEST(Gauge, RowsOfOneStampFollowOneAnother) {
  Eigen::VectorXd time(40);
  for (int row = 0; row < 40; ++row) time[row] = std::floor(7.7 + row / 3.0);
  const double first = time[0];
  EXPECT_EQ(spread_stamps(time), 40 - 14);
  for (int row = 1; row < 40; ++row) EXPECT_NEAR(time[row] - time[0], row / 3.0, 0.34) << row;
  for (int row = 1; row < 40; ++row) EXPECT_GT(time[row], time[row - 1]) << row;
  EXPECT_NEAR(time[0], first + 2.0 / 3.0, 1e-12);  // one of three rows of the first second
  Eigen::VectorXd held(6);
  held << 0.0, 0.0, 1.0, 1.0, 50.0, 50.0;
  EXPECT_EQ(spread_stamps(held), 3);
  EXPECT_TRUE(held.isApprox((Eigen::VectorXd(6) << 0.0, 0.5, 1.0, 1.5, 50.0, 50.5).finished())) << held.transpose();
  const Eigen::VectorXd fine = Eigen::VectorXd::LinSpaced(5, 0.0, 1.0);
  Eigen::VectorXd same = fine, one = Eigen::VectorXd::Constant(3, 2.0);
  EXPECT_EQ(spread_stamps(same), 0);
  EXPECT_EQ(fine, same);
  EXPECT_EQ(spread_stamps(one), 0);
}

}  // namespace test_gauge
}  // namespace imic3d::identification
