// The material point under mixed control, against closed forms and its derivatives against differences of the path.
#include "effect_cases.hpp"
#include "imic3d/material/bar.hpp"

namespace imic3d::material {
namespace {

/// Loading, unloading, compression, reloading, with two speeds.
BarHistory cycle(double direction = 0.0) {
  BarHistory history{.time = Eigen::VectorXd::Zero(12), .strain = Eigen::VectorXd::Zero(12), .direction = direction};
  history.strain << 0.0, 0.0005, 0.004, 0.02, 0.06, 0.055, 0.03, -0.02, -0.03, -0.025, 0.03, 0.12;
  history.time << 0, 1, 3, 10, 20, 21, 22, 30, 31, 40, 41, 100;
  return history;
}

TEST(Bar, TensionFollowsTheClosedForm) {
  for (const testing::Case& c : testing::plastic_cases()) {
    if (c.name != "linear") continue;
    const BarResponse r =
        pull_bar(*c.law, c.parameters,
                 {.time = Eigen::VectorXd::LinSpaced(40, 0, 39), .strain = Eigen::VectorXd::LinSpaced(40, 0.0, 0.4)});
    ASSERT_EQ(r.rows, 40);
    for (Eigen::Index i = 1; i < 40; ++i) {
      const double strain = 0.4 * static_cast<double>(i) / 39, E = c.parameters[0],
                   stress = (300 + 2000 * strain) / (1 + 2000 / E);
      EXPECT_NEAR(r.kirchhoff[i] / stress, 1.0, 1e-11);
      EXPECT_NEAR(r.engineering[i], stress * std::exp(-strain), 1e-8);
      EXPECT_NEAR(r.lateral(i, 0), -0.5 * (strain - stress / E) - c.parameters[1] * stress / E, 1e-12);
      EXPECT_NEAR(r.plastic_strain[i], strain - stress / E, 1e-12);
    }
  }
}

TEST(Bar, DerivativesMatchDifferencesOfTheWholePath) {
  for (const auto& effect : testing::effect_cases()) {
    const testing::Case c = effect.made();
    std::vector<int> free;
    for (std::size_t i = 0; i < c.parameters.size(); ++i) free.push_back(static_cast<int>(i));
    const BarHistory history = cycle(30.0);
    const BarOptions options{.largest_step = 0.01};
    const BarResponse r = pull_bar(*c.law, c.parameters, history, free, options);
    ASSERT_EQ(r.rows, history.strain.size()) << c.name;
    for (std::size_t i = 0; i < free.size(); ++i) {
      const auto stress = [&](double change) {
        auto parameters = c.parameters;
        parameters[i] += change;
        const Eigen::VectorXd s = pull_bar(*c.law, parameters, history, {}, options).kirchhoff;
        return std::vector<double>(s.data(), s.data() + s.size());
      };
      const Eigen::VectorXd d = r.derivatives.col(static_cast<Eigen::Index>(i));
      const std::string what = c.name + " " + c.law->parameters()[i].name;

      if (d.norm() * c.parameters[i] < 1e-4 * r.kirchhoff.norm() && c.law->parameters()[i].name == "nu")
        continue;  // a bar hardly knows it
      const auto errors = testing::difference_errors(stress, {d.data(), d.data() + d.size()}, c.parameters[i], 0.3);
      const auto best = errors.best();
      EXPECT_LT(errors.error[best], 1e-6) << what << errors.table();
      EXPECT_GT(errors.error[best], 0.0) << what << errors.table();
      EXPECT_GT(errors.error.back(), 1e3 * errors.error[best]) << what << errors.table();
      EXPECT_TRUE(errors.error.front() > 10.0 * errors.error[best] || errors.error.front() < 1e-7)
          << what << errors.table();
    }
  }
}

TEST(Bar, DirectionOfTheBarIsTheAngleOfTheMaterialAxisTheOtherWay) {
  auto turned = testing::with_effects("hill", {"hill"}, {1.2, 0.85, 1.1, -35}),
       straight = testing::with_effects("hill", {"hill"}, {1.2, 0.85, 1.1, 0});
  const BarResponse a = pull_bar(*turned.made().law, turned.parameters, cycle()),
                    b = pull_bar(*straight.made().law, straight.parameters, cycle(35.0));
  EXPECT_LT((a.kirchhoff - b.kirchhoff).norm(), 1e-10 * b.kirchhoff.norm());
  const BarResponse along = pull_bar(*straight.made().law, straight.parameters, cycle());
  EXPECT_GT((a.kirchhoff - along.kirchhoff).norm(), 1e-3 * b.kirchhoff.norm());
}

TEST(Bar, FollowsSofteningToTheEndAndRefusesPlaneStress) {
  const auto c = testing::with_effects("heating", {"heating"}, {5e-3, 0.0});
  const BarResponse r =
      pull_bar(*c.made().law, c.parameters,
               {.time = Eigen::VectorXd::LinSpaced(50, 0, 1), .strain = Eigen::VectorXd::LinSpaced(50, 0, 2)});
  EXPECT_EQ(r.rows, 50);  // the loss slows down the heating: the strength tends to 0 and never gets there
  EXPECT_GT(r.kirchhoff[49], 0.0);
  EXPECT_LT(r.kirchhoff[49], 0.2 * r.kirchhoff.maxCoeff());
  const auto plane = make_law({.hardening = "voce", .plane_stress = true});
  EXPECT_THROW((void)pull_bar(*plane, testing::voce_parameters(), cycle()), std::invalid_argument);
}

}  // namespace
}  // namespace imic3d::material
