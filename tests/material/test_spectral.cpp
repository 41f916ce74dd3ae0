// Eigenvalues, divided differences, and the logarithm and exponential of tensors with their derivatives.
#include "imic3d/material/spectral.hpp"
#include "material_point.hpp"

namespace imic3d::material {
namespace test_spectral {

using testing::Random;

SymmetricTensor<double> symmetric(const Matrix3& A) {
  const Vector6 v = testing::vector_of(A);
  SymmetricTensor<double> S;
  for (int i = 0; i < 6; ++i) S[i] = v[i];
  return S;
}

TEST(SpectralDecomposition, RebuildsTheTensorFromOrthonormalAxes) {
  Random random(1);
  std::vector<Matrix3> tensors = {Matrix3::Zero(), Matrix3::Identity(), 1e-170 * random.matrix(1.0)};
  for (int i = 0; i < 200; ++i) {
    const Matrix3 Q = random.rotation();
    const double gap = std::pow(10.0, random.uniform(-17, 0)), size = std::pow(10.0, random.uniform(-12, 3));
    tensors.push_back(size * Q * Eigen::Vector3d(1.0, 1.0 + gap, random.uniform(-1, 1)).asDiagonal() * Q.transpose());
    tensors.push_back(random.matrix(size));
  }
  Matrix3 shear = Matrix3::Zero();
  shear(0, 1) = shear(1, 0) = 1.0;
  tensors.push_back(shear);
  for (const Matrix3& any : tensors) {
    const Matrix3 A = 0.5 * (any + any.transpose());
    const auto [lambda, V] = spectral_decomposition(symmetric(A));
    const Matrix3 N = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(V.components.data());
    const Matrix3 rebuilt = N * Eigen::Vector3d(lambda[0], lambda[1], lambda[2]).asDiagonal() * N.transpose();
    EXPECT_LE((rebuilt - A).norm(), 3e-15 * A.norm());
    EXPECT_LT((N.transpose() * N - Matrix3::Identity()).norm(), 3e-15);
  }
}

/// Gauss-Legendre points and weights on [0, 1].
std::vector<std::pair<long double, long double>> gauss_legendre(int n) {
  std::vector<std::pair<long double, long double>> rule;
  for (int i = 0; i < n; ++i) {
    long double x = std::cos(3.14159265358979323846L * (i + 0.75L) / (n + 0.5L)), slope = 1.0L;
    for (int iteration = 0; iteration < 100; ++iteration) {
      long double p0 = 1.0L, p1 = x;
      for (int k = 2; k <= n; ++k) p0 = std::exchange(p1, ((2 * k - 1) * x * p1 - (k - 1) * p0) / k);
      slope = n * (x * p1 - p0) / (x * x - 1.0L);
      x -= p1 / slope;
    }
    rule.emplace_back(0.5L * (x + 1.0L), 1.0L / ((1.0L - x * x) * slope * slope));
  }
  return rule;
}

TEST(DividedDifference, OfTheLogarithmIsAccurateAtEveryGap) {
  // Hermite-Genocchi: ln[a,b] = int_0^1 1/(b + t (a - b)) dt, and the double integral of -1/x^2 for ln[a,b,c].
  const auto rule = gauss_legendre(24);
  double worst_first = 0.0, worst_second = 0.0;
  for (double x : {0.5, 1.0, 1.7})
    for (double exponent = -17.0; exponent <= -0.25; exponent += 0.25)
      for (double shape : {-1.0, -0.5, 0.0, 0.3, 0.999999, 1.0}) {
        const double a = x, b = x * (1.0 + std::pow(10.0, exponent)), c = x * (1.0 + shape * std::pow(10.0, exponent));
        long double first = 0.0L, second = 0.0L;
        for (const auto& [t, wt] : rule) {
          first += wt / (a + t * (static_cast<long double>(b) - a));
          for (const auto& [u, wu] : rule) {
            const long double at = a + t * ((static_cast<long double>(b) - a) + u * (static_cast<long double>(c) - b));
            second -= wt * wu * t / (at * at);
          }
        }
        worst_first =
            std::max(worst_first, std::abs(static_cast<double>(divided_difference::logarithm(a, b) / first - 1.0L)));
        const double orders[6] = {divided_difference::logarithm(a, b, c), divided_difference::logarithm(a, c, b),
                                  divided_difference::logarithm(b, a, c), divided_difference::logarithm(b, c, a),
                                  divided_difference::logarithm(c, a, b), divided_difference::logarithm(c, b, a)};
        for (double f : orders) worst_second = std::max(worst_second, std::abs(static_cast<double>(f / second - 1.0L)));
      }
  RecordProperty("worst_first", std::to_string(worst_first * 1e15) + "e-15");
  RecordProperty("worst_second", std::to_string(worst_second * 1e15) + "e-15");
  EXPECT_LT(worst_first, 1e-15);
  EXPECT_LT(worst_second, 1e-13);
}

TEST(DividedDifference, OfTheExponentialIsAccurateAtEveryGap) {
  const auto rule = gauss_legendre(24);
  for (double z : {-0.7, 0.0, 0.4})
    for (double exponent = -17.0; exponent <= 0.0; exponent += 0.25) {
      const double a = z, b = z + std::pow(10.0, exponent);
      long double integral = 0.0L;
      for (const auto& [t, w] : rule) integral += w * std::exp(a + t * (static_cast<long double>(b) - a));
      EXPECT_NEAR(static_cast<double>(divided_difference::exponential(a, b) / integral), 1.0, 1e-15);
    }
}

TEST(Logarithm, UndoesTheExponentialAndSoDoTheirDerivatives) {
  Random random(4);
  std::vector<Matrix3> strains = {Matrix3::Zero(), 0.1 * Matrix3::Identity()};
  for (int i = 0; i < 20; ++i) {
    const Matrix3 Q = random.rotation();
    const double gap = std::pow(10.0, random.uniform(-16, -1));
    strains.push_back(Q * Eigen::Vector3d(0.3, 0.3 + gap, -0.4).asDiagonal() * Q.transpose());
  }
  for (const Matrix3& strain : strains) {
    const SymmetricTensor<double> E = symmetric(strain), D = symmetric(random.matrix(1.0));
    SymmetricTensor<Dual<1>> twice;
    for (int i = 0; i < 6; ++i) twice[i] = Dual<1>::variable(2.0 * E[i], 0, 2.0 * D[i]);
    const SymmetricTensor<Dual<1>> B = exponential_minus_identity(twice);
    const SymmetricTensor<Dual<1>> back = LogarithmicStrain(values(B)).strain(B);
    for (int i = 0; i < 6; ++i) {
      EXPECT_NEAR(back[i].value, E[i], 2e-15);
      EXPECT_NEAR(back[i].derivative[0], D[i], 1e-14);
    }
  }
}

TEST(Exponential, HasTheDerivativeOfDifferences) {
  Random random(9);
  const SymmetricTensor<double> A = symmetric(random.matrix(0.5)), D = symmetric(random.matrix(1.0));
  const auto along = [&](double t) {
    SymmetricTensor<double> B = exponential_minus_identity(A + t * D);
    return std::vector<double>(B.components.begin(), B.components.end());
  };
  SymmetricTensor<Dual<1>> dual;
  for (int i = 0; i < 6; ++i) dual[i] = Dual<1>::variable(A[i], 0, D[i]);
  const SymmetricTensor<double> derivative = derivatives(exponential_minus_identity(dual), 0);
  testing::expect_v_shaped(
      testing::difference_errors(along, {derivative.components.begin(), derivative.components.end()}, 1.0), "exp");
}

}  // namespace test_spectral
}  // namespace imic3d::material
