// Bars that differ: what the experiment learns of their scatter, and what the loop finds in them.

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <chrono>
#include <cmath>
#include <limits>
#include <map>
#include <random>

#include "../../src/loop/starts.hpp"
#include "imic3d/core/error.hpp"
#include "imic3d/loop/closing.hpp"
#include "imic3d/loop/curve_experiment.hpp"
#include "imic3d/loop/joint_experiment.hpp"
#include "imic3d/loop/law_effects.hpp"

namespace imic3d::loop {
namespace test_curve_experiment {

const std::map<std::string, double> truth = {{"E", 200e3},     {"nu", 0.3}, {"S_y", 250.0},
                                             {"S_inf", 420.0}, {"b", 18.0}, {"H", 700.0}};

CurveModel model(std::map<std::string, double> values) {
  CurveModel m;
  m.extended = [](const std::vector<std::string>& effects) {
    return material::make_law({.law = "j2", .hardening = "voce", .effects = effects});
  };
  const auto law = m.extended(material::known_effects());
  for (ParameterInfo info : law->parameters()) {
    const auto found = values.find(info.name);
    info.scale = usual_size(info, 200e3);
    m.values.push_back(found != values.end() ? found->second : info.null_value.value_or(0.0));
    m.declared.push_back(truth.contains(info.name) ? 1 : 0);
    m.free.push_back(truth.contains(info.name) && info.name != "nu" ? 1 : 0);
    m.information.push_back(std::move(info));
  }
  m.priors.assign(m.values.size(), 0.0);
  return m;
}

/// Bars at two rates to 10 % strain, each off by a random parabola, with noise of the rows.
std::vector<identification::Curve> bars(unsigned seed, const std::map<std::string, double>& lacking, int count = 6,
                                        double fast = 10.0) {
  auto values = truth;
  values.insert(lacking.begin(), lacking.end());
  const CurveModel m = model(values);
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  std::vector<identification::Curve> all;
  for (const auto& [group, rate] : {std::pair("slow", 1e-4), std::pair("fast", fast)})
    for (int k = 0; k < count; ++k) {
      identification::Curve curve;
      curve.name = std::string(group) + std::to_string(k), curve.group = group;
      curve.history.strain = Eigen::VectorXd::LinSpaced(150, 0.0, k == 1 ? 0.07 : 0.1);
      curve.history.time = curve.history.strain / rate;
      curve.stress = material::pull_bar(*m.extended(material::known_effects()), m.values, curve.history).engineering;
      const double a = 5.0 * normal(random), b = 3.0 * normal(random), c = 2.0 * normal(random);
      for (Eigen::Index row = 1; row < curve.stress.size(); ++row) {
        const double s = 20.0 * curve.history.strain[row] - 1.0;
        curve.stress[row] += a + b * s + c * 0.5 * (3.0 * s * s - 1.0) + 2.0 * normal(random);
      }
      curve.deviation = 6.0;
      curve.use.assign(150, identification::Curve::fitted);
      curve.use[0] = identification::Curve::not_judged;
      all.push_back(std::move(curve));
    }
  return all;
}

Report loop_on(CurveExperiment& experiment) { return close_loop(experiment, {.held_out = experiment.held_out()}); }

TEST(CurveExperiment, ResidualsOfTheTruthAreWhite) {
  CurveExperiment experiment(Communicator(), bars(1, {}, 20), model(truth));
  std::vector<double> values;
  for (const auto& p : experiment.parameters()) values.push_back(p.value);
  experiment.learn_bias(values);
  const auto r = experiment.residuals({values}).front();
  // 40 bars of 24 numbers: the mean square is 1 within 3 sd, and neighbours are not correlated.
  EXPECT_NEAR(r.squaredNorm() / static_cast<double>(r.size()), 1.0,
              3.0 * std::sqrt(2.0 / static_cast<double>(r.size())));
  const double neighbours = r.head(r.size() - 1).dot(r.tail(r.size() - 1)) / static_cast<double>(r.size());
  EXPECT_LT(std::abs(neighbours), 4.0 / std::sqrt(static_cast<double>(r.size())));
  // The null ensemble knows that the scatter is an estimate: a little more than 1, no less.
  const Eigen::MatrixXd null = experiment.noise(values, 100);
  EXPECT_GT(null.squaredNorm() / static_cast<double>(null.size()), 0.97);
  EXPECT_LT(null.squaredNorm() / static_cast<double>(null.size()), 1.2);
}

/// Every parameter, moved by the step of a finite difference: along the paths' derivatives, by what is recorded, or
/// computed.
TEST(CurveExperiment, ResidualsNearAreThoseComputed) {
  CurveExperiment experiment(Communicator(), bars(4, {}), model(truth));
  std::vector<double> values;
  for (const auto& p : experiment.parameters())
    values.push_back(p.info.name == "C_rate" ? 0.01 : p.info.name == "rate_0" ? 1.0 : p.value);
  std::vector<std::vector<double>> sets;
  for (std::size_t j = 0; j < values.size(); ++j) {
    const auto& p = experiment.parameters()[j];
    sets.push_back(values);
    sets.back()[j] += p.info.null_value && !p.info.shape ? p.step : 1e-4 * std::abs(values[j]);
  }
  const auto near = experiment.residuals_near(values, sets);
  sets.insert(sets.begin(), values);
  const auto computed = experiment.residuals(sets);
  EXPECT_LT((near[0] - computed[0]).norm(), 1e-9);
  for (std::size_t s = 1; s < sets.size(); ++s) {
    const double moved = (computed[s] - computed[0]).norm();
    EXPECT_LT((near[s] - computed[s]).norm(), 1e-3 * moved + 1e-8)
        << experiment.parameters()[s - 1].info.name << " moves it by " << moved;
  }
}

/// What the bars' scatter makes of a score, and of the sum of squares, over many tests: as the null of each says, which
/// was made of that test's own few bars.
TEST(CurveExperimentNightly, TheNullKnowsThatTheScatterIsEstimated) {
  const auto exact = bars(1, {});
  CurveExperiment perfect(Communicator(), exact, model(truth));
  std::vector<double> values;
  for (const auto& p : perfect.parameters()) values.push_back(p.value);
  const auto predicted = perfect.predict(values);
  constexpr int tests = 400;
  double ratio = 0.0, energy = 0.0, of_null = 0.0;
  for (int test = 0; test < tests; ++test) {
    auto curves = exact;
    std::mt19937_64 random(100 + static_cast<unsigned>(test));
    std::normal_distribution<double> normal;
    for (std::size_t k = 0; k < curves.size(); ++k) {
      curves[k].stress = predicted[k];
      const double a = 5.0 * normal(random), b = 3.0 * normal(random), c = 2.0 * normal(random);
      for (Eigen::Index row = 1; row < curves[k].stress.size(); ++row) {
        const double s = 20.0 * curves[k].history.strain[row] - 1.0;
        curves[k].stress[row] += a + b * s + c * 0.5 * (3.0 * s * s - 1.0) + 2.0 * normal(random);
      }
    }
    CurveExperiment experiment(Communicator(), curves, model(truth));
    experiment.learn_bias(values);
    auto stronger = values;  // the bars of one group carry more
    for (std::size_t j = 0; j < values.size(); ++j)
      if (experiment.parameters()[j].info.name == "gain_of_fast") stronger[j] = 1.01;
    const auto r = experiment.residuals({values, stronger});
    const Eigen::VectorXd mark = (r[0] - r[1]).normalized();
    const Eigen::MatrixXd null = experiment.noise(values, 60), squares = experiment.noise_of_squares(values, null);
    ratio += std::pow(mark.dot(r[0]), 2) / ((mark.transpose() * null).squaredNorm() / 60.0) / tests;
    energy += r[0].squaredNorm() / tests, of_null += squares.colwise().squaredNorm().mean() / tests;
  }
  // t^2 of Student's t of variance one with 7 degrees, judged by 60 draws: its mean is known to a tenth.
  RecordProperty("ratio", std::to_string(ratio));
  EXPECT_NEAR(ratio, 1.0, 0.3);
  // What is left of the cubics in a bin has no variance here, and none is never estimated: the null is too large by
  // that, not too small.
  EXPECT_GT(energy / of_null, 0.9);
  EXPECT_LT(energy / of_null, 1.05);
}

/// Strain and time of two and a half cycles of 1.5 %, in rows of 7e-4.
material::BarHistory cycles() {
  material::BarHistory history;
  std::vector<double> strain;
  double at = 0.0;
  for (const double turn : {0.015, -0.015, 0.015, -0.015, 0.02})
    for (const double from = at, step = 7e-4 * (turn > at ? 1.0 : -1.0); std::abs(at - from) < std::abs(turn - from);
         at += step)
      strain.push_back(at);
  history.strain = Eigen::Map<const Eigen::VectorXd>(strain.data(), static_cast<Eigen::Index>(strain.size()));
  history.time = Eigen::VectorXd::LinSpaced(history.strain.size(), 0.0, 200.0);
  return history;
}

/// A bar of a group with this stress, off by `off` as far as it carries 200 MPa, and noise of 2 MPa.
identification::Curve bar_off_by(double off, const std::string& group, int number, const material::BarHistory& history,
                                 const Eigen::VectorXd& stress, std::mt19937_64& random) {
  std::normal_distribution<double> normal;
  identification::Curve curve;
  curve.name = group + std::to_string(number), curve.group = group, curve.history = history, curve.stress = stress,
  curve.deviation = 6.0;
  for (double& value : curve.stress) value += off * std::min(1.0, std::abs(value) / 200.0) + 2.0 * normal(random);
  curve.use.assign(static_cast<std::size_t>(stress.size()), identification::Curve::fitted);
  curve.use[0] = identification::Curve::not_judged;
  return curve;
}

/// Bars that differ in proportion to their stress, as far as it is small, do not differ where a cycle passes zero: no
/// cubic of the way, and the energy of a group whose mean is off holds it.
TEST(CurveExperimentNightly, BarsDifferOtherwiseWhereTheStressIsSmall) {
  const material::BarHistory history = cycles();
  const CurveModel m = model(truth);
  const Eigen::VectorXd stress =
      material::pull_bar(*m.extended(material::known_effects()), m.values, history).engineering;
  constexpr int tests = 200;
  int beyond = 0;
  for (int test = 0; test < tests; ++test) {
    std::mt19937_64 random(100 + static_cast<unsigned>(test));
    std::normal_distribution<double> normal;
    std::vector<identification::Curve> curves;
    for (int k = 0; k < 6; ++k)
      curves.push_back(bar_off_by(5.0 * normal(random), "cycles", k, history, stress, random));
    CurveExperiment experiment(Communicator(), curves, m);
    std::vector<double> values;
    for (const auto& p : experiment.parameters()) values.push_back(p.value);
    experiment.learn_bias(values);
    const Eigen::ArrayXd null =
        experiment.noise_of_squares(values, experiment.noise(values, 60)).colwise().squaredNorm();
    beyond += experiment.residuals({values}).front().squaredNorm() >
              null.mean() + 1.65 * std::sqrt((null - null.mean()).square().mean());
  }
  RecordProperty("beyond", beyond);
  std::printf("%d of %d beyond the null's 95 %%\n", beyond, tests);
  EXPECT_LE(beyond, 18);  // 10 expected; 97 % of 1.2
}

/// Residuals where the scatter was learned at the declared values: there, and with this parameter elsewhere.
std::vector<Eigen::VectorXd> residuals_with(CurveExperiment& experiment, const std::string& name, double value) {
  std::vector<double> values;
  for (const auto& p : experiment.parameters()) values.push_back(p.value);
  experiment.learn_bias(values);
  auto other = values;
  for (std::size_t j = 0; j < values.size(); ++j)
    if (experiment.parameters()[j].info.name == name) other[j] = value;
  EXPECT_NE(other, values) << name;
  return experiment.residuals({values, other});
}

/// The same beside bars that are pulled, whose elastic begin bends the cubic of how they differ: what is off by chance
/// in all bars that are cycled is no zero of their load cell.
TEST(CurveExperiment, BarsThatFlowOtherwiseHaveNoOtherLoadCell) {
  const CurveModel m = model(truth);
  material::BarHistory pulled;
  pulled.strain = 0.1 * Eigen::VectorXd::LinSpaced(120, 0.0, 1.0).array().pow(1.5);
  pulled.time = pulled.strain / 1e-3;
  std::map<std::string, std::pair<material::BarHistory, Eigen::VectorXd>> groups{{"pulled", {pulled, {}}},
                                                                                 {"cycles", {cycles(), {}}}};
  for (auto& [group, its] : groups)
    its.second = material::pull_bar(*m.extended(material::known_effects()), m.values, its.first).engineering;
  constexpr int tests = 60;
  double ratio = 0.0;
  for (int test = 0; test < tests; ++test) {
    std::mt19937_64 random(100 + static_cast<unsigned>(test));
    std::normal_distribution<double> normal;
    std::vector<identification::Curve> curves;
    for (const auto& [group, its] : groups)
      for (int k = 0; k < (group == "cycles" ? 4 : 12); ++k)
        curves.push_back(bar_off_by(5.0 * normal(random), group, k, its.first, its.second, random));
    CurveExperiment experiment(Communicator(), curves, m);
    const auto r = residuals_with(experiment, "force_offset_of_cycles", 1.0);
    const Eigen::VectorXd mark = (r[0] - r[1]).normalized();
    ratio +=
        std::pow(mark.dot(r[0]), 2) / ((mark.transpose() * experiment.noise({}, 200)).squaredNorm() / 200.0) / tests;
  }
  std::printf("score over what the null says, mean square: %.2f\n", ratio);
  EXPECT_NEAR(ratio, 1.0, 0.5);
}

/// Repeated bars that differ by nothing but noise, of the strain, too: it is in the bins where they are elastic, which
/// had been taken for something that is missing.
TEST(CurveExperiment, NoiseOfTheStrainIsInTheElasticBinsOfRepeatedBars) {
  constexpr double noise = 3e-5, E = 200e3;
  const CurveModel m = model(truth);
  material::BarHistory pulled;
  pulled.strain = 0.05 * Eigen::VectorXd::LinSpaced(200, 0.0, 1.0);
  pulled.time = pulled.strain / 1e-3;
  const Eigen::VectorXd stress =
      material::pull_bar(*m.extended(material::known_effects()), m.values, pulled).engineering;
  std::map<double, double> ratio;
  constexpr int tests = 20;
  for (const double of_strain : {0.0, noise})
    for (int test = 0; test < tests; ++test) {
      std::mt19937_64 random(300 + static_cast<unsigned>(test));
      std::normal_distribution<double> normal;
      std::vector<identification::Curve> curves;
      for (int k = 0; k < 8; ++k) {
        curves.push_back(bar_off_by(0.0, "pulled", k, pulled, stress, random));
        curves.back().strain_noise = of_strain;
        for (double& strain : curves.back().history.strain) strain += of_strain * normal(random);
      }
      CurveExperiment experiment(Communicator(), curves, m);
      std::vector<double> at;
      for (const auto& one : experiment.parameters()) at.push_back(one.value);
      experiment.learn_bias(at);
      const Eigen::VectorXd r = experiment.residuals({at}).front();
      const Eigen::MatrixXd null = experiment.noise_of_squares(at, experiment.noise(at, 100));
      ratio[of_strain] += r.squaredNorm() / (null.squaredNorm() / static_cast<double>(null.cols())) / tests;
    }
  std::printf("square of the residual over what the null says: %.3f, with noise of the strain %.3f (%.0f MPa)\n",
              ratio[0.0], ratio[noise], E * noise);
  EXPECT_NEAR(ratio[noise], ratio[0.0], 0.1);
}

/// Rows behind a turn whose place is in doubt are off together, in bars that have repetitions, too: they tell less.
TEST(CurveExperiment, TurnsOfRepeatedBarsAreInDoubt) {
  const CurveModel m = model(truth);
  std::map<double, double> length;
  for (const double doubt : {0.0, 1e-4}) {
    std::mt19937_64 random(1);
    const material::BarHistory history = cycles();
    const Eigen::VectorXd stress =
        material::pull_bar(*m.extended(material::known_effects()), m.values, history).engineering;
    std::vector<identification::Curve> curves;
    for (int k = 0; k < 6; ++k) {
      curves.push_back(bar_off_by(0.0, "cycles", k, history, stress, random));
      auto& turns = curves.back().history.turns;
      turns = identification::find_turns(history.time, history.strain, curves.back().stress);
      ASSERT_EQ(turns.size(), 4U);
      for (auto& turn : turns) turn.deviation = doubt;
    }
    CurveExperiment experiment(Communicator(), curves, m);
    const auto r = residuals_with(experiment, "force_delay", 0.1);
    length[doubt] = (r[0] - r[1]).norm();
  }
  EXPECT_LT(length[1e-4], 0.9 * length[0.0]) << length[0.0];
}

TEST(CurveExperiment, DeclaredEffectsAreNoCandidates) {
  CurveModel m = model(truth);
  m.effects = {{.effect = "force_zero", .quantity = "force_offset", .value = 7.0, .lower = {}, .upper = {}},
               {.effect = "compliance", .quantity = "compliance", .value = {}, .lower = {}, .upper = {}, .free = true}};
  const auto curves = bars(1, {});
  CurveExperiment with(Communicator(), curves, m), without(Communicator(), curves, model(truth));
  const auto values_of = [](const CurveExperiment& e) {
    std::vector<double> values;
    for (const auto& p : e.parameters()) values.push_back(p.value);
    return values;
  };
  for (const auto& candidate : with.candidates())
    EXPECT_TRUE(candidate.name != "force zero" && candidate.name != "compliance");
  EXPECT_EQ(with.candidates().size() + 2, without.candidates().size());
  EXPECT_EQ(std::count_if(with.parameters().begin(), with.parameters().end(),
                          [](const Parameter& p) { return p.info.name == "compliance" && p.free; }),
            1);
  const auto shown = with.predict(values_of(with)), bare = without.predict(values_of(without));
  EXPECT_NEAR((shown[0] - bare[0]).tail(100).mean(), 7.0, 1e-9);
  m.effects = {{.effect = "force_zero", .quantity = "force_offset", .value = 7.0, .lower = {}, .upper = {}},
               {.effect = "thickness", .quantity = "thickness_error", .value = 0.05, .lower = {}, .upper = {}}};
  CurveExperiment thicker(Communicator(), curves, m);
  EXPECT_LT((thicker.predict(values_of(thicker))[0] - (1.05 * bare[0].array() + 7.0).matrix()).tail(100).norm(),
            1e-9 * bare[0].norm());
  m.effects = {{.effect = "parallax", .quantity = "inverse_distance", .value = 1e-3, .lower = {}, .upper = {}}};
  EXPECT_THROW(CurveExperiment(Communicator(), curves, m), InputError);
}

/// Bars of one group, half of whose rows are below 1 % strain, strengths 1 % apart.
std::vector<identification::Curve> dense_bars(int count, double zero, unsigned seed) {
  const CurveModel m = model(truth);
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  std::vector<identification::Curve> all;
  for (int k = 0; k < count; ++k) {
    identification::Curve curve;
    curve.name = "bar" + std::to_string(k), curve.group = "bars";
    curve.history.strain.resize(150);
    curve.history.strain << Eigen::VectorXd::LinSpaced(75, 0.0, 0.01),
        Eigen::VectorXd::LinSpaced(76, 0.01, 0.1).tail(75);
    curve.history.time = curve.history.strain / 1e-3;
    curve.stress = material::pull_bar(*m.extended(material::known_effects()), m.values, curve.history).engineering;
    if (count > 1) curve.stress *= 1.0 + 0.01 * normal(random);
    for (double& stress : curve.stress) stress += zero + 1.5 * normal(random);
    curve.deviation = 1.5;
    curve.use.assign(150, identification::Curve::fitted);
    curve.use[0] = identification::Curve::not_judged;
    all.push_back(std::move(curve));
  }
  return all;
}

/// What a gauge of this gain shows of a logarithmic strain.
double shown(double strain, double gain) { return std::log1p(gain * std::expm1(strain)); }

/// A gauge that is off errs at a turn that no row has, too.
TEST(CurveExperiment, AGaugeActsOnTurnsBetweenRows) {
  constexpr double gain = 1.05;
  const auto triangle = [](double t) { return 0.01 * (1.0 - std::abs(std::fmod(t + 1.0, 4.0) - 2.0)); };
  const CurveModel m = model(truth);
  const auto sampled = [&](int rows, double spacing) {
    material::BarHistory history{.time = Eigen::VectorXd::LinSpaced(rows, 0.0, (rows - 1) * spacing), .strain = {}};
    history.strain = history.time.unaryExpr(triangle);
    return history;
  };
  identification::Curve curve;
  curve.name = "cycle", curve.group = "cycles", curve.deviation = 1.0;
  curve.history = sampled(86, 0.07);
  curve.stress = material::pull_bar(*m.extended(material::known_effects()), m.values, sampled(596, 0.01))
                     .kirchhoff(Eigen::seqN(0, 86, 7));
  curve.engineering = false;
  for (double& strain : curve.history.strain) strain = shown(strain, gain);
  curve.history.turns = identification::find_turns(curve.history.time, curve.history.strain, curve.stress);
  ASSERT_EQ(curve.history.turns.size(), 3U);
  curve.use.assign(86, identification::Curve::fitted);
  CurveExperiment experiment(Communicator(), {curve}, model(truth));
  std::vector<double> values;
  for (const auto& p : experiment.parameters()) values.push_back(p.info.name == "strain_gain" ? gain : p.value);
  EXPECT_LT((experiment.predict(values).front() - curve.stress).cwiseAbs().maxCoeff(), 0.05);
}

/// A bar pulled to 6 % with three unloadings, whose recorded strain holds the load train's.
identification::Curve bar_of_a_soft_train(const material::FiniteStrainLaw& law, const std::vector<double>& values,
                                          double compliance, unsigned seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  identification::Curve curve;
  curve.name = "bar", curve.group = "bar", curve.deviation = 1.0;
  curve.history.time = Eigen::VectorXd::LinSpaced(500, 0.0, 499.0);
  const auto strain = [](double t) {
    double at = 0.0, from = 0.0;
    for (const auto& [until, rate] : {std::pair(120.0, 1.5e-4),
                                      {140.0, -1e-4},
                                      {260.0, 1.5e-4},
                                      {280.0, -1e-4},
                                      {400.0, 1.5e-4},
                                      {420.0, -1e-4},
                                      {499.0, 1.5e-4}}) {
      if (t > from) at += rate * (std::min(t, until) - from);
      from = until;
    }
    return at;
  };
  curve.history.strain = curve.history.time.unaryExpr(strain);
  const Eigen::VectorXd stress = material::pull_bar(law, values, curve.history).engineering;
  curve.history.strain = (curve.history.strain.array().exp() + compliance * stress.array()).log();
  curve.stress = stress.unaryExpr([&](double s) { return s + 0.6 * normal(random); });
  curve.use.assign(500, identification::Curve::fitted);
  identification::read_gauge(curve, true);
  return curve;
}

/// Whether the set of the loop on that bar has the compliance in it.
bool finds_compliance(const CurveModel& m, double compliance, unsigned seed, std::size_t most) {
  CurveExperiment experiment(
      Communicator(), {bar_of_a_soft_train(*m.extended(material::known_effects()), m.values, compliance, seed)}, m);
  const Report report = loop_on(experiment);
  const auto is_it = [&](int k) { return experiment.candidates()[static_cast<std::size_t>(k)].name == "compliance"; };
  EXPECT_LE(report.set.size(), most) << report.sentence;
  EXPECT_EQ(report.named.size(), 1U) << report.sentence;
  return std::count_if(report.set.begin(), report.set.end(), is_it) == 1;
}

ParameterInfo& youngs_modulus(CurveModel& m) {
  return *std::find_if(m.information.begin(), m.information.end(), [](const auto& info) { return info.name == "E"; });
}

/// A load train that gives way like the bar, and a handbook's E: noise of the stress is no strain of the train. The
/// gain of a strain that hardens by a curve's formula is another name for it.
CurveModel with_a_prior_on_E() {
  CurveModel m = model(truth);
  m.priors[static_cast<std::size_t>(&youngs_modulus(m) - m.information.data())] = 2e3;
  return m;
}
TEST(CurveExperiment, AComplianceIsFoundBesideAPriorOnE) {
  EXPECT_TRUE(finds_compliance(with_a_prior_on_E(), 4e-6, 1, 2));
}
TEST(CurveExperimentNightly, AComplianceIsFoundBesideAPriorOnEInOtherNoise) {
  EXPECT_TRUE(finds_compliance(with_a_prior_on_E(), 4e-6, 2, 2));
}

/// E that would go to half of its value, were it not for its bound, hides none of it.
CurveModel with_bounds_of_E() {
  CurveModel m = model(truth);
  youngs_modulus(m).lower = 150e3, youngs_modulus(m).upper = 250e3;
  return m;
}
TEST(CurveExperiment, AComplianceIsFoundWhereEIsOnItsBound) {
  EXPECT_TRUE(finds_compliance(with_bounds_of_E(), 4e-6, 1, 4));
}
TEST(CurveExperimentNightly, AComplianceIsFoundWhereEIsOnItsBoundInOtherNoise) {
  EXPECT_TRUE(finds_compliance(with_bounds_of_E(), 4e-6, 2, 4));
}

/// Pulled, held and turned between two rows: the strain before the turn stands still from row to row.
TEST(CurveExperiment, AGaugeActsOnATurnAfterAHold) {
  constexpr double gain = 1.05;
  const CurveModel m = model(truth);
  identification::Curve curve;
  curve.name = "held", curve.group = "held", curve.deviation = 1.0, curve.engineering = false;
  curve.history.time = Eigen::VectorXd::LinSpaced(101, 0.0, 100.0);
  curve.history.strain = curve.history.time.unaryExpr([](double t) {
    return t <= 40.0 ? 2.5e-4 * t : t <= 60.0 ? 0.01 : 0.01 - 2.5e-4 * (t - 60.5);
  });
  curve.history.turns = {{.row = 61, .between = true, .time = 60.5, .strain = 0.0103}};
  curve.stress = material::pull_bar(*m.extended(material::known_effects()), m.values, curve.history).kirchhoff;
  for (double& strain : curve.history.strain) strain = shown(strain, gain);
  curve.history.turns.front().strain = shown(curve.history.turns.front().strain, gain);
  curve.use.assign(101, identification::Curve::fitted);
  CurveExperiment experiment(Communicator(), {curve}, model(truth));
  std::vector<double> values;
  for (const auto& p : experiment.parameters()) values.push_back(p.info.name == "strain_gain" ? gain : p.value);
  const auto predicted = experiment.predict(values);
  ASSERT_EQ(predicted.size(), 1U) << experiment.obstacle(values);
  EXPECT_LT((predicted.front() - curve.stress).cwiseAbs().maxCoeff(), 1e-3);
}

/// The fast bars of a declared rate that takes all of the yield stress away.
TEST(CurveExperiment, WhatTheLawCannotFollowIsSaid) {
  CurveModel m = model({{"E", 200e3},
                        {"nu", 0.3},
                        {"S_y", 250.0},
                        {"S_inf", 420.0},
                        {"b", 18.0},
                        {"H", 700.0},
                        {"C_rate", -0.15},
                        {"rate_0", 1e-6}});
  for (std::size_t j = 0; j < m.values.size(); ++j)
    if (m.information[j].effect == "rate") m.declared[j] = 1;
  m.extended = [](std::vector<std::string> effects) {
    if (std::find(effects.begin(), effects.end(), "rate") == effects.end()) effects.push_back("rate");
    return material::make_law({.law = "j2", .hardening = "voce", .effects = effects});
  };
  CurveExperiment experiment(Communicator(), bars(1, {}), m);
  try {
    loop_on(experiment);
    FAIL();
  } catch (const ConvergenceError& error) {
    EXPECT_NE(std::string(error.what()).find("fast0 (fast): the law cannot follow beyond row"), std::string::npos)
        << error.what();
  }
}

/// The elastic part is an eightieth of the strain and more than half of the stress: it has its share of the bins, the
/// same for all bars, and the load cell's zero is told from E. A bar that carries 25 MPa where its extensometer is set
/// to zero has the same record.
TEST(CurveExperiment, TheZeroOfTheForceIsFoundInRepeatedBars) {
  for (int count : {2, 6}) {
    CurveExperiment experiment(Communicator(), dense_bars(count, 25.0, 1), model(truth));
    const Report report = loop_on(experiment);
    const auto zero = std::find_if(report.set.begin(), report.set.end(), [&](int k) {
      return experiment.candidates()[static_cast<std::size_t>(k)].name == "force zero";
    });
    ASSERT_NE(zero, report.set.end()) << report.sentence;
    EXPECT_LE(report.set.size(), 3U) << report.sentence;
    const auto place =
        static_cast<std::size_t>(experiment.candidates()[static_cast<std::size_t>(*zero)].parameters.front());
    const auto& trials = report.rounds.front().trials;
    const auto its = std::find_if(trials.begin(), trials.end(), [&](const Trial& t) { return t.candidate == *zero; });
    ASSERT_NE(its, trials.end());
    EXPECT_NEAR(its->model.fit.values[place], 25.0, 3.0) << report.sentence;
  }
}

/// A load cell whose zero is off reads it where the record begins; a row that was set to zero says nothing.
TEST(CurveExperiment, ARecordThatBeginsAtZeroContradictsAZeroThatIsOff) {
  for (const auto& [begins, contradicted] : {std::pair(25.0, false), {0.0, true}, {-25.0, true}}) {
    auto curves = dense_bars(3, begins, 1);
    for (const bool set : {false, true}) {
      if (set)
        for (auto& curve : curves) curve.stress[0] = 0.0;
      CurveExperiment experiment(Communicator(), curves, model(truth));
      std::vector<double> values;
      for (const auto& p : experiment.parameters()) values.push_back(p.info.name == "force_offset" ? 25.0 : p.value);
      for (std::size_t k = 0; k < experiment.candidates().size(); ++k)
        EXPECT_EQ(!experiment.contradiction(static_cast<int>(k), values).empty(),
                  contradicted && !set && experiment.candidates()[k].name == "force zero")
            << begins << " " << experiment.candidates()[k].name;
    }
  }
}

/// An extensometer that reads 1e-4 too much begins with that, or was set to zero before a slack was taken up: the bar
/// carries nothing then.
TEST(CurveExperiment, ABarBeginsUnloadedWhateverItsGaugeShows) {
  for (const double begins : {0.0, 1e-4}) {
    auto curves = dense_bars(1, 0.0, 1);
    for (double& strain : curves[0].history.strain) strain += 1e-4;
    curves[0].history.strain[0] = begins;
    CurveExperiment experiment(Communicator(), curves, model(truth));
    std::vector<double> values;
    for (const auto& p : experiment.parameters()) values.push_back(p.info.name == "strain_offset" ? 1e-4 : p.value);
    const auto predicted = experiment.predict(values);
    EXPECT_NEAR(predicted[0][0], 0.0, 1e-2) << begins;
    EXPECT_NEAR(predicted[0][5], curves[0].stress[5], 8.0) << begins;
  }
}

/// An extensometer that was set to zero under load: the bar carries that load where it shows nothing.
TEST(CurveExperiment, AGaugeThatWasSetToZeroUnderLoad) {
  auto curves = dense_bars(1, 0.0, 1);
  const double zero = curves[0].history.strain[3];
  auto [strain, time] = std::tie(curves[0].history.strain, curves[0].history.time);
  const auto rows = strain.size() - 3;
  strain = Eigen::VectorXd(strain.tail(rows).array() - zero), time = Eigen::VectorXd(time.tail(rows));
  curves[0].stress = Eigen::VectorXd(curves[0].stress.tail(rows));
  curves[0].use.resize(static_cast<std::size_t>(rows));
  ASSERT_GT(curves[0].stress[0], 50.0);
  CurveExperiment experiment(Communicator(), curves, model(truth));
  std::vector<double> values;
  for (const auto& p : experiment.parameters()) values.push_back(p.info.name == "strain_offset" ? -zero : p.value);
  const auto predicted = experiment.predict(values);
  for (const Eigen::Index row : {0, 5}) EXPECT_NEAR(predicted[0][row], curves[0].stress[row], 8.0) << row;
}

/// Plastic work that softens by eight times what it usually does is heat; by thirty times it is something else,
/// whatever it leaves.
TEST(CurveExperiment, WhatIsManyTimesTheUsualSizeIsSomethingElse) {
  for (const double times : {8.0, 30.0}) {
    CurveExperiment experiment(Communicator(), bars(2, {{"heating", times * 50.0 / 200e3}, {"cooling", 0.05}}, 4),
                               model(truth));
    const Report report = loop_on(experiment);
    const auto is_it = [&](int k) { return experiment.candidates()[static_cast<std::size_t>(k)].name == "heating"; };
    EXPECT_EQ(std::any_of(report.set.begin(), report.set.end(), is_it), times < 20.0) << report.sentence;
    bool said = false;
    for (const auto& round : report.rounds)
      for (const auto& trial : round.trials)
        said =
            said || (is_it(trial.candidate) && trial.objection.find("times what is usual of it") != std::string::npos);
    EXPECT_EQ(said, times > 20.0);
  }
}

/// Two load cells' zeros together are what the bars of one group begin with.
TEST(CurveExperiment, ZerosOfAllAndOfOneGroupAreReadTogether) {
  auto curves = dense_bars(3, -40.0, 1);
  for (auto& curve : dense_bars(3, 10.0, 2)) curve.group = "there", curves.push_back(std::move(curve));
  CurveExperiment experiment(Communicator(), std::move(curves), model(truth));
  std::vector<double> values;
  for (const auto& p : experiment.parameters())
    values.push_back(p.info.name == "force_offset" ? -40.0 : p.info.name == "force_offset_of_there" ? 50.0 : p.value);
  for (std::size_t k = 0; k < experiment.candidates().size(); ++k)
    EXPECT_EQ(experiment.contradiction(static_cast<int>(k), values), "") << experiment.candidates()[k].name;
}

/// Two groups of bars, one of them measured on another machine, whose gauge or load cell is off.
TEST(CurveExperiment, TheMachineOfOneGroupIsFound) {
  for (const std::string fault : {"force zero", "strain gain", "strain zero"}) {
    auto curves = dense_bars(6, 0.0, 1);
    for (auto& curve : dense_bars(6, fault == "force zero" ? 25.0 : 0.0, 2)) {
      curve.group = "there";
      for (double& strain : curve.history.strain)
        strain = fault == "strain gain"   ? shown(strain, 1.06)
                 : fault == "strain zero" ? std::log1p(std::expm1(strain) + 1e-4)
                                          : strain;
      curves.push_back(std::move(curve));
    }
    CurveExperiment experiment(Communicator(), std::move(curves), model(truth));
    const Report report = loop_on(experiment);
    EXPECT_EQ(report.named.size(), 1U) << report.sentence;
    EXPECT_TRUE(std::any_of(
        report.set.begin(), report.set.end(),
        [&](int k) { return experiment.candidates()[static_cast<std::size_t>(k)].name == fault + " of there"; }))
        << fault << ": " << report.sentence;
    EXPECT_LE(report.set.size(), 2U) << report.sentence;
  }
}

/// What was estimated from the points of a curve has their freedom, and every draw its own estimate; what was declared
/// is known.
TEST(CurveExperiment, NoiseOfThePointsIsAnEstimate) {
  auto curves = dense_bars(1, 0.0, 4);  // one of the nine of ten whose steep rows do not scatter more by chance
  const auto spread = [](const CurveExperiment& e, Eigen::MatrixXd squares) {
    const Eigen::ArrayXd all = squares.colwise().squaredNorm().transpose() / static_cast<double>(e.data().size());
    return std::sqrt((all - all.mean()).square().mean());
  };
  std::vector<double> values;
  CurveExperiment known(Communicator(), curves, model(truth));
  curves[0].estimated = true, curves[0].deviation = 9.0;  // of the stresses; about the prediction it is 1.5
  CurveExperiment estimated(Communicator(), curves, model(truth));
  for (const auto& p : known.parameters()) values.push_back(p.value);
  known.learn_bias(values), estimated.learn_bias(values);
  EXPECT_TRUE((known.freedom().array() == std::numeric_limits<double>::infinity()).all());
  EXPECT_NEAR(estimated.freedom()[0], 0.5 * 149.0, 5.0);
  EXPECT_NEAR(estimated.bin_noise(0), 1.5, 0.4);
  const Eigen::MatrixXd exact = known.noise(values, 400), grown = estimated.noise(values, 400);
  EXPECT_GT(grown.norm(), 1.005 * exact.norm());
  // chi^2/N has a standard deviation of sqrt(2/149) = 0.116 where the noise is known; as much again comes of the
  // estimate, which shares its points.
  EXPECT_NEAR(spread(known, known.noise_of_squares(values, exact)), 0.116, 0.02);
  EXPECT_GT(spread(estimated, estimated.noise_of_squares(values, grown)), 0.116);
}

/// Whether something is said to be missing in a curve that has no repetition, whose first row is that of the virgin
/// bar.
bool raises_alarm(identification::Curve curve) {
  curve.deviation = identification::point_noise(curve),
  curve.use.assign(static_cast<std::size_t>(curve.stress.size()), identification::Curve::fitted);
  curve.use[0] = identification::Curve::not_judged;
  CurveExperiment experiment(Communicator(), {curve}, model(truth));
  const Report report = loop_on(experiment);
  if (report.verdict != Verdict::nothing_found) std::printf("  %s\n", report.sentence.c_str());
  return report.verdict != Verdict::nothing_found;
}

/// One bar, the noise of whose strain is 4 times as much stress as that of the load cell where it is elastic: nothing
/// is missing.
TEST(CurveExperiment, NoiseOfTheStrainIsNoEffect) {
  int alarms = 0;
  constexpr int count = 10;
  const std::vector<double> values = model(truth).values;
  for (unsigned seed = 0; seed < count; ++seed) {
    std::mt19937_64 random(seed);
    std::normal_distribution<double> normal;
    identification::Curve curve;
    curve.name = curve.group = "bar", curve.estimated = true;
    curve.history.strain = Eigen::VectorXd::LinSpaced(400, 0.0, 0.08), curve.history.time = curve.history.strain / 1e-3;
    curve.stress =
        material::pull_bar(*model(truth).extended(material::known_effects()), values, curve.history).engineering;
    for (Eigen::Index row = 1; row < 400; ++row)
      curve.stress[row] += normal(random), curve.history.strain[row] += 2e-5 * normal(random);
    alarms += raises_alarm(curve);
  }
  EXPECT_LE(alarms, 2);  // 0.05 each: 1 of 80 that there are more
}

/// A bar that is unloaded between two rows: what is not known of the turn is no friction, delay or zero of the force.
TEST(CurveExperiment, NoiseOfTheStrainOfAnUnloadedBarIsNoEffect) {
  int alarms = 0;
  constexpr unsigned count = 10;
  constexpr Eigen::Index rows = 740;
  const std::vector<double> values = model(truth).values;
  for (unsigned seed = 0; seed < count; ++seed) {
    std::mt19937_64 random(seed);
    std::normal_distribution<double> normal;
    // 0, .01, .0085, .03, .0275, .06, .0567 at 1e-3/s
    const std::vector<double> at = {0.0, 0.01, 0.0085, 0.03, 0.0275, 0.06, 0.0567, 0.1};
    std::vector<double> when = {0.0};
    for (std::size_t k = 1; k < at.size(); ++k) when.push_back(when.back() + std::abs(at[k] - at[k - 1]) / 1e-3);
    identification::Curve curve;
    curve.name = curve.group = "bar", curve.estimated = true;
    curve.history.time = Eigen::VectorXd::LinSpaced(rows, 0.0, 115.0 + 0.01 * seed), curve.history.strain.resize(rows);
    for (Eigen::Index row = 0, piece = 0; row < rows; ++row) {
      const double t = curve.history.time[row];
      while (piece + 2 < static_cast<Eigen::Index>(when.size()) && t > when[static_cast<std::size_t>(piece) + 1]) {
        ++piece;
        curve.history.turns.push_back(
            {row, true, when[static_cast<std::size_t>(piece)], at[static_cast<std::size_t>(piece)]});
      }
      const auto k = static_cast<std::size_t>(piece);
      curve.history.strain[row] = at[k] + (t - when[k]) * (at[k + 1] - at[k]) / (when[k + 1] - when[k]);
    }
    curve.stress =
        material::pull_bar(*model(truth).extended(material::known_effects()), values, curve.history).engineering;
    for (Eigen::Index row = 1; row < rows; ++row)
      curve.stress[row] += normal(random), curve.history.strain[row] += 2e-5 * normal(random);
    identification::read_gauge(curve);
    alarms += raises_alarm(curve);
  }
  EXPECT_LE(alarms, 2);  // 0.05 each: 1 of 80 that there are more
}

/// Bars along and across tell R_22; nothing tells R_33, R_12 and the angle, which would take the deviation of R_22
/// along.
TEST(CurveExperiment, WhatTwoDirectionsSayNothingOfIsLeftOut) {
  auto values = truth;
  values["R_22"] = 0.93;
  const CurveModel m = model(values);
  std::mt19937_64 random(4);
  std::normal_distribution<double> normal;
  std::vector<identification::Curve> both;
  for (const double direction : {0.0, 90.0})
    for (int k = 0; k < 4; ++k) {
      identification::Curve curve;
      curve.group = direction > 0.0 ? "across" : "along", curve.name = curve.group + std::to_string(k),
      curve.deviation = 3.0;
      curve.history.strain = Eigen::VectorXd::LinSpaced(150, 0.0, 0.08),
      curve.history.time = curve.history.strain / 1e-3, curve.history.direction = direction;
      curve.stress = material::pull_bar(*m.extended(material::known_effects()), m.values, curve.history).engineering;
      const double off = normal(random);
      for (Eigen::Index row = 1; row < 150; ++row) curve.stress[row] += off + normal(random);
      curve.use.assign(150, identification::Curve::fitted);
      curve.use[0] = identification::Curve::not_judged;
      both.push_back(std::move(curve));
    }
  CurveExperiment experiment(Communicator(), both, model(truth));
  const Report report = loop_on(experiment);
  ASSERT_EQ(report.final.added.size(), 1U) << report.sentence;
  EXPECT_EQ(experiment.candidates()[static_cast<std::size_t>(report.final.added.front())].name, "hill");
  EXPECT_EQ(report.final.idle.size(), 3U);
  for (std::size_t k = 0; k < report.final.fit.free.size(); ++k) {
    const auto& info = experiment.parameters()[static_cast<std::size_t>(report.final.fit.free[k])].info;
    const double value = report.final.fit.values[static_cast<std::size_t>(report.final.fit.free[k])],
                 deviation =
                     std::sqrt(report.final.covariance(static_cast<Eigen::Index>(k), static_cast<Eigen::Index>(k)));
    if (info.name != "R_22" && info.name != "E") continue;
    EXPECT_NEAR(value, values.at(info.name), 3.0 * deviation) << info.name;
    EXPECT_LT(deviation, 0.02 * value) << info.name;
  }
}

/// A hundred null tests of 6000 rows each estimate their own noise: no matrix of rows by rows (6000^3/3 operations
/// each) is in it.
TEST(CurveExperiment, ManyRowsTakeSeconds) {
  constexpr Eigen::Index rows = 6000;
  identification::Curve curve;
  curve.name = curve.group = "bar", curve.estimated = true;
  curve.history.strain = Eigen::VectorXd::LinSpaced(rows, 0.0, 0.08), curve.history.time = curve.history.strain / 1e-3;
  const std::vector<double> values = model(truth).values;
  curve.stress =
      material::pull_bar(*model(truth).extended(material::known_effects()), values, curve.history).engineering;
  std::mt19937_64 random(1);
  std::normal_distribution<double> normal;
  for (double& stress : curve.stress) stress += normal(random);
  curve.deviation = identification::point_noise(curve), curve.use.assign(rows, identification::Curve::fitted);
  CurveExperiment experiment(Communicator(), {curve}, model(truth));
  std::vector<double> all;
  for (const auto& p : experiment.parameters()) all.push_back(p.value);
  const auto start = std::chrono::steady_clock::now();
  experiment.learn_bias(all);
  const Eigen::MatrixXd squares = experiment.noise_of_squares(all, experiment.noise(all, 100));
  EXPECT_NEAR(squares.squaredNorm() / static_cast<double>(squares.size()), 1.0, 0.05);
  EXPECT_LT(std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count(), 30.0);
}

TEST(CurveExperiment, RecordsOfBarsHaveNoImages) {
  CurveExperiment experiment(Communicator(), bars(1, {}), model(truth));
  for (const auto& candidate : experiment.candidates())
    EXPECT_EQ(candidate.sentence.find("images"), std::string::npos) << candidate.sentence;
  const auto& parameters = experiment.parameters();
  EXPECT_EQ(std::count_if(parameters.begin(), parameters.end(),
                          [](const Parameter& p) { return p.info.name == "compliance" && p.info.lower == 0.0; }),
            1);
}

TEST(CurveExperiment, EveryFourthBarIsHeldOut) {
  CurveExperiment experiment(Communicator(), bars(1, {}), model(truth));
  EXPECT_EQ(experiment.held_out(), (std::vector<int>{2, 8}));
  EXPECT_EQ(experiment.frame_name(2).substr(0, 12), "slow2 (slow)");
}

TEST(CurveExperiment, NothingIsFoundWhereNothingIsMissing) {
  CurveExperiment experiment(Communicator(), bars(2, {}), model(truth));
  const Report report = loop_on(experiment);
  EXPECT_EQ(report.verdict, Verdict::nothing_found) << report.sentence;
  // A plateau is more than a shift along the curve: of a usual size it is seen.
  const auto& others = report.declared.others;
  const auto plateau = std::find_if(others.begin(), others.end(), [&](int k) {
    return experiment.candidates()[static_cast<std::size_t>(k)].name == "plateau";
  });
  ASSERT_NE(plateau, others.end());
  EXPECT_GT(report.declared.scores.candidates[static_cast<std::size_t>(plateau - others.begin())].visibility, 0.1);
  // Scores of many marks are judged by a covariance of far more draws than there are marks; sums of squares take time,
  // and a hundred tell.
  EXPECT_EQ(report.declared.ground->null.cols(), 2000);
  EXPECT_EQ(report.declared.ground->squares.cols(), 100);
  // Whitened with the bars' own scatter, and not weighed by it once more.
  const auto N = static_cast<Eigen::Index>(experiment.data().size());
  EXPECT_TRUE(report.declared.ground->weight(Eigen::MatrixXd::Identity(N, N)).isIdentity(1e-12));
}

/// Without reversal friction is a zero of the force; with cycles it is a jump at every turn, found and told from
/// back-stresses.
TEST(CurveExperiment, FrictionIsFoundAtReversals) {
  const auto has_friction = [](const CurveExperiment& experiment) {
    return std::any_of(experiment.candidates().begin(), experiment.candidates().end(),
                       [](const Candidate& c) { return c.name == "friction"; });
  };
  EXPECT_FALSE(has_friction(CurveExperiment(Communicator(), bars(4, {}), model(truth))));
  auto all = bars(4, {});
  std::mt19937_64 random(5);
  std::normal_distribution<double> normal;
  const CurveModel m = model(truth);
  for (int k = 0; k < 4; ++k) {
    identification::Curve curve;
    curve.name = "cycle" + std::to_string(k), curve.group = "cycles";
    curve.history.strain.resize(241);
    for (int row = 0; row <= 240; ++row)
      curve.history.strain[row] = 0.012 * std::asin(std::sin(2.0 * M_PI * row / 80.0)) / (0.5 * M_PI);
    curve.history.time = Eigen::VectorXd::LinSpaced(241, 0.0, 240.0);
    curve.stress = material::pull_bar(*m.extended(material::known_effects()), m.values, curve.history).engineering;
    const double a = 3.0 * normal(random);
    for (Eigen::Index row = 1; row < 241; ++row) curve.stress[row] += a + 2.0 * normal(random);
    curve.deviation = 4.0;
    curve.use.assign(241, identification::Curve::fitted);
    curve.use[0] = identification::Curve::not_judged;
    all.push_back(std::move(curve));
  }
  for (auto& curve : all)
    for (Eigen::Index row = 1; row < curve.stress.size(); ++row)
      curve.stress[row] += curve.history.strain[row] > curve.history.strain[row - 1] ? 20.0 : -20.0;
  CurveExperiment experiment(Communicator(), std::move(all), model(truth));
  ASSERT_TRUE(has_friction(experiment));
  const Report report = loop_on(experiment);
  ASSERT_EQ(report.named.size(), 1U) << report.sentence;
  EXPECT_EQ(experiment.candidates()[static_cast<std::size_t>(report.named.front())].name, "friction")
      << report.sentence;
  EXPECT_EQ(report.sentence.find("the course"), std::string::npos) << report.sentence;
  const auto place = experiment.candidates()[static_cast<std::size_t>(report.named.front())].parameters.front();
  EXPECT_NEAR(report.final.fit.values[static_cast<std::size_t>(place)], 20.0, 2.0);
}

/// One rate of two cannot tell a factor on the fast bars from a viscous stress that is small everywhere: the verdict
/// may be a set, but the truth is in it.
TEST(CurveExperiment, RateIsInTheSet) {
  CurveExperiment experiment(Communicator(), bars(3, {{"C_rate", 0.012}, {"rate_0", 1e-3}}), model(truth));
  const Report report = loop_on(experiment);
  ASSERT_FALSE(report.set.empty()) << report.sentence;
  std::vector<std::string> names;
  for (int k : report.set) names.push_back(experiment.candidates()[static_cast<std::size_t>(k)].name);
  EXPECT_NE(std::find(names.begin(), names.end(), "rate"), names.end()) << report.sentence;
  EXPECT_GT(report.declared.misfit.held_out, report.declared.misfit.null_held_out);
  EXPECT_LE(report.final.misfit.held_out, report.final.misfit.null_held_out);
}

/// Ten cycles of 42 rows each, whose noise nobody has declared: the course bends from row to row by far more than it.
Verdict verdict_on_sparse_cycles(unsigned seed) {
  CurveModel m = model(truth);
  for (std::size_t j = 0; j < m.information.size(); ++j)
    if (m.information[j].effect == "kinematic")
      m.values[j] = m.information[j].shape ? 300.0 : 60e3, m.declared[j] = m.free[j] = 1;
  m.extended = [](std::vector<std::string> effects) {
    if (std::find(effects.begin(), effects.end(), "kinematic") == effects.end())
      effects.insert(effects.begin(), "kinematic");
    return material::make_law({.law = "j2", .hardening = "voce", .effects = effects});
  };
  const auto law = m.extended(material::known_effects());
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform(-0.3, 0.3);
  // On a fine course, which the rows take some of.
  constexpr int rows = 420, fine = 20;
  material::BarHistory course{.time = Eigen::VectorXd::LinSpaced(rows * fine, 0.0, 80.0), .strain = {}};
  course.strain =
      course.time.unaryExpr([](double t) { return 0.01 * std::asin(std::sin(0.5 * M_PI * t / 2.0)) / (0.5 * M_PI); });
  const Eigen::VectorXd stress = material::pull_bar(*law, m.values, course).engineering;
  identification::Curve curve;
  curve.name = curve.group = "cycles", curve.estimated = true;
  curve.history.time.resize(rows), curve.history.strain.resize(rows), curve.stress.resize(rows);
  for (int row = 0; row < rows; ++row) {
    const auto at =
        static_cast<Eigen::Index>(std::clamp(fine * (row + (row > 0 ? uniform(random) : 0.0)), 0.0, rows * fine - 1.0));
    curve.history.time[row] = course.time[at],
    curve.history.strain[row] = course.strain[at] + (row > 0 ? 4e-6 * normal(random) : 0.0),
    curve.stress[row] = stress[at] + normal(random);
  }
  curve.use.assign(rows, identification::Curve::fitted);
  curve.deviation = identification::point_noise(curve);
  EXPECT_LT(curve.deviation, 2.0);
  identification::read_gauge(curve, true);
  CurveExperiment experiment(Communicator(), {curve}, m);
  return loop_on(experiment).verdict;
}
TEST(CurveExperimentNightly, NoiseOfSparseCyclesIsNoEffect) {
  int alarms = 0;
  for (unsigned seed = 1; seed <= 8; ++seed) alarms += verdict_on_sparse_cycles(seed) == Verdict::nothing_found ? 0 : 1;
  EXPECT_LE(alarms, 2);  // 0.05 each: 1 of 160 that there are more
}

/// Its usual reference is the test's own rate: relative to one per second no C_rate within its bounds would be found in
/// slow tests.
TEST(CurveExperiment, ARateIsScoredInSlowTests) {
  CurveExperiment experiment(Communicator(), bars(3, {{"C_rate", 0.012}, {"rate_0", 1e-5}}, 6, 1e-2), model(truth));
  const auto place = [&](const char* name) {
    return static_cast<std::size_t>(std::find_if(experiment.parameters().begin(), experiment.parameters().end(),
                                                 [&](const Parameter& p) { return p.info.name == name; }) -
                                    experiment.parameters().begin());
  };
  EXPECT_NEAR(experiment.parameters()[place("rate_0")].value, 1e-4, 1e-6);
  const Report report = close_loop(experiment, {.additions = 0, .held_out = experiment.held_out()});
  const auto& others = report.declared.others;
  const auto rate = std::find_if(others.begin(), others.end(), [&](int k) {
    return experiment.candidates()[static_cast<std::size_t>(k)].name == "rate";
  });
  ASSERT_NE(rate, others.end());
  const Score& score = report.declared.scores.candidates[static_cast<std::size_t>(rate - others.begin())];
  EXPECT_GT(score.z, report.declared.scores.threshold);
  EXPECT_NEAR(score.size[0], 0.012, 0.006);
}

/// Tests at several rates have one reference: that of the slowest.
TEST(CurveExperiment, TestsTogetherHaveOneReferenceRate) {
  const auto all = bars(3, {});
  CurveExperiment slow(Communicator(), {all.begin(), all.begin() + 6}, model(truth)),
      fast(Communicator(), {all.begin() + 6, all.end()}, model(truth));
  const JointExperiment joint({{"fast", &fast}, {"slow", &slow}});
  for (const auto& p : joint.parameters())
    if (p.info.name == "rate_0") {
      EXPECT_NEAR(p.value, 1e-4, 1e-6);
    }
}

/// Pulled at two rates, held twice, integrated by explicit Euler.
TEST(CurveExperiment, ViscosityIsFoundInHolds) {
  constexpr double E = 200e3, eta = 200.0, m = 0.2;
  identification::Curve curve;
  curve.name = "held", curve.group = "held", curve.deviation = 1.5;
  std::vector<double> time = {0.0}, strain = {0.0}, stress = {0.0};
  double p = 0.0;
  const auto go = [&](double rate, int rows, double spacing) {
    constexpr int parts = 4000;
    for (int row = 0; row < rows; ++row) {
      const double from = strain.back(), dt = spacing / parts;
      double now = 0.0;
      for (int k = 1; k <= parts; ++k) {
        now = E * (from + rate * dt * k - p);
        p += dt * std::pow(std::max(0.0, now - (420.0 - 170.0 * std::exp(-18.0 * p))) / eta, 1.0 / m);
      }
      time.push_back(time.back() + spacing), strain.push_back(from + rate * spacing),
          stress.push_back(E * (strain.back() - p));
    }
  };
  go(1e-3, 40, 0.5), go(0.0, 30, 1.0), go(1e-2, 20, 0.1), go(0.0, 30, 1.0), go(1e-3, 40, 0.5);
  const auto vector = [](const std::vector<double>& all) -> Eigen::VectorXd {
    return Eigen::Map<const Eigen::VectorXd>(all.data(), std::ssize(all));
  };
  curve.history.time = vector(time), curve.history.strain = vector(strain);
  std::mt19937_64 random(5);
  std::normal_distribution<double> normal;
  curve.stress = vector(stress).cwiseProduct((-vector(strain)).array().exp().matrix()).unaryExpr([&](double s) {
    return s + 1.5 * normal(random);
  });
  curve.use.assign(time.size(), identification::Curve::fitted);
  curve.use[0] = identification::Curve::not_judged;
  auto declared = truth;
  declared["H"] = 0.0;
  CurveModel m_declared = model(declared);
  for (std::size_t j = 0; j < m_declared.values.size(); ++j)
    if (m_declared.information[j].name == "H") m_declared.free[j] = 0;
  CurveExperiment experiment(Communicator(), {curve}, m_declared);
  const Report report = loop_on(experiment);
  ASSERT_EQ(report.named.size(), 1U) << report.sentence;
  EXPECT_EQ(report.verdict, Verdict::attributed) << report.sentence;
  EXPECT_EQ(experiment.candidates()[static_cast<std::size_t>(report.named.front())].name, "viscosity")
      << report.sentence;
  const std::map<std::string, double> planted = {{"E", E},    {"S_y", 250.0}, {"S_inf", 420.0},
                                                 {"b", 18.0}, {"eta", eta},   {"m", m}};
  const Fit& fit = report.final.fit;
  for (std::size_t k = 0; k < fit.free.size(); ++k) {
    const auto j = static_cast<std::size_t>(fit.free[k]);
    const auto place = static_cast<Eigen::Index>(k);
    const double deviation = std::sqrt(report.final.covariance(place, place));
    EXPECT_LT(std::abs(fit.values[j] - planted.at(experiment.parameters()[j].info.name)), 3.0 * deviation)
        << experiment.parameters()[j].info.name << " " << fit.values[j] << " +- " << deviation;
  }
}

/// Where the strain turned between rows is seen though the force rubs or lags, and friction changes its sign there.
TEST(CurveExperiment, AForceThatRubsOrLagsTurnsWithTheBar) {
  const auto triangle = [](double t) { return 0.01 * (1.0 - std::abs(std::fmod(t + 1.0, 4.0) - 2.0)); };
  const CurveModel m = model(truth);
  material::BarHistory fine{.time = Eigen::VectorXd::LinSpaced(9001, 0.0, 9.0), .strain = {}};
  fine.strain = fine.time.unaryExpr(triangle);
  const Eigen::VectorXd stress = material::pull_bar(*m.extended(material::known_effects()), m.values, fine).kirchhoff;
  for (const auto& [name, size] :
       {std::pair<std::string, double>("friction_force", 8.0), std::pair<std::string, double>("force_delay", 0.05)}) {
    identification::Curve curve;
    curve.name = "cycle", curve.group = "cycles", curve.engineering = false;
    curve.history = {.time = Eigen::VectorXd(130), .strain = Eigen::VectorXd(130)};
    curve.stress.resize(130), curve.use.assign(130, identification::Curve::fitted);
    for (Eigen::Index row = 0; row < 130; ++row) {
      const Eigen::Index at = row * 67 + row * row % 17;  // ms
      const bool back = (at - 1 + 1000) / 2000 % 2 == 1;
      curve.history.time[row] = 1e-3 * static_cast<double>(at), curve.history.strain[row] = fine.strain[at];
      curve.stress[row] = name == "force_delay" ? stress[std::max<Eigen::Index>(0, at - 50)]
                                                : stress[at] + (row == 0 ? 0.0
                                                                : back   ? -size
                                                                         : size);
    }
    curve.history.turns = identification::find_turns(curve.history.time, curve.history.strain, curve.stress);
    ASSERT_EQ(curve.history.turns.size(), 4U);
    for (std::size_t k = 0; k < 4; ++k)
      EXPECT_NEAR(curve.history.turns[k].strain, k % 2 == 0 ? 0.01 : -0.01, 2e-5) << name << k;
    if (name == "force_delay") continue;  // its course between rows is taken for straight
    CurveExperiment experiment(Communicator(), {curve}, model(truth));
    std::vector<double> values;
    for (const auto& p : experiment.parameters()) values.push_back(p.info.name == name ? size : p.value);
    EXPECT_LT((experiment.predict(values).front() - curve.stress).cwiseAbs().maxCoeff(), 0.5) << name;
  }
}

/// A viscous bar that is pulled, held and pulled on, sampled at other moments than those at which its rate changes,
/// with noise of strain and stress: what is declared is all there is, and a gauge whose course is smoothed has its
/// corners.
TEST(CurveExperiment, NoiseOfTheStrainOfAHeldBarIsNoEffect) {
  constexpr double E = 200e3, eta = 200.0, m = 0.2, dt = 1e-4, spacing = 0.7;
  CurveModel declared = model(truth);
  declared.extended = [](std::vector<std::string> effects) {
    effects.emplace_back("viscosity");
    return material::make_law({.law = "j2", .hardening = "voce", .effects = effects});
  };
  for (std::size_t j = 0; j < declared.values.size(); ++j) {
    const std::string& name = declared.information[j].name;
    if (name == "H") declared.free[j] = 0, declared.values[j] = 0.0;
    if (name == "eta" || name == "m")
      declared.declared[j] = declared.free[j] = 1, declared.values[j] = name == "m" ? 0.21 : 190.0;
  }
  int alarms = 0;
  for (unsigned seed = 1; seed <= 4; ++seed) {
    std::mt19937_64 random(seed);
    std::normal_distribution<double> normal;
    identification::Curve curve;
    curve.name = "held", curve.group = "held", curve.deviation = 0.6;
    constexpr Eigen::Index count = 115;
    curve.history.time = Eigen::VectorXd::LinSpaced(count, 0.0, spacing * (count - 1)),
    curve.history.strain = curve.stress = Eigen::VectorXd::Zero(count);
    double p = 0.0;
    for (long k = 1; k <= std::lround(spacing / dt) * (count - 1); ++k) {
      const double t = dt * static_cast<double>(k), strain = 1e-3 * (std::min(t, 20.0) + std::max(0.0, t - 60.0)),
                   now = E * (strain - p);
      p += dt * std::pow(std::max(0.0, now - (420.0 - 170.0 * std::exp(-18.0 * p))) / eta, 1.0 / m);
      if (k % std::lround(spacing / dt) != 0) continue;
      const auto row = static_cast<Eigen::Index>(k / std::lround(spacing / dt));
      curve.history.strain[row] = strain + 3e-6 * normal(random),
      curve.stress[row] = E * (strain - p) * std::exp(-strain) + 0.6 * normal(random);
    }
    curve.use.assign(count, identification::Curve::fitted);
    curve.use[0] = identification::Curve::not_judged;
    read_gauge(curve);
    if (seed == 1) {
      ASSERT_EQ(curve.history.turns.size(), 2U);
    }  // corners
    CurveExperiment experiment(Communicator(), {curve}, declared);
    const Report report = loop_on(experiment);
    alarms += report.verdict == Verdict::nothing_found ? 0 : 1;
    if (report.verdict != Verdict::nothing_found)
      std::cout << "[          ] seed " << seed << ": " << report.sentence << "\n";
  }
  EXPECT_LE(alarms, 1);
}

/// A plateau of 4 % bends the declared hardening until S_inf is below S_y: from there its identification stops at a
/// third of it.
TEST(CurveExperimentNightly, ALargePlateauIsNamedAlone) {
  auto start = truth;  // a declaration is never right
  start["S_y"] = 230.0, start["S_inf"] = 450.0, start["b"] = 14.0, start["H"] = 600.0;
  CurveExperiment experiment(Communicator(), bars(6, {{"eps_L", 0.04}}), model(start));
  const Report report = loop_on(experiment);
  ASSERT_EQ(report.named.size(), 1U) << report.sentence;
  const Candidate& named = experiment.candidates()[static_cast<std::size_t>(report.named.front())];
  EXPECT_EQ(named.name, "plateau") << report.sentence;
  EXPECT_NE(report.sentence.find("Of the hardening curve the test shows the course, not the formula."),
            std::string::npos)
      << report.sentence;
  EXPECT_NEAR(report.final.fit.values[static_cast<std::size_t>(named.parameters.front())], 0.04, 1e-3);
}

/// What is missing has bent the parameters: effects of the law, and those that change the path on which it yields, are
/// looked for from the declared ones, too, where the misfit is large.
TEST(Starts, EffectsOnThePathBeginAtTheDeclaredParametersToo) {
  const CurveExperiment experiment(Communicator(), bars(1, {}, 2), model(truth));
  constexpr double size = 1e-4;
  const auto starts = [&](const std::string& name, double chi) {
    Model at;
    for (const auto& p : experiment.parameters()) at.fit.values.push_back(p.value);
    at.fit.values[0] = 150e3;  // E
    at.misfit.fitted = chi, at.misfit.null_fitted = 1.0;
    for (int k = 0; k < std::ssize(experiment.candidates()); ++k)
      if (const auto& one = experiment.candidates()[static_cast<std::size_t>(k)]; one.name == name) {
        at.others = {k};
        at.scores.candidates.resize(1);
        at.scores.candidates[0].size = Eigen::VectorXd::Constant(std::ssize(one.parameters), size);
      }
    EXPECT_EQ(at.others.size(), 1U) << name;
    return std::pair(starts_of(experiment, at, 0), experiment.candidates()[static_cast<std::size_t>(at.others[0])]);
  };
  for (const std::string name : {"strain zero", "strain zero of fast"}) {
    const auto [far, candidate] = starts(name, 3.0);
    const auto j = static_cast<std::size_t>(candidate.parameters.front());
    ASSERT_EQ(far.size(), 4U) << name;
    EXPECT_EQ(far[0][0], 150e3);
    EXPECT_EQ(far[1][0], 200e3);
    EXPECT_EQ(far[2][0], 200e3);
    EXPECT_EQ(far[3][0], 150e3);
    EXPECT_NEAR(far[0][j], size, 1e-12);
    EXPECT_NEAR(far[1][j], size, 1e-12);
    EXPECT_NEAR(far[2][j], 3.0 * size, 1e-12);
    EXPECT_EQ(far[3][j], 0.0);
    EXPECT_EQ(starts(name, 1.5).first.size(), 2U) << name;
  }
  EXPECT_EQ(starts("force zero", 3.0).first.size(), 2U);
}

/// An effect with a shape is looked for beside three values of it, its size next to the null value.
TEST(Starts, AShapeHasThreeValues) {
  const CurveExperiment experiment(Communicator(), bars(1, {}, 2), model(truth));
  Model at;
  for (const auto& p : experiment.parameters()) at.fit.values.push_back(p.value);
  at.misfit.fitted = 3.0, at.misfit.null_fitted = 1.0;
  for (int k = 0; k < std::ssize(experiment.candidates()); ++k)
    if (experiment.candidates()[static_cast<std::size_t>(k)].name == "rate") at.others = {k};
  ASSERT_EQ(at.others.size(), 1U);
  const auto& its = experiment.candidates()[static_cast<std::size_t>(at.others[0])].parameters;
  const auto number = [&](bool shape) {
    for (const int j : its)
      if (experiment.parameters()[static_cast<std::size_t>(j)].info.shape == shape) return static_cast<std::size_t>(j);
    return std::size_t{0};
  };
  const auto starts = starts_of(experiment, at, 0);
  ASSERT_EQ(starts.size(), 4U);
  const double usual = at.fit.values[number(true)];
  EXPECT_NEAR(starts[0][number(true)], usual, 1e-9 * usual);
  EXPECT_NEAR(starts[1][number(true)], 8.0 * usual, 1e-9);
  EXPECT_NEAR(starts[2][number(true)], 0.125 * usual, 1e-9 * usual);
  for (int k = 0; k < 3; ++k) EXPECT_GT(starts[static_cast<std::size_t>(k)][number(false)], 0.0);
  EXPECT_EQ(starts[3], at.fit.values);
}

}  // namespace test_curve_experiment
}  // namespace imic3d::loop
