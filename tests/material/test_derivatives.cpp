// Derivatives with respect to the parameters, at one step and along a path, against differences.
#include "anisotropic_law.hpp"
#include "effect_cases.hpp"
#include "material_point.hpp"

namespace imic3d::material {
namespace test_derivatives {

using testing::Case;
using testing::MaterialPoint;
using testing::Random;

const Matrix3 I = Matrix3::Identity();

std::vector<Case> cases_with_anisotropy() {
  std::vector<Case> cases = testing::all_cases();
  cases.push_back({"anisotropic",
                   std::make_shared<LogStrainLaw<testing::AnisotropicViscous>>(testing::AnisotropicViscous{}),
                   {1000.0, 5000.0, 0.2}});
  for (const auto& effect : testing::effect_cases()) cases.push_back(effect.made());
  return cases;
}

TEST(ParameterDerivatives, MatchDifferencesForEveryParameterOfEveryLaw) {
  for (const Case& c : cases_with_anisotropy()) {
    MaterialPoint point(*c.law, c.parameters);
    Random random(43);
    Matrix3 F = I;
    std::vector<bool> met(c.parameters.size(), false);
    for (int step = 0; step < 4; ++step) {
      F = (I + random.matrix(0.004 * (1 + 2 * step))) * F;  // the first within the first segment of the table
      if (point.has_plastic_strain()) {
        ASSERT_GT(point.plastic_strain_after(F), point.plastic_strain() + 1e-4) << c.name << ": the state must yield";
      }
      Eigen::Matrix<double, 6, Eigen::Dynamic> derivatives(6, static_cast<Eigen::Index>(c.parameters.size()));
      ASSERT_TRUE(c.law->parameter_derivatives(F, 1.0, c.parameters, point.history(), derivatives));
      for (std::size_t i = 0; i < c.parameters.size(); ++i) {
        const std::string what = c.name + " " + c.law->parameters()[i].name + " step " + std::to_string(step);
        const Vector6 derivative = derivatives.col(static_cast<Eigen::Index>(i));
        const auto stress = [&](double change) {
          std::vector<double> parameters = c.parameters;
          parameters[i] += change;
          return testing::listed(point.at(F, parameters).kirchhoff);
        };
        if (derivative.squaredNorm() == 0.0) {  // table points of other segments; the rate of flow acts a step later
          EXPECT_TRUE(c.name == "table" || c.law->parameters()[i].name == "r") << what;
          EXPECT_EQ(stress(1e-3 * c.parameters[i]), stress(0.0)) << what;
          continue;
        }
        met[i] = true;
        testing::expect_v_shaped(testing::difference_errors(stress, testing::listed(derivative), c.parameters[i], 0.3),
                                 what);
      }
      point.advance(F);
    }
    for (std::size_t i = 0; i < met.size(); ++i)
      EXPECT_TRUE(met[i] || (c.name == "table" && i == 5) || c.name == "anisotropic") << c.name << " " << i;
  }
}

constexpr double time_increment = 0.7;

/// A path with loading, rotation, unloading and reloading whose deformations and parameters depend on one number s.
struct PathAlong {
  const Case* c;
  std::vector<Matrix3> F, dF;
  std::vector<double> d_parameters;

  PathAlong(const Case& case_, unsigned seed) : c(&case_) {
    Random random(seed);
    Matrix3 now = I;
    for (int step = 0; step < 7; ++step) {
      if (step == 3)
        now = (I - 2e-3 * (F.back() - F.front())) * now;  // unloads
      else
        now = (step == 5 ? random.rotation() : I) * (I + random.matrix(0.02)) * now;
      F.push_back(now);
      dF.push_back(random.matrix(0.2));
    }
    for (double p : c->parameters) d_parameters.push_back(p * random.uniform(0.2, 1.0));
  }

