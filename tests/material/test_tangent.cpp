// The spatial tangent against differences of the stress, its symmetry, and the hand-coded tangent against dual numbers.
#include "anisotropic_law.hpp"
#include "imic3d/material/elastic.hpp"
#include "imic3d/material/hardening.hpp"
#include "imic3d/material/j2.hpp"
#include "imic3d/material/log_strain_law.hpp"
#include "material_point.hpp"

namespace imic3d::material {
namespace test_tangent {

using testing::Case;
using testing::DifferenceErrors;
using testing::MaterialPoint;
using testing::Random;

const Matrix3 I = Matrix3::Identity();

/// d tau / dt under F = (I + t L) F0 is c : sym(L) + L tau + tau L^T.
DifferenceErrors tangent_errors(const MaterialPoint& point, const Matrix3& F, const Matrix3& L, double largest = 1e-3) {
  const Response response = point.at(F);
  const Matrix3 tau = testing::tensor_of(response.kirchhoff);
  const Vector6 rate =
      response.tangent * testing::engineering_strain(L) + testing::vector_of(L * tau + tau * L.transpose());
  return testing::difference_errors([&](double t) { return testing::listed(point.at((I + t * L) * F).kirchhoff); },
                                    testing::listed(rate), 1.0, largest);
}

double asymmetry(const Matrix6& c) { return (c - c.transpose()).norm() / c.norm(); }

TEST(SpatialTangent, MatchesDifferencesOfTheStressOnAPlasticPath) {
  for (const Case& c : testing::plastic_cases()) {
    Random random(7);
    MaterialPoint point(*c.law, c.parameters);
    Matrix3 F = I;
    for (int step = 0; step < 6; ++step) {
      F = (I + random.matrix(0.03)) * F;
      const double before = point.plastic_strain();
      const Matrix3 L = random.matrix(1.0);
      ASSERT_GT(point.plastic_strain_after(F), before + 1e-3) << c.name << ": the state must yield";
      testing::expect_v_shaped(tangent_errors(point, F, L), c.name + " step " + std::to_string(step));
      EXPECT_LT(asymmetry(point.at(F).tangent), 1e-13) << c.name;
      point.advance(F);
    }
  }
}

TEST(SpatialTangent, MatchesDifferencesOfTheStressForALargeElasticStrain) {
  // Principal stretches 0.6 to 1.9, where an error in the divided differences would show.
  const auto law = make_law({.law = "elastic"});
  MaterialPoint point(*law, {200e3, 0.3});
  Random random(3);
  for (int sample = 0; sample < 10; ++sample) {
    const Matrix3 F = random.rotation() * Eigen::Vector3d(0.6, 1.1, 1.9).asDiagonal() * random.rotation();
    ASSERT_GT(F.determinant(), 0.0);
    testing::expect_v_shaped(tangent_errors(point, F, random.matrix(1.0)), "elastic");
    EXPECT_LT(asymmetry(point.at(F).tangent), 1e-13);
  }
}

TEST(SpatialTangent, MatchesDifferencesOfTheStressOnUnloading) {
  for (const Case& c : testing::plastic_cases()) {
    MaterialPoint point(*c.law, c.parameters);
    Random random(5);
    Matrix3 F = I + random.matrix(0.05);
    point.advance(F);
    const double loaded = point.plastic_strain();
    ASSERT_GT(loaded, 1e-2) << c.name;
    F = I + (1.0 - 0.02) * (F - I);
    ASSERT_EQ(point.plastic_strain_after(F), loaded) << c.name << ": the point must unload";
    testing::expect_v_shaped(tangent_errors(point, F, random.matrix(1.0), 1e-4), c.name + " unloading");
  }
}

TEST(SpatialTangent, MatchesDifferencesWhereEigenvaluesAreEqualOrNearlySo) {
  const auto law = testing::j2_law("power_linear");
  const std::vector<double> p = testing::plastic_cases()[0].parameters;
  Random random(11);
  const Matrix3 Q = random.rotation(), R = random.rotation();
  const auto stretched = [&](double a, double b, double c) {
    return Matrix3(Q * Eigen::Vector3d(a, b, c).asDiagonal() * R);
  };
  std::vector<std::pair<std::string, Matrix3>> gradients = {
      {"identity", I}, {"hydrostatic", 1.1 * I}, {"uniaxial", stretched(1.05, 0.98, 0.98)}};
  for (double gap : {1e-15, 1e-12, 1e-9, 1e-6, 1e-4, 0.0099, 0.0101, 0.02})
    gradients.emplace_back("gap " + std::to_string(gap), stretched(1.05, 0.98, 0.98 * (1.0 + gap)));
  for (const auto& [name, F] : gradients) {
    const MaterialPoint point(*law, p);
    // At the identity a larger step would yield on both sides of it.
    testing::expect_v_shaped(tangent_errors(point, F, random.matrix(1.0), name == "identity" ? 1e-4 : 1e-3), name);
    EXPECT_LT(asymmetry(point.at(F).tangent), 1e-13) << name;
  }
  const Matrix6 c = MaterialPoint(*law, p).at(I).tangent;
  const double E = p[0], nu = p[1];
  EXPECT_NEAR(c(0, 0) / (E * (1 - nu) / ((1 + nu) * (1 - 2 * nu))), 1.0, 1e-14);
  EXPECT_NEAR(c(0, 1) / (E * nu / ((1 + nu) * (1 - 2 * nu))), 1.0, 1e-14);
  EXPECT_NEAR(c(3, 3) / (E / (2 * (1 + nu))), 1.0, 1e-14);
}

TEST(SpatialTangent, OfALawThatBringsNoTangentMatchesDifferences) {
  const LogStrainLaw law{testing::AnisotropicViscous{}};
  MaterialPoint point(law, {1000.0, 5000.0, 0.2});
  Random random(2);
  Matrix3 F = I;
  for (int step = 0; step < 6; ++step) {
    F = (I + random.matrix(0.2)) * F;
    const Response response = point.at(F);
    testing::expect_v_shaped(tangent_errors(point, F, random.matrix(1.0)), "step " + std::to_string(step));
    EXPECT_LT(asymmetry(response.tangent), 1e-13);
    point.advance(F, 0.5);
  }
  EXPECT_NEAR(point.history()[9], 3.0, 1e-15) << "the law's own state";
  EXPECT_GT((point.plastic_inverse() - I).norm(), 1e-3) << "the law must flow";
}

template <class Hardening>
void expect_same_tangents(const Hardening& hardening, const Case& c) {
  const LogStrainLaw<J2<Hardening>, true> by_hand{J2<Hardening>{hardening}};
  const LogStrainLaw<J2<Hardening>, false> by_dual_numbers{J2<Hardening>{hardening}};
  MaterialPoint hand(by_hand, c.parameters), dual(by_dual_numbers, c.parameters);
  Random random(23);
  Matrix3 F = I;
  int yielded = 0, elastic = 0;
  for (int step = 0; step < 40; ++step) {
    const Matrix3 next = (I + random.matrix(step % 4 == 0 ? 2e-4 : 0.03)) * F;
    const double before = hand.plastic_strain();
    F = next;
    const Response a = hand.advance(F), b = dual.advance(F);
    (hand.plastic_strain() > before ? yielded : elastic) += 1;
    EXPECT_LT((a.tangent - b.tangent).norm() / b.tangent.norm(), 1e-10) << c.name << " step " << step;
    EXPECT_LT((a.kirchhoff - b.kirchhoff).norm() / b.kirchhoff.norm(), 1e-12) << c.name << " step " << step;
  }
  EXPECT_GT(yielded, 20) << c.name;
  EXPECT_GT(elastic, 0) << c.name;
}

TEST(SpatialTangent, ByHandIsTheOneFromDualNumbers) {
  const std::vector<Case> cases = testing::plastic_cases();
  expect_same_tangents(PowerLinear{}, cases[0]);
  expect_same_tangents(PowerLinearTied{}, cases[1]);
  expect_same_tangents(Linear{}, cases[2]);
  expect_same_tangents(Voce{}, cases[3]);
  expect_same_tangents(Swift{}, cases[4]);
  expect_same_tangents(Table{{0, 0.01, 0.05, 0.2}}, cases[5]);
}

TEST(SpatialTangent, OfElasticityByHandIsTheOneFromDualNumbers) {
  const LogStrainLaw<Elastic, true> hand{Elastic{}};
  const LogStrainLaw<Elastic, false> dual{Elastic{}};
  const Matrix3 F = I + Random(1).matrix(0.3);
  const Matrix6 a = MaterialPoint(hand, {200e3, 0.3}).at(F).tangent,
                b = MaterialPoint(dual, {200e3, 0.3}).at(F).tangent;
  EXPECT_LT((a - b).norm() / b.norm(), 1e-14);
}

}  // namespace test_tangent
}  // namespace imic3d::material
