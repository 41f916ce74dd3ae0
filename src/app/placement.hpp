#pragma once
#include "imic3d/imaging/camera.hpp"
#include "imic3d/imaging/image.hpp"
#include "imic3d/io/case.hpp"
#include "imic3d/mesh/mesh.hpp"

namespace imic3d::app {
/// The camera that `place` in the case file describes. Throws InputError.
[[nodiscard]] imaging::TelecentricCamera place_camera(const io::CameraCase& declared, const mesh::Mesh& surface,
                                                      const imaging::Image& reference);
}  // namespace imic3d::app
