// What is added to J2: null values, closed forms, derivatives, objectivity, thermodynamics.
#include "effect_cases.hpp"

namespace imic3d::material {
namespace test_effects {

using testing::Case;
using testing::MaterialPoint;
using testing::Random;

const Matrix3 I = Matrix3::Identity();
constexpr double E = 200e3, nu = 0.3;

TEST(Effects, AtTheirNullValuesAreJ2) {
  double worst = 0.0;
  for (const bool plane : {false, true})
    for (const bool cauchy : {false, true})
      for (const Case& c : testing::plastic_cases()) {
        LawChoice choice{.law = "j2",
                         .hardening = c.name == "power_linear_tied" ? "power_linear" : c.name,
                         .tie_initial_modulus = c.name == "power_linear_tied",
                         .plane_stress = plane,
                         .cauchy_yield = cauchy};
        if (c.name == "table") choice.table_strain = {0, 0.01, 0.05, 0.2};
        const auto j2 = make_law(choice);
        const Case extended = testing::at_null(choice, c.parameters);
        MaterialPoint a(*j2, c.parameters), b(*extended.law, extended.parameters);
        Random random(101);
        Matrix3 F = I;
        for (int step = 0; step < 20; ++step) {
          Matrix3 L = random.matrix(step % 5 == 4 ? 3e-4 : 0.03);
          if (plane) L.row(2).setZero(), L.col(2).setZero();
          F = (I + L) * F;
          const Response from_j2 = a.advance(F), from_extended = b.advance(F);
          const double size = from_j2.kirchhoff.norm();
          worst = std::max(worst, (from_j2.kirchhoff - from_extended.kirchhoff).norm() / size);
          EXPECT_LT((from_j2.kirchhoff - from_extended.kirchhoff).norm(), 1e-11 * size) << c.name << " step " << step;
          EXPECT_NEAR(a.plastic_strain(), b.plastic_strain(), 1e-13 * (1.0 + a.plastic_strain()));
          if (cauchy) continue;  // J2's own tangent leaves the change of J out
          for (int i = 0; i < 6; ++i)
            for (int j = 0; j < 6; ++j)
              if (!plane || (i != 2 && i < 4 && j != 2 && j < 4)) {
                EXPECT_NEAR(from_j2.tangent(i, j), from_extended.tangent(i, j), 1e-10 * from_j2.tangent.norm())
                    << c.name << " step " << step;
              }
        }
        EXPECT_GT(a.plastic_strain(), 0.1) << c.name;
      }
  std::printf("effects at their null values against J2: stress differs by at most %.1e\n", worst);
}

TEST(Effects, AtRestTheTangentIsElastic) {
  const Matrix6 elastic = MaterialPoint(*make_law({.law = "elastic"}), {E, nu}).at(I).tangent;
  for (const auto& effect : testing::effect_cases()) {
    const Case c = effect.made();
    EXPECT_LT((MaterialPoint(*c.law, c.parameters).at(I).tangent - elastic).norm(), 1e-13 * elastic.norm()) << c.name;
  }
}

TEST(Effects, EachOneChangesTheStress) {
  for (const auto& effect : testing::effect_cases()) {
    const Case c = effect.made();
    std::vector<double> null = c.parameters;
    for (std::size_t i = 0; i < null.size(); ++i) null[i] = c.law->parameters()[i].null_value.value_or(null[i]);
    MaterialPoint with(*c.law, c.parameters), without(*c.law, null);
    const Matrix3 F = I + Random(3).matrix(0.05);
    with.advance(F), without.advance(F);
    const Matrix3 more = (I + Random(4).matrix(0.05)) * F;
    const Vector6 a = with.at(more).kirchhoff, b = without.at(more).kirchhoff;
    EXPECT_GT((a - b).norm(), 1e-4 * b.norm()) << effect.name;
  }
}

TEST(Effects, TangentMatchesDifferencesOfTheStressAndItsSymmetryIsAsTheLawSays) {
  for (const auto& effect : testing::effect_cases()) {
    const Case c = effect.made();
    Random random(7);
    MaterialPoint point(*c.law, c.parameters);
    Matrix3 F = I;
    double asymmetry = 0.0;
    for (int step = 0; step < 6; ++step) {
      F = (I + random.matrix(0.03)) * F;
      const Matrix3 L = random.matrix(1.0);
      ASSERT_GT(point.plastic_strain_after(F), point.plastic_strain() + 1e-3) << c.name << ": the state must yield";
      const Response response = point.at(F);
      const Matrix3 tau = testing::tensor_of(response.kirchhoff);
      const Vector6 rate =
          response.tangent * testing::engineering_strain(L) + testing::vector_of(L * tau + tau * L.transpose());
      testing::expect_v_shaped(
          testing::difference_errors([&](double t) { return testing::listed(point.at((I + t * L) * F).kirchhoff); },
                                     testing::listed(rate), 1.0, 1e-3),
          c.name + " step " + std::to_string(step));
      asymmetry =
          std::max(asymmetry, (response.tangent - response.tangent.transpose()).norm() / response.tangent.norm());
      point.advance(F);
    }
    if (c.law->symmetric_tangent())
      EXPECT_LT(asymmetry, 1e-12) << c.name;
    else
      EXPECT_GT(asymmetry, 1e-5) << c.name;
  }
}

TEST(Effects, TangentOfAYieldStressInCauchyStressIsSymmetricAndOffByNoMoreThanTheStress) {
  for (const Case& c : testing::plastic_cases()) {
    if (c.name == "table" || c.name == "power_linear_tied") continue;
    const auto law = make_law({.law = "j2", .hardening = c.name, .cauchy_yield = true, .effects = {"voce_term"}});
    ASSERT_TRUE(law->symmetric_tangent());
    std::vector<double> parameters = c.parameters;
    parameters.insert(parameters.end(), {80.0, 12.0});
    Random random(7);
    MaterialPoint point(*law, parameters);
    Matrix3 F = I;
    for (int step = 0; step < 6; ++step) {
      F = (I + random.matrix(0.03)) * F;
      Matrix3 L = random.matrix(1.0);
      L /= L.norm();
      const Response response = point.at(F);
      EXPECT_LT((response.tangent - response.tangent.transpose()).norm(), 1e-12 * response.tangent.norm()) << c.name;
      const Matrix3 tau = testing::tensor_of(response.kirchhoff);
      const Vector6 rate =
          response.tangent * testing::engineering_strain(L) + testing::vector_of(L * tau + tau * L.transpose());
      constexpr double h = 1e-6;
      const Vector6 difference =
          (point.at((I + h * L) * F).kirchhoff - point.at((I - h * L) * F).kirchhoff) / (2.0 * h);
      EXPECT_LT((rate - difference).norm(), 2.0 * response.kirchhoff.norm()) << c.name << " step " << step;
      EXPECT_LT((rate - difference).norm(), 0.05 * response.tangent.norm()) << c.name << " step " << step;
      point.advance(F);
    }
  }
}

TEST(Effects, RotationsOfTheSpecimenTurnTheStress) {
  for (const auto& effect : testing::effect_cases()) {
    const Case c = effect.made();
    MaterialPoint point(*c.law, c.parameters), turned(*c.law, c.parameters), cut(*c.law, c.parameters);
    Random random(13);
    const Matrix3 R = random.rotation();  // of the material before the test: no matter where it is isotropic
    Matrix3 F = I;
    double anisotropy = 0.0;
    for (int step = 0; step < 15; ++step) {
      F = (I + random.matrix(0.04)) * F;
      const Matrix3 Q = random.rotation();
      const Matrix3 tau = testing::tensor_of(point.advance(F).kirchhoff), expected = Q * tau * Q.transpose();
      EXPECT_LT((testing::tensor_of(turned.advance(Q * F).kirchhoff) - expected).norm(), 1e-11 * expected.norm())
          << c.name << " step " << step;
      anisotropy = std::max(anisotropy, (testing::tensor_of(cut.advance(F * R).kirchhoff) - tau).norm() / tau.norm());
    }
    if (effect.name.starts_with("hill") || effect.name == "all")
      EXPECT_GT(anisotropy, 1e-3) << c.name;
    else
      EXPECT_LT(anisotropy, 1e-11) << c.name;
  }
}

/// A bar along axis 1 with no other stress, strains by the trial strain alone. stress: Kirchhoff.
class Bar {
 public:
  explicit Bar(const testing::EffectCase& c) : law_(make_law(c.choice)), point_(*law_, c.parameters) {}
  /// Elongates to the logarithmic strain; the lateral strains by Newton's method.
  double pull(double strain, double time_increment = 1.0) {
    Eigen::Vector2d lateral = lateral_;
    std::vector<double> next(point_.history().size());
    Response r;
    const auto gradient = [&] {
      return Matrix3(Eigen::Vector3d(std::exp(strain), std::exp(lateral[0]), std::exp(lateral[1])).asDiagonal());
    };
    for (int i = 0; i < 60; ++i) {
      if (!law_->update(gradient(), time_increment, point_.parameters(), point_.history(), next, r, true))
        throw std::runtime_error("the law could not follow");
      const Eigen::Matrix2d slope = r.tangent.block<2, 2>(1, 1) +
                                    2.0 * Eigen::Matrix2d(Eigen::Vector2d(r.kirchhoff[1], r.kirchhoff[2]).asDiagonal());
      const Eigen::Vector2d change = slope.partialPivLu().solve(Eigen::Vector2d(r.kirchhoff[1], r.kirchhoff[2]));
      lateral -= change;
      if (change.norm() < 1e-15) break;
    }
    lateral_ = lateral;
    return point_.advance(gradient(), time_increment).kirchhoff[0];
  }
  [[nodiscard]] const Eigen::Vector2d& lateral() const { return lateral_; }
  [[nodiscard]] const MaterialPoint& point() const { return point_; }

