// Calibration files: one rig written in every format must be seen as one rig; a real VIC-3D file must fit its images.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <cstdlib>
#include <fstream>
#include <iostream>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/video.hpp>

#include "imic3d/core/error.hpp"
#include "imic3d/imaging/calibration.hpp"

namespace imic3d::imaging {
namespace test_calibration_files {

namespace fs = std::filesystem;

class CalibrationFiles : public testing::Test {
 protected:
  void SetUp() override { fs::create_directories(folder); }
  void TearDown() override { fs::remove_all(folder); }
  fs::path write(const std::string& name, const std::string& text) const {
    std::ofstream(folder / name, std::ios::binary) << text;
    return folder / name;
  }
  /// What read_calibration says of a file, without the folder's name.
  std::string said(const std::string& name, const std::string& text) const {
    try {
      (void)read_calibration(write(name, text));
    } catch (const InputError& error) {
      std::string message = error.what();
      for (auto at = message.find(folder.string() + "/"); at != std::string::npos;
           at = message.find(folder.string() + "/"))
        message.erase(at, folder.string().size() + 1);
      return message;
    }
    return "nothing";
  }
  const fs::path folder = fs::temp_directory_path() / ("imic3d_calibration_" + std::to_string(::getpid()));
};

// One rig: camera 0 at the origin, camera 1 by the angles 2, -17, 0.5 degrees and the way (120, -3, 21). In VIC-3D's
// and DICe's file both cameras also have the frame's own pose, half a turn about x and 400 away: x_0 = Rx(180) X + (0,
// 0, 400).
const char* const matchid = R"(Cam0_Fx [pixels];5000
Cam0_Fy [pixels];5010
Cam0_Fs [pixels];0.5
Cam0_Kappa 1;0.2
Cam0_Kappa 2;-3
Cam0_Kappa 3;7
Cam0_P1;0.001
Cam0_P2;-0.002
Cam0_Cx [pixels];640
Cam0_Cy [pixels];512
Cam1_Fx [pixels];5100
Cam1_Fy [pixels];5090
Cam1_Fs [pixels];-0.25
Cam1_Kappa 1;0.3
Cam1_Kappa 2;1
Cam1_Kappa 3;0
Cam1_P1;0
Cam1_P2;0
Cam1_Cx [pixels];600
Cam1_Cy [pixels];500
Tx [mm];120
Ty [mm];-3
Tz [mm];21
Theta [deg];2
Phi [deg];-17
Psi [deg];0.5
)";

const char* const vic = R"(<?xml version="1.0"?>
<!DOCTYPE vpml>
<project><calibration lri="calibration">
 <camera id="0">640 512 5000 5010 0.5 0.2 -3 7<orientation>180 0 0 0 0 400</orientation></camera>
 <camera id="1">
  <intrinsics>600 500 5100 5090 -0.25</intrinsics><distortion order="3">0.3 1 0</distortion>
  <orientation>182 17 -0.5 3.0547888 -16.9608786 403.2894867</orientation>
 </camera>
</calibration><polygonmask width="1280" height="1024"/></project>
)";

const char* const dice = R"(<ParameterList>
 <Parameter name="xml_file_format" type="string" value="DICe_xml_camera_system_file"/>
 <Parameter name="extrinsics_relative_camera_to_camera" type="bool" value="true"/>
 <!-- <Parameter name="FX" type="double" value="1"/> -->
 <ParameterList name="CAMERA 0">
  <Parameter name="CAMERA_ID" type="string" value="left"/>
  <Parameter name="CX" type="double" value="640"/><Parameter name="CY" type="double" value="512"/>
  <Parameter name="FX" type="double" value="5000"/><Parameter name="FY" type="double" value="5010"/>
  <Parameter name="FS" type="double" value="0.5"/>
  <Parameter name="K1" type="double" value="0.2"/><Parameter name="K2" type="double" value="-3"/>
  <Parameter name="K3" type="double" value="7"/>
  <Parameter name="P1" type="double" value="0.001"/><Parameter name="P2" type="double" value="-0.002"/>
  <Parameter name="LENS_DISTORTION_MODEL" type="string" value="OPENCV_DIS"/>
  <Parameter name="IMAGE_HEIGHT_WIDTH" type="string" value="{ 1024, 1280 }"/>
  <Parameter name="ALPHA" type="double" value="180"/><Parameter name="TZ" type="double" value="400"/>
 </ParameterList>
 <ParameterList name="CAMERA 1">
  <Parameter name="CX" type="double" value="600"/><Parameter name="CY" type="double" value="500"/>
  <Parameter name="FX" type="double" value="5100"/><Parameter name="FY" type="double" value="5090"/>
  <Parameter name="FS" type="double" value="-0.25"/>
  <Parameter name="K1" type="double" value="0.3"/><Parameter name="K2" type="double" value="1"/>
  <Parameter name="LENS_DISTORTION_MODEL" type="string" value="K1R3_K2R5_K3R7"/>
  <Parameter name="IMAGE_HEIGHT_WIDTH" type="string" value="{ 1024, 1280 }"/>
  <ParameterList name="rotation_3x3_matrix">
