#pragma once
// Where a specimen's mesh lies in the reference image (Sec. 3.1: "this mesh is glued on the reference image so that its
// contour coincides with the contour of the specimen"): a telecentric camera from numbers, from points, or from the
// specimen's outline and holes as the image shows them.

#include <Eigen/Core>
#include <array>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "imic3d/imaging/camera.hpp"
#include "imic3d/imaging/image.hpp"

namespace imic3d::imaging {

/// A camera and how well it fits what it was found from.
struct Placement {
  TelecentricCamera camera;
  double rms = 0.0;         ///< of the distances of points, or of the edge points that agree [px]
  int agreeing = 0;         ///< points, or edge points of the outline that agree
  int visible = 0;          ///< points given, or points of the outline at which the image shows an edge
  int tried = 0;            ///< points given, or points of the outline at which an edge was looked for
  double pixel_size = 0.0;  ///< mean [length/px]
  double rotation = 0.0;    ///< of the specimen's x axis in the image, counter-clockwise [degree]
  /// relative difference of the two magnifications of an affine fit (0: a similarity)
  double eccentricity = 0.0;
};

/// Without rotation and flip the specimen's x axis points to the right and its y axis upwards in the image. `flip` is a
/// mirrored image: x points to the left. z does not show. Throws InputError (pixel_size not positive).
/// `pixel_size` [length/px], `origin` pixel (column, row) of the mesh's origin, `rotation` of the specimen in the image
/// (before it is mirrored), counter-clockwise as one looks at it [degree].
[[nodiscard]] TelecentricCamera camera_from_pose(double pixel_size, const Eigen::Vector2d& origin,
                                                 double rotation = 0.0, bool flip = false);

/// From points x, y [length], column, row [px]: two points give a similarity (mirrored if `flip`), three or more an
/// affine map by least squares. Throws InputError (fewer than two, points that coincide or lie on one line, three or
/// more that are mirrored where `flip` says they are not, or the other way round).
[[nodiscard]] Placement place_by_points(std::span<const std::array<double, 4>> points, bool flip = false);

struct OutlineOptions {
  std::optional<double> pixel_size = {};  ///< [length/px]; found with the rest if not given
  double rotation = 0.0;                  ///< where the search begins [degree]
  double search = 30.0;                   ///< rotations are searched within +- this of it [degree]
  bool flip = false;                      ///< the image is mirrored
  bool affine = false;                    ///< fit a full affine map in the end instead of a similarity
  double largest_rms = 2.0;               ///< of the edge points that agree [px]; a worse fit is refused
};

/// From the specimen's outline in the reference image: bright on a dark background or the other way round. `contours`
/// are the closed contours of the mesh (outer ones counter-clockwise, holes clockwise) as points [length]; curved parts
/// are taken as smooth through the points. Parts of the outer contour that lie inside the material (a mesh shorter than
/// the specimen) are found to have no edge and do not count. A search on a coarse image is followed by a robust
/// least-squares fit to the sub-pixel position of the edge along the contour's normals.
/// Throws InputError if no place was found, if the outline leaves a movement undetermined (a strip without a hole), or
/// if the mesh does not lie on the image.
[[nodiscard]] Placement place_by_outline(const Image& reference,
                                         const std::vector<std::vector<Eigen::Vector2d>>& contours,
                                         const OutlineOptions& options = {});

/// The outline within `reach` [px] of where a camera that was placed otherwise has it: a similarity that starts from
/// there. Nothing where the image does not show the outline clearly (within a pixel, at 70 % of the points that have an
/// edge, at half of those of a hole), or where the mesh could slide along it.
[[nodiscard]] std::optional<Placement> outline_near(const Image& reference,
                                                    const std::vector<std::vector<Eigen::Vector2d>>& contours,
                                                    const TelecentricCamera& camera, double reach);

/// What is wrong if points of the mesh [length] lie outside the image by more than half a pixel; empty if nothing is.
[[nodiscard]] std::vector<Mistake> check_on_image(const Camera& camera, std::span<const Eigen::Vector3d> points,
                                                  const ImageHeader& image, const std::string& name);

}  // namespace imic3d::imaging
