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
}  // namespace imic3d::app
