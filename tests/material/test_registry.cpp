// Laws by name, their parameters, and what is said to a user who asks for something else.
#include <gmock/gmock.h>

#include "imic3d/core/error.hpp"
#include "imic3d/material/hardening.hpp"
#include "material_point.hpp"

namespace imic3d::material {
namespace test_registry {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

std::vector<std::string> parameter_names(const LawChoice& choice) {
  std::vector<std::string> names;
  const auto law = make_law(choice);
  for (const auto& parameter : law->parameters()) names.push_back(parameter.name);
  return names;
}

std::string mistake(const LawChoice& choice) {
  try {
    (void)make_law(choice);
  } catch (const InputError& error) {
    return error.mistakes().at(0).message();
  }
  return "no error";
}

TEST(Registry, KnowsItsLawsAndEveryOneCanBeMade) {
  for (const std::string hardening : {"power_linear", "linear", "voce", "swift", "table"})
    EXPECT_EQ(make_law({.law = "j2", .hardening = hardening, .table_strain = {0, 0.1}})->name(), "j2 " + hardening);
  EXPECT_EQ(make_law({.law = "elastic"})->name(), "elastic");
}

TEST(Registry, ParametersStandInTheDocumentedOrder) {
  EXPECT_THAT(parameter_names({.law = "elastic"}), ElementsAre("E", "nu"));
  EXPECT_THAT(parameter_names({}), ElementsAre("E", "nu", "S_y", "H", "delta", "eps_0"));
  EXPECT_THAT(parameter_names({.tie_initial_modulus = true}), ElementsAre("E", "nu", "S_y", "H", "delta"));
  EXPECT_THAT(parameter_names({.hardening = "linear"}), ElementsAre("E", "nu", "S_y", "H"));
  EXPECT_THAT(parameter_names({.hardening = "voce"}), ElementsAre("E", "nu", "S_y", "S_inf", "b", "H"));
  EXPECT_THAT(parameter_names({.hardening = "swift"}), ElementsAre("E", "nu", "K", "eps_0", "n"));
  EXPECT_THAT(parameter_names({.hardening = "table", .table_strain = {0, 0.1, 0.3}}),
              ElementsAre("E", "nu", "S_0", "S_1", "S_2"));
  for (const auto& c : testing::all_cases()) {
    ASSERT_EQ(c.parameters.size(), c.law->parameters().size()) << c.name;
    for (std::size_t i = 0; i < c.parameters.size(); ++i) {
      const ParameterInfo& info = c.law->parameters()[i];
      EXPECT_LE(info.lower, c.parameters[i]) << c.name << " " << info.name;
      EXPECT_GE(info.upper, c.parameters[i]) << c.name << " " << info.name;
      EXPECT_FALSE(info.description.empty() || info.unit.empty()) << c.name << " " << info.name;
    }
  }
}

TEST(Registry, EffectsBringTheirParametersInTheOrderOfTheLibrary) {
  EXPECT_THAT(known_effects(),
              ElementsAre("kinematic", "kinematic_2", "kinematic_3", "hill", "viscosity", "rate", "heating",
                          "voce_term", "plateau", "damage", "pressure", "voce_term_2", "power_term"));
  EXPECT_THAT(parameter_names({.hardening = "linear", .effects = {"rate", "kinematic"}}),
              ElementsAre("E", "nu", "S_y", "H", "C_1", "gamma_1", "C_rate", "rate_0"));
  EXPECT_EQ(make_law({.hardening = "linear", .effects = {"rate", "kinematic"}})->name(),
            "j2 linear + rate + kinematic");
  const auto extended = make_law({.effects = known_effects()});
  for (const auto& info : extended->parameters()) {
    EXPECT_EQ(info.effect.empty(), !info.null_value.has_value()) << info.name;
    if (info.effect.empty()) continue;
    EXPECT_GT(info.scale, 0.0) << info.name;
    EXPECT_GE(*info.null_value, info.lower) << info.name;
    EXPECT_LE(*info.null_value, info.upper) << info.name;
  }
}

TEST(Registry, NamesWhatIsAllowed) {
  EXPECT_THAT(mistake({.effects = {"kinematics"}}),
              ::testing::AllOf(HasSubstr("material.effects"), HasSubstr("kinematics"),
                               HasSubstr("kinematic_2, kinematic_3, hill")));
  EXPECT_THAT(mistake({.effects = {"rate", "rate"}}), HasSubstr("twice"));
  EXPECT_THAT(mistake({.law = "elastic", .effects = {"rate"}}), HasSubstr("law elastic"));

  EXPECT_THAT(mistake({.law = "j3"}),
              ::testing::AllOf(HasSubstr("material.law"), HasSubstr("j3"), HasSubstr("elastic, j2")));
  EXPECT_THAT(mistake({.hardening = "power"}),
              ::testing::AllOf(HasSubstr("material.hardening"), HasSubstr("power_linear, linear, voce, swift, table")));
  EXPECT_THAT(mistake({.hardening = "voce", .tie_initial_modulus = true}), HasSubstr("Eq. 19"));
  EXPECT_THAT(mistake({.hardening = "table"}), HasSubstr("0 values"));
  EXPECT_THAT(mistake({.hardening = "table", .table_strain = {0.0}}), HasSubstr("1 values"));
  EXPECT_THAT(mistake({.hardening = "table", .table_strain = {0.1, 0.2}}), HasSubstr("first"));
  EXPECT_THAT(mistake({.hardening = "table", .table_strain = {0, 0.2, 0.1}}), HasSubstr("after"));
  EXPECT_THAT(mistake({.hardening = "table", .table_strain = {0, 0.2, 0.2}}), HasSubstr("after"));
  EXPECT_THAT(mistake({.hardening = "table", .table_strain = {0, std::nan("")}}), HasSubstr("after"));
  EXPECT_THAT(mistake({.hardening = "table", .table_strain = {0, 0.1}}), HasSubstr("no error"));
}

TEST(Hardening, TiedLawLeavesTheYieldPointWithYoungsModulus) {
  const std::vector<double> p{284, 1480, 0.042};
  const double E = 198e3;
  const Dual<1> y = PowerLinearTied{}(Dual<1>::variable(0.0, 0), std::span<const double>(p), E);
  EXPECT_DOUBLE_EQ(y.value, 284);
  EXPECT_NEAR(y.derivative[0] / E, 1.0, 1e-14);  // Eq. (19)
  const std::vector<double> untied{284, 1480, 0.042, 0.042 * 284 / (E - 1480)};
  for (double ep : {1e-6, 1e-3, 0.1, 10.0})
    EXPECT_NEAR(
        PowerLinear{}(ep, std::span<const double>(untied), E) / PowerLinearTied{}(ep, std::span<const double>(p), E),
        1.0, 1e-14);
}

TEST(Hardening, TableIsPiecewiseLinearAndGoesOnWithItsLastSlope) {
  const Table table{{0, 0.1, 0.3}};
  const std::vector<double> p{100, 200, 300};
  const auto at = [&](double ep) { return table(ep, std::span<const double>(p), 1.0); };
  EXPECT_DOUBLE_EQ(at(0.0), 100);
  EXPECT_DOUBLE_EQ(at(0.05), 150);
  EXPECT_DOUBLE_EQ(at(0.1), 200);
  EXPECT_DOUBLE_EQ(at(0.2), 250);
  EXPECT_DOUBLE_EQ(at(0.5), 400);
}

}  // namespace test_registry
}  // namespace imic3d::material
