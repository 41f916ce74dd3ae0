// The laws of plane stress: against the three-dimensional law with the thickness that they found, closed forms, and all
// derivatives against differences.
#include "anisotropic_law.hpp"
#include "effect_cases.hpp"
#include "imic3d/material/plane_stress.hpp"
#include "material_point.hpp"

namespace imic3d::material {
namespace test_plane_stress {

using testing::Case;
using testing::MaterialPoint;
using testing::Random;

const Matrix3 I = Matrix3::Identity();

struct PlaneCase {
  Case plane, solid;
};

/// Every law of the registry in plane stress and in three dimensions, one of them yielding in Cauchy stress, and a law
/// that brings no tangent and is not isotropic in the plane.
std::vector<PlaneCase> cases() {
  const auto both = [](const std::string& name, LawChoice choice, const std::vector<double>& parameters) {
    choice.plane_stress = false;
    const auto solid = make_law(choice);
    choice.plane_stress = true;
    return PlaneCase{{name, make_law(choice), parameters}, {name, solid, parameters}};
  };
  std::vector<PlaneCase> list;
  for (const Case& c : testing::all_cases()) {
    LawChoice choice{.law = c.name == "elastic" ? "elastic" : "j2"};
    if (c.name != "elastic") choice.hardening = c.name == "power_linear_tied" ? "power_linear" : c.name;
    choice.tie_initial_modulus = c.name == "power_linear_tied";
    if (c.name == "table") choice.table_strain = {0, 0.01, 0.05, 0.2};
    list.push_back(both(c.name, choice, c.parameters));
  }
  list.push_back(both("cauchy", {.hardening = "power_linear", .tie_initial_modulus = true, .cauchy_yield = true},
                      {198e3, 0.25, 284, 1480, 0.042}));
  list.push_back(both("nu 0", {.hardening = "linear"}, {200e3, 0.0, 300, 20}));  // the thickness has two slopes, 3 : 1
  for (const auto& effect : testing::effect_cases())
    list.push_back(both(effect.name, effect.choice, effect.parameters));
  using Law = testing::AnisotropicViscous;
  const std::vector<double> parameters = {1000.0, 5000.0, 0.2};
  list.push_back({{"anisotropic", std::make_shared<LogStrainLaw<PlaneStress<Law>>>(PlaneStress<Law>{}), parameters},
                  {"anisotropic", std::make_shared<LogStrainLaw<Law>>(Law{}), parameters}});
  return list;
}

/// Random entries in the plane, zero out of it.
Matrix3 in_plane(Random& random, double size) {
  Matrix3 A = random.matrix(size);
  A.row(2).setZero();
  A.col(2).setZero();
  return A;
}
Matrix3 turn(double angle) { return Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitZ()).toRotationMatrix(); }

double thickness_strain(const MaterialPoint& point) {
  return point.history()[static_cast<std::size_t>(point.law().thickness_strain_index())];
}

TEST(PlaneStress, IsTheThreeDimensionalLawAtTheThicknessWithoutStress) {
  double worst = 0.0;
  for (const auto& [plane, solid] : cases()) {
    MaterialPoint sheet(*plane.law, plane.parameters), body(*solid.law, solid.parameters);
    Random random(61);
    Matrix3 F = I;
    for (int step = 0; step < 20; ++step) {
      if (step == 12)
        F = (I - 1e-3 * (F - I)) * F;  // unloads
      else
        F = turn(step == 8 ? 2.0 : 0.0) * (I + in_plane(random, step % 5 == 4 ? 0.15 : 0.03)) * F;
      const Response a = sheet.advance(F);
      Matrix3 whole = F;
      whole(2, 2) = std::exp(thickness_strain(sheet));
      const Response b = body.advance(whole);
      const double size = b.kirchhoff.norm();
      worst = std::max(worst, std::abs(b.kirchhoff[2]) / size);
      EXPECT_LT(std::abs(b.kirchhoff[2]), 1e-12 * size) << plane.name << " step " << step;
      if (plane.name != "anisotropic") {
        EXPECT_LT((a.kirchhoff - b.kirchhoff).norm(), 1e-11 * size) << plane.name << " step " << step;
      }
      if (sheet.has_plastic_strain()) {
        EXPECT_NEAR(sheet.plastic_strain(), body.plastic_strain(), 1e-12) << plane.name;
      }
      EXPECT_LT((sheet.plastic_inverse() - body.plastic_inverse()).norm(), 1e-11) << plane.name;
    }
    EXPECT_LT(std::exp(thickness_strain(sheet)), plane.name == "nu 0" ? 1.5 : 1.2) << plane.name;
    if (sheet.has_plastic_strain()) {
      EXPECT_GT(sheet.plastic_strain(), 0.1) << plane.name << ": the path must yield";
    }
  }
  std::printf("stress through the thickness: at most %.1e of the stress\n", worst);
}

TEST(PlaneStress, TangentMatchesDifferencesOfTheStress) {
  for (const auto& [plane, solid] : cases()) {
    if (plane.name == "cauchy") continue;  // its tangent leaves the change of J out
    Random random(67);
    MaterialPoint point(*plane.law, plane.parameters);
    Matrix3 F = I;
    for (int step = 0; step < 6; ++step) {
      F = (I + in_plane(random, 0.03)) * F;
      const Matrix3 L = in_plane(random, 1.0);
      if (point.has_plastic_strain()) {
        ASSERT_GT(point.plastic_strain_after(F), point.plastic_strain() + 1e-3)
            << plane.name << ": the state must yield";
      }
      const Response response = point.at(F);
      const Matrix3 tau = testing::tensor_of(response.kirchhoff);
      const Vector6 rate =
          response.tangent * testing::engineering_strain(L) + testing::vector_of(L * tau + tau * L.transpose());
      const auto plane_of = [](const Vector6& v) { return std::vector<double>{v[0], v[1], v[3]}; };
      testing::expect_v_shaped(
          testing::difference_errors([&](double t) { return plane_of(point.at((I + t * L) * F).kirchhoff); },
                                     plane_of(rate), 1.0, 1e-3),
          plane.name + " step " + std::to_string(step));
      Matrix3 c;
      constexpr int at[3] = {0, 1, 3};
      for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) c(i, j) = response.tangent(at[i], at[j]);
      if (plane.law->symmetric_tangent()) {
        EXPECT_LT((c - c.transpose()).norm(), 1e-13 * c.norm()) << plane.name;
      }
      point.advance(F);
    }
  }
}

