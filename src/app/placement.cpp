#include "placement.hpp"

#include <fmt/format.h>

#include <cmath>
#include <utility>

#include "imic3d/core/error.hpp"
#include "imic3d/core/linear.hpp"
#include "imic3d/core/log.hpp"
#include "imic3d/imaging/placement.hpp"

namespace imic3d::app {

namespace {

constexpr double unlikely_points = 0.3;       // rms that careful picking does not leave [px]
constexpr double unlikely_pixel_size = 0.03;  // relative difference
constexpr double unlikely_eccentricity = 0.03;
constexpr double least_extent = 30.0;  // of the mesh in the image, the longer side [px]

std::vector<std::string> doubts_of(const io::CameraCase& declared, const imaging::Placement& found) {
  std::vector<std::string> doubts;
  if (found.rms > unlikely_points)
    doubts.push_back(
        fmt::format("cameras.{}.place.points: they lie {:.2f} px (rms) off the affine map that fits them best: one of "
                    "them may be in a wrong place of the specimen or of the image",
                    declared.name, found.rms));
  if (found.eccentricity > unlikely_eccentricity)
    doubts.push_back(
        fmt::format("cameras.{}.place.points make the image {:.0f} % larger in one direction than across it: one of "
                    "them may be in a wrong place of the specimen or of the image",
                    declared.name, 100.0 * found.eccentricity));
  if (declared.pixel_size > 0.0 && std::abs(declared.pixel_size / found.pixel_size - 1.0) > unlikely_pixel_size)
    doubts.push_back(
        fmt::format("cameras.{}.pixel_size is {:.4g} where the points make it {:.4g}, which is what is used: are they "
                    "and the mesh in the units of the case file?",
                    declared.name, declared.pixel_size, found.pixel_size));
  for (const auto& doubt : doubts) spdlog::warn("{}", doubt);
  return doubts;
}

std::vector<std::vector<Eigen::Vector2d>> contours_of(const mesh::Mesh& surface) {
  std::vector<std::vector<Eigen::Vector2d>> contours;
  for (const auto& contour : mesh::contours(surface)) {
    contours.emplace_back();
    for (int node : contour) contours.back().push_back(surface.nodes.row(node).head<2>().transpose());
  }
  return contours;
}

/// A place that the outline alone tells, of an image that may be turned by quarters and mirrored.
struct OutlinePlace {
  double rotation;  ///< that the search began with [degree]
  bool mirrored;    ///< the image, to what is declared
  imaging::Placement placement;
};

/// The image shows an edge at most of the outline, and nearly all of these agree.
bool is_clear(const imaging::Placement& found) {
  return found.agreeing > 0.9 * found.visible && found.visible > 0.7 * found.tried && found.rms < 1.0;
}

/// The one with which most edge points agree, as it is declared if no other has a tenth more; nothing where the outline
/// tells none. With the declared pixel size, or with any.
std::optional<OutlinePlace> by_outline(const io::CameraCase& declared, const mesh::Mesh& surface,
                                       const imaging::Image& reference, bool flip, bool any_size) {
  std::optional<OutlinePlace> best;
  for (const double turn : {0.0, 180.0, 90.0, -90.0}) {
    for (const bool mirrored : {false, true}) try {
        imaging::OutlineOptions options;
        options.rotation = std::remainder(declared.place.rotation + turn, 360.0), options.flip = flip != mirrored;
        if (!any_size && declared.pixel_size > 0.0) options.pixel_size = declared.pixel_size;
        const auto found = imaging::place_by_outline(reference, contours_of(surface), options);
        if (!best || found.agreeing > 1.1 * best->placement.agreeing) best = {options.rotation, mirrored, found};
      } catch (const InputError&) {
      }
    if (best && is_clear(best->placement)) break;
  }
  return best;
}

/// The place in words, and what the case file has to say to have it.
std::string described(const io::CameraCase& declared, const OutlinePlace& place) {
  const auto& found = place.placement;
  const Eigen::Vector2d origin = found.camera.project(Eigen::Vector3d::Zero());
  const bool other_size = declared.pixel_size > 0.0 && std::abs(declared.pixel_size / found.pixel_size - 1.0) > 2e-3;
  return fmt::format(
      "place{}: {:.5g} is the length of a pixel, the origin lies at ({:.1f}, {:.1f}), turned by {:.2f} degrees. "
      "place: {{auto: outline{}{}}}{} takes these ({} of {} edge points agree, rms {:.2f} px)",
      place.mirrored ? " in the mirrored image" : "", found.pixel_size, origin.x(), origin.y(), found.rotation,
      place.rotation == 0.0 ? "" : fmt::format(", rotation: {:g}", place.rotation),
      place.mirrored != declared.place.flip ? ", flip: true" : "", other_size ? " without pixel_size" : "",
      found.agreeing, found.visible, found.rms);
}

// An outline is looked for up to a tenth of the mesh's longer side off, and doubted from a hundredth on.
constexpr double farthest = 0.1, far = 0.01, far_px = 2.5;

/// Nodes in the image [nodes x 2, px].
Eigen::MatrixX2d positions_of(const mesh::Mesh& surface, const imaging::Camera& camera) {
  Eigen::MatrixX2d at(surface.nodes.rows(), 2);
  for (Eigen::Index i = 0; i < at.rows(); ++i) at.row(i) = camera.project(surface.nodes.row(i).transpose()).transpose();
  return at;
}

double longer_side(const Eigen::MatrixX2d& positions) {
  return (positions.colwise().maxCoeff() - positions.colwise().minCoeff()).maxCoeff();
}

/// A place that was declared, where the image shows the specimen's outline elsewhere.
std::vector<std::string> doubts_of(const io::CameraCase& declared, const mesh::Mesh& surface,
                                   const imaging::Image& reference, const imaging::TelecentricCamera& camera,
                                   bool flip) {
  const Eigen::MatrixX2d here = positions_of(surface, camera);
  const double longer = longer_side(here);
  const auto beside = [&](const imaging::TelecentricCamera& eye) {
    return (positions_of(surface, eye) - here).rowwise().norm().maxCoeff();
  };
  const auto near = imaging::outline_near(reference, contours_of(surface), camera, std::max(12.0, farthest * longer));
  const double allowed = std::max(far_px, far * longer);
  const bool amiss = near && beside(near->camera) >= allowed;
  if (near && !amiss && is_clear(*near)) return {};
  const auto best = by_outline(declared, surface, reference, flip, amiss);
  const bool elsewhere = best && is_clear(best->placement) && beside(best->placement.camera) >= allowed &&
                         (!near || best->placement.agreeing > 1.1 * near->agreeing);
  if (!amiss && !elsewhere) return {};
  std::vector<std::string> doubts = {fmt::format(
      "cameras.{}.place: the outline in the reference {}, and {}", declared.name,
      amiss ? fmt::format("lies up to {:.1f} px beside the mesh's", beside(near->camera))
            : "is not where the mesh has it",
      best ? "tells another " + described(declared, *best)
           : "alone does not tell where the mesh belongs (place.points does): is the image mirrored, upside down or "
             "turned (place.flip, place.rotation)?")};
  spdlog::warn("{}", doubts.front());
  return doubts;
}

/// The outline's place; `doubts` are of one that fits better if the image is turned or mirrored.
imaging::TelecentricCamera place_by_outline(const io::CameraCase& declared, const mesh::Mesh& surface,
                                            const imaging::Image& reference, bool flip,
                                            std::vector<std::string>& doubts) {
  imaging::OutlineOptions options;
  if (declared.pixel_size > 0.0) options.pixel_size = declared.pixel_size;
  options.rotation = declared.place.rotation;
  options.flip = flip;
  try {
    const auto found = imaging::place_by_outline(reference, contours_of(surface), options);
    spdlog::info(
        "placed by the outline: {} of {} edge points agree, rms {:.2f} px; {:.6g} per pixel, turned by {:.3f} degrees",
        found.agreeing, found.visible, found.rms, found.pixel_size, found.rotation);
    if (is_clear(found)) return found.camera;
    const auto best = by_outline(declared, surface, reference, flip, false);
    if (best && is_clear(best->placement) && best->placement.agreeing > 1.1 * found.agreeing) {
      doubts.push_back(
          fmt::format("cameras.{}.place: {} of {} edge points agree with the outline, which tells another {}",
                      declared.name, found.agreeing, found.visible, described(declared, *best)));
      spdlog::warn("{}", doubts.back());
    }
    return found.camera;
  } catch (const InputError& error) {
    auto mistakes = error.mistakes();
    const auto best = by_outline(declared, surface, reference, flip, false);
    for (auto& one : mistakes) {
      one.place = fmt::format("cameras.{}.{}", declared.name, one.place);
      if (best)
        one.allowed +=
            fmt::format("; of an image that is turned or mirrored the outline tells a {}", described(declared, *best));
    }
    throw InputError(std::move(mistakes));
  }
}

}  // namespace

PlacedCamera place_camera(const io::CameraCase& declared, const mesh::Mesh& surface, const imaging::Image& reference) {
  const auto& place = declared.place;
  std::vector<std::string> doubts;
  imaging::TelecentricCamera camera;
  const bool flip = place.flip != (declared.face == "back");  // the back is seen from the other side
  if (!place.automatic.empty()) {
    camera = place_by_outline(declared, surface, reference, flip, doubts);
  } else if (!place.points.empty()) {
    const auto found = imaging::place_by_points(place.points, flip);
    spdlog::info(
        "placed by {} points, rms {:.2f} px; {:.6g} per pixel, {:.2g} % more in one direction than across it, turned "
        "by {:.3f} degrees",
        place.points.size(), found.rms, found.pixel_size, 100.0 * found.eccentricity, found.rotation);
    doubts = doubts_of(declared, found);
    camera = found.camera;
  } else {
    camera = imaging::camera_from_pose(declared.pixel_size, Eigen::Vector2d((*place.origin)[0], (*place.origin)[1]),
                                       place.rotation, flip);
  }
  std::vector<Eigen::Vector3d> nodes;
  for (Eigen::Index i = 0; i < surface.nodes.rows(); ++i) nodes.push_back(surface.nodes.row(i).transpose());
  const Eigen::MatrixX2d positions = positions_of(surface, camera);
  const Eigen::Vector2d extent = (positions.colwise().maxCoeff() - positions.colwise().minCoeff()).transpose();
  if (extent.maxCoeff() < least_extent)
    throw InputError(
        fmt::format("cameras.{}.place", declared.name),
        fmt::format("a mesh that covers {:.2g} x {:.2g} px of an image of {} x {}", extent.x(), extent.y(),
                    reference.width, reference.height),
        fmt::format("{:g} px and more on its longer side: are the mesh and pixel_size in the units of the case file?",
                    least_extent));
  if (auto mistakes =
          imaging::check_on_image(camera, nodes, reference.header(), fmt::format("cameras.{}.place", declared.name));
      !mistakes.empty())
    throw InputError(std::move(mistakes));
  if (place.automatic.empty())
    for (auto& doubt : doubts_of(declared, surface, reference, camera, flip)) doubts.push_back(std::move(doubt));
  return {camera, std::move(doubts)};
}

std::string doubt_outline(const std::string& name, const mesh::Mesh& surface, const imaging::Image& reference,
                          const imaging::Camera& camera) {
  constexpr double straight = 1.0;  // what perspective may leave of an affine map [px, rms]
  const Eigen::MatrixX2d here = positions_of(surface, camera);
  Eigen::MatrixX3d plane(here.rows(), 3);
  plane << surface.nodes.leftCols(2), Eigen::VectorXd::Ones(here.rows());
  const Eigen::MatrixXd map = least_squares(plane, here);  // [3 x 2]
  if ((plane * map - here).rowwise().norm().squaredNorm() > straight * straight * static_cast<double>(here.rows()))
    return {};
  imaging::TelecentricCamera from_afar;
  from_afar.linear.leftCols<2>() = map.topRows(2).transpose(), from_afar.offset = map.row(2).transpose();
  const double longer = longer_side(here);
  const auto found =
      imaging::outline_near(reference, contours_of(surface), from_afar, std::max(12.0, farthest * longer));
  // Ends inside the material have no edge, and sides that a leaning camera sees are no outline of the face.
  if (!found || found->agreeing < 0.8 * found->visible || found->visible < 0.5 * found->tried) return {};
  const Eigen::MatrixX2d beside = positions_of(surface, found->camera) - positions_of(surface, from_afar);
  const double most = beside.rowwise().norm().maxCoeff();
  if (most < std::max(far_px, far * longer)) return {};
  return fmt::format(
      "specimen.place: the outline in the reference of camera {} lies up to {:.1f} px beside the mesh's, in the mean "
      "by "
      "({:+.1f}, {:+.1f}) px ({} of {} edge points agree): were specimen.place.points read there?",
      name, most, beside.col(0).mean(), beside.col(1).mean(), found->agreeing, found->visible);
}

}  // namespace imic3d::app