ROWS
  </ParameterList>
  <Parameter name="TX" type="double" value="120"/><Parameter name="TY" type="double" value="-3"/>
  <Parameter name="TZ" type="double" value="21"/>
 </ParameterList>
</ParameterList>
)";

/// Rz(0.5) Ry(-17) Rx(2) written out by hand, not by the code under test.
Eigen::Matrix3d rotation() {
  const double a = 2 * M_PI / 180, b = -17 * M_PI / 180, c = 0.5 * M_PI / 180;
  const Eigen::Matrix3d X{{1, 0, 0}, {0, std::cos(a), -std::sin(a)}, {0, std::sin(a), std::cos(a)}};
  const Eigen::Matrix3d Y{{std::cos(b), 0, std::sin(b)}, {0, 1, 0}, {-std::sin(b), 0, std::cos(b)}};
  const Eigen::Matrix3d Z{{std::cos(c), -std::sin(c), 0}, {std::sin(c), std::cos(c), 0}, {0, 0, 1}};
  return Z * Y * X;
}

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const auto at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return at == std::string::npos ? text : text.replace(at, from.size(), to);
}

std::string dice_text() {
  std::string rows;
  for (int i = 0; i < 3; ++i) {
    char line[200];
    std::snprintf(line, sizeof line, "<Parameter name=\"ROW %d\" type=\"string\" value=\"{ %.15g, %.15g, %.15g }\"/>\n",
                  i, rotation()(i, 0), rotation()(i, 1), rotation()(i, 2));
    rows += line;
  }
  return replaced(dice, "ROWS", rows);
}

/// Where camera 1 sees, by OpenCV, a point that camera 0 has at `point` in its own frame.
Eigen::Vector2d seen_by_second(const Eigen::Vector3d& point) {
  const Eigen::Vector3d p = rotation() * point + Eigen::Vector3d(120, -3, 21);
  std::vector<cv::Point2d> seen;
  cv::projectPoints(std::vector<cv::Point3d>{{p[0], p[1], p[2]}}, cv::Vec3d(0, 0, 0), cv::Vec3d(0, 0, 0),
                    cv::Mat(cv::Matx33d(5100, 0, 600, 0, 5090, 500, 0, 0, 1)), std::vector<double>{0.3, 1, 0, 0, 0},
                    seen);
  return {seen[0].x - 0.25 * (seen[0].y - 500) / 5090, seen[0].y};
}

void expect_the_rig(const std::vector<CalibratedCamera>& cameras, bool tangential, double tolerance) {
  ASSERT_EQ(cameras.size(), 2u);
  const Pose to_rig{cameras[0].pose.rotation.transpose(),
                    -cameras[0].pose.rotation.transpose() * cameras[0].pose.translation};
  for (const auto& point : {Eigen::Vector3d(0, 0, 390), Eigen::Vector3d(30, -20, 400), Eigen::Vector3d(-25, 22, 405)}) {
    const Eigen::Vector3d X = to_rig.rotation * point + to_rig.translation;
    EXPECT_LT((cameras[1].camera().project(X) - seen_by_second(point)).norm(), tolerance);
    EXPECT_LT(
        (cameras[0].camera().ray(cameras[0].camera().project(X)) - (X - cameras[0].camera().centre()).normalized())
            .norm(),
        1e-12);
  }
  const auto& lens = cameras[0].intrinsics;
  EXPECT_THAT((std::array{lens.fx, lens.fy, lens.cx, lens.cy, lens.skew}),
              testing::ElementsAre(5000, 5010, 640, 512, 0.5));
  EXPECT_THAT(lens.distortion,
              testing::ElementsAre(0.2, -3, tangential ? 0.001 : 0, tangential ? -0.002 : 0, 7, 0, 0, 0, 0, 0, 0, 0));
}

