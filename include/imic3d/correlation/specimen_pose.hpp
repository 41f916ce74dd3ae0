#pragma once
// Where a specimen lies in front of calibrated cameras (Sec. 3.2: "a 2D mesh is positioned within the physical space so
// that its projections on the images of the two cameras match the projection of the specimen").

#include <Eigen/Core>
#include <span>
#include <string>
#include <vector>

#include "imic3d/imaging/image.hpp"
#include "imic3d/imaging/pinhole.hpp"
#include "imic3d/mesh/mesh.hpp"

namespace imic3d::correlation {

/// A camera whose pose is given in the rig's frame, and its reference image.
struct RigView {
  imaging::PinholeCamera camera;
  imaging::Image reference;
  std::string name = "camera";
};

/// A point of the mesh and where a camera sees it.
struct PlacedPoint {
  double x, y;         ///< [length]
  double column, row;  ///< [px]
};

struct PoseOptions {
  int camera = 0;                ///< the one that the points were read in
  double point_deviation = 1.0;  ///< standard deviation of the points [px]
  bool cameras = false;          ///< refine the pose of the cameras but the first one too
  /// shortest wave of the correction of the shape [length]; 0: the specimen is flat
  double shape = 0.0;
};

/// The result, with what it fits. A residual is f_a(P_a X) - f_b(P_b X) of two cameras' references, each with the mean
/// of an element taken out and divided by its standard deviation there: sqrt(2) for images that have nothing in common.
struct SpecimenPose {
  imaging::Pose pose;                           ///< from the specimen's frame to the rig's
  std::vector<imaging::PinholeCamera> cameras;  ///< in the specimen's frame
  Eigen::VectorXd shape;                        ///< offset of the nodes along z [length]; zero if not asked for
  /// patches looked for in another camera; those that lie on one plane
  int patches = 0, matched = 0;
  double plane_rms = 0.0;                  ///< distance of the latter from it [length]
  double points_rms = 0.0;                 ///< of the given points, in the end [px]
  double rms_start = 0.0, rms_pose = 0.0;  ///< residual: from points and patches; with the pose refined
  double rms_cameras = 0.0;                ///< with the cameras refined, if asked for
  double rms_shape = 0.0;                  ///< with the shape, if asked for
  /// Change of each camera's pose: rotation vector [degree] (left of its rotation), translation [length].
  std::vector<Eigen::Matrix<double, 6, 1>> camera_change;
};

/// Finds the pose of a mesh (in the plane z = 0, its z towards the cameras). The points alone give a start, parallel to
/// the sensors; patches of one camera's image that are found in another's, triangulated, give the plane; Gauss-Newton
/// on the residual of every pair of cameras over the mesh (gain and offset per element), from coarse images to fine
/// ones, gives the pose. A flat specimen may glide in its plane without the residual noticing: the points hold it
/// there. Cameras: their poses but the first's move too, held by 0.1 degree and a thousandth of the distance: the
/// images say nothing of the rig's scale. With one camera the points alone give all (at least 4, the more perspective
/// the better). Throws InputError (points too few, on a line or mirrored, no part of the image found in another).
[[nodiscard]] SpecimenPose find_pose(const mesh::Mesh& surface, std::span<const RigView> views,
                                     std::span<const PlacedPoint> points, const PoseOptions& options);

/// The point nearest to the rays of several cameras (weighted alike) and the largest distance to one of them [length].
struct Triangulated {
  Eigen::Vector3d point;
  double gap;
};
[[nodiscard]] Triangulated triangulate(std::span<const imaging::PinholeCamera> cameras,
                                       std::span<const Eigen::Vector2d> pixels);

}  // namespace imic3d::correlation