  /// Stress and history after each step.
  [[nodiscard]] std::vector<std::vector<double>> responses(double s) const {
    std::vector<double> parameters = c->parameters;
    for (std::size_t i = 0; i < parameters.size(); ++i) parameters[i] += s * d_parameters[i];
    MaterialPoint point(*c->law, parameters);
    std::vector<std::vector<double>> all;
    for (std::size_t step = 0; step < F.size(); ++step) {
      std::vector<double> both = testing::listed(point.advance(F[step] + s * dF[step], time_increment).kirchhoff);
      both.insert(both.end(), point.history().begin(), point.history().end());
      all.push_back(both);
    }
    return all;
  }
};

TEST(DirectionalDerivative, AlongAPathMatchesDifferencesOfTheWholePath) {
  for (const Case& c : cases_with_anisotropy()) {
    const PathAlong path(c, 47);
    std::vector<double> d_history(static_cast<std::size_t>(c.law->history_size()), 0.0), d_next(d_history);
    MaterialPoint point(*c.law, c.parameters);
    int yielded = 0;
    for (std::size_t step = 0; step < path.F.size(); ++step) {
      Vector6 d_kirchhoff;
      ASSERT_TRUE(c.law->directional_derivative(path.F[step], path.dF[step], time_increment, c.parameters,
                                                path.d_parameters, point.history(), d_history, d_kirchhoff, d_next));
      d_history = d_next;
      const double before = point.has_plastic_strain() ? point.plastic_strain() : 0.0;
      point.advance(path.F[step], time_increment);
      if (point.has_plastic_strain() && point.plastic_strain() > before) ++yielded;
      const std::string what = c.name + " step " + std::to_string(step);
      // Changes of the path must not take a step over the yield point; the viscous law has none.
      const double largest = c.name == "anisotropic" ? 1e-2 : 1e-4;
      const auto stress = [&](double s) {
        auto both = path.responses(s)[step];
        both.resize(6);
        return both;
      };
      const auto history = [&](double s) {
        auto both = path.responses(s)[step];
        both.erase(both.begin(), both.begin() + 6);
        return both;
      };
      testing::expect_v_shaped(testing::difference_errors(stress, testing::listed(d_kirchhoff), 1.0, largest), what);
      if (testing::norm(d_history) > 0.0)
        testing::expect_v_shaped(testing::difference_errors(history, d_history, 1.0, largest), what + " history");
      else
        EXPECT_EQ(c.name, "elastic");
    }
    if (point.has_plastic_strain()) {
      EXPECT_GE(yielded, 4) << c.name;
    }
  }
}

TEST(DirectionalDerivative, AgreesWithTheTangentAndTheParameterDerivatives) {
  for (const Case& c : cases_with_anisotropy()) {
    MaterialPoint point(*c.law, c.parameters);
    Random random(53);
    point.advance(I + random.matrix(0.03));
    const Matrix3 F = (I + random.matrix(0.03)), L = random.matrix(1.0), dF = L * F;
    const Response response = point.at(F);
    const Matrix3 tau = testing::tensor_of(response.kirchhoff);
    const std::size_t n = c.parameters.size(), m = point.history().size();
    const std::vector<double> zero_parameters(n, 0.0), zero_history(m, 0.0);
    std::vector<double> d_next(m);
    Vector6 along_F;
    ASSERT_TRUE(c.law->directional_derivative(F, dF, 1.0, c.parameters, zero_parameters, point.history(), zero_history,
                                              along_F, d_next));
    const Vector6 expected =
        response.tangent * testing::engineering_strain(L) + testing::vector_of(L * tau + tau * L.transpose());
    EXPECT_LT((along_F - expected).norm() / expected.norm(), 1e-11) << c.name;

    Eigen::Matrix<double, 6, Eigen::Dynamic> derivatives(6, static_cast<Eigen::Index>(n));
    ASSERT_TRUE(c.law->parameter_derivatives(F, 1.0, c.parameters, point.history(), derivatives));
    for (std::size_t i = 0; i < n; ++i) {
      std::vector<double> one = zero_parameters;
      one[i] = c.parameters[i];
      Vector6 along;
      ASSERT_TRUE(c.law->directional_derivative(F, Matrix3::Zero(), 1.0, c.parameters, one, point.history(),
                                                zero_history, along, d_next));
      const Vector6 column = c.parameters[i] * derivatives.col(static_cast<Eigen::Index>(i));
      EXPECT_LT((along - column).norm(), 1e-12 * response.kirchhoff.norm()) << c.name;
    }
  }
}

}  // namespace test_derivatives
}  // namespace imic3d::material