TEST_F(CalibrationFiles, MatchID) {
  const auto cameras = read_calibration(write("rig.caldat", matchid));
  expect_the_rig(cameras, true, 1e-8);
  EXPECT_TRUE(cameras[0].pose.rotation.isIdentity());
  expect_the_rig(read_calibration(write("dos.caldat", replaced(matchid, "5000\n", "5000\r\n"))), true, 1e-8);
}

TEST_F(CalibrationFiles, VIC3D) {
  // x_1 = R (x_0) + t with x_0 = Rx(180) X + (0, 0, 400): R Rx(180) = Rz(c) Ry(b) Rx(a + 180).
  const Eigen::Vector3d t = rotation() * Eigen::Vector3d(0, 0, 400) + Eigen::Vector3d(120, -3, 21);
  char pose[200];
  std::snprintf(pose, sizeof pose, "182 -17 0.5 %.12g %.12g %.12g", t[0], t[1], t[2]);
  const auto text = replaced(vic, "182 17 -0.5 3.0547888 -16.9608786 403.2894867", pose);
  const auto cameras = read_calibration(write("cal.xml", text));
  expect_the_rig(cameras, false, 1e-6);
  EXPECT_EQ(cameras[1].name, "camera 1");
  EXPECT_EQ(cameras[1].width, 1280);
  EXPECT_EQ(cameras[1].height, 1024);
}

TEST_F(CalibrationFiles, DICe) {
  const auto cameras = read_calibration(write("dice.xml", dice_text()));
  expect_the_rig(cameras, true, 1e-8);
  EXPECT_EQ(cameras[0].name, "left");
  EXPECT_EQ(cameras[0].width, 1280);
}

TEST_F(CalibrationFiles, OpenCV_stereo_sample_in_one_file_or_two) {
  const cv::Mat R = [] {
    cv::Mat m(3, 3, CV_64F);
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) m.at<double>(i, j) = rotation()(i, j);
    return m;
  }();
  const cv::Mat M1 = (cv::Mat_<double>(3, 3) << 5000, 0.5, 640, 0, 5010, 512, 0, 0, 1),
                M2 = (cv::Mat_<double>(3, 3) << 5100, -0.25, 600, 0, 5090, 500, 0, 0, 1);
  const cv::Mat D1 = (cv::Mat_<double>(1, 5) << 0.2, -3, 0.001, -0.002, 7),
                D2 = (cv::Mat_<double>(5, 1) << 0.3, 1, 0, 0, 0);
  const cv::Mat T = (cv::Mat_<double>(3, 1) << 120, -3, 21);
  for (const std::string ending : {".yml", ".xml"}) {
    {
      cv::FileStorage one((folder / ("rig" + ending)).string(), cv::FileStorage::WRITE);
      one << "M1" << M1 << "D1" << D1 << "M2" << M2 << "D2" << D2 << "R" << R << "T" << T;
      cv::FileStorage first((folder / ("intrinsics" + ending)).string(), cv::FileStorage::WRITE);
      first << "M1" << M1 << "D1" << D1 << "M2" << M2 << "D2" << D2;
      cv::FileStorage second((folder / ("extrinsics" + ending)).string(), cv::FileStorage::WRITE);
      second << "R" << R << "T" << T;
    }
    expect_the_rig(read_calibration(folder / ("rig" + ending)), true, 1e-8);
    expect_the_rig(read_calibration(folder / ("intrinsics" + ending)), true, 1e-8);
  }
}

TEST_F(CalibrationFiles, what_is_written_is_read) {
  auto cameras = read_calibration(write("rig.caldat", matchid));
  cameras[0].name = "left \"one\": a";
  cameras[0].width = 1280, cameras[0].height = 1024;
  cameras[1].intrinsics.distortion = {0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.0 / 3.0};
  cameras[0].covariance = Eigen::MatrixXd::Random(camera_numbers, 2 * camera_numbers);
  cameras[1].covariance = Eigen::MatrixXd::Random(camera_numbers, 2 * camera_numbers);
  write_calibration(folder / "calibration.yaml", cameras, "mm");
  const auto again = read_calibration(folder / "calibration.yaml");
  ASSERT_EQ(again.size(), 2u);
  for (std::size_t i = 0; i < 2; ++i) {
    EXPECT_EQ(again[i].name, cameras[i].name);
    EXPECT_EQ(again[i].width, cameras[i].width);
    EXPECT_EQ(again[i].intrinsics.distortion, cameras[i].intrinsics.distortion);
    EXPECT_EQ(again[i].intrinsics.skew, cameras[i].intrinsics.skew);
    EXPECT_EQ(again[i].pose.rotation, cameras[i].pose.rotation);
    EXPECT_EQ(again[i].pose.translation, cameras[i].pose.translation);
    EXPECT_EQ(again[i].covariance, cameras[i].covariance);
  }
  cv::FileStorage storage((folder / "calibration.yaml").string(), cv::FileStorage::READ);  // as OpenCV reads it
  cv::Mat K;
  storage["cameras"][1]["camera_matrix"] >> K;
  EXPECT_EQ(K.at<double>(0, 0), 5100.0);
}

