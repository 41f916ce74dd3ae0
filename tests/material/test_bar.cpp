// The material point under mixed control, against closed forms and its derivatives against differences of the path.
#include <numeric>

#include "effect_cases.hpp"
#include "imic3d/material/bar.hpp"

namespace imic3d::material {
namespace test_bar {

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

void expect_derivatives(double of_train) {
  for (const auto& effect : testing::effect_cases()) {
    const testing::Case c = effect.made();
    std::vector<int> free;
    for (std::size_t i = 0; i < c.parameters.size(); ++i) free.push_back(static_cast<int>(i));
    BarHistory history = cycle(30.0);
    history.compliance = of_train;
    const BarOptions options{.largest_step = 0.01, .given_steps = true};
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

TEST(Bar, DerivativesMatchDifferencesOfTheWholePath) { expect_derivatives(0.0); }

TEST(Bar, DerivativesMatchThoseOfABarWhoseLoadTrainGivesWay) { expect_derivatives(4e-6); }

/// The strain of a gauge that is longer by compliance times force, of a path of the bar alone.
TEST(Bar, ALoadTrainTakesItsShareOfTheStrain) {
  constexpr double compliance = 4e-6;
  for (const testing::Case& c : testing::plastic_cases()) {
    const BarResponse alone = pull_bar(*c.law, c.parameters, cycle());
    BarHistory shown = cycle();
    shown.strain = (shown.strain.array().exp() + compliance * alone.engineering.array()).log();
    shown.compliance = compliance;
    const BarResponse r = pull_bar(*c.law, c.parameters, shown);
    ASSERT_EQ(r.rows, 12) << c.name;
    EXPECT_LT((r.engineering - alone.engineering).norm(), 1e-9 * alone.engineering.norm()) << c.name;
    EXPECT_LT((r.kirchhoff.array() - alone.engineering.array() * shown.strain.array().exp()).matrix().norm(),
              1e-9 * alone.kirchhoff.norm())
        << c.name;
    EXPECT_LT((r.plastic_strain - alone.plastic_strain).norm(), 1e-9) << c.name;
  }
}

/// A row is the step where rows are far apart: 30 rows from one turn of a cycle to the next.
TEST(Bar, BackStressesNeedNoNarrowRows) {
  const auto c = testing::with_effects("kinematic", {"kinematic"}, {40e3, 400.0});
  std::vector<int> free(c.parameters.size());
  std::iota(free.begin(), free.end(), 0);
  const auto cycle_of = [](Eigen::Index rows) {
    BarHistory history{.time = Eigen::VectorXd::LinSpaced(3 * rows + 1, 0.0, 3.0),
                       .strain = Eigen::VectorXd(3 * rows + 1)};
    const double turns[] = {0.0, 0.01, -0.01, 0.01};
    for (Eigen::Index i = 0; i <= 3 * rows; ++i) {
      const auto branch = static_cast<std::size_t>(std::min<Eigen::Index>(i / rows, 2));
      history.strain[i] = turns[branch] + (turns[branch + 1] - turns[branch]) *
                                              static_cast<double>(i - static_cast<Eigen::Index>(branch) * rows) /
                                              static_cast<double>(rows);
    }
    return history;
  };
  const BarResponse coarse = pull_bar(*c.made().law, c.parameters, cycle_of(30), free),
                    fine = pull_bar(*c.made().law, c.parameters, cycle_of(3000), free);
  const auto rows = Eigen::seqN(0, 91, 100);
  const double stress = (coarse.kirchhoff - fine.kirchhoff(rows)).norm() / coarse.kirchhoff.norm();
  double slope = 0.0;  // worst column: what the parameter is off by, if it alone is free
  for (Eigen::Index j = 0; j < coarse.derivatives.cols(); ++j) {
    const Eigen::VectorXd own = fine.derivatives(rows, j);
    if (own.norm() * c.parameters[static_cast<std::size_t>(j)] > 1e-3 * fine.kirchhoff(rows).norm())
      slope = std::max(slope, (coarse.derivatives.col(j) - own).norm() / own.norm());
  }
  std::cout << "[          ] 30 rows a branch against 3000: stress " << stress << ", derivatives " << slope << "\n";
  EXPECT_LT(stress, 1e-4);
  EXPECT_LT(slope, 0.006);
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

/// A law that follows short steps only where the axial strain is between 0.010 and 0.0125; counts what it is asked.
class Corner final : public FiniteStrainLaw {
 public:
  Corner(std::shared_ptr<const FiniteStrainLaw> law, double shortest) : law_(std::move(law)), shortest_(shortest) {}
  [[nodiscard]] const std::string& name() const override { return law_->name(); }
  [[nodiscard]] const std::vector<ParameterInfo>& parameters() const override { return law_->parameters(); }
  [[nodiscard]] int history_size() const override { return law_->history_size(); }
  void initialise(std::span<double> history) const override { law_->initialise(history); }
  [[nodiscard]] int plastic_strain_index() const override { return law_->plastic_strain_index(); }
  [[nodiscard]] int thickness_strain_index() const override { return law_->thickness_strain_index(); }
  [[nodiscard]] bool update(const Matrix3& F, double time_increment, std::span<const double> parameters,
                            std::span<const double> history_old, std::span<double> history_new, Response& response,
                            bool with_tangent) const noexcept override {
    ++asked;
    const double strain = std::log(F(0, 0));
    return !(strain > 0.010 && strain < 0.0125 && time_increment > shortest_) &&
           law_->update(F, time_increment, parameters, history_old, history_new, response, with_tangent);
  }
  [[nodiscard]] bool parameter_derivatives(
      const Matrix3& F, double time_increment, std::span<const double> parameters, std::span<const double> history_old,
      Eigen::Ref<Eigen::Matrix<double, 6, Eigen::Dynamic>> derivatives) const noexcept override {
    return law_->parameter_derivatives(F, time_increment, parameters, history_old, derivatives);
  }
  [[nodiscard]] bool directional_derivatives(const Matrix3& F, std::span<const Matrix3> dF, double time_increment,
                                             std::span<const double> parameters, std::span<const double> d_parameters,
                                             std::span<const double> history_old, std::span<const double> d_history_old,
                                             Vector6& kirchhoff, std::span<Vector6> d_kirchhoff,
                                             std::span<double> d_history_new) const noexcept override {
    return law_->directional_derivatives(F, dF, time_increment, parameters, d_parameters, history_old, d_history_old,
                                         kirchhoff, d_kirchhoff, d_history_new);
  }
  mutable int asked = 0;

 private:
  std::shared_ptr<const FiniteStrainLaw> law_;
  double shortest_;
};

TEST(Bar, StepsAreShortWhereTheyMustBeAndLongAgain) {
  const Corner law(make_law({.hardening = "voce"}), 1e-2);
  // Two rows of 26 steps of 1.9 units of time; in one place steps must be 256 times as short. To the end of their row
  // they would be 5000.
  BarHistory history{.time = Eigen::VectorXd::LinSpaced(3, 0.0, 100.0),
                     .strain = Eigen::VectorXd::LinSpaced(3, 0.0, 0.1001)};
  const BarResponse r = pull_bar(law, testing::voce_parameters(), history);
  ASSERT_EQ(r.rows, 3);
  EXPECT_GT(law.asked, 500);
  EXPECT_LT(law.asked, 3000);
  const BarResponse straight = pull_bar(*make_law({.hardening = "voce"}), testing::voce_parameters(), history);
  EXPECT_NEAR(r.kirchhoff[2] / straight.kirchhoff[2], 1.0, 1e-9);
  RecordProperty("asked", law.asked);
}

/// With an exponent near null the overstress is there at once: where the stress is just above the yield stress the rate
/// is 1e-30, and less.
TEST(Bar, ViscosityWithASmallExponentIsFollowedFromItsOnset) {
  for (double exponent : {0.1, 0.0574, 0.03, 0.01}) {
    const double overstress = 131.0;
    const auto c = testing::with_effects("viscosity", {"viscosity"}, {overstress, exponent});
    std::vector<int> free(c.parameters.size());
    std::iota(free.begin(), free.end(), 0);
    const auto plain = testing::voce_parameters();
    for (double rate : {1e-4, 1.0, 500.0}) {
      // Rows so near each other that some lie just beyond the onset, then to 10 % strain.
      const double yield = plain[2] / plain[0];
      BarHistory history{.time = Eigen::VectorXd(140), .strain = Eigen::VectorXd(140)};
      history.strain << Eigen::VectorXd::LinSpaced(80, 0.99 * yield, 1.05 * yield),
          Eigen::VectorXd::LinSpaced(60, 1.06 * yield, 0.1);
      history.time = history.strain / rate;
      const BarResponse r = pull_bar(*c.made().law, c.parameters, history, free);
      ASSERT_EQ(r.rows, 140) << "m " << exponent << ", rate " << rate;
      EXPECT_TRUE(r.derivatives.allFinite()) << "m " << exponent << ", rate " << rate;
      // sigma_y(p) + eta p'^m
      const Eigen::Index last = 139;
      const double p = r.plastic_strain[last],
                   speed = (p - r.plastic_strain[last - 1]) / (history.time[last] - history.time[last - 1]);
      const double hardened =
          pull_bar(*make_law({.hardening = "voce"}), plain,
                   {.time = history.time.tail(2), .strain = Eigen::Vector2d(0.0, p + r.kirchhoff[last] / plain[0])})
              .kirchhoff[1];
      EXPECT_NEAR(r.kirchhoff[last] / (hardened + overstress * std::pow(speed, exponent)), 1.0, 0.02)
          << "m " << exponent << ", rate " << rate;
    }
  }
}

/// Loaded at one rate, at a hundred times that, and held, in few rows: the overstress of a hold from its closed form,
/// (sigma - S_y)^(1-1/m) grows by (1/m - 1) E eta^(-1/m) in a unit of time; all of it from narrow rows.
TEST(Bar, AHoldAndAJumpOfTheRateNeedNoNarrowRows) {
  constexpr double E = 200e3, yield = 300.0, eta = 200.0, m = 0.2;
  const auto course = [](Eigen::Index parts) {
    BarHistory history{.time = Eigen::VectorXd::Zero(34 * parts + 1), .strain = Eigen::VectorXd::Zero(34 * parts + 1)};
    for (Eigen::Index i = 1; i <= 34 * parts; ++i) {
      const bool slow = i <= 9 * parts, held = i > 18 * parts;
      history.time[i] = history.time[i - 1] + (slow ? 1.0 : held ? 2.0 : 0.01) / static_cast<double>(parts);
      history.strain[i] = history.strain[i - 1] + (held ? 0.0 : 1e-3 / static_cast<double>(parts));
    }
    return history;
  };
  const auto c = testing::with_effects("viscosity", {"viscosity"}, {eta, m});
  std::vector<double> parameters = {E, 0.3, yield, yield, 15.0, 0.0, eta, m};
  std::vector<int> free = {0, 2, 6, 7};
  const BarResponse r = pull_bar(*c.made().law, parameters, course(1), free),
                    narrow = pull_bar(*c.made().law, parameters, course(200), free);
  ASSERT_EQ(r.rows, 35);
  const auto rows = Eigen::seqN(0, 35, 200);
  EXPECT_NEAR(r.kirchhoff[9], yield + eta * std::pow(1e-3, m), 0.01);
  EXPECT_NEAR(r.kirchhoff[18], yield + eta * std::pow(1e-1, m), 0.01);
  for (Eigen::Index i = 19; i <= 34; ++i) {
    const double over = std::pow(std::pow(r.kirchhoff[18] - yield, 1.0 - 1.0 / m) +
                                     (1.0 / m - 1.0) * E * std::pow(eta, -1.0 / m) * 2.0 * static_cast<double>(i - 18),
                                 1.0 / (1.0 - 1.0 / m));
    EXPECT_NEAR(r.kirchhoff[i], yield + over, 0.5) << i;
  }
  const double off = (r.kirchhoff - narrow.kirchhoff(rows)).cwiseAbs().maxCoeff();
  std::cout << "[          ] off by " << off << " MPa\n";
  EXPECT_LT(off, 0.5);
  for (Eigen::Index j = 0; j < 4; ++j)
    EXPECT_LT((r.derivatives.col(j) - narrow.derivatives(rows, j)).norm(), 0.02 * r.derivatives.col(j).norm()) << j;
}

/// 1 + C ln(1 + p'/rate_0) below zero: no yield stress is left, and a viscous stress on top of none is no metal's.
TEST(Bar, ARateThatTakesTheYieldStressAwayIsNotFollowed) {
  const auto c = testing::with_effects("rate and viscosity", {"viscosity", "rate"}, {0.7, 1.7, -0.2, 3e-4});
  const auto pulled = [&](double rate) {
    const Eigen::VectorXd strain = Eigen::VectorXd::LinSpaced(60, 0.0, 0.1);
    return pull_bar(*c.made().law, c.parameters, {.time = strain / rate, .strain = strain}).rows;
  };
  EXPECT_EQ(pulled(1e-4), 60);   // 1 - 0.2 ln(1.3)
  EXPECT_LT(pulled(500.0), 60);  // 1 - 0.2 ln(1.7e6)
}

}  // namespace test_bar
}  // namespace imic3d::material
