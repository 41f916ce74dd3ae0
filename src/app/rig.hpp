#pragma once
// The cameras that look at one face of the specimen.

#include <string>
#include <vector>

#include "imic3d/correlation/global_dic.hpp"
#include "imic3d/correlation/specimen_pose.hpp"
#include "imic3d/io/case.hpp"

namespace imic3d::app {

/// What the cameras of one face see of it.
struct Rig {
  bool back = false;
  mesh::Mesh surface;        ///< with its measured shape
  std::vector<int> cameras;  ///< places in Case::cameras
  std::vector<correlation::View> views;
  std::vector<std::vector<imaging::Image>> statics;  ///< of each view, averaged to its reference
  std::vector<bool> noise_is_measured;
  /// of the face in front of its pinhole cameras; its frame has z towards them
  correlation::SpecimenPose pose;
  bool placed = false;              ///< by specimen.place
  std::vector<std::string> doubts;  ///< of the telecentric cameras' places and of pictures that are saturated
  [[nodiscard]] int references(std::size_t view) const { return static_cast<int>(statics[view].size()); }
};
/// The reference frames of a camera. Throws InputError where one cannot be read, or has one grey level throughout.
[[nodiscard]] std::vector<imaging::Image> references_of(const io::Case& test, const io::CameraCase& camera);
/// Reads the references of the face's cameras, places them; `surface` is the face, counter-clockwise in x and y. With
/// several views their noise is measured, for their weights. Throws InputError.
[[nodiscard]] Rig make_rig(const io::Case& test, bool back, mesh::Mesh surface);
/// The face that `imic3d dic` works on, without a volume: quadrilaterals lie at z = 0, their back at -thickness.
[[nodiscard]] mesh::Mesh surface_of(const io::Case& test, bool back);
/// Of cameras together [grey level]: 1/sigma^2 is the mean of 1/sigma_c^2; infinity where nothing is known yet.
[[nodiscard]] double joint_noise(const std::vector<double>& sigma);
/// Measures the noise of a view on the pixels of the specimen, where it is not declared and there are several reference
/// frames.
void measure_noise(Rig& rig, std::size_t view, const correlation::PixelQuadrature& seen);
/// Doubts a view of which many pixels of the specimen have the largest or the smallest grey level of its first
/// reference frame.
void doubt_saturation(const io::Case& test, Rig& rig, std::size_t view, const correlation::PixelQuadrature& seen);

/// Doubts a view in which elements of the surface show nothing but noise: the mesh covers a hole or a shadow there.
/// `response`: of the grey levels that the correlation sees to noise of the image (imaging::NoiseResponse::level).
void doubt_bare_places(const io::Case& test, Rig& rig, std::size_t view, const correlation::PixelQuadrature& seen,
                       double response);

/// What lets doubt a rig of which points lie off their epipolar lines in some frames
/// (correlation::Cameras::off_epipolar), and what it looks like: alike in all of them, a push; as the specimen's motion
/// from one frame to the next, a camera that is late. Else empty. `numbers`: of the frames, `frames` those of the face
/// that `cameras` see.
[[nodiscard]] std::string doubt_off_epipolar(const io::Case& test, const Rig& rig, const correlation::Cameras& cameras,
                                             const io::Frames& numbers,
                                             const std::vector<correlation::DicFrame>& frames);

/// The residual of one camera at a displacement of its face (and what its nodes move by beside that,
/// Cameras::off_epipolar) in units of its noise `sigma` [grey level], as a map of `columns` x `rows` pixels with NaN
/// off the specimen.
struct ResidualMap {
  int columns = 0, rows = 0;
  std::vector<double> values;
};
[[nodiscard]] ResidualMap residual_map(const correlation::GlobalDic& dic, int camera, const imaging::BSpline& image,
                                       const Eigen::VectorXd& displacement, double sigma,
                                       const correlation::InImage& off_epipolar = {});

}  // namespace imic3d::app
