#pragma once
// What a camera calibration says, and the files that it is written in. See docs/calibration.md.

#include <Eigen/Core>
#include <array>
#include <filesystem>
#include <string>
#include <vector>

#include "imic3d/imaging/pinhole.hpp"

namespace imic3d::imaging {

/// The numbers of one camera in the order of every covariance: fx fy cx cy skew, the 12 distortion terms, then the pose
/// as rx ry rz tx ty tz. The rotation is counted from its value R on the left: exp([r]x) R [rad].
inline constexpr int camera_numbers = 23;
inline constexpr std::array<const char*, camera_numbers> camera_number_names = {
    "fx", "fy", "cx", "cy", "skew", "k1", "k2", "p1", "p2", "k3", "k4", "k5",
    "k6", "s1", "s2", "s3", "s4",   "rx", "ry", "rz", "tx", "ty", "tz"};

struct CalibratedCamera {
  std::string name;
  int width = 0, height = 0;  ///< [px]; 0: the file does not say
  Intrinsics intrinsics;
  /// from the rig's frame (the first camera's, or the file's own) to the camera's [the file's length unit]
  Pose pose;
  /// [23 x 23 n], n cameras: covariance of this camera's numbers with those of all cameras, in the file's order; fixed
  /// numbers have zeros. Empty: the file does not say.
  Eigen::MatrixXd covariance;

  [[nodiscard]] PinholeCamera camera() const { return {intrinsics, pose}; }
};

/// The cameras of a calibration file, recognised by its contents: VIC-3D's project or `cal.xml`, DICe's
/// `DICe_xml_camera_system_file`, MatchID's `.caldat`, OpenCV's YAML or XML (what `write_calibration` writes; the
/// stereo sample's M1 D1 M2 D2 R T, R and T in an `extrinsics` file beside it if not in the same; one camera's
/// camera_matrix and distortion_coefficients). Throws InputError, naming file and line or key, for everything that
/// cannot be taken as it is meant: also for a distortion that Intrinsics cannot hold.
[[nodiscard]] std::vector<CalibratedCamera> read_calibration(const std::filesystem::path& file);

/// Writes a file that cv::FileStorage and read_calibration read: for each camera its name, size, camera_matrix,
/// distortion_coefficients (12), rotation, translation, and the covariance where there is one.
void write_calibration(const std::filesystem::path& file, const std::vector<CalibratedCamera>& cameras,
                       const std::string& length_unit);

/// Rz(gamma) Ry(beta) Rx(alpha), angles in degrees: the rotation of VIC-3D, DICe and MatchID.
[[nodiscard]] Eigen::Matrix3d rotation_of_angles(double alpha, double beta, double gamma);

}  // namespace imic3d::imaging