TEST_F(CalibrationFiles, one_camera_of_OpenCV) {
  {
    cv::FileStorage one((folder / "one.yml").string(), cv::FileStorage::WRITE);
    one << "image_width" << 640 << "image_height" << 480 << "camera_matrix"
        << (cv::Mat_<double>(3, 3) << 900, 0, 320, 0, 901, 240, 0, 0, 1) << "distortion_coefficients"
        << (cv::Mat_<double>(4, 1) << 0.1, 0.2, 0.3, 0.4);
  }
  const auto cameras = read_calibration(folder / "one.yml");
  ASSERT_EQ(cameras.size(), 1u);
  EXPECT_EQ(cameras[0].intrinsics.fy, 901.0);
  EXPECT_EQ(cameras[0].intrinsics.distortion[3], 0.4);
  EXPECT_EQ(cameras[0].width, 640);
}

TEST_F(CalibrationFiles, mistakes_are_named) {
  const std::string formats = "a calibration of VIC-3D, DICe (XML), MatchID (.caldat) or OpenCV (YAML, XML)";
  EXPECT_EQ(said("empty.xml", ""), "empty.xml: not a calibration; allowed: " + formats);
  EXPECT_EQ(said("case.yaml", "title: no calibration\n"), "case.yaml: not a calibration; allowed: " + formats);
  EXPECT_THAT([&] { (void)read_calibration(folder / "none.xml"); },
              testing::ThrowsMessage<InputError>(testing::HasSubstr("none.xml: no such file; allowed: ")));
  EXPECT_THAT([&] { (void)read_calibration(folder); },
              testing::ThrowsMessage<InputError>(testing::HasSubstr(": cannot be read; allowed: ")));

  EXPECT_EQ(said("a.caldat", replaced(matchid, "Theta [deg];2\n", "")),
            "a.caldat Theta: not given; allowed: a line Theta;<number>");
  EXPECT_EQ(said("a.caldat", replaced(matchid, ";5010", ";5010x")),
            "a.caldat:2 Cam0_Fy: \"5010x\"; allowed: a finite number");
  EXPECT_EQ(said("a.caldat", replaced(matchid, ";5010", ";nan")),
            "a.caldat:2 Cam0_Fy: \"nan\"; allowed: a finite number");
  EXPECT_EQ(said("a.caldat", replaced(matchid, ";5000", ";-5000")),
            "a.caldat camera 0: focal lengths -5000 and 5010; allowed: positive numbers [px]");
  EXPECT_EQ(said("a.caldat", replaced(matchid, "Cam0_Fy [pixels];5010", "Cam0_Fx [pixels];5010")),
            "a.caldat:2 Cam0_Fx: given twice (first in line 1); allowed: each name once");
  EXPECT_EQ(said("a.caldat", replaced(matchid, "Ty [mm];", "Ty [mm] ")),
            "a.caldat:22: \"Ty [mm] -3\"; allowed: a name, a semicolon and a number");

  EXPECT_EQ(said("cal.xml", replaced(vic, " 0.5 0.2 -3 7", "")),
            "cal.xml:4 camera: 4 numbers; allowed: cx cy fx fy skew k1 k2 k3");
  EXPECT_EQ(said("cal.xml", replaced(vic, "0 0 400</", "0 400</")),
            "cal.xml:4 orientation: 5 numbers; allowed: alpha beta gamma [degrees] tx ty tz");
  EXPECT_EQ(said("cal.xml", replaced(vic, "<orientation>180 0 0 0 0 400</orientation>", "")),
            "cal.xml:4 camera: no orientation; allowed: <orientation> alpha beta gamma tx ty tz");
  EXPECT_EQ(said("cal.xml", replaced(vic, "640 512", "640 five")),
            "cal.xml:4 camera: \"five\"; allowed: a finite number");
  EXPECT_EQ(said("cal.xml", replaced(vic, "<intrinsics>600 500 5100 5090 -0.25</intrinsics>", "")),
            "cal.xml:5 camera: no numbers; allowed: cx cy fx fy skew k1 k2 k3");
  EXPECT_EQ(said("cal.xml", replaced(vic, "<polygonmask width=\"1280\" height=\"1024\"/></project>", "<polygonmask")),
            "cal.xml:9: a tag that does not end; allowed: <...>");

  EXPECT_EQ(said("d.xml", replaced(dice_text(), "K1R3_K2R5_K3R7", "K1R1_K2R2_K3R3")),
            "d.xml:22 CAMERA 1 LENS_DISTORTION_MODEL: K1R1_K2R2_K3R3; allowed: OPENCV_DIS, VIC3D_DIS, K1R3_K2R5_K3R7, "
            "NONE (no other can "
            "be kept)");
  EXPECT_EQ(
      said("d.xml", replaced(dice_text(), "name=\"FX\" type=\"double\" value=\"5000\"", "name=\"FXX\" value=\"5000\"")),
      "d.xml CAMERA 0 FX: not given; allowed: a number");
  EXPECT_EQ(
      said("d.xml", replaced(dice_text(), "name=\"K3\" type=\"double\" value=\"7\"", "name=\"T1\" value=\"0.1\"")),
      "d.xml:11 CAMERA 0 T1: 0.1; allowed: 0 (a tilted sensor is not modelled)");

  const std::string storage = "%YAML:1.0\n---\n";
  EXPECT_EQ(
      said("o.yaml", storage + "a: 1\n"),
      "o.yaml: no camera; allowed: cameras (a list), M1 D1 M2 D2 R T, or camera_matrix and distortion_coefficients");
  EXPECT_EQ(said("o.yaml", storage + "cameras:\n   - { name: one }\n"),
            "o.yaml cameras[0] camera_matrix: not given; allowed: a value");
  EXPECT_EQ(said("o.yaml", storage + "camera_matrix: 3\ndistortion_coefficients: 2\n"),
            "o.yaml camera_matrix: not a matrix; allowed: 3 x 3 numbers");
  EXPECT_THAT(said("o.yaml", storage + "camera_matrix: [ 3\n"), testing::StartsWith("o.yaml: "));
  write_calibration(folder / "good.yaml", read_calibration(write("rig.caldat", matchid)), "mm");
  std::ifstream stream(folder / "good.yaml");
  const std::string good((std::istreambuf_iterator<char>(stream)), {});
  EXPECT_EQ(said("o.yaml", replaced(good, "cols: 12", "cols: 11")),
            "o.yaml cameras[0] distortion_coefficients: 1 x 11 numbers; allowed: 4, 5, 8, 12 or 14 numbers: k1 k2 p1 "
            "p2 k3 k4 ...");
  EXPECT_THAT(said("o.yaml", good.substr(0, good.size() / 2)), testing::StartsWith("o.yaml"));
  auto mirrored = read_calibration(folder / "good.yaml");
  mirrored[1].pose.rotation.row(0) *= -1.0;
  write_calibration(folder / "mirrored.yaml", mirrored, "mm");
  std::ifstream other(folder / "mirrored.yaml");
  EXPECT_EQ(said("o.yaml", std::string((std::istreambuf_iterator<char>(other)), {})),
            "o.yaml cameras[1]: a rotation that is not orthogonal or mirrors; allowed: a rotation matrix");
}

