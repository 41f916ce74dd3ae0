// The pose and the shape of a specimen from rendered images of two cameras.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "imic3d/core/error.hpp"
#include "imic3d/correlation/specimen_pose.hpp"
#include "stereo_scene.hpp"

namespace imic3d::correlation {
namespace test_specimen_pose {

using namespace test;
using imaging::PinholeCamera;
using imaging::Pose;

/// The rig's frame is another than the specimen's.
const Pose true_pose{Eigen::AngleAxisd(0.4, Eigen::Vector3d(1, 2, -1).normalized()).toRotationMatrix(),
                     {20.0, -7.0, 33.0}};

std::vector<RigView> views(const Displacement& shape) {
  std::vector<RigView> result;
  for (const double angle : {-12.0, 10.0}) {
    const PinholeCamera eye = looking_from(angle, 170, 150);
    result.push_back(
        {{eye.intrinsics(), eye.pose() * inverse(true_pose)}, render(texture(), sight_of(eye), 170, 150, shape)});
  }
  return result;
}

/// Points read with an error of up to half a pixel, the same in all directions.
std::vector<PlacedPoint> points(double error, int camera = 0) {
  const PinholeCamera eye = looking_from(camera == 0 ? -12.0 : 10.0, 170, 150);
  std::vector<PlacedPoint> result;
  int k = 0;
  for (const auto& [x, y] : {std::pair{-4.0, -3.0}, {4.0, -3.0}, {4.0, 3.0}, {-4.0, 3.0}}) {
    const Eigen::Vector2d p = eye.project({x, y, 0.0});
    result.push_back({x, y, p.x() + error * (k % 2 == 0 ? 1 : -1), p.y() + error * (k / 2 == 0 ? 1 : -1)}), ++k;
  }
  return result;
}

const mesh::Mesh& quads() {
  static const mesh::Mesh made = rectangle(-4.2, -3.6, 4.2, 3.6, 7, 6);
  return made;
}

/// Largest distance of the found mesh from the true plane, and from the true nodes [mm].
std::pair<double, double> misses(const SpecimenPose& found) {
  const Pose error = inverse(true_pose) * found.pose;
  double off = 0.0, away = 0.0;
  for (Eigen::Index n = 0; n < quads().nodes.rows(); ++n) {
    const Eigen::Vector3d X = quads().nodes.row(n).transpose(), at = error.rotation * X + error.translation;
    off = std::max(off, std::abs(at.z())), away = std::max(away, (at - X).norm());
  }
  return {off, away};
}

TEST(SpecimenPose, IsFoundOnTheImages) {
  const auto seen = views(still);
  const SpecimenPose exact = find_pose(quads(), seen, points(0.0), {});
  const auto [off, away] = misses(exact);
  std::cout << "[          ] off the plane by " << 1000 * off << " um, nodes by " << 1000 * away << " um; residual "
            << exact.rms_start << ", then " << exact.rms_pose << "; " << exact.matched << " of " << exact.patches
            << " patches, rms " << 1000 * exact.plane_rms << " um\n";
  EXPECT_LT(off, 0.002);  // 0.03 px
  EXPECT_LT(away, 0.004);
  EXPECT_LT(exact.rms_pose, 0.1);
  // Points that were read badly move the mesh in its plane, not the plane.
  const SpecimenPose rough = find_pose(quads(), seen, points(0.5, 1), {.camera = 1});
  EXPECT_LT(misses(rough).first, 0.004);
  EXPECT_LT(misses(rough).second, 0.05);
  EXPECT_GT(rough.points_rms, 0.3);
}

TEST(SpecimenPose, ShapeThatIsNotFlat) {
  const Displacement shape = [](double x, double y) { return Eigen::Vector3d(0.0, 0.0, 0.01 * x * x - 0.006 * x * y); };
  const SpecimenPose flat = find_pose(quads(), views(shape), points(0.0), {});
  const SpecimenPose found = find_pose(quads(), views(shape), points(0.0), {.shape = 3.0});
  // Compared in space: the pose of a curved specimen is that of its mean plane.
  const Pose error = inverse(true_pose) * found.pose;
  double worst = 0.0, squares = 0.0;
  for (Eigen::Index n = 0; n < quads().nodes.rows(); ++n) {
    const Eigen::Vector3d X = quads().nodes.row(n).transpose() + Eigen::Vector3d(0, 0, found.shape[n]);
    const Eigen::Vector3d at = error.rotation * X + error.translation;
    const double off = std::abs(at.z() - shape(at.x(), at.y()).z());
    worst = std::max(worst, off), squares += off * off / static_cast<double>(quads().nodes.rows());
  }
  std::cout << "[          ] shape off by " << 1000 * std::sqrt(squares) << " um, at most " << 1000 * worst
            << " um; residual " << flat.rms_pose << " flat, " << found.rms_shape << " with the shape of "
            << 1000 * (found.shape.maxCoeff() - found.shape.minCoeff()) << " um\n";
  EXPECT_LT(std::sqrt(squares), 0.006);
  EXPECT_LT(found.rms_shape, 0.5 * flat.rms_pose);
}

TEST(SpecimenPose, ACameraThatWasKnockedIsPutRight) {
  auto seen = views(still);
  const Pose& at = seen[1].camera.pose();
  const double knock =
      0.03 * std::numbers::pi / 180.0;  // about the line of sight of the first row: not seen as a depth
  seen[1].camera = PinholeCamera(
      seen[1].camera.intrinsics(),
      {Eigen::AngleAxisd(knock, Eigen::Vector3d::UnitX()).toRotationMatrix() * at.rotation, at.translation});
  const SpecimenPose as_given = find_pose(quads(), seen, points(0.0), {}),
                     refined = find_pose(quads(), seen, points(0.0), {.cameras = true});
  std::cout << "[          ] residual " << as_given.rms_pose << ", with the camera refined " << refined.rms_cameras
            << "; turned by " << refined.camera_change[1].head<3>().transpose() << " degrees, moved by "
            << refined.camera_change[1].tail<3>().transpose() << " mm\n";
  EXPECT_LT(refined.rms_cameras, 0.3 * as_given.rms_pose);
  EXPECT_LT(refined.camera_change[0].norm(), 1e-12);
}

TEST(SpecimenPose, OneCameraTakesItFromThePoints) {
  const auto seen = views(still);
  EXPECT_LT(misses(find_pose(quads(), {seen.data(), 1}, points(0.0), {})).second, 1e-6);
}

TEST(SpecimenPose, MistakesAreExplained) {
  const auto says = [](auto work, const std::string& text) {
    try {
      work();
      ADD_FAILURE() << "no error";
    } catch (const InputError& error) {
      EXPECT_THAT(error.what(), ::testing::HasSubstr(text));
    }
  };
  auto seen = views(still);
  auto given = points(0.0);
  says([&] { (void)find_pose(quads(), seen, {given.data(), 2}, {}); }, "at least 3 points");
  says([&] { (void)find_pose(quads(), {seen.data(), 1}, {given.data(), 3}, {}); }, "at least 4 points");
  auto mirrored = given;
  for (auto& p : mirrored) p.column = 170.0 - p.column;
  says([&] { (void)find_pose(quads(), seen, mirrored, {}); }, "mirrored");
  auto line = given;
  for (auto& p : line) p.y = 0.5 * p.x;
  says([&] { (void)find_pose(quads(), seen, line, {}); }, "on a line");
  std::reverse(seen[1].reference.grey.begin(), seen[1].reference.grey.end());
  says([&] { (void)find_pose(quads(), seen, given, {}); }, "patches");
}

}  // namespace test_specimen_pose
}  // namespace imic3d::correlation
