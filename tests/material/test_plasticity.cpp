// The physics of the plastic laws: closed form in tension, consistency, incompressible flow, objectivity, unloading.
#include <limits>

#include "anisotropic_law.hpp"
#include "material_point.hpp"

namespace imic3d::material {
namespace test_plasticity {

using testing::Case;
using testing::MaterialPoint;
using testing::Random;

const Matrix3 I = Matrix3::Identity();

/// The yield stress of each case, written out once more and independently.
double yield_stress(const Case& c, double ep) {
  const std::vector<double>& p = c.parameters;
  if (c.name == "power_linear") return p[3] * ep + p[2] * std::pow(1 + ep / p[5], p[4]);
  if (c.name == "power_linear_tied") return p[3] * ep + p[2] * std::pow(1 + ep / (p[4] * p[2] / (p[0] - p[3])), p[4]);
  if (c.name == "linear") return p[2] + p[3] * ep;
  if (c.name == "voce") return p[2] + (p[3] - p[2]) * (1 - std::exp(-p[4] * ep)) + p[5] * ep;
  if (c.name == "swift") return p[2] * std::pow(p[3] + ep, p[4]);
  if (ep < 0.01) return 300 + 60 * ep / 0.01;
  if (ep < 0.05) return 360 + 60 * (ep - 0.01) / 0.04;
  return 420 + 80 * (ep - 0.05) / 0.15;
}

double von_mises(const Vector6& tau) {
  const Matrix3 T = testing::tensor_of(tau);
  const Matrix3 s = T - T.trace() / 3.0 * I;
  return std::sqrt(1.5) * s.norm();
}

/// diag(stretch, t, t) with t such that the lateral stress vanishes.
Matrix3 uniaxial_gradient(const MaterialPoint& point, double stretch, double guess) {
  double t = guess;
  for (int i = 0; i < 50; ++i) {
    const Response r = point.at(Eigen::Vector3d(stretch, t, t).asDiagonal());
    const double slope = (r.tangent(1, 1) + r.tangent(1, 2) + 2.0 * r.kirchhoff[1]) / t;
    const double change = -r.kirchhoff[1] / slope;
    t += change;
    if (std::abs(change) < 1e-16) break;
  }
  return Eigen::Vector3d(stretch, t, t).asDiagonal();
}

TEST(UniaxialTension, FollowsTheClosedForm) {
  // tau = E (ln stretch - ep) = sigma_y(ep), exactly, in one step or in many.
  for (const Case& c : testing::plastic_cases())
    for (int steps : {1, 7}) {
      MaterialPoint point(*c.law, c.parameters);
      double lateral = 1.0;
      for (int step = 1; step <= steps; ++step) {
        const double strain = 0.3 * step / steps, E = c.parameters[0];
        lateral = std::exp(-0.45 * strain);
        const Matrix3 F = uniaxial_gradient(point, std::exp(strain), lateral);
        const Response response = point.advance(F);
        double low = 0.0, high = strain;
        for (int i = 0; i < 200; ++i) {
          const double middle = 0.5 * (low + high);
          (E * (strain - middle) > yield_stress(c, middle) ? low : high) = middle;
        }
        EXPECT_GT(point.plastic_strain(), 0.9 * strain) << c.name << ": the state must yield";
        EXPECT_NEAR(point.plastic_strain() / low, 1.0, 1e-12) << c.name;
        EXPECT_NEAR(response.kirchhoff[0] / yield_stress(c, low), 1.0, 1e-11) << c.name;
        EXPECT_LT(std::abs(response.kirchhoff[1]) / response.kirchhoff[0], 1e-11) << c.name;
        EXPECT_NEAR(point.plastic_inverse()(0, 0), std::exp(-low), 1e-12) << c.name;
        const double nu = c.parameters[1], elastic = yield_stress(c, low) / E;
        EXPECT_NEAR(std::log(F(1, 1)), -0.5 * low - nu * elastic, 1e-12) << c.name;
      }
    }
}

TEST(ReturnMapping, EndsOnTheYieldSurface) {
  double worst = 0.0;
  for (const Case& c : testing::plastic_cases()) {
    MaterialPoint point(*c.law, c.parameters);
    Random random(17);
    Matrix3 F = I;
    for (int step = 0; step < 300; ++step) {
      // Steps of strain from 1e-4 to 1, with large rotations in between.
      F = random.rotation() * (I + random.matrix(std::pow(10.0, random.uniform(-4.0, -0.4)))) * F;
      if (!(F.determinant() > 0.2 && F.norm() < 6.0)) {
        F = I + random.matrix(0.3);
        if (F.determinant() < 0.2) F = I;
      }
      const double before = point.plastic_strain();
      const Response response = point.advance(F);
      if (point.plastic_strain() == before) continue;
      const double error = von_mises(response.kirchhoff) / yield_stress(c, point.plastic_strain()) - 1.0;
      // The digits of the deviator are those of the whole stress.
      const double digits = response.kirchhoff.norm() / von_mises(response.kirchhoff);
      worst = std::max(worst, std::abs(error) / digits);
      EXPECT_LT(std::abs(error), 1e-13 * digits) << c.name << " step " << step;
      // The difference of accumulated strains loses digits.
      const double yield = yield_stress(c, point.plastic_strain());
      EXPECT_NEAR(response.dissipated_work_rate, (point.plastic_strain() - before) * yield,
                  1e-11 * response.dissipated_work_rate + 1e-15 * point.plastic_strain() * yield)
          << c.name;
    }
    EXPECT_GT(point.plastic_strain(), 10.0) << c.name << ": the path must reach large plastic strains";
  }
  RecordProperty("worst", std::to_string(worst * 1e15) + "e-15");
}

TEST(ReturnMapping, EndsOnTheYieldSurfaceOfTheCauchyStress) {
  const Case tied{
      "power_linear_tied",
      make_law({.law = "j2", .hardening = "power_linear", .tie_initial_modulus = true, .cauchy_yield = true}),
      {2000.0, 0.2, 60.0, 30.0, 0.1}};  // soft: J differs from 1 by some per cent
  MaterialPoint point(*tied.law, tied.parameters);
  Random random(5);
  double largest_change = 0.0;
  for (int step = 0; step < 100; ++step) {
    const double stretch = 1.0 + 0.004 * step;
    const Matrix3 F = random.rotation() * Eigen::Vector3d(stretch, 1.0 / stretch, 1.03).asDiagonal();
    const double before = point.plastic_strain();
    const Response response = point.advance(F);
    if (point.plastic_strain() == before) continue;
    const double J = F.determinant();
    largest_change = std::max(largest_change, std::abs(J - 1.0));
    EXPECT_NEAR(von_mises(response.kirchhoff) / J / yield_stress(tied, point.plastic_strain()), 1.0, 1e-12) << step;
  }
  EXPECT_GT(largest_change, 0.02);
  EXPECT_GT(point.plastic_strain(), 0.2);
}

TEST(ReturnMapping, ResolvesTheSteepStartOfTheTiedLaw) {
  // First plastic strains from 1e-12 on, where sigma_y rises with the slope E.
  const Case c = testing::plastic_cases()[1];
  const double E = c.parameters[0], nu = c.parameters[1], G = E / (2 * (1 + nu)), S_y = c.parameters[2];
  for (double beyond : {1e-10, 1e-8, 1e-6, 1e-4, 1e-2, 1.0, 100.0}) {
    const double shear = S_y / (std::sqrt(3.0) * G) * (1.0 + beyond);  // principal strains +- shear / 2
    const double e = 0.5 * shear;
    const MaterialPoint point(*c.law, c.parameters);
    const Matrix3 F = Eigen::Vector3d(std::exp(e), std::exp(-e), 1.0).asDiagonal();
    const double ep = point.plastic_strain_after(F);
    ASSERT_GT(ep, 0.0);
    const double residual = std::sqrt(3.0) * G * shear - 3 * G * ep - yield_stress(c, ep);
    EXPECT_LT(std::abs(residual), 1e-12 * std::sqrt(3.0) * G * shear) << beyond;
  }
}

TEST(PlasticFlow, KeepsTheVolume) {
  for (const Case& c : testing::plastic_cases()) {
    MaterialPoint point(*c.law, c.parameters);
    Random random(29);
    Matrix3 F = I;
    for (int step = 0; step < 50; ++step) {
      F = random.rotation() * (I + random.matrix(0.05)) * F;
      point.advance(F);
      EXPECT_NEAR(point.plastic_inverse().determinant(), 1.0, 1e-12) << c.name << " step " << step;
    }
    EXPECT_GT(point.plastic_strain(), 0.5) << c.name;
  }
}

TEST(FrameIndifference, RotatingThePathRotatesTheStress) {
  std::vector<Case> cases = testing::plastic_cases();
  cases.push_back({"anisotropic",
                   std::make_shared<LogStrainLaw<testing::AnisotropicViscous>>(testing::AnisotropicViscous{}),
                   {1000.0, 5000.0, 0.2}});
  double worst = 0.0;
  for (const Case& c : cases) {
    MaterialPoint point(*c.law, c.parameters), rotated(*c.law, c.parameters);
    Random random(31);
    Matrix3 F = I;
    for (int step = 0; step < 20; ++step) {
      F = (I + random.matrix(0.04)) * F;
      const Matrix3 Q = random.rotation();  // another one at every step
      const Response a = point.advance(F), b = rotated.advance(Q * F);
      const Matrix3 expected = Q * testing::tensor_of(a.kirchhoff) * Q.transpose();
      const double error = (testing::tensor_of(b.kirchhoff) - expected).norm() / expected.norm();
      worst = std::max(worst, error);
      EXPECT_LT(error, 1e-12) << c.name << " step " << step;
      // The tangent turns as well: c'[Q d Q^T] = Q c[d] Q^T.
      const Matrix3 any = random.matrix(1.0), d = 0.5 * (any + any.transpose());
      const Matrix3 rate = testing::tensor_of(a.tangent * testing::engineering_strain(d));
      const Matrix3 turned = testing::tensor_of(b.tangent * testing::engineering_strain(Q * d * Q.transpose()));
      EXPECT_LT((turned - Q * rate * Q.transpose()).norm() / rate.norm(), 1e-11) << c.name << " step " << step;
    }
    if (point.has_plastic_strain()) {
      EXPECT_GT(point.plastic_strain(), 0.1) << c.name << ": the path must yield";
    }
  }
  RecordProperty("worst", std::to_string(worst * 1e15) + "e-15");
}

TEST(Isotropy, RotatingTheVirginMaterialChangesNothing) {
  for (const Case& c : testing::plastic_cases()) {
    MaterialPoint point(*c.law, c.parameters), turned(*c.law, c.parameters);
    Random random(37);
    const Matrix3 Q = random.rotation();
    Matrix3 F = I;
    for (int step = 0; step < 10; ++step) {
      F = (I + random.matrix(0.04)) * F;
      const Response a = point.advance(F), b = turned.advance(F * Q);
      EXPECT_LT((a.kirchhoff - b.kirchhoff).norm() / a.kirchhoff.norm(), 1e-12) << c.name;
    }
  }
}

TEST(LargeRotation, InOneStepOfNonProportionalLoading) {
  // The same stretch history, with and without a rotation by 170 degrees inside one step: same invariants.
  const Case c = testing::plastic_cases()[0];
  MaterialPoint still(*c.law, c.parameters), turning(*c.law, c.parameters);
  const Matrix3 Q = Eigen::AngleAxisd(170.0 / 180.0 * 3.14159265358979323846, Eigen::Vector3d(1, 2, 3).normalized())
                        .toRotationMatrix();
  Matrix3 tension = I, shear = I;
  tension(0, 0) = 1.08;
  shear(0, 1) = 0.15;
  shear(2, 0) = -0.07;
  still.advance(tension);
  turning.advance(tension);
  const double before = still.plastic_strain();
  const Response a = still.advance(shear * tension), b = turning.advance(Q * shear * tension);
  EXPECT_GT(still.plastic_strain(), before + 0.05);
  EXPECT_NEAR(turning.plastic_strain() / still.plastic_strain(), 1.0, 1e-13);
  const Matrix3 expected = Q * testing::tensor_of(a.kirchhoff) * Q.transpose();
  EXPECT_LT((testing::tensor_of(b.kirchhoff) - expected).norm() / expected.norm(), 1e-12);
  EXPECT_LT((testing::tensor_of(b.kirchhoff) - testing::tensor_of(a.kirchhoff)).norm() / expected.norm(), 3.0);
}

TEST(Unloading, IsElasticAndReversible) {
  for (const Case& c : testing::plastic_cases()) {
    MaterialPoint point(*c.law, c.parameters);
    const Matrix3 F = I + Random(41).matrix(0.05);
    const Response loaded = point.advance(F);
    const std::vector<double> history = point.history();
    const Response unloaded = point.advance(0.9995 * (F - I) + I);
    EXPECT_EQ(point.history(), history) << c.name << ": unloading must leave the history alone";
    EXPECT_EQ(unloaded.dissipated_work_rate, 0.0);
    EXPECT_LT(von_mises(unloaded.kirchhoff), von_mises(loaded.kirchhoff)) << c.name;
    const Response again = point.advance(F);
    EXPECT_LT((again.kirchhoff - loaded.kirchhoff).norm() / loaded.kirchhoff.norm(), 1e-12) << c.name;
    EXPECT_NEAR(point.plastic_strain(), history[9], 1e-14) << c.name;
  }
}

TEST(Elasticity, IsStressFreeAtTheIdentityAndUnderRotation) {
  for (const Case& c : testing::all_cases()) {
    const MaterialPoint point(*c.law, c.parameters);
    EXPECT_EQ(point.at(I).kirchhoff.norm(), 0.0) << c.name;
    EXPECT_LT(point.at(Random(2).rotation()).kirchhoff.norm(), 1e-14 * c.parameters[0]) << c.name;
    const double K = c.parameters[0] / (3 * (1 - 2 * c.parameters[1]));
    const Vector6 tau = point.at(1.2 * I).kirchhoff;  // tau = K ln J
    for (int i = 0; i < 3; ++i) EXPECT_NEAR(tau[i] / (3 * K * std::log(1.2)), 1.0, 1e-14) << c.name;
    EXPECT_EQ(tau.tail<3>().norm(), 0.0) << c.name;
  }
}

TEST(Update, RefusesWhatCannotBeFollowed) {
  for (const Case& c : testing::all_cases()) {
    std::vector<double> old(static_cast<std::size_t>(c.law->history_size())), next(old);
    c.law->initialise(old);
    Response response;
    const auto follows = [&](const Matrix3& F, const std::vector<double>& parameters) {
      return c.law->update(F, 1.0, parameters, old, next, response, true);
    };
    Matrix3 inverted = I, flat = I, not_a_number = I, infinite = I;
    inverted(2, 2) = -1.0;
    flat(1, 1) = 0.0;
    not_a_number(0, 1) = std::numeric_limits<double>::quiet_NaN();
    infinite(0, 0) = std::numeric_limits<double>::infinity();
    EXPECT_TRUE(follows(I, c.parameters)) << c.name;
    for (const Matrix3& F : {inverted, flat, not_a_number, infinite}) EXPECT_FALSE(follows(F, c.parameters)) << c.name;
    for (std::size_t i = 0; i < c.parameters.size(); ++i) {
      std::vector<double> broken = c.parameters;
      broken[i] = std::numeric_limits<double>::quiet_NaN();
      const bool used = c.name != "table" || i < 4;  // the last points of a table are far away
      EXPECT_EQ(follows(I + Random(3).matrix(0.006), broken), !used) << c.name << " parameter " << i;
    }
  }
  // Eq. (19) has no eps_0 where H reaches E.
  const Case tied = testing::plastic_cases()[1];
  std::vector<double> parameters = tied.parameters, old(10), next(10);
  parameters[3] = 3.0 * parameters[0];
  tied.law->initialise(old);
  Response response;
  EXPECT_FALSE(tied.law->update(I + Random(3).matrix(0.1), 1.0, parameters, old, next, response, true));
}

}  // namespace test_plasticity
}  // namespace imic3d::material
