// The spatial tangent against differences of the stress, its symmetry, and the hand-coded tangent against dual numbers.
#include <limits>

#include "imic3d/material/elastic.hpp"
#include "imic3d/material/hardening.hpp"
#include "imic3d/material/j2.hpp"
#include "imic3d/material/log_strain_law.hpp"
#include "material_point.hpp"

namespace imic3d::material {
namespace {

using testing::Case;
using testing::DifferenceErrors;
using testing::MaterialPoint;
using testing::Random;

/// d tau / dt under F = (I + t L) F0 is c : sym(L) + L tau + tau L^T.
DifferenceErrors tangent_errors(const MaterialPoint& point, const Matrix3& F, const Matrix3& L, double largest) {
  const Response response = point.at(F);
  const Matrix3 tau = testing::tensor_of(response.kirchhoff);
  const Vector6 rate =
      response.tangent * testing::engineering_strain(L) + testing::vector_of(L * tau + tau * L.transpose());
  return testing::difference_errors(
      [&](double t) { return testing::listed(point.at((Matrix3::Identity() + t * L) * F).kirchhoff); },
      testing::listed(rate), 1.0, largest);
}

TEST(SpatialTangent, MatchesDifferencesOfTheStressOnAPlasticPath) {
  for (const Case& c : testing::plastic_cases()) {
    Random random(7);
    MaterialPoint point(*c.law, c.parameters);
    Matrix3 F = Matrix3::Identity();
    for (int step = 0; step < 6; ++step) {
      F = (Matrix3::Identity() + random.matrix(0.03)) * F;
      const double before = point.plastic_strain();
      const Matrix3 L = random.matrix(1.0);
      ASSERT_GT(point.plastic_strain_after(F), before + 1e-3) << c.name << ": the state must yield";
      testing::expect_v_shaped(tangent_errors(point, F, L, 1e-3), c.name + " step " + std::to_string(step));
      point.advance(F);
    }
  }
}

}  // namespace
}  // namespace imic3d::material