/// Distance of matched pixels from the epipolar line in camera 1 [px], one a match (by the nearest points on both
/// rays).
Eigen::VectorXd epipolar_error(const std::vector<CalibratedCamera>& cameras, const std::vector<cv::Point2f>& left,
                               const std::vector<cv::Point2f>& right) {
  Eigen::VectorXd error(static_cast<Eigen::Index>(left.size()));
  const PinholeCamera a = cameras[0].camera(), b = cameras[1].camera();
  const Eigen::Vector3d base = b.centre() - a.centre();
  for (std::size_t i = 0; i < left.size(); ++i) {
    const Eigen::Vector3d u = a.ray({left[i].x, left[i].y}), v = b.ray({right[i].x, right[i].y}),
                          n = u.cross(v).normalized();
    const double depth = v.cross(n).dot(base) / u.cross(v).norm();  // along u to the nearest point
    error[static_cast<Eigen::Index>(i)] = base.dot(n) / depth * cameras[1].intrinsics.fx;
  }
  return error;
}

// The meaning of VIC-3D's numbers, by the images: the pair at rest matched by affine subsets.
TEST(Measured, the_cameras_of_VIC3D_look_at_one_specimen) {
  const char* set = std::getenv("IMIC3D_DATA");
  const fs::path folder =
      (set != nullptr ? fs::path(set) : fs::path(IMIC3D_SOURCE_DIRECTORY) / ".." / "shared" / "data") / "gt4_stereo";
  if (!fs::exists(folder)) GTEST_SKIP() << "gt4_stereo: no folder " << folder << " (set IMIC3D_DATA)";
  const cv::Mat first = cv::imread((folder / "GT4-0000_0.tif").string(), cv::IMREAD_GRAYSCALE),
                second = cv::imread((folder / "GT4-0000_1.tif").string(), cv::IMREAD_GRAYSCALE);
  std::vector<cv::Point2f> grid, found, left, right;
  for (int row = 130; row < 900; row += 50)
    for (int column = 200; column < 1700; column += 50)
      grid.emplace_back(static_cast<float>(column), static_cast<float>(row));
  std::vector<unsigned char> there;
  std::vector<float> misfit;
  cv::calcOpticalFlowPyrLK(first, second, grid, found, there, misfit, {51, 51}, 6);
  for (std::size_t i = 0; i < grid.size(); ++i) {
    if (!there[i] || cv::norm(found[i] - grid[i]) > 150.0) continue;
    constexpr int half = 20;  // an affine subset about the point
    const cv::Mat subset = first(
        cv::Rect(static_cast<int>(grid[i].x) - half, static_cast<int>(grid[i].y) - half, 2 * half + 1, 2 * half + 1));
    cv::Matx23f map(1, 0, found[i].x - half, 0, 1, found[i].y - half);
    try {
      if (cv::findTransformECC(subset, second, map, cv::MOTION_AFFINE,
                               {cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 100, 1e-6}, cv::noArray(), 1) < 0.97)
        continue;
    } catch (const cv::Exception&) {
      continue;
    }
    const cv::Vec2f at = map * cv::Vec3f(half, half, 1);
    left.push_back(grid[i]), right.emplace_back(at[0], at[1]);
  }
  ASSERT_GT(left.size(), 150u);

  const auto cameras = read_calibration(folder / "cal.xml");
  ASSERT_EQ(cameras.size(), 2u);
  const auto figures = [&](const char* what, const std::vector<CalibratedCamera>& as) {
    Eigen::VectorXd error = epipolar_error(as, left, right);
    std::sort(error.begin(), error.end());
    const double median = error[error.size() / 2];
    Eigen::VectorXd rest = (error.array() - median).abs();
    std::sort(rest.begin(), rest.end());
    const double rms = std::sqrt(error.head(error.size()).squaredNorm() / static_cast<double>(error.size()));
    std::cout << "[          ] " << what << ": rms " << rms << " px, median " << median << " px, 90 % within "
              << rest[rest.size() * 9 / 10] << " px of it (" << error.size() << " matches)\n";
    return std::pair(std::abs(median), rest[rest.size() * 9 / 10]);
  };
  const auto [offset, spread] = figures("VIC-3D as it is read", cameras);
  EXPECT_LT(offset, 0.12);  // 0.11 px, the same everywhere: the rig has moved since its calibration
  EXPECT_LT(spread, 0.04);
  auto other = cameras;
  for (auto& camera : other) camera.intrinsics.distortion = {};
  figures("without distortion", other);
  other = cameras;
  for (auto& camera : other)
    camera.pose.rotation =
        rotation_of_angles(180, 0, 0) * camera.pose.rotation.transpose() * rotation_of_angles(180, 0, 0);
  EXPECT_GT(figures("rotations the other way", other).first, 10.0 * offset);

  const Eigen::Vector3d a = cameras[0].camera().ray({960, 600}), b = cameras[1].camera().ray({960, 600});
  const Eigen::Vector3d base = cameras[1].camera().centre() - cameras[0].camera().centre();
  EXPECT_NEAR(base.norm(), 120.0, 20.0);  // [mm]
  EXPECT_NEAR(std::acos(a.dot(b)) * 180 / M_PI, 18.8, 1.0);
}

}  // namespace test_calibration_files
}  // namespace imic3d::imaging