TEST(PlaneStress, ElasticModuliAreThoseOfTheSheet) {
  const double E = 200e3, nu = 0.3;
  const auto law = make_law({.law = "elastic", .plane_stress = true});
  const Matrix6 c = MaterialPoint(*law, {E, nu}).at(I).tangent;
  EXPECT_NEAR(c(0, 0) / (E / (1 - nu * nu)), 1.0, 1e-14);
  EXPECT_NEAR(c(0, 1) / (nu * E / (1 - nu * nu)), 1.0, 1e-14);
  EXPECT_NEAR(c(3, 3) / (E / (2 * (1 + nu))), 1.0, 1e-14);
}

TEST(PlaneStress, TurningThePathTurnsTheStress) {
  for (const auto& [plane, solid] : cases()) {
    MaterialPoint point(*plane.law, plane.parameters), turned(*plane.law, plane.parameters);
    Random random(71);
    Matrix3 F = I;
    for (int step = 0; step < 20; ++step) {
      F = (I + in_plane(random, 0.04)) * F;
      const Matrix3 Q = turn(random.uniform(-3.0, 3.0));
      const Response a = point.advance(F), b = turned.advance(Q * F);
      const Matrix3 expected = Q * testing::tensor_of(a.kirchhoff) * Q.transpose();
      EXPECT_LT((testing::tensor_of(b.kirchhoff) - expected).norm(), 1e-12 * expected.norm())
          << plane.name << " step " << step;
      EXPECT_NEAR(thickness_strain(point), thickness_strain(turned), 1e-13) << plane.name;
    }
  }
}

/// p with modulus (strain - p) = sigma_y(p), by bisection.
template <class Yield>
double plastic_part(double modulus, double strain, const Yield& yield) {
  double low = 0.0, high = strain;
  for (int i = 0; i < 200; ++i) {
    const double middle = 0.5 * (low + high);
    (modulus * (strain - middle) > yield(middle) ? low : high) = middle;
  }
  return low;
}

