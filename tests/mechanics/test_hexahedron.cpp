#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>

#include "box.hpp"
#include "imic3d/mechanics/hexahedron.hpp"

namespace imic3d::mechanics {
namespace {

struct Element {
  std::shared_ptr<const material::FiniteStrainLaw> law =
      material::make_law({.law = "j2", .hardening = "power_linear", .tie_initial_modulus = true, .table_strain = {}});
  std::vector<double> parameters = {198e3, 0.25, 284.0, 1480.0, 0.042};
  Eigen::Matrix<double, 8, 3> nodes;
  Eigen::Matrix<double, 24, 1> u;
  std::vector<double> old_history, new_history;

  Element() {
    std::mt19937 random(3);
    std::uniform_real_distribution<double> shift(-0.15, 0.15), move(-0.03, 0.03);
    nodes << 0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0, 0, 0, 1, 1, 0, 1, 1, 1, 1, 0, 1, 1;
    for (int i = 0; i < 24; ++i) nodes(i / 3, i % 3) += shift(random);
    for (int i = 0; i < 24; ++i) u[i] = move(random);
    for (int a = 0; a < 8; ++a) u[3 * a] += 0.05 * nodes(a, 0);
    old_history.resize(static_cast<std::size_t>(8 * law->history_size()));
    new_history = old_history;
    const auto size = static_cast<std::size_t>(law->history_size());
    for (std::size_t p = 0; p < 8; ++p) law->initialise(std::span(old_history).subspan(p * size, size));
  }
  bool evaluate(const Eigen::Matrix<double, 24, 1>& at, ElementResult& result, bool tangent) {
    return evaluate_hex8(*law, parameters, 1.0, nodes, at, old_history, new_history, result, tangent);
  }
};

TEST(Hexahedron, TangentIsTheDerivativeOfTheForceWhilePlastic) {
  Element element;
  ElementResult result;
  ASSERT_TRUE(element.evaluate(element.u, result, true));
  ASSERT_GT(result.plastic_strain, 0.01) << "the state must have yielded";
  EXPECT_LT((result.tangent - result.tangent.transpose()).norm(), 1e-12 * result.tangent.norm());

  Eigen::Matrix<double, 24, 1> direction = Eigen::Matrix<double, 24, 1>::Random();
  const Eigen::Matrix<double, 24, 1> exact = result.tangent * direction;
  std::vector<double> errors;
  for (double h = 1e-3; h > 1e-11; h *= 0.1) {
    ElementResult plus, minus;
    ASSERT_TRUE(element.evaluate(element.u + h * direction, plus, false));
    ASSERT_TRUE(element.evaluate(element.u - h * direction, minus, false));
    errors.push_back(((plus.force - minus.force) / (2.0 * h) - exact).norm() / exact.norm());
  }
  const auto best = std::min_element(errors.begin(), errors.end());
  EXPECT_LT(*best, 1e-8);
  EXPECT_GT(errors.front(), 30.0 * *best) << "truncation error must be seen";
  EXPECT_GT(errors.back(), 30.0 * *best) << "round-off must be seen: an error that stays zero is suspicious";
}

TEST(Hexahedron, RigidRotationLeavesNoForce) {
  Element element;
  const Eigen::Matrix3d R = Eigen::AngleAxisd(1.1, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  Eigen::Matrix<double, 24, 1> u;
  for (int a = 0; a < 8; ++a)
    u.segment<3>(3 * a) = (R - Eigen::Matrix3d::Identity()) * element.nodes.row(a).transpose() + Eigen::Vector3d(5, 6, 7);
  ElementResult result;
  ASSERT_TRUE(element.evaluate(u, result, false));
  EXPECT_LT(result.force.norm(), 1e-9 * element.parameters[0]);
}

TEST(Hexahedron, ForcesTurnWithTheElement) {
  Element element;
  ElementResult result, turned;
  ASSERT_TRUE(element.evaluate(element.u, result, false));
  const Eigen::Matrix3d R = Eigen::AngleAxisd(0.7, Eigen::Vector3d(-1, 2, 0.5).normalized()).toRotationMatrix();
  Eigen::Matrix<double, 24, 1> u;
  for (int a = 0; a < 8; ++a) {
    const Eigen::Vector3d X = element.nodes.row(a).transpose();
    u.segment<3>(3 * a) = R * (X + element.u.segment<3>(3 * a)) - X;
  }
  ASSERT_TRUE(element.evaluate(u, turned, false));
  for (int a = 0; a < 8; ++a)
    EXPECT_LT((turned.force.segment<3>(3 * a) - R * result.force.segment<3>(3 * a)).norm(), 1e-12 * result.force.norm());
}

TEST(Hexahedron, AnInvertedElementIsReported) {
  Element element;
  element.u[2] += 3.0;
  ElementResult result;
  EXPECT_FALSE(element.evaluate(element.u, result, true));
}

}  // namespace
}  // namespace imic3d::mechanics
