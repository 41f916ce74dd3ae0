// The original I-MIC (Eq. 2) on "images" that answer linearly (plate.hpp): Poisson's ratio without any force.

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <random>

#include "imic3d/core/error.hpp"
#include "imic3d/identification/equilibrium_gap.hpp"
#include "plate.hpp"

namespace imic3d::identification {
namespace test_equilibrium_gap {

/// An elastic sheet of quad4, pulled along y; a tapered strip, so that its strain is not uniform.
struct Sheet {
  std::shared_ptr<const material::FiniteStrainLaw> law = material::make_law({.law = "elastic", .plane_stress = true});
  std::vector<double> truth = {70e3, 0.3};
  Specimen specimen = make();
  Record record;
  ImageData images;
  Stage stage{.free = {1}, .frames = {0, 1}};
  GaussNewtonOptions options{.functional = Functional::equilibrium_gap, .alpha = 1e-3, .eta = 1e-6, .noise_model = {}};

  static Specimen make() {
    auto quads = testing::strip(6, 8);
    quads.thickness = 1.0;
    return make_specimen(std::move(quads), "bottom", "top", 1, false);
  }
  Sheet() {
    const auto nodes = specimen.surface.mesh.nodes.rows();
    record.time = Eigen::VectorXd::LinSpaced(2, 1.0, 2.0);
    record.frames = {1, 2};
    record.force.setZero(2);
    record.surface_displacement.setZero(2 * nodes, 2);
    for (Eigen::Index i = 0; i < nodes; ++i) {
      const auto x = specimen.surface.mesh.nodes.row(i);
      for (int t = 0; t < 2; ++t)  // the end is pulled and turned
        record.surface_displacement.col(t).segment<2>(2 * i) << 0.0, (t + 1) * 0.001 * x[1] * (1.0 + 0.1 * x[0]);
    }
    record.driving = record.surface_displacement;
    ForwardModel model({}, specimen, law, record, {.with_fields = false}, 1, 1);
    record.surface_displacement = model.simulate(Control::displacement, {{.parameters = truth}}, 2).front().surface;
    images.M.resize(2 * nodes, 2 * nodes);
    for (Eigen::Index i = 0; i < 2 * nodes; ++i) images.M.insert(i, i) = 4e8 * (1.0 + 0.3 * static_cast<double>(i % 3));
    images.pixels_per_length = 50.0;
    images.evaluate = [this](int t, const Eigen::VectorXd& u, const Communicator&) {
      const Eigen::VectorXd gap = record.surface_displacement.col(t) - u;
      return ImageEvaluation{.b = images.M * gap, .squares = gap.dot(images.M * gap), .pixels = 1.0, .element_rms = {}};
    };
  }
  EquilibriumGapResult find(std::vector<double>& parameters, Communicator world = {}) {
    return equilibrium_gap(world, specimen, law, record, images, law->parameters(), stage, options, parameters);
  }
};

TEST(EquilibriumGap, PoissonsRatioIsFoundWithoutAForceAtEveryAlpha) {
  for (double alpha : {1e-6, 1e-3, 0.5})
    for (double start : {0.15, 0.45}) {
      Sheet sheet;
      sheet.options.alpha = alpha;
      std::vector<double> parameters = {70e3, start};
      const auto result = sheet.find(parameters);
      EXPECT_TRUE(result.stage.converged) << alpha;
      EXPECT_NEAR(parameters[1], 0.3, 1e-6) << alpha;
      EXPECT_LT(result.gap.maxCoeff(), 1e-5);
      EXPECT_LT((result.surface - sheet.record.surface_displacement).norm(), 1e-6 * result.surface.norm());
      EXPECT_LT(result.stage.iterates.size(), 10U);
    }
}

/// Any E gives the same ratio, and the force that it asks for is in proportion: how a load record would calibrate it.
TEST(EquilibriumGap, YoungsModulusOnlyScalesTheForce) {
  Sheet sheet;
  std::vector<double> soft = {7e3, 0.2}, stiff = {70e3, 0.2};
  const auto of_soft = sheet.find(soft), of_stiff = sheet.find(stiff);
  EXPECT_NEAR(soft[1], stiff[1], 1e-7);
  EXPECT_GT(of_stiff.reaction[1], 1.0);
  EXPECT_NEAR(of_soft.reaction[1] / of_stiff.reaction[1], 0.1, 1e-6);
}

TEST(EquilibriumGap, AParameterThatScalesEveryForceIsRefused) {
  Sheet sheet;
  sheet.stage.free = {0, 1};
  std::vector<double> parameters = {70e3, 0.2};
  try {
    sheet.find(parameters);
    FAIL();
  } catch (const InputError& error) {
    EXPECT_NE(std::string(error.what()).find("E with functional: equilibrium_gap"), std::string::npos) << error.what();
    EXPECT_NE(std::string(error.what()).find("ratios"), std::string::npos) << error.what();
  }
}

TEST(EquilibriumGap, ThreeDimensionsAreRefused) {
  testing::Plate plate({0.001});
  std::vector<double> parameters = {198e3, 0.25};
  const auto law = material::make_law({.law = "elastic"});
  EXPECT_THROW(equilibrium_gap({}, plate.specimen, law, plate.record, plate.images, law->parameters(),
                               {.free = {1}, .frames = {0}}, {.alpha = 1e-3, .noise_model = {}}, parameters),
               InputError);
}

/// The images' noise alone, of frames and common reference, against the scatter over 200 draws; and no bias.
TEST(EquilibriumGap, CovarianceIsTheScatterOfNoiseDraws) {
  Sheet sheet;
  constexpr double sigma = 0.5;
  constexpr int draws = 200, references = 2;
  sheet.images.noise = sigma;
  sheet.options.noise_model = {.image = sigma, .references = references, .driving = {}};
  const Eigen::MatrixXd clean = sheet.record.surface_displacement;
  const Eigen::VectorXd root = sheet.images.M.diagonal().cwiseSqrt();
  std::mt19937_64 random(5);
  std::normal_distribution<double> normal;
  double mean = 0.0, squares = 0.0, predicted = 0.0;
  for (int d = 0; d < draws; ++d) {
    Eigen::VectorXd reference(root.size());
    for (double& value : reference) value = sigma / std::sqrt(references) * normal(random);
    for (int t = 0; t < 2; ++t) {
      Eigen::VectorXd noise = reference;
      for (double& value : noise) value += sigma * normal(random);
      sheet.record.surface_displacement.col(t) = clean.col(t) + noise.cwiseQuotient(root);
    }
    std::vector<double> parameters = {70e3, 0.25};
    predicted = std::sqrt(sheet.find(parameters).stage.covariance.total(0, 0));
    mean += (parameters[1] - 0.3) / draws;
    squares += (parameters[1] - 0.3) * (parameters[1] - 0.3) / draws;
  }
  const double measured = std::sqrt(squares - mean * mean);
  std::printf("nu: standard deviation %.2e over %d draws, predicted %.2e, bias %.1e\n", measured, draws, predicted,
              mean);
  EXPECT_NEAR(measured / predicted, 1.0, 0.15);  // 200 draws give it to 5 %
  EXPECT_LT(std::abs(mean), 4.0 * predicted / std::sqrt(draws));
}

}  // namespace test_equilibrium_gap
}  // namespace imic3d::identification