struct ClosedForm {
  LawChoice choice;
  std::vector<double> parameters;
  double (*yield)(double);
};
const std::vector<ClosedForm> closed_forms = {
    {{.hardening = "power_linear", .tie_initial_modulus = true, .plane_stress = true},
     {198e3, 0.25, 284, 1480, 0.042},
     [](double p) { return 1480 * p + 284 * std::pow(1 + p / (0.042 * 284 / (198e3 - 1480)), 0.042); }},
    {{.hardening = "linear", .plane_stress = true}, {200e3, 0.3, 300, 2000}, [](double p) { return 300 + 2000 * p; }}};

TEST(PlaneStress, UniaxialTensionFollowsTheClosedForm) {
  // tau = E (ln stretch - p) = sigma_y(p), width and thickness alike: the three-dimensional law's closed form.
  for (const auto& [choice, parameters, yield] : closed_forms) {
    const auto law = make_law(choice);
    MaterialPoint point(*law, parameters);
    const double E = parameters[0], nu = parameters[1];
    for (double strain : {0.0005, 0.01, 0.1, 0.3}) {
      double width = -0.45 * strain;
      Matrix3 F = I;
      for (int i = 0; i < 50; ++i) {  // Newton's method for the width without stress
        F = Eigen::Vector3d(std::exp(strain), std::exp(width), 1.0).asDiagonal();
        const Response r = point.at(F);
        const double change = -r.kirchhoff[1] / (r.tangent(1, 1) + 2.0 * r.kirchhoff[1]);
        width += change;
        if (std::abs(change) < 1e-16) break;
      }
      const Response response = point.advance(F);
      const double p = E * strain < yield(0.0) ? 0.0 : plastic_part(E, strain, yield), stress = E * (strain - p);
      EXPECT_NEAR(point.plastic_strain(), p, 1e-12);
      EXPECT_NEAR(response.kirchhoff[0] / stress, 1.0, 1e-11);
      EXPECT_NEAR(width, -0.5 * p - nu * stress / E, 1e-13);
      EXPECT_NEAR(thickness_strain(point), width, 1e-13);
    }
    EXPECT_GT(point.plastic_strain(), 0.29);
  }
}

TEST(PlaneStress, PureShearFollowsTheClosedForm) {
  // Logarithmic strains e and -e keep area and thickness: q = sqrt(3) tau = 3 G (2 e / sqrt(3) - p) = sigma_y(p).
  for (const auto& [choice, parameters, yield] : closed_forms) {
    const auto law = make_law(choice);
    MaterialPoint point(*law, parameters);
    const double G = parameters[0] / (2.0 * (1.0 + parameters[1]));
    const Matrix3 Q = turn(0.4);
    for (double e : {0.0004, 0.02, 0.2}) {
      const Matrix3 F = Q * Eigen::Vector3d(std::exp(e), std::exp(-e), 1.0).asDiagonal() * Q.transpose();
      const Matrix3 tau = Q.transpose() * testing::tensor_of(point.advance(F).kirchhoff) * Q;
      const double strain = 2.0 * e / std::sqrt(3.0);
      const double p = 3.0 * G * strain < yield(0.0) ? 0.0 : plastic_part(3.0 * G, strain, yield);
      EXPECT_NEAR(point.plastic_strain(), p, 1e-12);
      EXPECT_NEAR(std::sqrt(3.0) * tau(0, 0) / (3.0 * G * (strain - p)), 1.0, 1e-11);
      EXPECT_NEAR(tau(1, 1) / tau(0, 0), -1.0, 1e-11);  // det F is 1 to 1e-16, times K / tau
      EXPECT_NEAR(thickness_strain(point), 0.0, 1e-14);
    }
    EXPECT_GT(point.plastic_strain(), 0.2);
  }
}

TEST(PlaneStress, YieldInCauchyStressIsThatOfTheTrueStress) {
  // Uniaxial tension: sigma = tau / J = sigma_y(p), ln J = (1 - 2 nu) tau / E.
  const auto& parameters = closed_forms[0].parameters;
  LawChoice choice = closed_forms[0].choice;
  choice.cauchy_yield = true;
  const auto law = make_law(choice);
  MaterialPoint point(*law, parameters);
  const double strain = 0.1;
  double low = -0.6 * strain, high = -0.4 * strain;
  const auto gradient = [&](double width) {
    return Matrix3(Eigen::Vector3d(std::exp(strain), std::exp(width), 1.0).asDiagonal());
  };
  for (int i = 0; i < 100; ++i) {
    const double middle = 0.5 * (low + high);
    (point.at(gradient(middle)).kirchhoff[1] < 0.0 ? low : high) = middle;
  }
  const Response response = point.advance(gradient(low));
  const double tau = response.kirchhoff[0], J = std::exp(strain + low + thickness_strain(point));
  EXPECT_NEAR(std::log(J), (1.0 - 2.0 * parameters[1]) * tau / parameters[0], 1e-14);
  EXPECT_NEAR(tau / J / closed_forms[0].yield(point.plastic_strain()), 1.0, 1e-12);
  EXPECT_NEAR(point.plastic_strain(), strain - tau / parameters[0], 1e-13);
}

