#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>

#include "box.hpp"
#include "imic3d/core/linear.hpp"
#include "imic3d/mechanics/hexahedron.hpp"
#include "imic3d/mechanics/one_point.hpp"

namespace imic3d::mechanics {
namespace test_hexahedron {

/// Which element a test takes.
template <int n>
struct WithPoints {
  static constexpr int nodes = n, points = hexahedron_points, state = 0;
};
template <bool stabilised>
struct OnePoint {
  static constexpr int nodes = 8, points = 1, state = stabilised ? hourglass_state : 0;
};

/// A distorted element, stretched and wrinkled until it yields.
template <class Element>
class Hexahedron : public ::testing::Test {
 protected:
  static constexpr int nodes_count = Element::nodes, dofs = 3 * nodes_count;
  using VectorOf = ElementVector<nodes_count>;
  using ResultOf = ElementResult<nodes_count>;

  std::shared_ptr<const material::FiniteStrainLaw> law =
      material::make_law({.law = "j2", .hardening = "power_linear", .tie_initial_modulus = true, .table_strain = {}});
  std::vector<double> parameters = {198e3, 0.25, 284.0, 1480.0, 0.042};
  ElementNodes<nodes_count> nodes;
  VectorOf u;
  std::vector<double> old_history, new_history;

  Hexahedron() {
    std::mt19937 random(3);
    std::uniform_real_distribution<double> shift(-0.15, 0.15), move(-0.03, 0.03), bend(-0.03, 0.03);
    nodes.template topRows<8>() << 0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0, 0, 0, 1, 1, 0, 1, 1, 1, 1, 0, 1, 1;
    for (int i = 0; i < 24; ++i) nodes(i / 3, i % 3) += shift(random);
    constexpr int edges[12][2] = {{0, 1}, {1, 2}, {2, 3}, {3, 0}, {4, 5}, {5, 6},
                                  {6, 7}, {7, 4}, {0, 4}, {1, 5}, {2, 6}, {3, 7}};
    for (int e = 8; e < nodes_count; ++e)  // curved edges
      for (int i = 0; i < 3; ++i)
        nodes(e, i) = 0.5 * (nodes(edges[e - 8][0], i) + nodes(edges[e - 8][1], i)) + bend(random);
    for (int i = 0; i < dofs; ++i) u[i] = move(random);
    for (int a = 0; a < nodes_count; ++a) u[3 * a] += 0.05 * nodes(a, 0);
    old_history.resize(static_cast<std::size_t>(Element::points * law->history_size() + Element::state));
    new_history = old_history;
    const auto size = static_cast<std::size_t>(law->history_size());
    for (std::size_t p = 0; p < Element::points; ++p) law->initialise(std::span(old_history).subspan(p * size, size));
  }
  bool evaluate_at(const VectorOf& at, ResultOf& result, bool tangent) {
    if constexpr (Element::points == 1) {
      const ElasticModuli elastic = elastic_moduli(*law, parameters);
      return evaluate_one_point(*law, parameters, 1.0, nodes, at, old_history, new_history, result, tangent,
                                Element::state > 0 ? &elastic : nullptr);
    } else {
      return evaluate(*law, parameters, 1.0, nodes, at, old_history, new_history, result, tangent);
    }
  }
};

using Elements = ::testing::Types<WithPoints<8>, WithPoints<20>, OnePoint<false>, OnePoint<true>>;
TYPED_TEST_SUITE(Hexahedron, Elements);

TYPED_TEST(Hexahedron, TangentIsTheDerivativeOfTheForceWhilePlastic) {
  using Vector = typename TestFixture::VectorOf;
  using Result = typename TestFixture::ResultOf;
  Result result;
  if constexpr (TypeParam::state > 0) {  // remembers a step: hourglass stress, a softer modulus, another metric
    const Vector first = 0.6 * this->u;
    ASSERT_TRUE(this->evaluate_at(first, result, false));
    ASSERT_GT(result.plastic_strain, 0.01);
    this->old_history = this->new_history;
    for (int a = 0; a < 8; ++a) this->u[3 * a] += 0.03 * this->nodes(a, 0);
  }
  ASSERT_TRUE(this->evaluate_at(this->u, result, true));
  ASSERT_GT(result.plastic_strain, 0.01) << "the state must have yielded";
  EXPECT_LT((result.tangent - result.tangent.transpose()).norm(), 1e-12 * result.tangent.norm());

  Vector direction = Vector::Random();
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

TYPED_TEST(Hexahedron, RigidRotationLeavesNoForce) {
  using Vector = typename TestFixture::VectorOf;
  using Result = typename TestFixture::ResultOf;
  constexpr int count = TestFixture::nodes_count;
  const Eigen::Matrix3d R = Eigen::AngleAxisd(1.1, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  Vector moved;
  for (int a = 0; a < count; ++a)
    moved.template segment<3>(3 * a) =
        (R - Eigen::Matrix3d::Identity()) * this->nodes.row(a).transpose() + Eigen::Vector3d(5, 6, 7);
  Result result;
  ASSERT_TRUE(this->evaluate_at(moved, result, false));
  EXPECT_LT(result.force.norm(), 1e-9 * this->parameters[0]);
}

TYPED_TEST(Hexahedron, ForcesTurnWithTheElement) {
  using Vector = typename TestFixture::VectorOf;
  using Result = typename TestFixture::ResultOf;
  constexpr int count = TestFixture::nodes_count;
  Result result, turned;
  ASSERT_TRUE(this->evaluate_at(this->u, result, false));
  const Eigen::Matrix3d R = Eigen::AngleAxisd(0.7, Eigen::Vector3d(-1, 2, 0.5).normalized()).toRotationMatrix();
  Vector moved;
  for (int a = 0; a < count; ++a) {
    const Eigen::Vector3d X = this->nodes.row(a).transpose();
    moved.template segment<3>(3 * a) = R * (X + this->u.template segment<3>(3 * a)) - X;
  }
  ASSERT_TRUE(this->evaluate_at(moved, turned, false));
  for (int a = 0; a < count; ++a)
    EXPECT_LT((turned.force.template segment<3>(3 * a) - R * result.force.template segment<3>(3 * a)).norm(),
              1e-12 * result.force.norm());
}

/// Rank of the stiffness at rest: 6 rigid modes, and with one point the 12 hourglass modes. The quadratic element's
/// reduced integration has 6 more, of which the class says that they do not spread.
TYPED_TEST(Hexahedron, ModesWithoutEnergy) {
  using Result = typename TestFixture::ResultOf;
  constexpr int expected = TypeParam::nodes == 20 ? 12 : TypeParam::points == 8 || TypeParam::state > 0 ? 6 : 18;
  Result result;
  ASSERT_TRUE(this->evaluate_at(TestFixture::VectorOf::Zero(), result, true));
  const Eigen::VectorXd values = symmetric_eigen(result.tangent).values;
  EXPECT_EQ((values.array() < 1e-10 * values.maxCoeff()).count(), expected) << values.transpose();
  EXPECT_GT(values.minCoeff(), -1e-10 * values.maxCoeff());
  EXPECT_GT(values[expected], 1e-3 * values.maxCoeff());
}

TYPED_TEST(Hexahedron, AnInvertedElementIsReported) {
  using Result = typename TestFixture::ResultOf;
  for (int a = 0; a < 4; ++a) this->u[3 * a + 2] += 3.0;
  Result result;
  EXPECT_FALSE(this->evaluate_at(this->u, result, true));
}

}  // namespace test_hexahedron
}  // namespace imic3d::mechanics
