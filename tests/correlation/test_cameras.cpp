// Several cameras on one mesh, on rendered images of known motion.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "imic3d/correlation/global_dic.hpp"
#include "stereo_scene.hpp"

namespace imic3d::correlation {
namespace test_cameras {

using namespace test;
using imaging::Image;
using imaging::PinholeCamera;

const Communicator alone{MPI_COMM_SELF};
std::shared_ptr<const imaging::Camera> shared(const PinholeCamera& camera) {
  return std::make_shared<PinholeCamera>(camera);
}

Eigen::VectorXd nodal(const mesh::Mesh& quads, const Displacement& u) {
  Eigen::VectorXd U(3 * quads.nodes.rows());
  for (Eigen::Index n = 0; n < quads.nodes.rows(); ++n) U.segment<3>(3 * n) = u(quads.nodes(n, 0), quads.nodes(n, 1));
  return U;
}

/// Root mean square of the errors [px-equivalent: times the magnification].
struct Miss {
  double in_plane, out_of_plane;
};
Miss miss(const Eigen::VectorXd& U, const Eigen::VectorXd& truth) {
  const Eigen::Matrix3Xd error = scale * (U - truth).reshaped(3, U.size() / 3);
  const auto n = static_cast<double>(error.cols());
  return {error.topRows<2>().norm() / std::sqrt(2.0 * n), error.row(2).norm() / std::sqrt(n)};
}

struct Pair {
  int width = 170, height = 150;
  PinholeCamera left = looking_from(-12.0, width, height), right = looking_from(10.0, width, height);
  Image left_f = render(texture(), sight_of(left), width, height),
        right_f = render(texture(), sight_of(right), width, height);
  mesh::Mesh quads = rectangle(-4.2, -3.6, 4.2, 3.6, 7, 6);
  [[nodiscard]] std::vector<View> views() const {
    return {{.camera = shared(left), .reference = left_f, .place = "left"},
            {.camera = shared(right), .reference = right_f, .place = "right"}};
  }
  [[nodiscard]] Image seen(int camera, const Displacement& u) const {
    return render(texture(), sight_of(camera == 0 ? left : right), width, height, u);
  }
};
const Pair& pair() {
  static const Pair made;
  return made;
}

class StereoMotion : public ::testing::TestWithParam<std::pair<const char*, Displacement>> {};

TEST_P(StereoMotion, IsMeasuredToThousandthsOfAPixel) {
  const auto& [name, u] = GetParam();
  const GlobalDic dic(pair().quads, pair().views(), 3, {});
  const DicFrame frame = dic.run(alone, 1, [&](int, int camera) { return pair().seen(camera, u); }).front();
  const Miss error = miss(frame.displacement, nodal(pair().quads, u));
  std::cout << "[          ] " << name << ": rms error in plane " << error.in_plane << " px, out of plane "
            << error.out_of_plane << " px, " << frame.iterations << " iterations, residuals " << frame.cameras[0].rms
            << " and " << frame.cameras[1].rms << '\n';
  EXPECT_TRUE(frame.converged && !frame.lost);
  EXPECT_LT(error.in_plane, 0.003);
  // The two lines of sight are 22 degrees apart: what the images miss counts 1/tan(11 degrees) = 5 times through the
  // plane.
  EXPECT_LT(error.out_of_plane, 0.015);
}

Eigen::Vector3d turned(double x, double y, const Eigen::Vector3d& axis, double degrees) {
  const Eigen::Vector3d X(x, y, 0.0);
  return Eigen::AngleAxisd(degrees * std::numbers::pi / 180.0, axis) * X - X;
}

INSTANTIATE_TEST_SUITE_P(
    Dic, StereoMotion,
    ::testing::Values(std::pair<const char*, Displacement>{"nothing", still},
                      std::pair<const char*, Displacement>{
                          "out of plane by 0.1 mm", [](double, double) { return Eigen::Vector3d(0.01, 0.02, 0.1); }},
                      std::pair<const char*, Displacement>{
                          "shift of 0.4 and 0.3 mm", [](double, double) { return Eigen::Vector3d(0.4, -0.3, 0.6); }},
                      std::pair<const char*, Displacement>{
                          "tilt of 2 degrees",
                          [](double x, double y) { return turned(x, y, Eigen::Vector3d(0.6, 0.8, 0.0), 2.0); }},
                      std::pair<const char*, Displacement>{
                          "turn of 2 degrees and 1 % stretch",
                          [](double x, double y) {
                            return Eigen::Vector3d(turned(1.01 * x, 0.997 * y, Eigen::Vector3d::UnitZ(), 2.0) +
                                                   Eigen::Vector3d(0.01 * x, -0.003 * y, 0.05));
                          }},
                      std::pair<const char*, Displacement>{"bulge", [](double x, double y) {
                                                             return Eigen::Vector3d(
                                                                 0.002 * x, 0.0, 0.004 * x * x - 0.003 * x * y + 0.1);
                                                           }}));

/// A camera that is turned across the epipolar lines moves points off them: no motion of the surface does, and none is
/// made of it. Half of it is shared with the other camera.
TEST(Cameras, WhatLiesOffEpipolarLinesIsNoMotion) {
  constexpr double push = 0.5;  // [px]
  const Displacement u = [](double x, double y) {
    return Eigen::Vector3d(0.03 + 0.004 * x, 0.02 - 0.002 * y, 0.05 + 0.01 * x);
  };
  auto intrinsics = pair().right.intrinsics();
  intrinsics.cy += push;
  const PinholeCamera pushed(intrinsics, pair().right.pose());
  const GlobalDic dic(pair().quads, pair().views(), 3, {});
  const auto found = [&](const PinholeCamera& right) {
    return dic
        .run(alone, 1,
             [&](int, int camera) {
               return render(texture(), sight_of(camera == 0 ? pair().left : right), pair().width, pair().height, u);
             })
        .front();
  };
  const DicFrame still = found(pair().right), moved = found(pushed);
  for (const double rms : dic.cameras().rms_off_epipolar(still.epipolar)) EXPECT_LT(rms, 0.002);
  EXPECT_TRUE(moved.converged);
  for (const double rms : dic.cameras().rms_off_epipolar(moved.epipolar)) EXPECT_NEAR(rms, 0.5 * push, 0.02 * push);
  const Eigen::Matrix3Xd change =
      scale * (moved.displacement - still.displacement).reshaped(3, still.displacement.size() / 3);
  const Eigen::Vector3d rigid = change.rowwise().mean();
  std::cout << "[          ] residual " << still.rms << " and " << moved.rms << ", motion by " << rigid.transpose()
            << " px, else " << (change.colwise() - rigid).cwiseAbs().maxCoeff() << " px at most\n";
  EXPECT_LT(moved.rms, 1.1 * still.rms);
  EXPECT_LT((change.colwise() - rigid).cwiseAbs().maxCoeff(), 0.02);
  EXPECT_LT((dic.cameras().epipolar_of(dic.cameras().off_epipolar(moved.epipolar)) - moved.epipolar).norm(),
            1e-9 * moved.epipolar.norm());
  // As numbers and back.
  const DicFrame again = frame_of(numbers_of(moved), moved.displacement.size(), moved.element_rms.size(), 2);
  EXPECT_EQ(again.epipolar, moved.epipolar);
}

TEST(Cameras, FindALargeJumpByTriangulatingPatches) {
  const Displacement jump = [](double x, double) { return Eigen::Vector3d(1.6, -1.2, 1.5 + 0.01 * x); };
  const mesh::Mesh quads = rectangle(-4.0, -2.0, 2.0, 3.4, 6, 5);
  const GlobalDic dic(quads, pair().views(), 3, {.pyramid_levels = 1});
  const DicFrame frame = dic.run(alone, 1, [&](int, int camera) { return pair().seen(camera, jump); }).front();
  const Miss error = miss(frame.displacement, nodal(quads, jump));
  EXPECT_FALSE(frame.lost);
  EXPECT_LT(error.in_plane, 0.006);
  EXPECT_LT(error.out_of_plane, 0.03);
}

TEST(Cameras, WhichOneIsFirstDoesNotMatter) {
  const Displacement u = [](double x, double y) { return Eigen::Vector3d(0.05 + 0.003 * x, 0.02, 0.1 + 0.01 * y); };
  std::vector<View> views = pair().views();
  views[0].noise = 1.0, views[1].noise = 1.7;
  const Image left = pair().seen(0, u), right = pair().seen(1, u);
  const DicFrame one =
      GlobalDic(pair().quads, views, 3, {}).run(alone, 1, [&](int, int c) { return c == 0 ? left : right; }).front();
  std::swap(views[0], views[1]);
  const DicFrame other =
      GlobalDic(pair().quads, views, 3, {}).run(alone, 1, [&](int, int c) { return c == 0 ? right : left; }).front();
  // Grey levels are interpolated in single precision.
  EXPECT_LT((one.displacement - other.displacement).norm(), 1e-6 * one.displacement.norm());
  EXPECT_NEAR(one.rms, other.rms, 1e-6 * one.rms);
  EXPECT_NEAR(one.cameras[0].rms, other.cameras[1].rms, 1e-6 * one.rms);
}

TEST(Cameras, RanksDoNotChangeTheResult) {
  const Communicator world;
  const auto image = [&](int frame, int camera) {
    return pair().seen(camera, [frame](double x, double y) {
      return Eigen::Vector3d(0.02 * frame, 0.001 * frame * x, 0.05 * frame + 0.002 * y);
    });
  };
  const GlobalDic dic(pair().quads, pair().views(), 3, {}), one_group(pair().quads, pair().views(), 3, {.groups = 1});
  const auto mine = dic.run(alone, 2, image), side_by_side = dic.run(world, 2, image),
             together = one_group.run(world, 2, image);
  for (std::size_t frame = 0; frame < 2; ++frame)
    for (const auto* other : {&side_by_side, &together}) {
      EXPECT_LT((mine[frame].displacement - (*other)[frame].displacement).norm(), 1e-8);
      EXPECT_NEAR(mine[frame].cameras[1].rms, (*other)[frame].cameras[1].rms, 1e-8 * mine[frame].rms);
    }
}

/// Measured over predicted standard deviation over 60 draws, in and out of the plane, for cameras whose noise differs.
TEST(Cameras, NoiseOfTheDisplacementIsTheOnePredicted) {
  constexpr int width = 90, height = 84, draws = 60;
  const PinholeCamera left = looking_from(-12.0, width, height), right = looking_from(10.0, width, height);
  const Displacement u = [](double x, double) { return Eigen::Vector3d(0.02 + 0.002 * x, -0.01, 0.03); };
  const mesh::Mesh quads = rectangle(-2.4, -2.2, 2.4, 2.2, 3, 3);
  const Image clean_f[2] = {render(texture(), sight_of(left), width, height),
                            render(texture(), sight_of(right), width, height)};
  const Image clean_g[2] = {render(texture(), sight_of(left), width, height, u),
                            render(texture(), sight_of(right), width, height, u)};
  const double sigma[2] = {0.01 * 65535, 0.025 * 65535};
  std::mt19937 generator(4);
  for (const bool weighted : {true, false}) {
    Eigen::MatrixXd measured(48, draws);
    Eigen::VectorXd predicted = Eigen::VectorXd::Zero(48);
    for (int draw = 0; draw < draws; ++draw) {
      std::vector<Image> f(clean_f, clean_f + 2), g(clean_g, clean_g + 2);
      for (std::size_t c = 0; c < 2; ++c) add_noise(f[c], sigma[c], generator), add_noise(g[c], sigma[c], generator);
      const GlobalDic dic(quads,
                          {{.camera = shared(left), .reference = f[0], .noise = weighted ? sigma[0] : 1.0},
                           {.camera = shared(right), .reference = f[1], .noise = weighted ? sigma[1] : 1.0}},
                          3, {.pyramid_levels = 0, .low_pass = 0.7});
      const DicFrame frame = dic.correlate(g, nodal(quads, u), 0, 0, alone);
      EXPECT_TRUE(frame.converged);
      measured.col(draw) = frame.displacement;
      predicted += dic.standard_deviation({{sigma[0], 1}, {sigma[1], 1}}).cwiseAbs2() / draws;
    }
    const Eigen::VectorXd variance =
        (measured.colwise() - measured.rowwise().mean()).rowwise().squaredNorm() / (draws - 1.0);
    double of[2][2] = {};  // [in, out of plane][measured, predicted]
    for (Eigen::Index i = 0; i < 48; ++i) of[i % 3 == 2][0] += variance[i], of[i % 3 == 2][1] += predicted[i];
    for (int out = 0; out < 2; ++out) {
      const double ratio = std::sqrt(of[out][0] / of[out][1]);
      std::cout << "[          ] " << (weighted ? "weighted by the noise" : "alike")
                << (out != 0 ? ", out of plane" : ", in plane") << ": predicted "
                << scale * std::sqrt(of[out][1] / (out != 0 ? 16.0 : 32.0)) << " px, measured over predicted " << ratio
                << '\n';
      EXPECT_NEAR(ratio, 1.0, 0.1);
    }
  }
}

TEST(Cameras, ATelecentricAndAPerspectiveOneTogether) {
  imaging::TelecentricCamera facing;
  facing.linear << scale, 0.0, 0.0, 0.0, -scale, 0.0;
  facing.offset << 85.0, 75.0;
  const Sight straight = [](double column, double row) {
    return across(Eigen::Vector3d((column - 85.0) / scale, (75.0 - row) / scale, 10.0), -Eigen::Vector3d::UnitZ());
  };
  const PinholeCamera oblique = looking_from(25.0, 170, 150);
  const Displacement u = [](double x, double y) {
    return Eigen::Vector3d(0.04 + 0.004 * x, -0.03, 0.08 + 0.01 * x - 0.005 * y);
  };
  const mesh::Mesh& quads = pair().quads;
  const GlobalDic dic(quads,
                      {{.camera = std::make_shared<imaging::TelecentricCamera>(facing),
                        .reference = render(texture(), straight, 170, 150)},
                       {.camera = shared(oblique), .reference = render(texture(), sight_of(oblique), 170, 150)}},
                      3, {});
  const DicFrame frame =
      dic.run(alone, 1,
              [&](int, int c) { return render(texture(), c == 0 ? straight : sight_of(oblique), 170, 150, u); })
          .front();
  const Miss error = miss(frame.displacement, nodal(quads, u));
  EXPECT_LT(error.in_plane, 0.003);
  EXPECT_LT(error.out_of_plane, 0.015);
}

TEST(Cameras, FieldsOfViewThatOverlapInPart) {
  // Each of two cameras sees about two thirds of the mesh, the third all of it.
  constexpr int width = 120, height = 150;
  const PinholeCamera left = looking_from(-12.0, width, height, 30.0), right = looking_from(10.0, width, height, -30.0);
  const PinholeCamera all = looking_from(1.0, 170, 150);
  const Displacement u = [](double x, double y) {
    return Eigen::Vector3d(0.04 + 0.004 * x, -0.03, 0.08 + 0.01 * x - 0.005 * y);
  };
  const mesh::Mesh& quads = pair().quads;
  const auto view = [](const PinholeCamera& camera, int w, int h) {
    return View{.camera = shared(camera), .reference = render(texture(), sight_of(camera), w, h)};
  };
  const std::vector<View> three = {view(left, width, height), view(right, width, height), view(all, 170, 150)};
  const auto image = [&](int, int c) {
    return c == 2 ? render(texture(), sight_of(all), 170, 150, u)
                  : render(texture(), sight_of(c == 0 ? left : right), width, height, u);
  };
  const GlobalDic dic(quads, three, 3, {});
  int unseen[2] = {0, 0};
  for (int e = 0; e < dic.cameras().elements(); ++e)
    for (int c = 0; c < 2; ++c) unseen[c] += dic.correlation(c).quadrature().pixels_of(e) == 0;
  EXPECT_GE(unseen[0], 6);
  EXPECT_GE(unseen[1], 6);
  const DicFrame frame = dic.run(alone, 1, image).front();
  const Miss error = miss(frame.displacement, nodal(quads, u));
  EXPECT_LT(error.in_plane, 0.004);
  EXPECT_LT(error.out_of_plane, 0.03);

  // Without the third, nodes at both ends are seen by one camera only: its image is still matched, and what nobody sees
  // continues the motion of the middle (here affine: exactly, but for what is measured there).
  const GlobalDic two(quads, {three[0], three[1]}, 3, {});
  const std::vector<int> blind = two.cameras().hardly_seen(two.cameras().M());
  EXPECT_GE(blind.size(), 14U);
  const DicFrame partly = two.run(alone, 1, image).front();
  // Every mode that is kept is told from the others, however the fields of view overlap.
  for (const GlobalDic* one : {&dic, &two}) {
    const Eigen::VectorXd epipolar = Eigen::VectorXd::LinSpaced(one->cameras().epipolar_modes(), 1.0, 2.0);
    EXPECT_LT((one->cameras().epipolar_of(one->cameras().off_epipolar(epipolar)) - epipolar).norm(),
              1e-6 * epipolar.norm());
  }
  EXPECT_TRUE(partly.converged);
  for (int c = 0; c < 2; ++c) {
    const InImage found = two.correlation(c).pixel_displacement(partly.displacement),
                  truth = two.correlation(c).pixel_displacement(nodal(quads, u));
    for (const int node : blind) {
      const Eigen::Vector2d place = two.correlation(c).positions().row(node).transpose();
      if (place.x() <= 2 || place.x() >= width - 3) continue;
      EXPECT_LT((found.row(node) - truth.row(node)).norm(), 0.02) << node;
    }
  }
  const Eigen::VectorXd deviation = two.standard_deviation({{100.0, 1}, {100.0, 1}});
  EXPECT_TRUE(deviation.allFinite());
  const Miss continued = miss(partly.displacement, nodal(quads, u));
  std::cout << "[          ] three cameras: " << error.in_plane << " and " << error.out_of_plane << " px; two, "
            << blind.size() << " nodes continued: " << continued.in_plane << " and " << continued.out_of_plane
            << " px\n";
  EXPECT_LT(continued.in_plane, 0.05);
  EXPECT_LT(continued.out_of_plane, 0.2);
}

TEST(Cameras, MistakesAreExplained) {
  const auto says = [](auto work, const std::string& text) {
    try {
      work();
      ADD_FAILURE() << "no error";
    } catch (const InputError& error) {
      EXPECT_THAT(error.what(), ::testing::HasSubstr(text));
    }
  };
  says([] { const GlobalDic dic(rectangle(-12.0, -3.6, 4.2, 3.6, 14, 6), pair().views(), 3, {}); },
       "are seen by no camera");
  says([] { const GlobalDic dic(pair().quads, {pair().views()[0]}, 3, {}); }, "one camera for three components");
  says([] { const GlobalDic dic(pair().quads, std::vector<View>{}, 3, {}); }, "none");
}

/// The bilinear map of the projected nodes is not the projection of the bilinear element: with elements of half the
/// image the difference shows, and is taken into account.
TEST(Cameras, PerspectiveInsideAnElement) {
  const mesh::Mesh quads = rectangle(-4.2, -3.6, 4.2, 3.6, 1, 1);
  const PinholeCamera oblique = looking_from(40.0, 170, 150);
  const Correlation correlation(quads, shared(oblique),
                                imaging::BSpline(render(texture(), sight_of(oblique), 170, 150)), {.dofs_per_node = 3});
  const PixelQuadrature& q = correlation.quadrature();
  std::size_t p = 0;
  double worst = 0.0, without = 0.0;
  const InImage& corners = correlation.positions();
  for (const PixelRow& row : q.rows)
    for (int i = 0; i < row.count; ++i, ++p) {
      const Eigen::Vector2d truth = met(
          across(oblique.centre(), oblique.ray({static_cast<double>(row.column + i), static_cast<double>(row.row)})),
          still, {0, 0});
      const double xi = truth.x() / 4.2, eta = truth.y() / 3.6;
      worst = std::max({worst, std::abs(q.xi[p] - xi), std::abs(q.eta[p] - eta)});
      const Eigen::RowVector2d bilinear =
          0.25 * ((1 - xi) * (1 - eta) * corners.row(0) + (1 + xi) * (1 - eta) * corners.row(1) +
                  (1 - xi) * (1 + eta) * corners.row(2) + (1 + xi) * (1 + eta) * corners.row(3));
      without = std::max(without, (bilinear - Eigen::RowVector2d(row.column + i, row.row)).norm());
    }
  std::cout << "[          ] off by " << 60.0 * worst << " px, by the bilinear map " << without << " px\n";
  EXPECT_GT(without, 0.5);
  EXPECT_LT(60.0 * worst, 0.05);
}

}  // namespace test_cameras
}  // namespace imic3d::correlation
