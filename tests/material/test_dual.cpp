// Dual numbers: every operation against differences, with mixed arguments.
#include <limits>

#include "imic3d/material/dual.hpp"
#include "imic3d/material/scalar_root.hpp"
#include "material_point.hpp"

namespace imic3d::material {
namespace test_dual {

TEST(Dual, EveryOperationHasTheDerivativeOfDifferences) {
  using std::abs, std::exp, std::expm1, std::log, std::pow, std::sqrt;
  const auto check = [](const std::string& what, const auto& f) {
    const double x = 0.7, y = 1.3;
    const Dual<2> z = f(Dual<2>::variable(x, 0), Dual<2>::variable(y, 1));
    EXPECT_EQ(z.value, f(x, y)) << what;
    const auto along_x = [&](double t) { return std::vector<double>{f(x + t, y)}; };
    const auto along_y = [&](double t) { return std::vector<double>{f(x, y + t)}; };
    for (int i = 0; i < 2; ++i) {
      const double d = z.derivative[static_cast<std::size_t>(i)];
      const auto errors =
          i == 0 ? testing::difference_errors(along_x, {d}, 1.0) : testing::difference_errors(along_y, {d}, 1.0);
      if (d != 0.0)
        EXPECT_LT(errors.error[errors.best()], 1e-9) << what << errors.table();
      else
        EXPECT_EQ(i == 0 ? along_x(0.1) : along_y(0.1), std::vector<double>{z.value}) << what;
    }
  };
  check("+ -", [](auto x, auto y) { return 2.0 + x + y * 3.0 - (1.0 - x) - (y - 2.0) + (-x); });
  check("* /", [](auto x, auto y) { return 2.0 * x * y / (y + x) + 3.0 / x + y / 4.0; });
  check("sqrt exp log", [](auto x, auto y) { return sqrt(x * y) + exp(x) * log(y) + expm1(x - y); });
  check("pow", [](auto x, auto y) { return pow(x, y) + pow(x, 2.5) + pow(1.7, y); });
  check("abs", [](auto x, auto y) { return abs(x - y) + abs(y); });
  check("+= -= *= /=", [](auto x, auto y) {
    auto z = x;
    z += y;
    z *= x;
    z -= y;
    z /= y;
    return z;
  });
}

TEST(Dual, PowersAtTheEdgesAreFinite) {
  const Dual<1> zero = Dual<1>::variable(0.0, 0), one = Dual<1>::variable(1.0, 0);
  EXPECT_EQ(pow(zero, 2.0).derivative[0], 0.0);
  EXPECT_EQ(pow(zero, 1.0).derivative[0], 1.0);
  EXPECT_EQ(pow(one, 0.0).derivative[0], 0.0);
}

TEST(BracketedNewton, FindsRootsToTheLastPlaces) {
  // A residual as steep at the start as Eq. (18) with Eq. (19), and one that Newton alone overshoots.
  const auto steep = [](const Dual<1>& x) { return 1.0 - x - 0.1 * pow(1.0 + x / 1e-9, 0.05); };
  const auto root = bracketed_newton(steep, 0.0, 1.0, 1.0);
  ASSERT_TRUE(root);
  EXPECT_NEAR(steep(Dual<1>(*root)).value, 0.0, 1e-15);

  const auto overshooting = [](const Dual<1>& x) { return 1.0 - pow(x, 12.0) - 1e-3 * x; };
  const auto second = bracketed_newton(overshooting, 0.0, 100.0, 1.0);
  ASSERT_TRUE(second);
  EXPECT_NEAR(overshooting(Dual<1>(*second)).value, 0.0, 1e-14);

  const auto kinked = [](const Dual<1>& x) { return x < 0.5 ? 1.0 - x : 0.75 - 0.5 * x - 0.25 * (x - 0.5) * 40.0; };
  const auto third = bracketed_newton(kinked, 0.0, 1.0, 1.0);
  ASSERT_TRUE(third);
  EXPECT_NEAR(kinked(Dual<1>(*third)).value, 0.0, 1e-14);
}

TEST(BracketedNewton, SaysWhereThereIsNoRoot) {
  EXPECT_FALSE(bracketed_newton([](const Dual<1>& x) { return 2.0 - x; }, 0.0, 1.0, 1.0));
  EXPECT_FALSE(bracketed_newton([](const Dual<1>& x) { return x - 2.0; }, 0.0, 1.0, 1.0));
  EXPECT_FALSE(
      bracketed_newton([](const Dual<1>& x) { return x * std::numeric_limits<double>::quiet_NaN(); }, 0.0, 1.0, 1.0));
}

}  // namespace test_dual
}  // namespace imic3d::material