TEST(PlaneStress, DerivativesMatchDifferencesForEveryParameter) {
  for (const auto& [plane, solid] : cases()) {
    MaterialPoint point(*plane.law, plane.parameters);
    Random random(73);
    Matrix3 F = I;
    for (int step = 0; step < 4; ++step) {
      F = (I + in_plane(random, 0.006 * (1 + 2 * step))) * F;
      if (point.has_plastic_strain()) {
        ASSERT_GT(point.plastic_strain_after(F), point.plastic_strain() + 1e-4)
            << plane.name << ": the state must yield";
      }
      Eigen::Matrix<double, 6, Eigen::Dynamic> derivatives(6, static_cast<Eigen::Index>(plane.parameters.size()));
      ASSERT_TRUE(plane.law->parameter_derivatives(F, 1.0, plane.parameters, point.history(), derivatives));
      for (std::size_t i = 0; i < plane.parameters.size(); ++i) {
        if (plane.parameters[i] == 0.0) continue;
        const std::string what = plane.name + " " + plane.law->parameters()[i].name + " step " + std::to_string(step);
        const Vector6 derivative = derivatives.col(static_cast<Eigen::Index>(i));
        const auto stress = [&](double change) {
          std::vector<double> parameters = plane.parameters;
          parameters[i] += change;
          return testing::listed(point.at(F, parameters).kirchhoff);
        };
        if (derivative.squaredNorm() == 0.0) {
          EXPECT_TRUE(plane.name == "table" || plane.name == "anisotropic") << what;
          continue;
        }
        testing::expect_v_shaped(testing::difference_errors(stress, testing::listed(derivative), plane.parameters[i]),
                                 what);
      }
      point.advance(F);
    }
  }
}

TEST(PlaneStress, DerivativeAlongAPathMatchesDifferencesOfTheWholePath) {
  for (const auto& [plane, solid] : cases()) {
    if (plane.name == "nu 0") continue;
    Random random(79);
    std::vector<Matrix3> F, dF;
    for (int step = 0; step < 5; ++step) {
      F.push_back(step == 3 ? Matrix3((I - 2e-3 * (F.back() - F.front())) * F.back())
                            : Matrix3((I + in_plane(random, 0.02)) * (step > 0 ? F.back() : I)));
      dF.push_back(in_plane(random, 0.2));
    }
    std::vector<double> d_parameters;
    for (double p : plane.parameters) d_parameters.push_back(p * random.uniform(0.2, 1.0));
    const auto history_along = [&](double s, std::size_t steps) {
      std::vector<double> parameters = plane.parameters;
      for (std::size_t i = 0; i < parameters.size(); ++i) parameters[i] += s * d_parameters[i];
      MaterialPoint point(*plane.law, parameters);
      for (std::size_t step = 0; step < steps; ++step) point.advance(F[step] + s * dF[step]);
      return point.history();
    };
    MaterialPoint point(*plane.law, plane.parameters);
    std::vector<double> d_history(point.history().size(), 0.0), d_next(d_history);
    for (std::size_t step = 0; step < F.size(); ++step) {
      Vector6 d_kirchhoff;
      ASSERT_TRUE(plane.law->directional_derivative(F[step], dF[step], 1.0, plane.parameters, d_parameters,
                                                    point.history(), d_history, d_kirchhoff, d_next));
      d_history = d_next;
      point.advance(F[step]);
      testing::expect_v_shaped(testing::difference_errors([&](double s) { return history_along(s, step + 1); },
                                                          d_history, 1.0, plane.name == "anisotropic" ? 1e-2 : 1e-4),
                               plane.name + " step " + std::to_string(step));
    }
  }
}

}  // namespace test_plane_stress
}  // namespace imic3d::material
