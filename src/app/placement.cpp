#include "placement.hpp"

#include <cmath>

#include "imic3d/core/error.hpp"

namespace imic3d::app {

imaging::TelecentricCamera place_camera(const io::CameraCase& declared, const mesh::Mesh&, const imaging::Image&) {
  imaging::TelecentricCamera camera;
  const auto& place = declared.place;
  if (!place.origin) throw InputError("cameras.place", "not yet", "origin");
  const double c = std::cos(place.rotation * M_PI / 180.0) / declared.pixel_size, s = std::sin(place.rotation * M_PI / 180.0) / declared.pixel_size;
  camera.linear << (place.flip ? -c : c), -s, 0, (place.flip ? s : -s), -c, 0;
  camera.offset = Eigen::Vector2d((*place.origin)[0], (*place.origin)[1]);
  return camera;
}

}  // namespace imic3d::app
