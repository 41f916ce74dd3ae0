#include "placement.hpp"

#include <fmt/format.h>

#include "imic3d/core/error.hpp"
#include "imic3d/core/log.hpp"
#include "imic3d/imaging/placement.hpp"

namespace imic3d::app {

imaging::TelecentricCamera place_camera(const io::CameraCase& declared, const mesh::Mesh& surface,
                                        const imaging::Image& reference) {
  const auto& place = declared.place;
  imaging::TelecentricCamera camera;
  const bool flip = place.flip != (declared.face == "back");  // the back is seen from the other side
  if (!place.automatic.empty()) {
    std::vector<std::vector<Eigen::Vector2d>> contours;
    for (const auto& contour : mesh::contours(surface)) {
      contours.emplace_back();
      for (int node : contour) contours.back().push_back(surface.nodes.row(node).head<2>().transpose());
    }
    imaging::OutlineOptions options;
    if (declared.pixel_size > 0.0) options.pixel_size = declared.pixel_size;
    options.rotation = place.rotation;
    options.flip = flip;
    const auto found = imaging::place_by_outline(reference, contours, options);
    spdlog::info("placed by the outline: {} of {} edge points agree, rms {:.2f} px; {:.6g} per pixel, turned by {:.3f} degrees",
                 found.agreeing, found.visible, found.rms, found.pixel_size, found.rotation);
    camera = found.camera;
  } else if (!place.points.empty()) {
    const auto found = imaging::place_by_points(place.points, flip);
    spdlog::info("placed by {} points, rms {:.2f} px; {:.6g} per pixel, turned by {:.3f} degrees", place.points.size(),
                 found.rms, found.pixel_size, found.rotation);
    camera = found.camera;
  } else {
    camera = imaging::camera_from_pose(declared.pixel_size, Eigen::Vector2d((*place.origin)[0], (*place.origin)[1]),
                                       place.rotation, flip);
  }
  std::vector<Eigen::Vector3d> nodes;
  for (Eigen::Index i = 0; i < surface.nodes.rows(); ++i) nodes.push_back(surface.nodes.row(i).transpose());
  if (auto mistakes = imaging::check_on_image(camera, nodes, reference.header(), "cameras.place"); !mistakes.empty())
    throw InputError(std::move(mistakes));
  return camera;
}

}  // namespace imic3d::app
