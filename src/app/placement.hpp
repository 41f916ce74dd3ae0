#pragma once
#include <string>
#include <vector>

#include "imic3d/imaging/camera.hpp"
#include "imic3d/imaging/image.hpp"
#include "imic3d/io/case.hpp"
#include "imic3d/mesh/mesh.hpp"

namespace imic3d::app {
struct PlacedCamera {
  imaging::TelecentricCamera camera;
  /// of points that do not fit one another, or the declared size of a pixel; said in the log, too
  std::vector<std::string> doubts;
};
/// The camera that `place` in the case file describes. Throws InputError.
[[nodiscard]] PlacedCamera place_camera(const io::CameraCase& declared, const mesh::Mesh& surface,
                                        const imaging::Image& reference);
/// What is to be said where the image shows the specimen's outline beside where a camera in space, to which it was
/// placed by points, sees the mesh's: along a flat specimen nothing else holds it. Empty where it lies there, or is not
/// seen clearly.
[[nodiscard]] std::string doubt_outline(const std::string& name, const mesh::Mesh& surface,
                                        const imaging::Image& reference, const imaging::Camera& camera);
}  // namespace imic3d::app
