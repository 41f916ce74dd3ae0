#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <omp.h>

#include <Eigen/SparseCholesky>
#include <chrono>

#include "imic3d/correlation/correlation.hpp"
#include "speckle.hpp"

namespace imic3d::correlation {
namespace test_correlation {

using namespace test;
using imaging::BSpline;
using imaging::Image;

const Communicator alone{MPI_COMM_SELF};

/// Moves the inner nodes of a rectangle about.
mesh::Mesh distorted(mesh::Mesh quads, double amount) {
  for (Eigen::Index n = 0; n < quads.nodes.rows(); ++n) {
    const double x = quads.nodes(n, 0), y = quads.nodes(n, 1);
    quads.nodes(n, 0) += amount * std::sin(0.3 * x + 0.7 * y);
    quads.nodes(n, 1) += amount * std::cos(0.5 * x - 0.2 * y);
  }
  return quads;
}

struct Pair {
  Speckle speckle{120, 100};
  Image reference = photograph(speckle, 120, 100);
  BSpline f{reference};
  std::shared_ptr<imaging::TelecentricCamera> eye = camera(10.0, 8.0, 92.0, true, 0.05);
  mesh::Mesh quads = rectangle(0.7, 0.4, 10.2, 8.0, 5, 4);
};

const Pair& pair() {
  static const Pair made;
  return made;
}

Eigen::VectorXd some_displacement(const Correlation& quadrature, double size) {
  Eigen::VectorXd U(quadrature.unknowns());
  for (Eigen::Index i = 0; i < U.size(); ++i) U[i] = size * std::sin(1.7 * static_cast<double>(i) + 0.3);
  return U;
}

TEST(PixelQuadrature, EveryPixelBelongsToOneElement) {
  const BSpline f(Image(200, 180, 8, 1.0F));
  // Nodes and edges on pixel centres, edges along them, slanted ones, both senses of y.
  struct Example {
    mesh::Mesh quads;
    std::shared_ptr<imaging::TelecentricCamera> eye;
  };
  const std::vector<Example> examples{{rectangle(10, 10, 110, 90, 10, 8), camera()},
                                      {rectangle(1.0, 1.0, 11.0, 9.0, 10, 8), camera(10.0, 3.0, 130.0, true)},
                                      {distorted(rectangle(20, 20, 150, 140, 7, 9), 2.0), camera()},
                                      {rectangle(0, 0, 80, 80, 8, 8), camera(1.0, 85.0, 20.0, false, M_PI / 4)}};
  for (const auto& [quads, eye] : examples) {
    const Correlation correlation(quads, eye, f);
    const PixelQuadrature& quadrature = correlation.quadrature();
    std::vector<int> owners(200UL * 180UL, 0);
    std::size_t counted = 0;
    for (int k = 0; k < quadrature.elements(); ++k)
      for (const PixelRow& run : quadrature.rows_of(k))
        for (int i = 0; i < run.count; ++i, ++counted)
          ++owners[static_cast<std::size_t>(run.row * 200 + run.column + i)];
    EXPECT_EQ(counted, quadrature.pixels());
    EXPECT_EQ(*std::max_element(owners.begin(), owners.end()), 1);
    // A single polygon of the same contour holds the same number: its rows are counted here between the edges.
    double area = 0.0;
    for (Eigen::Index e = 0; e < quads.cells.rows(); ++e) {
      const auto p = [&](int i) { return Eigen::Vector2d(correlation.positions().row(quads.cells(e, i))); };
      const Eigen::Vector2d a = p(2) - p(0), b = p(3) - p(1);
      area += 0.5 * std::abs(a.x() * b.y() - a.y() * b.x());
    }
    EXPECT_NEAR(static_cast<double>(counted), area, 0.01 * area);
  }
  // Edges on pixel centres: exactly as many pixels as the area says.
  EXPECT_EQ(Correlation(examples[0].quads, examples[0].eye, f).quadrature().pixels(), 100U * 80U);
  EXPECT_EQ(Correlation(examples[1].quads, examples[1].eye, f).quadrature().pixels(), 100U * 80U);
}

TEST(PixelQuadrature, PixelsInsideTheContourAreAllFound) {
  const BSpline f(Image(200, 180, 8, 1.0F));
  const mesh::Mesh quads = distorted(rectangle(20, 20, 150, 140, 7, 9), 2.0);
  const Correlation correlation(quads, camera(), f);
  const PixelQuadrature& quadrature = correlation.quadrature();
  std::vector<char> found(200UL * 180UL, 0);
  for (int k = 0; k < quadrature.elements(); ++k)
    for (const PixelRow& run : quadrature.rows_of(k))
      for (int i = 0; i < run.count; ++i) found[static_cast<std::size_t>(run.row * 200 + run.column + i)] = 1;
  std::vector<Eigen::Vector2d> contour;
  const auto node = [&](int i, int j) { contour.push_back(quads.nodes.row(j * 8 + i).head<2>().transpose()); };
  for (int i = 0; i < 7; ++i) node(i, 0);
  for (int j = 0; j < 9; ++j) node(7, j);
  for (int i = 7; i > 0; --i) node(i, 9);
  for (int j = 9; j > 0; --j) node(0, j);
  int wrong = 0;
  for (int y = 0; y < 180; ++y)
    for (int x = 0; x < 200; ++x) {
      bool inside = false;
      for (std::size_t a = 0, b = contour.size() - 1; a < contour.size(); b = a++)
        if ((contour[a].y() > y) != (contour[b].y() > y) &&
            x < (contour[b].x() - contour[a].x()) * (y - contour[a].y()) / (contour[b].y() - contour[a].y()) +
                    contour[a].x())
          inside = !inside;
      wrong += inside != (found[static_cast<std::size_t>(y * 200 + x)] == 1);
    }
  EXPECT_EQ(wrong, 0);
}

TEST(PixelQuadrature, TheBorderIsLeftOutExceptWhereTheSpecimenGoesOn) {
  const BSpline f(Image(200, 180, 8, 1.0F));
  const mesh::Mesh quads = rectangle(20, 30, 120, 130, 5, 5);
  QuadratureOptions options{.border = 3.0};
  for (int i = 0; i <= 5; ++i) options.cut_nodes.push_back(i);  // the nodes of the side y = 30
  InImage positions = quads.nodes.leftCols<2>();
  const Image kept = footprint(quadrature(quads.cells, positions, f, options), 200, 180);
  const auto is_kept = [&](int column, int row) { return kept(column, row) > 0.0F; };
  EXPECT_FALSE(is_kept(22, 80));
  EXPECT_TRUE(is_kept(23, 80));
  EXPECT_FALSE(is_kept(118, 80));
  EXPECT_FALSE(is_kept(70, 128));
  EXPECT_TRUE(is_kept(70, 127));
  EXPECT_TRUE(is_kept(70, 31));  // the cut side
  EXPECT_TRUE(is_kept(40, 80));  // an edge between two elements
}

TEST(PixelQuadrature, LocalCoordinatesLeadBackToThePixel) {
  const BSpline f(Image(200, 180, 8, 1.0F));
  const mesh::Mesh quads = distorted(rectangle(20, 20, 150, 140, 7, 9), 3.0);
  const Correlation correlation(quads, camera(), f);
  const PixelQuadrature& quadrature = correlation.quadrature();
  double worst = 0.0;
  std::size_t p = 0;
  for (int k = 0; k < quadrature.elements(); ++k)
    for (const PixelRow& run : quadrature.rows_of(k))
      for (int i = 0; i < run.count; ++i, ++p) {
        const double xi = quadrature.xi[p], eta = quadrature.eta[p];
        Eigen::Vector2d place(0, 0);
        const double N[4] = {(1 - xi) * (1 - eta) / 4, (1 + xi) * (1 - eta) / 4, (1 + xi) * (1 + eta) / 4,
                             (1 - xi) * (1 + eta) / 4};
        for (int n = 0; n < 4; ++n) place += N[n] * quads.nodes.row(quads.cells(k, n)).head<2>().transpose();
        worst = std::max(worst, (place - Eigen::Vector2d(run.column + i, run.row)).norm());
      }
  EXPECT_LT(worst, 1e-5);
}

TEST(PixelQuadrature, MistakesSayWhichPartIsOffTheImage) {
  const BSpline f(Image(100, 80));
  const auto message = [&](const mesh::Mesh& quads, const QuadratureOptions& options = {}) -> std::string {
    try {
      const Correlation correlation(quads, camera(), f, {.quadrature = options});
    } catch (const InputError& error) {
      return error.what();
    }
    return "nothing was thrown";
  };
  EXPECT_THAT(message(rectangle(-10, 10, 90, 70, 10, 6)), ::testing::HasSubstr("6 of 60 elements reach beyond"));
  EXPECT_THAT(message(rectangle(-10, 10, 90, 70, 10, 6)), ::testing::HasSubstr("6 left, 0 right, 0 above, 0 below"));
  EXPECT_EQ(message(rectangle(-10, 10, 90, 70, 10, 6), {.clip = true}), "nothing was thrown");
  mesh::Mesh folded = rectangle(10, 10, 90, 70, 2, 2);
  folded.nodes.row(4) << 95, 75, 0;
  EXPECT_THAT(message(folded), ::testing::HasSubstr("not convex"));
  const Image small(10, 10);
  EXPECT_THAT(message(rectangle(10, 10, 90, 70, 2, 2), {.mask = &small}), ::testing::HasSubstr("mask"));
  Image mask(100, 80, 8, 255.0F);
  mask(50, 40) = 0.0F;
  EXPECT_EQ(
      Correlation(rectangle(10, 10, 90, 70, 2, 2), camera(), f, {.quadrature = {.mask = &mask}}).quadrature().pixels(),
      80U * 60 - 1);
}

TEST(Correlation, MatrixIsSymmetricPositiveAndTheTangentOfB) {
  const Correlation correlation(pair().quads, pair().eye, pair().f);
  const Eigen::SparseMatrix<double> M = correlation.M();
  EXPECT_LT((Eigen::MatrixXd(M) - Eigen::MatrixXd(M).transpose()).cwiseAbs().maxCoeff(), 1e-12 * M.norm());
  const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> factor(M);
  ASSERT_EQ(factor.info(), Eigen::Success);
  EXPECT_GT(factor.vectorD().minCoeff(), 0.0);
  // The reference image against itself: b(0) = 0 and b(dU) = -M dU to first order.
  const Evaluation at_zero = correlation.evaluate(pair().f, Eigen::VectorXd::Zero(correlation.unknowns()), alone);
  EXPECT_LT(at_zero.rms(), 0.02);
  const Eigen::VectorXd dU = some_displacement(correlation, 1e-3);  // 0.01 px
  const Eigen::VectorXd b = correlation.evaluate(pair().f, dU, alone).b;
  EXPECT_LT((b + M * dU).norm(), 0.02 * (M * dU).norm());
}

TEST(Correlation, BIsMinusTheDerivativeOfTheFunctional) {
  const BSpline g(photograph(pair().speckle, 120, 100, [](const Eigen::Vector2d& x) {
    return Eigen::Vector2d(0.4 + 0.01 * x.x(), -0.3 + 0.005 * x.y());
  }));
  const Correlation correlation(pair().quads, pair().eye, pair().f);
  const Eigen::VectorXd U = some_displacement(correlation, 0.03);
  const Eigen::VectorXd direction = some_displacement(correlation, 1.0).reverse();
  const double slope = -correlation.evaluate(g, U, alone, Gradient::deformed).b.dot(direction);
  std::vector<double> errors;
  for (const double h : {2e-2, 6e-3, 2e-3, 1e-6, 1e-8}) {
    const double after = correlation.evaluate(g, U + h * direction, alone).squares,
                 before = correlation.evaluate(g, U - h * direction, alone).squares;
    errors.push_back(std::abs((after - before) / (4 * h) - slope) / std::abs(slope));
  }
  EXPECT_LT(errors[1], 0.2 * errors[0]);
  EXPECT_LT(errors[2], 0.3 * errors[1]);
  EXPECT_GT(errors[4], errors[2]);
}

TEST(Correlation, TransportedMatrixIsTheTangentAtLargeStrain) {
  const Motion stretch = [](const Eigen::Vector2d& x) {
    return Eigen::Vector2d(0.15 * x.x(), -0.1 * x.y() + 0.05 * x.x());
  };
  const Correlation correlation(pair().quads, pair().eye, pair().f);
  const BSpline g(photograph(pair().speckle, 150, 120, stretch));
  const Eigen::VectorXd U = nodal(pair().quads, *pair().eye, stretch), dU = some_displacement(correlation, 1e-3);
  const auto miss = [&](Gradient gradient, const Eigen::SparseMatrix<double>& M) {
    const Eigen::VectorXd change =
        correlation.evaluate(g, U + dU, alone, gradient).b - correlation.evaluate(g, U - dU, alone, gradient).b;
    return (0.5 * change + M * dU).norm() / (M * dU).norm();
  };
  const double transported = miss(Gradient::transported, correlation.M(U)),
               plain = miss(Gradient::reference, correlation.M());
  EXPECT_LT(transported, 0.05);
  EXPECT_GT(plain, 2.0 * transported);
}

TEST(Correlation, BrightnessIsFittedWithTheDisplacement) {
  const Correlation correlation(pair().quads, pair().eye, pair().f);
  Image bright = pair().reference;
  for (float& g : bright.grey) g = 0.8F * g + 3000.0F;
  const Eigen::VectorXd zero = Eigen::VectorXd::Zero(correlation.unknowns());
  const Evaluation plain = correlation.evaluate(BSpline(bright), zero, alone);
  const Evaluation fitted =
      Correlation(pair().quads, pair().eye, pair().f, {.brightness = true}).evaluate(BSpline(bright), zero, alone);
  EXPECT_GT(plain.rms(), 1000.0);
  EXPECT_LT(fitted.rms(), 0.5);
  EXPECT_NEAR(fitted.gain, 1.25, 1e-5);
  EXPECT_NEAR(fitted.coefficient, 1.0, 1e-6);
  EXPECT_NEAR(fitted.offset, -3750.0, 0.5);
}

// The contour's nodes are where an offset that is left in an element does not cancel between neighbours.
TEST(Correlation, LightThatChangesFromPlaceToPlaceMovesNothing) {
  const Correlation all(pair().quads, pair().eye, pair().f, {.brightness = true});
  const Correlation local(pair().quads, pair().eye, pair().f, {.local_brightness = true});
  Image bright = pair().reference;
  for (int y = 0; y < bright.height; ++y)
    for (int x = 0; x < bright.width; ++x) bright(x, y) = (0.7F + 0.004F * x) * bright(x, y) + 40.0F * y;
  const Eigen::VectorXd zero = Eigen::VectorXd::Zero(all.unknowns());
  const BSpline g(bright);
  const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> M(all.M());
  const auto moved = [&](const Correlation& correlation) {
    return Eigen::VectorXd(M.solve(correlation.evaluate(g, zero, alone).b)).cwiseAbs().maxCoeff() *
           std::sqrt(std::abs(correlation.pixels_per_length().determinant()));
  };
  std::printf("moved by the light: %.3f px with one gain, %.3f px with one for each element\n", moved(all),
              moved(local));
  EXPECT_LT(moved(local), 0.15 * moved(all));
  EXPECT_GT(local.evaluate(g, zero, alone).coefficient, all.evaluate(g, zero, alone).coefficient);
  // The residual in pixels is that of the sums.
  double squares = 0.0;
  for (const float r : local.residual(g, zero)) squares += static_cast<double>(r) * r;
  const Evaluation seen = local.evaluate(g, zero, alone);
  EXPECT_NEAR(squares, seen.squares, 1e-4 * seen.squares);
  // Light that is the same everywhere is what `brightness` finds.
  Image even = pair().reference;
  for (float& value : even.grey) value = 0.8F * value + 3000.0F;
  const Evaluation same = local.evaluate(BSpline(even), zero, alone);
  EXPECT_LT(same.rms(), 0.5);
  EXPECT_NEAR(same.element_gain.minCoeff(), 1.25, 1e-4);
  EXPECT_NEAR(same.element_gain.maxCoeff(), 1.25, 1e-4);
}

TEST(Correlation, PixelsThatLeaveTheImageAreDropped) {
  const mesh::Mesh quads = rectangle(10, 10, 110, 90, 10, 8);
  const Correlation correlation(quads, camera(), pair().f);
  const Motion shift = [](const Eigen::Vector2d&) { return Eigen::Vector2d(20.25, 0.0); };
  const Evaluation moved = correlation.evaluate(pair().f, nodal(quads, *camera(), shift), alone);
  // Columns 99 ... 109 go to 119.25 and beyond; the image ends at 119.
  EXPECT_EQ(moved.dropped, 11.0 * 80);
  EXPECT_EQ(moved.pixels + moved.dropped, 8000.0);
  EXPECT_TRUE(std::isfinite(moved.squares) && moved.b.allFinite());
  EXPECT_EQ(correlation
                .evaluate(pair().f, nodal(quads, *camera(), [](const auto&) { return Eigen::Vector2d(500, 0); }), alone)
                .pixels,
            0.0);
}

TEST(Correlation, ThreeUnknownsPerNodeWork) {
  auto eye = camera(10.0, 8.0, 92.0, true, 0.05);
  eye->linear.col(2) << 0.3, -0.4;  // a camera that looks slightly from the side
  const Correlation flat(pair().quads, eye, pair().f), spatial(pair().quads, eye, pair().f, {.dofs_per_node = 3});
  const Eigen::VectorXd U2 = some_displacement(flat, 0.02);
  Eigen::VectorXd U3 = Eigen::VectorXd::Zero(spatial.unknowns());
  for (int n = 0; n < flat.nodes(); ++n) U3.segment<2>(3 * n) = U2.segment<2>(2 * n);
  const Eigen::VectorXd b2 = flat.evaluate(pair().f, U2, alone).b, b3 = spatial.evaluate(pair().f, U3, alone).b;
  const Eigen::SparseMatrix<double> M2 = flat.M(), M3 = spatial.M();
  for (int n = 0; n < flat.nodes(); ++n) {
    EXPECT_NEAR((b2.segment<2>(2 * n) - b3.segment<2>(3 * n)).norm(), 0.0, 1e-9 * b2.norm());
    EXPECT_NEAR(M2.coeff(2 * n, 2 * n + 1), M3.coeff(3 * n, 3 * n + 1), 1e-9 * M2.norm());
  }
  Eigen::VectorXd towards = Eigen::VectorXd::Zero(spatial.unknowns());
  for (int n = 0; n < flat.nodes(); ++n) towards[3 * n + 2] = 1e-2;
  EXPECT_LT((spatial.evaluate(pair().f, towards, alone).b + M3 * towards).norm(), 0.02 * (M3 * towards).norm());
}

TEST(Correlation, RanksAndThreadsDoNotChangeTheResult) {
  const Communicator world;
  for (const bool brightness : {false, true}) {
    const Correlation correlation(pair().quads, pair().eye, pair().f, {.brightness = brightness});
    const Eigen::VectorXd U = some_displacement(correlation, 0.05);
    const Evaluation a = correlation.evaluate(pair().f, U, alone, Gradient::transported),
                     b = correlation.evaluate(pair().f, U, world, Gradient::transported);
    EXPECT_LT((a.b - b.b).norm(), 1e-10 * a.b.norm());
    EXPECT_NEAR(a.squares, b.squares, 1e-10 * a.squares);
    EXPECT_EQ(a.pixels, b.pixels);
    EXPECT_LT((a.element_squares - b.element_squares).norm(), 1e-10 * a.element_squares.norm());
    const int threads = omp_get_max_threads();
    omp_set_num_threads(3);
    const Evaluation c = correlation.evaluate(pair().f, U, alone, Gradient::transported);
    omp_set_num_threads(threads);
    EXPECT_EQ(a.squares, c.squares);
    EXPECT_EQ((a.b - c.b).norm(), 0.0);
    // The residuals of the pixels are those of the sums.
    double squares = 0.0;
    for (const float r : correlation.residual(pair().f, U)) squares += static_cast<double>(r) * r;
    EXPECT_NEAR(squares, a.squares, 1e-5 * squares);
  }
}

TEST(Correlation, PixelPassIsFast) {
  Image image(1200, 1000);
  std::mt19937 generator(1);
  std::uniform_real_distribution<float> grey(0.0F, 255.0F);
  for (float& g : image.grey) g = grey(generator);
  const BSpline f(image);
  const mesh::Mesh quads = rectangle(20, 20, 1170, 970, 58, 48);
  const Correlation correlation(quads, camera(), f);
  const PixelQuadrature& quadrature = correlation.quadrature();
  Eigen::VectorXd U = some_displacement(correlation, 2.0);
  double best = 0.0;
  for (int repeat = 0; repeat < 5; ++repeat) {
    const auto start = std::chrono::steady_clock::now();
    const Evaluation result = correlation.evaluate(f, U, alone);
    best = std::max(best, static_cast<double>(quadrature.pixels()) /
                              std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
    EXPECT_EQ(result.dropped, 0.0);
  }
  std::cout << "[          ] residual and b: " << best * 1e-6 << " Mpx/s with " << omp_get_max_threads()
            << " thread(s)\n";
#ifdef NDEBUG
  EXPECT_GT(best, 5e6);  // far below the usual figure: the machine may be busy
#endif
}

}  // namespace test_correlation
}  // namespace imic3d::correlation
