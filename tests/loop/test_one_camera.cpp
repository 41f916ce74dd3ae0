#include <gtest/gtest.h>

#include <Eigen/Dense>

#include "../../src/loop/effects/effects.hpp"
#include "imic3d/imaging/pinhole.hpp"
#include "imic3d/loop/one_camera.hpp"

namespace imic3d::loop {
namespace test_one_camera {

mesh::Mesh plate() {
  mesh::Mesh mesh;
  constexpr int columns = 7, rows = 11;
  mesh.nodes.resize(columns * rows, 3);
  mesh.cells.resize((columns - 1) * (rows - 1), 4);
  for (int j = 0; j < rows; ++j)
    for (int i = 0; i < columns; ++i) mesh.nodes.row(j * columns + i) << 2.0 * i - 6.0, 2.0 * j - 10.0, 0.0;
  int cell = 0;
  for (int j = 0; j + 1 < rows; ++j)
    for (int i = 0; i + 1 < columns; ++i)
      mesh.cells.row(cell++) << j * columns + i, j * columns + i + 1, (j + 1) * columns + i + 1, (j + 1) * columns + i;
  return mesh;
}

imaging::PinholeCamera looking_from(double x) {
  const Eigen::Vector3d from(x, 3.0, 390.0);
  imaging::Pose pose;
  const Eigen::Vector3d z = -from.normalized(), right = z.cross(Eigen::Vector3d::UnitY()).normalized();
  pose.rotation.row(0) = right, pose.rotation.row(1) = z.cross(right), pose.rotation.row(2) = z;
  pose.translation = -pose.rotation * from;
  return {{.fx = 5600, .fy = 5600, .cx = 100, .cy = 150}, pose};
}

/// The displacement in space that carries the pixels of both cameras from X to `seen` best (Gauss and Newton).
Eigen::Vector3d triangulated(const std::vector<imaging::PinholeCamera>& cameras, const Eigen::Vector3d& X,
                             const std::vector<Eigen::Vector2d>& seen) {
  Eigen::Vector3d x = X;
  for (int k = 0; k < 20; ++k) {
    Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
    Eigen::Vector3d right = Eigen::Vector3d::Zero();
    for (std::size_t c = 0; c < cameras.size(); ++c) {
      const auto J = cameras[c].jacobian(x);
      normal += J.transpose() * J, right += J.transpose() * (seen[c] - cameras[c].project(x));
    }
    x += normal.ldlt().solve(right);
  }
  return x - X;
}

/// What the left camera's lens, its growing image, or a push make of its pixels is the motion that a triangulation of
/// both cameras finds, and nothing where nothing is.
TEST(OneCamera, ErrsAsTheTriangulationDoes) {
  const std::vector<imaging::PinholeCamera> cameras = {looking_from(-85.0), looking_from(85.0)};
  const mesh::Mesh surface = plate();
  const Eigen::Index n = surface.nodes.rows();
  std::vector<Sight> sights;
  for (const auto& camera : cameras)
    sights.emplace_back(sights.empty() ? "left" : "right", camera, surface, Eigen::Vector2d(100, 150));
  Scene scene;
  scene.surface = &surface, scene.components = 3, scene.time = Eigen::Vector2d(0.5, 1.0),
  scene.force = Eigen::Vector2d(1.0, 2.0);
  measure(scene, surface);
  EXPECT_NEAR(sights[0].scale(), 5600.0 / 399.2, 0.02);

  Eigen::VectorXd U(3 * n);
  for (Eigen::Index i = 0; i < n; ++i)
    U.segment<3>(3 * i) << -0.01 * surface.nodes(i, 0), 0.04 * surface.nodes(i, 1) + 0.3, -0.05;
  const double k1 = 2e-4;
  const auto shift = [&](std::size_t c, Eigen::Index i) -> Eigen::Vector2d {
    return cameras[c].project(surface.nodes.row(i).transpose() + U.segment<3>(3 * i));
  };
  struct Case {
    std::shared_ptr<const Effect> effect;
    std::vector<double> values;
    std::function<Eigen::Vector2d(Eigen::Index)> beyond;  // [px]
  };
  const auto from_centre = [&](const Eigen::Vector2d& pixel) -> Eigen::Vector2d {
    return pixel - Eigen::Vector2d(100, 150);
  };
  const double scale = sights[0].scale();
  const std::vector<Case> all = {
      {lens_distortion(),
       {k1},
       // What the lens shows in the reference where the mesh has its node is another point of the specimen.
       [&](Eigen::Index i) -> Eigen::Vector2d {
         const auto moved = [&](const Eigen::Vector2d& pixel) -> Eigen::Vector2d {
           return k1 / (scale * scale) * from_centre(pixel).squaredNorm() * from_centre(pixel);
         };
         const Eigen::Vector2d node = cameras[0].project(surface.nodes.row(i).transpose());
         Eigen::Vector3d X = surface.nodes.row(i).transpose();
         for (int k = 0; k < 10; ++k) {
           const Eigen::Vector2d off = node - moved(cameras[0].project(X)) - cameras[0].project(X);
           X.head<2>() += cameras[0].jacobian(X).leftCols<2>().inverse() * off;
         }
         const Eigen::Vector3d u(-0.01 * X[0], 0.04 * X[1] + 0.3, -0.05);
         const Eigen::Vector2d now = cameras[0].project(X + u);
         return now + moved(now) - shift(0, i);
       }},
      {magnification_drift(),
       {1e-3},
       [&](Eigen::Index i) -> Eigen::Vector2d { return 1e-3 * from_centre(shift(0, i)); }},
      {camera_bump(), {0.0, 0.0, 1e-3, 0.3}, [&](Eigen::Index i) -> Eigen::Vector2d {
         return 1e-3 * from_centre(shift(0, i));
       }}};
  for (const Case& one : all) {
    const auto effect = of_one_camera(one.effect, sights, 0, surface, scene);
    ASSERT_TRUE(effect->applies(scene));
    ASSERT_EQ(effect->describe(scene).quantities.size(), one.values.size());
    Eigen::VectorXd error = Eigen::VectorXd::Zero(3 * n), expected(3 * n), none = error;
    effect->see(one.values, scene, 1, U, error);
    for (Eigen::Index i = 0; i < n; ++i) {
      const Eigen::Vector3d X = surface.nodes.row(i).transpose();
      expected.segment<3>(3 * i) =
          triangulated(cameras, X, {shift(0, i) + one.beyond(i), shift(1, i)}) - U.segment<3>(3 * i);
    }
    ASSERT_GT(expected.norm(), 1e-3);
    EXPECT_LE((error - expected).norm(), 0.01 * expected.norm()) << one.effect->describe(scene).name;
    std::vector<double> null;
    for (const auto& q : effect->describe(scene).quantities) null.push_back(q.null);
    effect->see(null, scene, 1, U, none);
    EXPECT_EQ(none.norm(), 0.0);
  }
}

}  // namespace test_one_camera
}  // namespace imic3d::loop
