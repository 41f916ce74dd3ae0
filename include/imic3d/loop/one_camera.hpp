#pragma once
// What one of several cameras on a face errs by, and the motion that its rig takes it for.

#include <Eigen/Core>
#include <memory>
#include <string>
#include <vector>

#include "imic3d/imaging/camera.hpp"
#include "imic3d/loop/effect.hpp"
#include "imic3d/mesh/mesh.hpp"

namespace imic3d::loop {

using Pixels = Eigen::Matrix<double, Eigen::Dynamic, 2, Eigen::RowMajor>;  ///< [nodes x 2, px]

/// How one camera of a rig sees the nodes of its face [n].
struct Sight {
  std::string camera;  ///< its name
  Pixels pixels;       ///< where it sees the nodes in the reference
  /// d(pixel)/d(displacement) there, 2 x 3 row by row [n x 6, px/length]
  Eigen::Matrix<double, Eigen::Dynamic, 6, Eigen::RowMajor> slopes;
  Eigen::Vector2d centre;  ///< of its image [px]

  Sight(std::string name, const imaging::Camera& seen_by, const mesh::Mesh& surface,
        const Eigen::Vector2d& image_centre);
  [[nodiscard]] auto slope(Eigen::Index node) const {
    return Eigen::Map<const Eigen::Matrix<double, 2, 3, Eigen::RowMajor>>(slopes.row(node).data());
  }
  /// Pixels for a length of the specimen that lies across the line of sight (rms over the nodes).
  [[nodiscard]] double scale() const;
};

/// The image of one camera as a scene of its own: a plane, in which the specimen has its true size.
class ImagePlane {
 public:
  /// `of_face`: the scene of the face, whose record and times it has.
  ImagePlane(const Sight& sight, const mesh::Mesh& surface, Scene of_face);
  ImagePlane(const ImagePlane&) = delete;
  ImagePlane& operator=(const ImagePlane&) = delete;
  [[nodiscard]] const Scene& scene() const { return scene_; }
  /// What an effect of the camera adds in frame t to pixels that have moved by `motion`.
  [[nodiscard]] Pixels error(const Effect& effect, Effect::Values values, int t, const Pixels& motion) const;

 private:
  double scale_;
  mesh::Mesh plane_;
  Scene scene_;
};

/// An effect of one camera as an effect of its rig: the displacement of each node with three components that carries
/// its errors in the image best, by least squares over all cameras of the face (as in Eq. 16 where the speckle has no
/// direction). Its quantities are those in the camera's image.
[[nodiscard]] std::shared_ptr<const Effect> of_one_camera(std::shared_ptr<const Effect> effect,
                                                          const std::vector<Sight>& sights, std::size_t camera,
                                                          const mesh::Mesh& surface, const Scene& of_face);

}  // namespace imic3d::loop
