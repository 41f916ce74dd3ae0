#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <random>

#include "imic3d/mechanics/quadrilateral.hpp"

namespace imic3d::mechanics {
namespace test_quadrilateral {

/// A distorted element of a sheet, stretched and wrinkled until it yields.
template <class Size>
class Quadrilateral : public ::testing::Test {
 protected:
  static constexpr int nodes_count = Size::value, dofs = 2 * nodes_count;
  using VectorOf = ElementVector<nodes_count, 2>;
  using ResultOf = ElementResult<nodes_count, 2>;

  std::shared_ptr<const material::FiniteStrainLaw> law =
      material::make_law({.hardening = "power_linear", .tie_initial_modulus = true, .plane_stress = true});
  std::vector<double> parameters = {198e3, 0.25, 284.0, 1480.0, 0.042};
  double thickness = 0.7;
  ElementNodes<nodes_count, 2> nodes;
  VectorOf u;
  std::vector<double> old_history, new_history;

  Quadrilateral() {
    std::mt19937 random(3);
    std::uniform_real_distribution<double> shift(-0.15, 0.15), move(-0.03, 0.03), bend(-0.03, 0.03);
    nodes.template topRows<4>() << 0, 0, 1, 0, 1, 1, 0, 1;
    for (int i = 0; i < 8; ++i) nodes(i / 2, i % 2) += shift(random);
    for (int e = 4; e < nodes_count; ++e)  // curved edges
      for (int i = 0; i < 2; ++i) nodes(e, i) = 0.5 * (nodes(e - 4, i) + nodes((e - 3) % 4, i)) + bend(random);
    for (int i = 0; i < dofs; ++i) u[i] = move(random);
    for (int a = 0; a < nodes_count; ++a) u[2 * a] += 0.05 * nodes(a, 0);
    old_history.resize(static_cast<std::size_t>(quadrilateral_points * law->history_size()));
    new_history = old_history;
    const auto size = static_cast<std::size_t>(law->history_size());
    for (std::size_t p = 0; p < quadrilateral_points; ++p)
      law->initialise(std::span(old_history).subspan(p * size, size));
  }
  bool evaluate_at(const VectorOf& at, ResultOf& result, bool tangent) {
    return evaluate<nodes_count>(*law, thickness, parameters, 1.0, nodes, at, old_history, new_history, result,
                                 tangent);
  }
  /// The displacement that follows `u` by a rotation and a shift.
  VectorOf turned(const VectorOf& at, const Eigen::Matrix2d& R) const {
    VectorOf moved;
    for (int a = 0; a < nodes_count; ++a) {
      const Eigen::Vector2d X = nodes.row(a).transpose();
      moved.template segment<2>(2 * a) = R * (X + at.template segment<2>(2 * a)) - X + Eigen::Vector2d(5, 6);
    }
    return moved;
  }
};

using Sizes = ::testing::Types<std::integral_constant<int, 4>, std::integral_constant<int, 8>>;
TYPED_TEST_SUITE(Quadrilateral, Sizes);

TYPED_TEST(Quadrilateral, TangentIsTheDerivativeOfTheForceWhilePlastic) {
  using Vector = typename TestFixture::VectorOf;
  using Result = typename TestFixture::ResultOf;
  Result result;
  ASSERT_TRUE(this->evaluate_at(this->u, result, true));
  ASSERT_GT(result.plastic_strain, 0.01) << "the state must have yielded";
  EXPECT_LT((result.tangent - result.tangent.transpose()).norm(), 1e-12 * result.tangent.norm());

  const Vector direction = Vector::Random();
  const Vector exact = result.tangent * direction;
  std::vector<double> errors;
  for (double h = 1e-3; h > 1e-11; h *= 0.1) {
    Result plus, minus;
    ASSERT_TRUE(this->evaluate_at(this->u + h * direction, plus, false));
    ASSERT_TRUE(this->evaluate_at(this->u - h * direction, minus, false));
    errors.push_back(((plus.force - minus.force) / (2.0 * h) - exact).norm() / exact.norm());
  }
  const auto best = std::min_element(errors.begin(), errors.end());
  EXPECT_LT(*best, 1e-8);
  EXPECT_GT(errors.front(), 30.0 * *best) << "truncation error must be seen";
  EXPECT_GT(errors.back(), 30.0 * *best) << "round-off must be seen: an error that stays zero is suspicious";
}

TYPED_TEST(Quadrilateral, RigidRotationLeavesNoForce) {
  typename TestFixture::ResultOf result;
  const auto moved = this->turned(TestFixture::VectorOf::Zero(), Eigen::Rotation2Dd(1.1).toRotationMatrix());
  ASSERT_TRUE(this->evaluate_at(moved, result, false));
  EXPECT_LT(result.force.norm(), 1e-9 * this->parameters[0]);
}

TYPED_TEST(Quadrilateral, ForcesTurnWithTheElement) {
  typename TestFixture::ResultOf result, turned;
  ASSERT_TRUE(this->evaluate_at(this->u, result, false));
  const Eigen::Matrix2d R = Eigen::Rotation2Dd(0.7).toRotationMatrix();
  ASSERT_TRUE(this->evaluate_at(this->turned(this->u, R), turned, false));
  for (int a = 0; a < TestFixture::nodes_count; ++a)
    EXPECT_LT((turned.force.template segment<2>(2 * a) - R * result.force.template segment<2>(2 * a)).norm(),
              1e-12 * result.force.norm());
}

TYPED_TEST(Quadrilateral, AnInvertedElementIsReported) {
  typename TestFixture::ResultOf result;
  this->u[0] += 3.0;
  EXPECT_FALSE(this->evaluate_at(this->u, result, true));
}

}  // namespace test_quadrilateral
}  // namespace imic3d::mechanics
