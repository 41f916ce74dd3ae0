#include "rig_mistakes.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <vector>

#include "imic3d/core/error.hpp"

namespace imic3d::app {
namespace {

using correlation::RigView;
using imaging::PinholeCamera;
using imaging::Pose;

PinholeCamera in_unit(const PinholeCamera& camera, double factor) {
  Pose pose = camera.pose();
  pose.translation *= factor;
  return {camera.intrinsics(), pose};
}

PinholeCamera of_images(const PinholeCamera& camera, double factor) {
  auto lens = camera.intrinsics();
  for (double* number : {&lens.fx, &lens.fy, &lens.cx, &lens.cy, &lens.skew}) *number *= factor;
  return {lens, camera.pose()};
}

}  // namespace

void require_different(std::span<const RigView> views) {
  for (std::size_t b = 1; b < views.size(); ++b)
    for (std::size_t a = 0; a < b; ++a) {
      if (views[a].reference.grey == views[b].reference.grey)
        throw InputError(fmt::format("cameras.{}.images", views[b].name),
                         fmt::format("the same reference as that of {}", views[a].name), "images of another camera");
      const auto &one = views[a].camera.pose(), &other = views[b].camera.pose();
      if (one.rotation == other.rotation && one.translation == other.translation)
        throw InputError(fmt::format("cameras.{}.calibration", views[b].name),
                         fmt::format("the same place as that of {}", views[a].name),
                         "another camera of the calibration (index)");
    }
}

std::string likely_mistake(const mesh::Mesh& face, std::span<const RigView> views,
                           std::span<const correlation::PlacedPoint> points, const correlation::PoseOptions& options,
                           double left) {
  // The points' distance in the end if they agree so [px], else infinite.
  const auto points_left = [&](const std::function<void(std::vector<RigView>&, correlation::PoseOptions&)>& change,
                               double of_points = 1.0) {
    std::vector<RigView> other(views.begin(), views.end());
    correlation::PoseOptions placed = options;
    placed.cameras = false, placed.shape = 0.0;
    change(other, placed);
    std::vector<correlation::PlacedPoint> read(points.begin(), points.end());
    for (auto& point : read) point.column *= of_points, point.row *= of_points;
    try {
      const auto pose = correlation::find_pose(face, other, read, placed);
      if (pose.rms_pose < std::min(0.5, 0.5 * left) && pose.points_rms < std::max(1.0, 3.0 * options.point_deviation))
        return pose.points_rms;
    } catch (const InputError&) {  // no pose at all
    }
    return static_cast<double>(INFINITY);
  };
  const auto agree = [&](const auto& change, double of_points = 1.0) {
    return std::isfinite(points_left(change, of_points));
  };
  const auto of_all = [](const auto& change) {
    return [change](std::vector<RigView>& other, correlation::PoseOptions&) {
      for (auto& view : other) view.camera = change(view.camera);
    };
  };
  const bool inverse_agrees = agree([](auto& other, auto&) {
    const Pose first = other.front().camera.pose();
    for (std::size_t c = 1; c < other.size(); ++c)
      other[c].camera = {other[c].camera.intrinsics(), inverse(other[c].camera.pose() * inverse(first)) * first};
  });
  if (views.size() == 2) {
    const auto exchange_cameras = [](std::vector<RigView>& other, correlation::PoseOptions&) {
      std::swap(other[0].camera, other[1].camera);
    };
    // With their images exchanged, too, the points were read in those of the other.
    const double of_cameras = points_left(exchange_cameras), of_pictures = points_left([&](auto&other, auto&placed) {
                                                               exchange_cameras(other, placed),
                                                                   placed.camera = 1 - placed.camera;
                                                             });
    if (const double least = std::min(of_cameras, of_pictures); std::isfinite(least))
      return fmt::format(
          "with {}{} and {} exchanged{} they agree{}", of_pictures < of_cameras ? "the images of " : "", views[0].name,
          views[1].name, of_pictures < of_cameras ? "" : " in the calibration",
          inverse_agrees ? ", and with rotations and translations the other way round (from a camera to the first one)"
                         : "");  // of lenses that are alike these are the same
    if (agree([](auto& other, auto&) {
          const PinholeCamera first = other[0].camera, second = other[1].camera;
          other[0].camera = {second.intrinsics(), first.pose()}, other[1].camera = {first.intrinsics(), second.pose()};
        }))
      return fmt::format(
          "with the lenses of {} and {} exchanged in the calibration, their places as they are, they agree",
          views[0].name, views[1].name);
  }
  if (inverse_agrees)
    return "with rotations and translations the other way round (from a camera to the first one) they agree";
  if (agree([](auto& other, auto&) {
        const Pose first = other.front().camera.pose();
        for (std::size_t c = 1; c < other.size(); ++c) {
          Pose to_it = other[c].camera.pose() * inverse(first);
          to_it.rotation.transposeInPlace();
          other[c].camera = {other[c].camera.intrinsics(), to_it * first};
        }
      }))
    return "with the rotations transposed, the translations as they are, they agree";
  for (const double factor : {1e-3, 1e3, 1.0 / 25.4, 25.4})
    if (agree(of_all([factor](const PinholeCamera& camera) { return in_unit(camera, factor); })))
      return fmt::format("with the lengths of the calibration times {:.4g} they agree: is it in another unit?", factor);
  for (const double factor : {0.5, 2.0}) {
    const auto of_all_images = of_all([factor](const PinholeCamera& camera) { return of_images(camera, factor); });
    if (agree(of_all_images))
      return fmt::format("with a calibration for images {:g} times as large they agree", factor);
    if (agree(of_all_images, factor))
      return fmt::format("with a calibration and points for images {:g} times as large they agree", factor);
    for (std::size_t c = 0; c < views.size(); ++c)
      if (agree([&](auto& other, auto&) { other[c].camera = of_images(other[c].camera, factor); }))
        return fmt::format("with a calibration of {} for images {:g} times as large they agree", views[c].name, factor);
  }
  return {};
}

}  // namespace imic3d::app
