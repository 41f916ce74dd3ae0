// Calibration against known cameras. The points come from OpenCV's projection, the images from rays through every part
// of every pixel: neither from the projection that the fit uses.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <cstdlib>
#include <filesystem>
#include <iostream>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <random>

#include "imic3d/core/error.hpp"
#include "imic3d/core/linear.hpp"
#include "imic3d/imaging/calibrate.hpp"

namespace imic3d::imaging {
namespace test_calibrate {

namespace fs = std::filesystem;
using Pixels = std::vector<Eigen::Vector2d>;

const std::vector<int> five_terms = {0, 1, 2, 3, 4};

Eigen::Matrix3d turn(double x, double y, double z) {
  return (Eigen::AngleAxisd(z, Eigen::Vector3d::UnitZ()) * Eigen::AngleAxisd(y, Eigen::Vector3d::UnitY()) *
          Eigen::AngleAxisd(x, Eigen::Vector3d::UnitX()))
      .toRotationMatrix();
}

/// Cameras about 300 away from the target, turned towards it.
std::vector<CalibratedCamera> true_cameras(std::size_t count) {
  std::vector<CalibratedCamera> cameras(count);
  for (std::size_t c = 0; c < count; ++c) {
    auto& camera = cameras[c];
    camera.name = std::string("camera ") + static_cast<char>('a' + c);
    camera.width = 420, camera.height = 340;
    const double d = static_cast<double>(c);
    camera.intrinsics = {.fx = 950.0 + 20.0 * d,
                         .fy = 955.0 - 10.0 * d,
                         .cx = 204.0 + 7.0 * d,
                         .cy = 171.0 - 5.0 * d,
                         .skew = 0.0,
                         .distortion = {-0.2 + 0.05 * d, 0.4, 0.001, -0.002, 0.5}};
    const double angle = c == 0 ? 0.0 : c == 1 ? -0.35 : 0.3;
    camera.pose.rotation = turn(0.02 * d, angle, -0.03 * d);
    // The point 300 before the first camera stays near the middle of each.
    camera.pose.translation =
        Eigen::Vector3d(2.0 * d, -d, 300.0 + 8.0 * d) - camera.pose.rotation * Eigen::Vector3d(0, 0, 300.0);
  }
  return cameras;
}

/// Poses of a target (its middle about the middle of the view), in different directions.
std::vector<Pose> true_targets(const Target& target, std::size_t count, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  Eigen::Vector3d last = target.points().back();
  for (const auto& point : target.points()) last = last.cwiseMax(point);
  std::vector<Pose> poses(count);
  for (auto& pose : poses) {
    pose.rotation = turn(0.45 * uniform(random), 0.35 * uniform(random), 0.3 * uniform(random));
    pose.translation = Eigen::Vector3d(9.0 * uniform(random), 7.0 * uniform(random), 300.0 + 25.0 * uniform(random)) -
                       pose.rotation * 0.5 * last;
  }
  return poses;
}

std::vector<cv::Point2d> by_opencv(const CalibratedCamera& camera, const Pose& target,
                                   const std::vector<Eigen::Vector3d>& points) {
  const Pose seen = camera.pose * target;
  cv::Matx33d R;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) R(i, j) = seen.rotation(i, j);
  cv::Mat rotation;
  cv::Rodrigues(R, rotation);
  std::vector<cv::Point3d> objects;
  for (const auto& point : points) objects.emplace_back(point[0], point[1], point[2]);
  const auto& lens = camera.intrinsics;
  std::vector<cv::Point2d> pixels;
  cv::projectPoints(objects, rotation, cv::Vec3d(seen.translation[0], seen.translation[1], seen.translation[2]),
                    cv::Mat(cv::Matx33d(lens.fx, 0, lens.cx, 0, lens.fy, lens.cy, 0, 0, 1)),
                    std::vector<double>(lens.distortion.begin(), lens.distortion.end()), pixels);
  return pixels;
}

std::vector<CameraSightings> sightings(const std::vector<CalibratedCamera>& cameras, const std::vector<Pose>& targets,
                                       const Target& target, double noise, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal(0.0, noise);
  std::vector<CameraSightings> all;
  for (const auto& camera : cameras) {
    all.push_back({camera.name, camera.width, camera.height, {}});
    for (const auto& pose : targets) {
      Pixels pixels;
      for (const auto& pixel : by_opencv(camera, pose, target.points()))
        pixels.emplace_back(pixel.x + normal(random), pixel.y + normal(random));
      all.back().pixels.push_back(pixels);
    }
  }
  return all;
}

/// Found minus true for the free numbers of all cameras, and the covariance of just those.
struct Errors {
  Eigen::VectorXd error;
  Eigen::MatrixXd covariance;
  std::vector<std::string> names;

