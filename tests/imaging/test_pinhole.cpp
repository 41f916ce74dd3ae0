// The perspective camera: derivatives, the inverse, and OpenCV's projection as an independent one.

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <opencv2/calib3d.hpp>

#include "imic3d/core/error.hpp"
#include "imic3d/imaging/pinhole.hpp"

namespace imic3d::imaging {
namespace test_pinhole {

PinholeCamera camera() {
  Intrinsics lens{.fx = 6600.0,
                  .fy = 6610.0,
                  .cx = 955.0,
                  .cy = 645.0,
                  .skew = 0.0,
                  .distortion = {0.9, -20.0, 0.002, -0.003, 30.0, 0.1, 0.2, -0.3, 0.001, -0.02, 0.003, 0.05}};
  Pose pose;
  pose.rotation = Eigen::AngleAxisd(0.3, Eigen::Vector3d(1.0, -2.0, 0.4).normalized()).toRotationMatrix();
  pose.translation = Eigen::Vector3d(3.0, -4.0, 210.0);
  return {lens, pose};
}

const Eigen::Vector3d points[] = {{0.0, 0.0, 0.0}, {12.0, -7.0, 2.0}, {-15.0, 10.0, -3.0}};

TEST(Pinhole, agrees_with_OpenCV) {
  const PinholeCamera ours = camera();
  const auto& lens = ours.intrinsics();
  const cv::Mat K = (cv::Mat_<double>(3, 3) << lens.fx, 0, lens.cx, 0, lens.fy, lens.cy, 0, 0, 1);
  cv::Mat R(3, 3, CV_64F), rotation;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) R.at<double>(i, j) = ours.pose().rotation(i, j);
  cv::Rodrigues(R, rotation);
  const auto& t = ours.pose().translation;
  std::vector<cv::Point3d> objects;
  for (const auto& point : points) objects.emplace_back(point[0], point[1], point[2]);
  std::vector<cv::Point2d> seen;
  cv::projectPoints(objects, rotation, cv::Vec3d(t[0], t[1], t[2]), K,
                    std::vector<double>(lens.distortion.begin(), lens.distortion.end()), seen);
  for (std::size_t i = 0; i < 3; ++i) {
    const Eigen::Vector2d pixel = ours.project(points[i]);
    EXPECT_NEAR(pixel[0], seen[i].x, 1e-8);
    EXPECT_NEAR(pixel[1], seen[i].y, 1e-8);
  }
}

TEST(Pinhole, jacobian_is_the_derivative) {
  Intrinsics lens = camera().intrinsics();
  lens.skew = 0.7;
  const PinholeCamera ours(lens, camera().pose());
  for (const auto& point : points) {
    const auto exact = ours.jacobian(point);
    double best = 1.0;
    for (double h : {1e-1, 1e-3, 1e-5}) {
      Eigen::Matrix<double, 2, 3> numeric;
      for (int j = 0; j < 3; ++j) {
        const Eigen::Vector3d step = h * Eigen::Vector3d::Unit(j);
        numeric.col(j) = (ours.project(point + step) - ours.project(point - step)) / (2.0 * h);
      }
      best = std::min(best, (numeric - exact).norm() / exact.norm());
    }
    EXPECT_LT(best, 1e-9);
  }
}

TEST(Pinhole, jacobian_of_the_numbers_is_the_derivative) {
  Intrinsics lens = camera().intrinsics();
  lens.skew = 0.7;
  const auto moved = [&](int number, double by) {
    Intrinsics to = lens;
    Pose pose = camera().pose();
    double* const first[] = {&to.fx, &to.fy, &to.cx, &to.cy, &to.skew};
    if (number < 5)
      *first[number] += by;
    else if (number < 17)
      to.distortion[static_cast<std::size_t>(number - 5)] += by;
    else if (number < 20)
      pose.rotation = Eigen::AngleAxisd(by, Eigen::Vector3d::Unit(number - 17)).toRotationMatrix() * pose.rotation;
    else
      pose.translation[number - 20] += by;
    return PinholeCamera(to, pose);
  };
  for (const auto& point : points) {
    const auto exact = PinholeCamera(lens, camera().pose()).jacobian_of_numbers(point);
    for (int number = 0; number < 23; ++number) {
      double best = 1.0;
      for (double h : {1e2, 1e1, 1.0, 1e-1, 1e-2, 1e-3, 1e-4, 1e-5}) {
        const Eigen::Vector2d numeric =
            (moved(number, h).project(point) - moved(number, -h).project(point)) / (2.0 * h);
        best = std::min(best, (numeric - exact.col(number)).norm() / std::max(exact.col(number).norm(), 1e-12));
      }
      EXPECT_LT(best, 1e-6) << "number " << number;
    }
  }
}

TEST(Pinhole, a_ray_goes_back_to_its_point) {
  const PinholeCamera ours = camera();
  for (const auto& point : points) {
    const Eigen::Vector3d from = point - ours.centre();
    EXPECT_LT((from.normalized() - ours.ray(ours.project(point))).norm(), 1e-12);
  }
}

TEST(Pinhole, poses_follow_one_another) {
  const Pose outer{Eigen::AngleAxisd(0.2, Eigen::Vector3d::UnitX()).toRotationMatrix(), {1.0, 2.0, 3.0}};
  const Pose inner = camera().pose();
  const Eigen::Vector3d point(4.0, 5.0, 6.0);
  const Pose both = inner * outer;
  EXPECT_LT((both.rotation * point + both.translation -
             (inner.rotation * (outer.rotation * point + outer.translation) + inner.translation))
                .norm(),
            1e-12);
}

TEST(Pinhole, nothing_is_seen_behind_the_camera) { EXPECT_FALSE(camera().project({0.0, 0.0, -1000.0}).allFinite()); }

}  // namespace test_pinhole
}  // namespace imic3d::imaging
