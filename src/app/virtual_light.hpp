#pragma once
// The light of a virtual test: what planted effects make of the grey levels of its images.

#include <memory>
#include <string>

#include "imic3d/imaging/synthesis.hpp"
#include "imic3d/mesh/mesh.hpp"
#include "test_effects.hpp"

namespace imic3d::app {

/// Of one camera. Frames are those of PlantedEffects, -1 the reference.
class VirtualLight {
 public:
  /// `reference`: rendered without noise. `other`: a speckle like the specimen's, in the frame of the image. Throws
  /// InputError: more saturated pixels than there are.
  VirtualLight(const PlantedEffects& planted, std::string name, std::shared_ptr<const imaging::Camera> camera,
               const mesh::Mesh& surface, const imaging::Image& reference,
               std::shared_ptr<const imaging::Texture> other);

  /// Changes the image of the surface at `moved` [nodes x 3, length], rendered without noise; the factor on its noise.
  [[nodiscard]] double operator()(int frame, const Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>& moved,
                                  imaging::Image& image) const;

 private:
  const PlantedEffects& planted_;
  std::string name_;  // of the camera
  std::shared_ptr<const imaging::Camera> camera_;
  const mesh::Mesh& surface_;
  std::shared_ptr<const imaging::Texture> other_;
  imaging::PixelPoints in_plane_;                                      // of the nodes [length]
  double exposure_ = 1.0, mean_ = 0.0, variance_ = 0.0, flake_ = 1.0;  // of the reference; a flake has 8 pixels
};

}  // namespace imic3d::app