  [[nodiscard]] double chi_squared() const {
    return error.dot(solve_symmetric(covariance, error).col(0)) / static_cast<double>(error.size());
  }
  [[nodiscard]] Eigen::VectorXd in_deviations() const { return error.cwiseQuotient(covariance.diagonal().cwiseSqrt()); }
};

Errors errors_of(const RigCalibration& result, const std::vector<CalibratedCamera>& truth) {
  const auto count = static_cast<Eigen::Index>(truth.size());
  Eigen::VectorXd all(camera_numbers * count);
  Eigen::MatrixXd joint(camera_numbers * count, camera_numbers * count);
  for (Eigen::Index c = 0; c < count; ++c) {
    const auto &found = result.cameras[static_cast<std::size_t>(c)], &camera = truth[static_cast<std::size_t>(c)];
    const auto &a = found.intrinsics, &b = camera.intrinsics;
    auto part = all.segment<camera_numbers>(c * camera_numbers);
    part.head<5>() << a.fx - b.fx, a.fy - b.fy, a.cx - b.cx, a.cy - b.cy, a.skew - b.skew;
    for (std::size_t k = 0; k < 12; ++k) part[5 + static_cast<Eigen::Index>(k)] = a.distortion[k] - b.distortion[k];
    const Eigen::AngleAxisd rotation(found.pose.rotation * camera.pose.rotation.transpose());
    part.segment<3>(17) = rotation.angle() * rotation.axis();
    part.tail<3>() = found.pose.translation - camera.pose.translation;
    joint.middleRows<camera_numbers>(c * camera_numbers) = found.covariance;
  }
  std::vector<Eigen::Index> free;
  Errors errors;
  for (Eigen::Index n = 0; n < all.size(); ++n) {
    if (joint(n, n) > 0.0)
      free.push_back(n), errors.names.push_back(camera_number_names[static_cast<std::size_t>(n % camera_numbers)] +
                                                std::string(n < camera_numbers ? " a" : " b"));
    else
      EXPECT_NEAR(all[n], 0.0, 1e-12);  // what is fixed has not moved
  }
  errors.error.resize(static_cast<Eigen::Index>(free.size()));
  errors.covariance.resize(errors.error.size(), errors.error.size());
  for (Eigen::Index i = 0; i < errors.error.size(); ++i) {
    errors.error[i] = all[free[static_cast<std::size_t>(i)]];
    for (Eigen::Index j = 0; j < errors.error.size(); ++j)
      errors.covariance(i, j) = joint(free[static_cast<std::size_t>(i)], free[static_cast<std::size_t>(j)]);
  }
  return errors;
}

const Target board{.type = TargetType::chessboard, .rows = 7, .columns = 9, .spacing = 10.0};
const Target grid{.type = TargetType::circles, .rows = 7, .columns = 9, .spacing = 10.0, .diameter = 6.0};
const Target staggered{
    .type = TargetType::asymmetric_circles, .rows = 11, .columns = 4, .spacing = 7.0, .diameter = 6.5};

TEST(Target, orders_are_the_rotations_of_the_grid) {
  EXPECT_EQ(board.orders().size(), 2u);
  EXPECT_EQ(grid.orders()[1].front(), 62);
  EXPECT_EQ(staggered.orders().size(), 1u);  // an odd number of rows: it has an up and a down
  EXPECT_EQ((Target{.type = TargetType::asymmetric_circles, .rows = 6, .columns = 4}).orders().size(), 2u);
  const Target square{.rows = 5, .columns = 5};
  EXPECT_EQ(square.orders().size(), 4u);
  EXPECT_EQ(square.orders()[0][7], 7);
}

TEST(Calibrate, exact_points_give_the_true_cameras) {
  for (const std::size_t count : {1u, 2u, 3u}) {
    const auto truth = true_cameras(count);
    const auto result = calibrate_rig(board, sightings(truth, true_targets(board, 8, 1), board, 0.0, 1), five_terms);
    EXPECT_LT(result.rms, 1e-7);
    for (std::size_t c = 0; c < count; ++c) {
      EXPECT_NEAR(result.cameras[c].intrinsics.fx, truth[c].intrinsics.fx, 1e-3);
      EXPECT_NEAR(result.cameras[c].intrinsics.distortion[4], truth[c].intrinsics.distortion[4], 1e-2);
      EXPECT_LT((result.cameras[c].pose.translation - truth[c].pose.translation).norm(), 1e-4);
      EXPECT_LT((result.cameras[c].pose.rotation - truth[c].pose.rotation).norm(), 1e-6);
    }
  }
}

TEST(Calibrate, all_twelve_terms_can_be_found) {
  auto truth = true_cameras(2);
  for (auto& camera : truth)
    camera.intrinsics.distortion = {-0.2, 0.4, 0.001, -0.002, 0.0, 0.0, 0.0, 0.0, 0.004, 0.02, -0.003, 0.01};
  const auto result =
      calibrate_rig(board, sightings(truth, true_targets(board, 12, 1), board, 0.0, 1), {0, 1, 2, 3, 8, 9, 10, 11});
  EXPECT_LT(result.rms, 1e-7);
  EXPECT_NEAR(result.cameras[1].intrinsics.distortion[8], 0.004, 1e-5);
  EXPECT_NEAR(result.cameras[0].intrinsics.distortion[11], 0.01, 1e-4);
}

// The predicted standard deviations are those of many draws of the noise, and the joint covariance explains the errors.
TEST(Calibrate, covariance_is_that_of_many_draws) {
  const auto truth = true_cameras(3);
  const auto targets = true_targets(board, 9, 2);
  constexpr int draws = 80;
  Eigen::VectorXd squares, predicted;
  double chi_squared = 0.0, deviation = 0.0;
  for (int draw = 0; draw < draws; ++draw) {
    auto seen = sightings(truth, targets, board, 0.05, 100 + static_cast<unsigned>(draw));
    // frames that not all cameras have
    seen[0].pixels[2].clear(), seen[1].pixels[5].clear(), seen[2].pixels[5].clear();
    const auto result = calibrate_rig(board, seen, five_terms);
    const Errors errors = errors_of(result, truth);
    if (draw == 0) squares = predicted = Eigen::VectorXd::Zero(errors.error.size());
    squares += errors.error.cwiseAbs2() / draws;
    predicted += errors.covariance.diagonal() / draws;
    chi_squared += errors.chi_squared() / draws;
    deviation += result.deviation / draws;
  }
  EXPECT_NEAR(deviation, 0.05, 0.05 * 0.01);
  EXPECT_NEAR(chi_squared, 1.0, 0.1);  // mean over 80 x 39 numbers: 1 +- 0.025
  const Eigen::VectorXd ratio = squares.cwiseQuotient(predicted).cwiseSqrt();
  EXPECT_GT(ratio.minCoeff(), 0.7);  // 80 draws: 1 +- 0.08
  EXPECT_LT(ratio.maxCoeff(), 1.3);
}

TEST(Calibrate, agrees_with_OpenCVs_stereo_calibration) {
  const auto truth = true_cameras(2);
  const auto seen = sightings(truth, true_targets(board, 10, 3), board, 0.1, 7);
  const auto result = calibrate_rig(board, seen, five_terms);
  std::vector<std::vector<cv::Point3f>> objects;
  std::vector<std::vector<cv::Point2f>> images[2];
  for (std::size_t f = 0; f < 10; ++f) {
    objects.emplace_back();
    for (const auto& p : board.points())
      objects.back().emplace_back(static_cast<float>(p[0]), static_cast<float>(p[1]), 0.0F);
    for (std::size_t c = 0; c < 2; ++c) {
      images[c].emplace_back();
      for (const auto& p : seen[c].pixels[f])
        images[c].back().emplace_back(static_cast<float>(p[0]), static_cast<float>(p[1]));
    }
  }
  cv::Mat K[2], D[2], R, T, E, F;
  std::vector<cv::Mat> rotations, translations;
  for (int c = 0; c < 2; ++c) cv::calibrateCamera(objects, images[c], {420, 340}, K[c], D[c], rotations, translations);
  const double rms =
      cv::stereoCalibrate(objects, images[0], images[1], K[0], D[0], K[1], D[1], {420, 340}, R, T, E, F,
                          cv::CALIB_USE_INTRINSIC_GUESS, {cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 500, 1e-12});
  EXPECT_NEAR(result.rms, rms, 1e-4 * rms);
  EXPECT_NEAR(result.cameras[0].intrinsics.fx, K[0].at<double>(0, 0), 0.02);
  EXPECT_NEAR(result.cameras[1].pose.translation[2], T.at<double>(2), 0.02);
}

// A chessboard that looks the same upside down: a finder may begin at either end, in each image anew.
TEST(Calibrate, numbering_may_begin_at_either_end) {
  const auto truth = true_cameras(2);
  auto seen = sightings(truth, true_targets(board, 8, 4), board, 0.0, 1);
  for (const std::size_t f : {0u, 3u, 4u, 5u, 6u}) std::reverse(seen[1].pixels[f].begin(), seen[1].pixels[f].end());
  for (const std::size_t f : {3u, 7u}) std::reverse(seen[0].pixels[f].begin(), seen[0].pixels[f].end());
  const auto result = calibrate_rig(board, seen, five_terms);
  EXPECT_LT(result.rms, 1e-7);
  EXPECT_LT((result.cameras[1].pose.translation - truth[1].pose.translation).norm(), 1e-4);
}

TEST(Calibrate, too_little_is_said) {
  const auto truth = true_cameras(2);
  auto seen = sightings(truth, true_targets(board, 6, 4), board, 0.0, 1);
  auto few = seen;
  for (std::size_t f = 2; f < 6; ++f) few[1].pixels[f].clear();
  EXPECT_THAT([&] { (void)calibrate_rig(board, few, five_terms); },
              testing::ThrowsMessage<InputError>(
                  "camera camera b: the target was found in 2 of 6 images; allowed: at least 3"));
  auto apart = seen;
  for (std::size_t f = 0; f < 3; ++f) apart[0].pixels[f].clear(), apart[1].pixels[f + 3].clear();
  EXPECT_THAT([&] { (void)calibrate_rig(board, apart, five_terms); },
              testing::ThrowsMessage<InputError>(
                  "camera camera b: no image of the target at the same time as camera a; allowed: at least 1"));
  auto parallel = true_targets(board, 6, 4);
  for (auto& pose : parallel) pose.rotation.setIdentity();
  EXPECT_THAT([&] { (void)calibrate_rig(board, sightings(true_cameras(1), parallel, board, 0.05, 1), {0}); },
              testing::ThrowsMessage<InputError>(testing::HasSubstr("the target turned in different directions")));
}

/// Grey level of a target's plane at (x, y): 200, or 45 where it is dark.
double grey(const Target& target, double x, double y) {
  bool dark = false;
  if (target.type == TargetType::chessboard) {
    const double i = std::floor(x / target.spacing), j = std::floor(y / target.spacing);
    const bool inside = i >= -1 && i < target.columns && j >= -1 && j < target.rows;
    dark = inside && static_cast<long>(i + j) % 2 != 0;
  } else {
    const int row = static_cast<int>(std::lround(y / target.spacing));
    const bool staggered_rows = target.type == TargetType::asymmetric_circles;
    const double start = staggered_rows ? target.spacing * (row % 2) : 0.0,
                 pitch = staggered_rows ? 2.0 * target.spacing : target.spacing;
    const int column = static_cast<int>(
        std::lround((x - start) / pitch));  // the nearest of the row: circles do not reach the next row
    dark = row >= 0 && row < target.rows && column >= 0 && column < target.columns &&
           std::hypot(x - start - pitch * column, y - target.spacing * row) < 0.5 * target.diameter;
  }
  return dark ? 45.0 : 200.0;
}

constexpr int parts = 5;  // of a pixel, each way

/// Directions through 5 x 5 places of every pixel, in the camera's frame: each at random in its part of the pixel, as a
/// regular grid would see an edge along the pixels in steps.
std::vector<Eigen::Vector3d> rays_of(const CalibratedCamera& camera) {
  const PinholeCamera lens(camera.intrinsics, {});
  std::vector<Eigen::Vector3d> rays;
  std::mt19937 random(9);
  std::uniform_real_distribution<double> within(0.0, 1.0);
  for (int row = 0; row < camera.height * parts; ++row)
    for (int column = 0; column < camera.width * parts; ++column)
      rays.push_back(lens.ray({(column + within(random)) / parts - 0.5, (row + within(random)) / parts - 0.5}));
  return rays;
}

/// What a camera sees, without noise: a lens that blurs by 0.5 px, the mean over each pixel.
Image drawn(const CalibratedCamera& camera, const std::vector<Eigen::Vector3d>& rays, const Pose& target_pose,
            const Target& target) {
  const Pose pose = camera.pose * target_pose;
  const Eigen::Matrix3d back = pose.rotation.transpose();
  const Eigen::Vector3d origin = -back * pose.translation;
  cv::Mat_<float> fine(camera.height * parts, camera.width * parts);
  for (int row = 0; row < fine.rows; ++row)
    for (int column = 0; column < fine.cols; ++column) {
      const Eigen::Vector3d ray = back * rays[static_cast<std::size_t>(row * fine.cols + column)],
                            at = origin - origin[2] / ray[2] * ray;
      fine(row, column) = static_cast<float>(grey(target, at[0], at[1]));
    }
  cv::GaussianBlur(fine, fine, {}, 0.5 * parts);
  Image image(camera.width, camera.height);
  cv::Mat coarse(image.height, image.width, CV_32F, image.grey.data());
  cv::resize(fine, coarse, coarse.size(), 0, 0, cv::INTER_AREA);
  return image;
}

Image with_noise(Image image, double deviation, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<float> normal(0.0F, static_cast<float>(deviation));
  for (float& level : image.grey) level = std::round(std::clamp(level + normal(random), 0.0F, 255.0F));
  return image;
}

class Drawn : public testing::TestWithParam<Target> {};

TEST_P(Drawn, cameras_are_recovered_within_their_deviations) {
  const Target target = GetParam();
  const auto truth = true_cameras(2);
  const auto targets = true_targets(target, 8, 5);
  std::vector<std::vector<Image>> clean(2);
  for (std::size_t c = 0; c < 2; ++c) {
    const auto rays = rays_of(truth[c]);
    for (const auto& pose : targets) clean[c].push_back(drawn(truth[c], rays, pose, target));
  }
  constexpr unsigned draws = 5;
  double chi_squared = 0.0, largest = 0.0, deviation = 0.0, off = 0.0, as_points = 0.0;
  for (unsigned draw = 0; draw < draws; ++draw) {
    std::vector<CameraSightings> seen;
    for (std::size_t c = 0; c < 2; ++c) {
      seen.push_back({truth[c].name, truth[c].width, truth[c].height, {}});
      for (std::size_t f = 0; f < targets.size(); ++f) {
        seen[c].pixels.push_back(find_target(
            target,
            with_noise(clean[c][f], 2.0, 1000 * draw + 10 * static_cast<unsigned>(f) + static_cast<unsigned>(c))));
        ASSERT_EQ(seen[c].pixels[f].size(), target.points().size()) << "camera " << c << " frame " << f;
        // As they are numbered or from the other end: the points are where OpenCV projects them.
        const auto exact = by_opencv(truth[c], targets[f], target.points());
        double distance = 1e9;
        for (const auto& order : target.orders()) {
          double worst = 0.0;
          for (std::size_t k = 0; k < exact.size(); ++k)
            worst = std::max(worst, std::hypot(seen[c].pixels[f][k][0] - exact[static_cast<std::size_t>(order[k])].x,
                                               seen[c].pixels[f][k][1] - exact[static_cast<std::size_t>(order[k])].y));
          distance = std::min(distance, worst);
        }
        off = std::max(off, distance);
      }
    }
    const auto result = calibrate_rig(target, seen, five_terms);
    const Errors errors = errors_of(result, truth);
    chi_squared += errors.chi_squared() / draws;
    largest = std::max(largest, errors.in_deviations().cwiseAbs().maxCoeff());
    deviation += result.deviation / draws;
    Target without = target;  // a circle's centroid taken for its centre's image
    without.diameter = 0.0;
    as_points += errors_of(calibrate_rig(without, seen, five_terms), truth).chi_squared() / draws;
  }
  std::cout << "[          ] deviation of a coordinate " << deviation << " px, worst point " << off
            << " px from its true place; errors: chi^2 per number " << chi_squared << ", largest " << largest
            << " standard deviations; chi^2 without the diameter " << as_points << "\n";
  if (target.type != TargetType::chessboard) {
    EXPECT_GT(as_points, 2.0 * chi_squared);
  }
  EXPECT_LT(off, 0.25);
  EXPECT_LT(deviation, 0.05);
  EXPECT_LT(largest, 4.0);
  EXPECT_LT(chi_squared, 2.0);
}

INSTANTIATE_TEST_SUITE_P(Calibrate, Drawn, testing::Values(board, grid, staggered), [](const auto& of) {
  return of.param.type == TargetType::chessboard ? "chessboard"
         : of.param.type == TargetType::circles  ? "circles"
                                                 : "asymmetric_circles";
});

TEST(FindTarget, nothing_is_found_where_nothing_is) {
  const Image empty = with_noise(Image(320, 240, 8, 120.0F), 3.0, 1);
  for (const auto& target : {board, grid, staggered}) EXPECT_TRUE(find_target(target, empty).empty());
}

TEST(FindTarget, sixteen_bits_and_bright_circles) {
  const auto camera = true_cameras(1)[0];
  const auto pose = true_targets(grid, 1, 6)[0];
  Image image = drawn(camera, rays_of(camera), pose, grid);
  const auto dark = find_target(grid, image);
  ASSERT_EQ(dark.size(), 63u);
  image.depth = 16;
  for (float& level : image.grey) level = 4000.0F - 15.0F * level;
  const auto bright = find_target(grid, image);
  ASSERT_EQ(bright.size(), 63u);
  for (std::size_t k = 0; k < 63; ++k)
    EXPECT_LT(std::min((dark[k] - bright[k]).norm(), (dark[k] - bright[62 - k]).norm()), 1e-3);
}

// 20 pairs of another laboratory's chessboard.
TEST(Measured, stereo_chessboard) {
  const char* set = std::getenv("IMIC3D_DATA");
  const fs::path folder =
      (set != nullptr ? fs::path(set) : fs::path(IMIC3D_SOURCE_DIRECTORY) / ".." / "shared" / "data") /
      "stereo_chessboard";
  if (!fs::exists(folder)) GTEST_SKIP() << "stereo_chessboard: no folder " << folder << " (set IMIC3D_DATA)";
  const Target target{.type = TargetType::chessboard, .rows = 7, .columns = 11, .spacing = 8.0};
  std::vector<CameraSightings> seen;
  for (const char* side : {"imgleft", "imgright"}) {
    seen.push_back({side, 613, 513, {}});
    for (int k = 0; k < 20; ++k) {
      char name[20];
      std::snprintf(name, sizeof name, "image_%02d.tif", k);
      seen.back().pixels.push_back(find_target(target, read_image(folder / side / name)));
      EXPECT_EQ(seen.back().pixels.back().size(), 77u) << side << " " << name;
    }
  }
  const auto result = calibrate_rig(target, seen, five_terms);
  std::cout << "[          ] 20 pairs: reprojection error " << result.rms << " px rms (" << result.rms_of(0)
            << " left, " << result.rms_of(1) << " right), " << result.cameras[1].pose.translation.norm()
            << " mm apart\n";
  EXPECT_LT(result.rms, 0.12);
}

}  // namespace test_calibrate
}  // namespace imic3d::imaging
