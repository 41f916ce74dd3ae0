// Effects that the declared model contains: a known one is in the prediction, a free one among the unknowns, neither a
// candidate.

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>

#include "imic3d/core/error.hpp"
#include "imic3d/loop/fit.hpp"
#include "strip.hpp"

namespace imic3d::loop {
namespace test_declared {

using testing::declared, testing::is_candidate, testing::place_of, testing::Strip;

TEST(Declared, AKnownEffectIsInThePrediction) {
  Strip strip(120.0);
  FieldExperiment without = strip.experiment();
  EXPECT_TRUE(is_candidate(without, "force zero"));
  EXPECT_NEAR((without.unwhitened(declared(without)).second.array() - 120.0).abs().maxCoeff(), 0.0, 0.05);
  strip.model.effects = {
      {.effect = "force_zero", .quantity = "force_offset", .value = 120.0, .lower = {}, .upper = {}}};
  FieldExperiment with = strip.experiment();
  EXPECT_FALSE(is_candidate(with, "force zero"));
  EXPECT_FALSE(with.parameters()[static_cast<std::size_t>(place_of(with, "force_offset"))].free);
  EXPECT_NEAR(with.unwhitened(declared(with)).second.cwiseAbs().maxCoeff(), 0.0, 0.05);
}

/// A region's place is nothing without its size.
TEST(Declared, ShapesAloneAreNoCandidate) {
  Strip strip(0.0);
  const FieldExperiment without = strip.experiment();
  EXPECT_TRUE(is_candidate(without, "stiff or soft region"));
  strip.model.effects = {
      {.effect = "stiff_or_soft_region", .quantity = "region", .value = 0.1, .lower = {}, .upper = {}}};
  const FieldExperiment with = strip.experiment();
  EXPECT_FALSE(is_candidate(with, "stiff or soft region"));
}

/// In space it is simulated: the strip is no bar, but nearly one.
TEST(Declared, AThickerStripCarriesMore) {
  Strip strip(0.0);
  FieldExperiment without = strip.experiment();
  EXPECT_TRUE(is_candidate(without, "thickness"));
  EXPECT_TRUE(without.takes_simulations(place_of(without, "thickness_error")));
  strip.model.effects = {
      {.effect = "thickness", .quantity = "thickness_error", .value = 0.1, .lower = {}, .upper = {}}};
  FieldExperiment with = strip.experiment();
  EXPECT_FALSE(is_candidate(with, "thickness"));
  const auto [apart, more] = with.unwhitened(declared(with));
  EXPECT_NEAR((-more.array() / strip.data.force.array() - 0.1).abs().maxCoeff(), 0.0, 2e-3);
  EXPECT_GT(apart.cwiseAbs().maxCoeff(), 1e-9);
  EXPECT_LT(apart.cwiseAbs().maxCoeff(), 1e-2 * strip.data.displacement.cwiseAbs().maxCoeff());
}

/// In plane stress the motion is the same and the force so much larger, before the load cell adds to it: no simulation.
TEST(Declared, InPlaneStressTheThicknessScalesTheForce) {
  Strip strip(0.0);
  strip.model.law = material::make_law({.law = "j2",
                                        .hardening = "power_linear",
                                        .tie_initial_modulus = true,
                                        .plane_stress = true,
                                        .table_strain = {}});
  strip.model.specimen = [](const MeshChange& change) {
    mesh::Mesh quads = identification::testing::strip();
    quads.thickness = change.thickness;
    return identification::make_specimen(std::move(quads), "bottom", "top", 1, false);
  };
  FieldExperiment without = strip.experiment();
  EXPECT_FALSE(without.takes_simulations(place_of(without, "thickness_error")));
  strip.model.effects = {
      {.effect = "force_zero", .quantity = "force_offset", .value = 120.0, .lower = {}, .upper = {}},
      {.effect = "thickness", .quantity = "thickness_error", .value = 0.1, .lower = {}, .upper = {}}};
  FieldExperiment with = strip.experiment();
  const auto [apart, missing] = without.unwhitened(declared(without));
  const auto [apart_with, missing_with] = with.unwhitened(declared(with));
  const Eigen::VectorXd force = strip.data.force - missing;
  EXPECT_EQ(apart, apart_with);
  EXPECT_LT((strip.data.force - missing_with - (1.1 * force.array() + 120.0).matrix()).norm(), 1e-9 * force.norm());
}

/// What a simulation in space shows beyond that of plane stress, which is one of a specimen that is far thinner, is
/// learned, and taken off.
TEST(Learned, WhatASimulationInSpaceShowsBeyondPlaneStress) {
  const auto law = [](bool in_space) {
    return material::make_law({.law = "j2",
                               .hardening = "power_linear",
                               .tie_initial_modulus = true,
                               .plane_stress = !in_space,
                               .table_strain = {}});
  };
  const auto in = [&](bool space, double part = 1.0) {
    Strip strip(0.0);
    strip.data.force *= part, strip.data.force_noise *= part;
    strip.data.correlate =
        [](const identification::Specimen& made,
           const Eigen::MatrixXd& U) {  // the nodes of the declared mesh are among those of a finer one
          return Eigen::MatrixXd(identification::of_components(identification::interpolation(
                                     made.surface.mesh, identification::testing::strip().nodes.leftCols<2>())) *
                                 U);
        };
    strip.model.law = law(space);
    strip.model.extended = [law](const std::vector<std::string>&, bool in_space) { return law(in_space); };
    strip.model.specimen = [space, part](const MeshChange& change) {
      mesh::Mesh quads = identification::testing::strip();
      for (int i = 0; i < change.numerics.refinements; ++i) quads = mesh::refine(quads);
      if (!space && !change.numerics.in_space)
        return identification::make_specimen(std::move(quads), "bottom", "top", 1, false);
      return identification::make_specimen(mesh::extrude(quads, 0.5 * part * change.numerics.of_thickness, 1), "bottom",
                                           "top", 1, true);
    };
    return strip.experiment();
  };
  FieldExperiment plane = in(false), space = in(true), flat = in(true, 0.01);
  const auto values = declared(plane);
  const Eigen::VectorXd beyond = flat.residuals({declared(flat)}).front() - space.residuals({declared(space)}).front();
  plane.learn_bias(values);
  EXPECT_GT(beyond.norm(), 1.0);
  EXPECT_LT((plane.in_space() - beyond).norm(), 0.02 * beyond.norm());
  space.learn_bias(declared(space));
  // A quarter of it is in doubt, and what ends do at depth as in space.
  const Eigen::MatrixXd doubt = plane.doubt().whole, at_depth = space.doubt().whole.rightCols(30);
  EXPECT_LT((doubt.colwise() - 0.25 * plane.in_space()).colwise().norm().minCoeff(), 1e-9 * beyond.norm());
  EXPECT_GT(at_depth.norm(), 0.0);
  EXPECT_LT((doubt.rightCols(30) - at_depth).norm(), 0.05 * at_depth.norm());
  EXPECT_EQ(space.in_space().size(), 0);
  FieldExperiment other = in(false);
  other.learn_again(values, plane.learned_numbers());
  EXPECT_EQ(other.in_space(), plane.in_space());
}

/// Theories of one law differ: the null has each of its numbers as known to a thousandth, and those of the direction in
/// which it flows to the elastic strain.
TEST(Learned, TheLawIsInDoubtByAThousandthAndTheFlowByTheElasticStrain) {
  Strip strip(0.0);
  strip.data.correlate = [](const identification::Specimen&, const Eigen::MatrixXd& U) { return U; };
  strip.model.extended = [](const std::vector<std::string>& effects, bool /*in_space*/) {
    return material::make_law({.law = "j2",
                               .hardening = "power_linear",
                               .tie_initial_modulus = true,
                               .effects = effects,
                               .table_strain = {}});
  };
  for (const auto& info : strip.model.extended({"hill", "pressure", "voce_term"}, false)->parameters())
    if (!info.effect.empty()) strip.model.lacking.push_back(info), strip.model.lacking.back().scale = 1.0;
  FieldExperiment experiment = strip.experiment();
  const auto values = declared(experiment);
  experiment.learn_bias(values);
  const Eigen::MatrixXd doubt = experiment.doubt().whole;
  const auto nodes = identification::testing::strip().nodes;
  const double width = nodes.col(0).maxCoeff() - nodes.col(0).minCoeff(),
               elastic_strain = strip.data.force.maxCoeff() / width / values.front();  // 1 thick
  ASSERT_GT(elastic_strain, 1.2e-3);
  std::vector<int> numbers;
  for (int j = 0; j < static_cast<int>(strip.model.values.size()); ++j) numbers.push_back(j);
  for (const char* name : {"R_22", "R_33", "R_12", "friction", "dilatancy"})
    numbers.push_back(place_of(experiment, name));
  const auto first =
      doubt.cols() - 30 - static_cast<Eigen::Index>(numbers.size());  // those of uneven ends are the last
  ASSERT_GE(first, 0);
  for (std::size_t k = 0; k < numbers.size(); ++k) {
    const auto j = static_cast<std::size_t>(numbers[k]);
    auto more = values, less = values;
    const double size = k < strip.model.values.size() ? 1e-3 * values[j] : elastic_strain;
    more[j] += 0.5 * size, less[j] -= 0.5 * size;
    const Eigen::VectorXd expected = experiment.residuals({more}).front() - experiment.residuals({less}).front();
    EXPECT_LT((doubt.col(first + static_cast<Eigen::Index>(k)) - expected).norm(), 0.02 * expected.norm())
        << experiment.parameters()[j].info.name;
  }
}

/// A body has the thickness of its mesh, whether it is the camera's half or not, a sheet its own.
TEST(Declared, TheThicknessIsThatOfTheSpecimen) {
  for (const bool half : {true, false}) {
    Strip strip(0.0);
    strip.model.specimen = [half](const MeshChange&) {
      return identification::make_specimen(mesh::extrude(identification::testing::strip(), 0.3, 1), "bottom", "top", 1,
                                           half);
    };
    EXPECT_NEAR(strip.experiment().scene().thickness, half ? 0.6 : 0.3, 1e-12);
  }
  Strip sheet(0.0);
  sheet.data.force *= 0.4;
  sheet.model.law = material::make_law({.law = "j2",
                                        .hardening = "power_linear",
                                        .tie_initial_modulus = true,
                                        .plane_stress = true,
                                        .table_strain = {}});
  sheet.model.specimen = [](const MeshChange&) {
    mesh::Mesh quads = identification::testing::strip();
    quads.thickness = 0.4;
    return identification::make_specimen(std::move(quads), "bottom", "top", 1, false);
  };
  EXPECT_NEAR(sheet.experiment().scene().thickness, 0.4, 1e-12);
}

/// What a preload has stretched goes with Young's modulus: the force in the first frame, which is elastic, is that of
/// the displacement since the reference, whatever the modulus and the preload.
TEST(Declared, APreloadStretchesAsYoungsModulusSays) {
  Strip strip(0.0);
  strip.model.effects = {
      {.effect = "preload", .quantity = "preload", .value = 100.0, .lower = {}, .upper = {}, .free = false}};
  FieldExperiment experiment = strip.experiment();
  const auto& data = experiment.data();
  const auto force =
      std::find_if(data.begin(), data.end(), [](const Datum& d) { return d.channel == force_channel; }) - data.begin();
  ASSERT_EQ(data[static_cast<std::size_t>(force)].frame, 0);
  for (const double modulus : {198e3, 180e3}) {
    auto with = declared(experiment);
    with[0] = modulus;
    auto without = with;
    without[static_cast<std::size_t>(place_of(experiment, "preload"))] = 0.0;
    const auto residual = experiment.residuals({with, without});
    EXPECT_NEAR(residual[0][force], residual[1][force], 1.0 / strip.data.force_noise) << modulus;  // of 100 N
  }
}

TEST(Declared, AFreeEffectIsIdentified) {
  Strip strip(120.0);
  strip.model.effects = {
      {.effect = "force_zero", .quantity = "force_offset", .value = {}, .lower = -200.0, .upper = {}, .free = true}};
  FieldExperiment experiment = strip.experiment();
  const int offset = place_of(experiment, "force_offset");
  EXPECT_TRUE(experiment.parameters()[static_cast<std::size_t>(offset)].free);
  EXPECT_EQ(experiment.parameters()[static_cast<std::size_t>(offset)].value, 0.0);
  EXPECT_EQ(experiment.parameters()[static_cast<std::size_t>(offset)].info.lower, -200.0);
  EXPECT_FALSE(is_candidate(experiment, "force zero"));
  auto start = declared(experiment);
  start[0] = 180e3;
  const Weight weight(experiment.data(), Eigen::MatrixXd(static_cast<Eigen::Index>(experiment.data().size()), 0));
  const Fit found = fit(experiment, weight, rows_of_frames(experiment.data(), {1, 1, 1, 1}), {0, offset}, start);
  EXPECT_NEAR(found.values[0], 198e3, 50.0);
  EXPECT_NEAR(found.values[static_cast<std::size_t>(offset)], 120.0, 0.5);
}

/// What the load cell reads at rest is a reading of its zero, unless that is declared.
TEST(Declared, TheRecordAtRestReadsTheZero) {
  Strip strip(120.0);
  strip.data.force_at_rest = {.value = 25.0, .deviation = 2.5};
  const auto zero = [&]() -> Parameter {
    const FieldExperiment experiment = strip.experiment();
    return experiment.parameters()[static_cast<std::size_t>(place_of(experiment, "force_offset"))];
  };
  EXPECT_DOUBLE_EQ(zero().expected(), 25.0);
  EXPECT_DOUBLE_EQ(zero().prior, 2.5);
  strip.model.effects = {{.effect = "force_zero", .quantity = "force_offset", .value = 7.0, .lower = {}, .upper = {}}};
  EXPECT_FALSE(zero().reading);
  EXPECT_DOUBLE_EQ(zero().expected(), 7.0);
  strip.model.effects.front().value = 0.0;
  EXPECT_FALSE(zero().reading);
  strip.model.effects.front().free = true;
  EXPECT_DOUBLE_EQ(zero().expected(), 25.0);
}

/// A load cell that is off by twelve times what is known of it is not explained by that.
TEST(Declared, WhatIsKnownBeforehandGoesNoFartherThanItIsKnown) {
  Strip strip(120.0);
  strip.model.effects = {{.effect = "force_zero",
                          .quantity = "force_offset",
                          .value = {},
                          .lower = {},
                          .upper = {},
                          .free = true,
                          .prior = 1.0}};
  const double whole =
      strip.experiment().parameters()[static_cast<std::size_t>(place_of(strip.experiment(), "force_offset"))].prior;
  strip.model.effects.front().prior = 10.0 / whole;
  FieldExperiment experiment = strip.experiment();
  const int offset = place_of(experiment, "force_offset");
  const auto& known = experiment.parameters()[static_cast<std::size_t>(offset)];
  EXPECT_DOUBLE_EQ(known.prior, 10.0);
  EXPECT_DOUBLE_EQ(known.info.upper, 50.0);
  EXPECT_DOUBLE_EQ(known.info.lower, -50.0);
  const Weight weight(experiment.data(), Eigen::MatrixXd(static_cast<Eigen::Index>(experiment.data().size()), 0));
  const Fit found =
      fit(experiment, weight, rows_of_frames(experiment.data(), {1, 1, 1, 1}), {offset}, declared(experiment));
  EXPECT_NEAR(found.values[static_cast<std::size_t>(offset)], 50.0, 1e-6);
}

TEST(Declared, OneOfTwoQuantitiesLeavesTheOtherACandidate) {
  Strip strip(0.0);
  strip.model.effects = {{.effect = "taper", .quantity = "taper_y", .value = 0.01, .lower = {}, .upper = {}}};
  const FieldExperiment experiment = strip.experiment();
  for (const auto& one : experiment.candidates())
    if (one.name == "taper") {
      ASSERT_EQ(one.parameters.size(), 1U);
      EXPECT_EQ(one.parameters.front(), place_of(experiment, "taper_x"));
    }
  EXPECT_TRUE(is_candidate(experiment, "taper"));
}

TEST(Declared, WhatTheSpecimenLacksIsRefused) {
  Strip strip(0.0);
  strip.model.effects = {
      {.effect = "hole_radius", .quantity = "hole_radius_error", .value = 0.1, .lower = {}, .upper = {}}};
  EXPECT_THROW((void)strip.experiment(), InputError);
  strip.model.effects = {{.effect = "force_zero", .quantity = "force_offset", .value = 1e9, .lower = {}, .upper = {}}};
  EXPECT_THROW((void)strip.experiment(), InputError);
}

/// kN read as N, or compression as tension: no identification leads from there. A force within its noise tells neither.
TEST(Declared, AForceThatTheLawCannotGiveIsRefused) {
  const auto with = [](double factor, double noise) {
    Strip strip(0.0);
    strip.data.force *= factor, strip.data.force_noise = noise;
    return strip.experiment().candidates().size();
  };
  for (const double factor : {1e-3, -1.0, 200.0}) EXPECT_THROW((void)with(factor, 5.0), InputError) << factor;
  EXPECT_GT(with(0.05, 5.0), 0U);
  EXPECT_GT(with(1e-3, 1e6), 0U);
  EXPECT_GT(with(-1.0, 1e6), 0U);
}

}  // namespace test_declared
}  // namespace imic3d::loop