 private:
  testing::LawPointer law_;
  MaterialPoint point_;
  Eigen::Vector2d lateral_ = Eigen::Vector2d::Zero();
};

testing::EffectCase linear(std::vector<std::string> effects, const std::vector<double>& values, double S_y = 300,
                           double H = 0) {
  testing::EffectCase c{"linear", {.law = "j2", .hardening = "linear", .effects = std::move(effects)}, {E, nu, S_y, H}};
  c.parameters.insert(c.parameters.end(), values.begin(), values.end());
  return c;
}

TEST(KinematicHardening, UniaxialCycleFollowsTheAnalyticSolution) {
  // Lemaitre & Chaboche: X = s C/gamma + (X_0 - s C/gamma) exp(-s gamma (ep - ep_0)), sigma = X + s S_y, s = +1, -1.
  const double C = 40e3, gamma = 200, S_y = 200;
  const auto error = [&](int steps) {
    Bar bar(linear({"kinematic"}, {C, gamma}, S_y));
    double ep0 = 0.0, X0 = 0.0, worst = 0.0, from = 0.0;
    int sign = 1;
    for (const double to : {0.02, -0.02, 0.015}) {
      double stress = 0.0;
      for (int k = 1; k <= steps; ++k) stress = bar.pull(from + (to - from) * k / steps);
      const double ep = to - stress / E,
                   X = sign * C / gamma + (X0 - sign * C / gamma) * std::exp(-sign * gamma * (ep - ep0));
      worst = std::max(worst, std::abs(stress - (X + sign * S_y)) / S_y);
      ep0 = ep, X0 = X, from = to, sign = -sign;
    }
    return worst;
  };
  const double coarse = error(200), fine = error(400), finest = error(800);
  EXPECT_LT(finest, 1e-3);
  EXPECT_NEAR(coarse / fine, 2.0, 0.1) << "backward Euler is of first order";
  EXPECT_NEAR(fine / finest, 2.0, 0.1);
  std::printf("Armstrong-Frederick cycle against the analytic solution: %.1e with 800 steps a branch, ratio %.3f\n",
              finest, fine / finest);
}

TEST(KinematicHardening, WithoutFadingIsPrager) {
  // gamma = 0: sigma = S_y + C ep exactly, and yields on reversal 2 S_y lower.
  Bar bar(linear({"kinematic"}, {5000, 0}, 200));
  const double top = bar.pull(0.01);
  EXPECT_NEAR(top, (200 + 5000 * 0.01) / (1 + 5000 / E), 1e-9);
  double before = top, strain = 0.01, p = bar.point().plastic_strain();
  while (bar.point().plastic_strain() == p) before = bar.pull(strain -= 1e-5);
  EXPECT_NEAR(top - before, 400, 1e-5 * E);
}

TEST(KinematicHardening, SaturatedLoopCloses) {
  Bar bar(linear({"kinematic", "kinematic_2"}, {60e3, 300, 5e3, 30}, 150));
  std::vector<double> tops;
  double strain = 0.0;
  for (int cycle = 0; cycle < 40; ++cycle)
    for (const double to : {0.01, -0.01}) {
      double stress = 0.0;
      for (int k = 1; k <= 40; ++k) stress = bar.pull(strain + (to - strain) * k / 40);
      strain = to;
      if (to > 0) tops.push_back(stress);
    }
  EXPECT_NEAR(tops.back(), tops[tops.size() - 2], 1e-9 * tops.back());
  EXPECT_GT(std::abs(tops[1] - tops[0]), 1e-3 * tops[0]) << "the first cycles must differ";
}

TEST(Hill48, YieldStressesAndStrainRatiosAreThoseOfTheParameters) {
  const double R_22 = 1.15, R_33 = 0.9, R_12 = 1.05, S_y = 300;
  const double a = 1 / (R_22 * R_22), b = 1 / (R_33 * R_33), F = 0.5 * (a + b - 1), G = 0.5 * (b - a + 1),
               H = 0.5 * (1 + a - b), N = 1.5 / (R_12 * R_12);
  for (const double degrees : {0.0, 90.0}) {
    Bar bar(linear({"hill"}, {R_22, R_33, R_12, degrees}, S_y, 0.0));
    double stress = 0.0;
    for (int k = 1; k <= 20; ++k) stress = bar.pull(0.01 * k);
    const Eigen::Vector2d plastic = bar.lateral() + Eigen::Vector2d::Constant(nu * stress / E);
    EXPECT_NEAR(stress / (degrees == 0.0 ? S_y : S_y * R_22), 1.0, 1e-12);
    EXPECT_NEAR(plastic[0] / plastic[1], degrees == 0.0 ? H / G : H / F, 1e-10);  // Lankford's r_0, r_90
  }
  // Simple shear stress in material axes: small strain, tau sqrt(3) = R_12 S_y; and at 45 degrees r = N/(F+G) - 1/2 by
  // the flow of the yield function, written out.
  const auto law = make_law(linear({"hill"}, {}).choice);
  const std::vector<double> parameters = {E, nu, S_y, 0.0, R_22, R_33, R_12, 0.0};
  MaterialPoint point(*law, parameters);
  Matrix3 F_shear = I;
  F_shear(0, 1) = F_shear(1, 0) = 0.004;
  EXPECT_NEAR(point.at(F_shear).kirchhoff[3] * std::sqrt(3.0), R_12 * S_y,
              1e-4 * S_y);            // and a Poynting effect of strain^2
  const double F1 = 0.5 * b, N1 = N;  // R_22 = 1: F = G, and no shear under tension at 45 degrees
  Bar bar(linear({"hill"}, {1.0, R_33, R_12, 45.0}, S_y, 0.0));
  double stress = 0.0;
  for (int k = 1; k <= 20; ++k) stress = bar.pull(0.01 * k);
  const Eigen::Vector2d plastic = bar.lateral() + Eigen::Vector2d::Constant(nu * stress / E);
  EXPECT_NEAR(plastic[0] / plastic[1], N1 / (2 * F1) - 0.5, 1e-10);  // Lankford's r_45 = N / (F + G) - 1/2
  EXPECT_NEAR(stress / S_y, 2 / std::sqrt(F1 * 2 + 2 * N1), 1e-12);  // q^2 = sigma^2 (F + G + 2 N) / 4
}

TEST(Viscosity, SteadyStateIsPerzynas) {
  // Perfectly plastic: at a constant rate the stress settles at S_y + eta rate^m; and relaxes to S_y when held.
  for (const double m : {1.0, 0.3}) {
    const double rate = 0.01, eta = 150;
    Bar bar(linear({"viscosity"}, {eta, m}));
    double stress = 0.0;
    for (int k = 1; k <= 200; ++k) stress = bar.pull(1e-3 * k, 1e-3 / rate);
    EXPECT_NEAR(stress, 300 + eta * std::pow(rate, m), 1e-8);
    for (int k = 0; k < 60; ++k) stress = bar.pull(0.2, 100.0 * std::pow(2.0, k / 2));
    EXPECT_NEAR(stress, 300, 0.1);
  }
}

TEST(Rate, FactorIsJohnsonAndCooks) {
  const double C = 0.03, rate_0 = 1e-6;
  const auto flow_stress = [&](double rate) {
    Bar bar(linear({"rate"}, {C, rate_0}));
    double stress = 0.0;
    for (int k = 1; k <= 20; ++k) stress = bar.pull(5e-3 * k, 5e-3 / rate);
    return stress;
  };
  const double slow = flow_stress(1e-4), fast = flow_stress(1e2);
  EXPECT_NEAR(slow, 300 * (1 + C * std::log(1 + 1e-4 / rate_0)), 1e-8);
  EXPECT_NEAR(fast, 300 * (1 + C * std::log(1 + 1e2 / rate_0)), 1e-8);
  EXPECT_NEAR(fast / slow, (1 + C * std::log(1e2 / rate_0)) / (1 + C * std::log(1e-4 / rate_0)),
              4e-4);  // without the 1: C ln(101/100) less
  EXPECT_NEAR(Bar(linear({"rate"}, {C, rate_0})).pull(0.01, 0.0), 300, 1e-9) << "a step without duration has no rate";
}

TEST(Heating, AdiabaticIsTheClosedFormAndSlowIsIsothermal) {
  // Perfectly plastic, adiabatic: dw = S_y (1 - h w) dp, so that sigma = S_y exp(-h S_y p).
  const double h = 1e-3, S_y = 300;
  const auto stress_after = [&](int steps, double cooling, double step_time) {
    Bar bar(linear({"heating"}, {h, cooling}, S_y));
    double stress = 0.0;
    for (int k = 1; k <= steps; ++k) stress = bar.pull(0.4 * k / steps, step_time);
    return std::pair{stress, bar.point().plastic_strain()};
  };
  double error[2];
  for (int i = 0; i < 2; ++i) {
    const auto [stress, p] = stress_after(200 << i, 0.0, 1.0);
    error[i] = stress / (S_y * std::exp(-h * S_y * p)) - 1.0;
  }
  EXPECT_LT(std::abs(error[1]), 1e-4);
  EXPECT_NEAR(error[0] / error[1], 2.0, 0.05);
  EXPECT_NEAR(stress_after(200, 1.0, 1e6).first, S_y, 1e-3);
}

TEST(Plateau, YieldsAtConstantStressAndThenHardens) {
  Bar bar(linear({"plateau"}, {0.02}, 300, 2000));
  EXPECT_NEAR(bar.pull(0.01), 300, 1e-9);
  EXPECT_NEAR(bar.pull(0.02), 300, 1e-9);
  const double stress = bar.pull(0.06), p = bar.point().plastic_strain();
  EXPECT_NEAR(stress, 300 + 2000 * (p - 0.02), 1e-9);
}

TEST(VoceTerm, AddsItsStress) {
  Bar bar(linear({"voce_term"}, {80, 25}, 300, 1000));
  const double stress = bar.pull(0.05), p = bar.point().plastic_strain();
  EXPECT_NEAR(stress, 300 + 1000 * p + 80 * (1 - std::exp(-25 * p)), 1e-9);
}

TEST(PowerTerm, MakesEquation18OfLinearHardening) {
  Bar bar(linear({"power_term"}, {0.042, 6e-5}, 284, 1480));
  for (const double strain : {0.002, 0.01, 0.1}) {
    const double stress = bar.pull(strain), p = bar.point().plastic_strain();
    EXPECT_NEAR(stress, 1480 * p + 284 * std::pow(1 + p / 6e-5, 0.042), 1e-9);
  }
}

TEST(Damage, ScalesStressAndUnloadingStiffness) {
  Bar bar(linear({"damage"}, {2.0, 0.01}, 300, 1000));
  const double stress = bar.pull(0.08), p = bar.point().plastic_strain(), integrity = std::exp(-2.0 * (p - 0.01));
  EXPECT_NEAR(stress, integrity * (300 + 1000 * p), 1e-8);
  const double unloaded = bar.pull(0.0795);
  EXPECT_EQ(bar.point().plastic_strain(), p);
  EXPECT_NEAR((stress - unloaded) / 5e-4, integrity * E, 1e-4 * E);
}

TEST(Pressure, YieldsEarlierInTensionAndDilates) {
  const double a = 0.3, b = 0.2, S_y = 300;
  for (const int sign : {1, -1}) {
    Bar bar(linear({"pressure"}, {a, b}, S_y));
    double stress = 0.0;
    for (int k = 1; k <= 10; ++k) stress = bar.pull(sign * 0.01 * k);
    const double p = bar.point().plastic_strain();
    EXPECT_NEAR(stress, sign * S_y / (1 + sign * a / 3), 1e-9);  // q + a sigma/3 = S_y
    const double elastic_volume = (1 - 2 * nu) * stress / E;
    EXPECT_NEAR(sign * 0.1 + bar.lateral().sum() - elastic_volume, b * p, 1e-12);
    EXPECT_NEAR(bar.point().plastic_inverse().determinant(), std::exp(-b * p), 1e-12);
  }
}

TEST(Effects, PlasticWorkIsNeverNegative) {
  for (const auto& effect : testing::effect_cases()) {
    const Case c = effect.made();
    MaterialPoint point(*c.law, c.parameters);
    Random random(31);
    Matrix3 F = I;
    double largest = 0.0;
    for (int step = 0; step < 60; ++step) {
      F = I + random.matrix(0.03);
      const double p = point.plastic_strain();
      const Response r = point.advance(F);
      largest = std::max(largest, point.plastic_strain() - p);
      // A back-stress stores energy and gives it back; without one plastic flow only dissipates.
      if (effect.name.find("back") == std::string::npos && effect.name != "kinematic" && effect.name != "all") {
        EXPECT_GE(r.dissipated_work_rate, 0.0) << c.name;
      }
      EXPECT_GE(point.plastic_strain(), p) << c.name;
    }
    EXPECT_GT(largest, 1e-3) << c.name;
  }
}

}  // namespace test_effects
}  // namespace imic3d::material
