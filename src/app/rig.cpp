#include "rig.hpp"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>

#include "imic3d/app/setup.hpp"
#include "imic3d/core/log.hpp"
#include "imic3d/imaging/calibration.hpp"
#include "imic3d/imaging/noise.hpp"
#include "placement.hpp"
#include "rig_mistakes.hpp"

namespace imic3d::app {
namespace {

imaging::CalibratedCamera calibrated(const io::CameraCase& declared, const imaging::Image& reference) {
  const auto cameras = imaging::read_calibration(declared.calibration);
  if (declared.index >= static_cast<int>(cameras.size()))
    throw InputError(
        "cameras." + declared.name + ".index", fmt::format("{}", declared.index),
        fmt::format("0 to {}: {} has {} cameras", cameras.size() - 1, declared.calibration.string(), cameras.size()));
  const auto& camera = cameras[static_cast<std::size_t>(declared.index)];
  if (camera.width > 0 && (camera.width != reference.width || camera.height != reference.height))
    throw InputError("cameras." + declared.name,
                     fmt::format("images of {} x {} pixels", reference.width, reference.height),
                     fmt::format("{} x {} as calibrated", camera.width, camera.height));
  return camera;
}

/// A principal point far from the middle of the images; else empty. Calibrations that say the size of their images are
/// checked by that.
std::string doubt_principal_point(const std::string& name, const imaging::CalibratedCamera& camera,
                                  const imaging::Image& reference) {
  if (camera.width > 0) return {};
  const auto& lens = camera.intrinsics;
  constexpr double far = 0.25;  // of the image's side; lenses are centred to some percent of it
  if (std::abs(lens.cx / (reference.width - 1) - 0.5) < far && std::abs(lens.cy / (reference.height - 1) - 0.5) < far)
    return {};
  if (lens.fx < 0.1 * reference.width)
    return fmt::format(
        "cameras.{}: a focal length of {:.4g} px, where the images are {} px wide: are focal length and principal "
        "point "
        "in millimetres? They are in pixels",
        name, lens.fx, reference.width);
  return fmt::format(
      "cameras.{}: the principal point of the calibration, ({:.0f}, {:.0f}), lies far from the middle of images of {} "
      "x {} px: is it that of images of another size, or of a part of them?",
      name, lens.cx, lens.cy, reference.width, reference.height);
}

/// Finds the specimen in front of the pinhole cameras; `which` views they are. That is done in a frame of the face, its
/// origin in the face and z towards the cameras.
void place_specimen(Rig& rig, const io::Case& test, const std::vector<correlation::RigView>& pinholes,
                    const std::vector<std::size_t>& which, correlation::PoseOptions options) {
  const auto& place = *test.specimen.place;
  const double side = rig.back ? -1.0 : 1.0;
  imaging::Pose to_face;
  to_face.rotation = Eigen::Vector3d(side, 1.0, side).asDiagonal();
  to_face.translation[2] = -side * rig.surface.nodes.col(2).mean();
  mesh::Mesh face = rig.surface;
  for (Eigen::Index i = 0; i < face.nodes.rows(); ++i)
    face.nodes.row(i) = (to_face.rotation * rig.surface.nodes.row(i).transpose() + to_face.translation).transpose();
  std::vector<correlation::PlacedPoint> points;
  for (const auto& [x, y, column, row] : place.points) points.push_back({side * x, y, column, row});
  options.point_deviation = place.deviation, options.cameras = place.refine_cameras, options.shape = place.shape;
  require_different(pinholes);
  const auto mistake = [&](double left) {
    return pinholes.size() > 1 ? likely_mistake(face, pinholes, points, options, left) : std::string();
  };
  try {
    rig.pose = correlation::find_pose(face, pinholes, points, options);
  } catch (const InputError& error) {
    const auto& said = error.mistakes().front();
    const std::string likely = mistake(INFINITY);
    if (likely.empty()) throw;
    throw InputError(said.place, fmt::format("{}; {}", said.found, likely), said.allowed);
  }
  const auto& pose = rig.pose;
  for (std::size_t k = 0; k < which.size(); ++k)
    rig.views[which[k]].camera =
        std::make_shared<imaging::PinholeCamera>(pose.cameras[k].intrinsics(), pose.cameras[k].pose() * to_face);
  rig.surface.nodes.col(2) += side * pose.shape;
  rig.placed = true;
  spdlog::info("points of the mesh: rms {:.2f} px", pose.points_rms);
  const auto doubt = [&rig](std::string text) {
    spdlog::warn("{}", text);
    rig.doubts.push_back(std::move(text));
  };
  if (const double likely = std::max(0.3, 3.0 * place.deviation); pose.points_rms > likely)
    doubt(
        fmt::format("specimen.place.points: once the images have placed the specimen they lie {:.2f} px (rms) beside "
                    "it, deviation: {:g} lets {:.2g} be: were they read in another image than that of camera {}, or is "
                    "its calibration another one's?",
                    pose.points_rms, place.deviation, likely, pinholes[static_cast<std::size_t>(options.camera)].name));
  const auto& read = rig.views[which[static_cast<std::size_t>(options.camera)]];
  if (auto beside = doubt_outline(pinholes[static_cast<std::size_t>(options.camera)].name, rig.surface, read.reference,
                                  *read.camera);
      !beside.empty())
    doubt(std::move(beside));
  if (pinholes.size() > 1) {
    const std::string unit = test.units.length;
    spdlog::info("{} of {} patches of {} found in the other cameras lie on a plane, rms {:.3g} {}", pose.matched,
                 pose.patches, pinholes[static_cast<std::size_t>(options.camera)].name, pose.plane_rms, unit);
    spdlog::info("difference of the references on the mesh (normalised): {:.3f}, {:.3f} with the pose refined",
                 pose.rms_start, pose.rms_pose);
    for (std::size_t k = 1; k < pinholes.size() && options.cameras; ++k)
      spdlog::info("{:.3f} with the cameras refined: {} turned by {:.4f} degrees, moved by {:.4f} {}", pose.rms_cameras,
                   pinholes[k].name, pose.camera_change[k].head<3>().norm(), pose.camera_change[k].tail<3>().norm(),
                   unit);
    if (options.shape > 0.0)
      spdlog::info("{:.3f} with the shape: from {:.4g} to {:.4g} {} off the plane", pose.rms_shape,
                   pose.shape.minCoeff(), pose.shape.maxCoeff(), unit);
    // images that correlate by 7/8; those of two that have nothing to do with each other differ by sqrt(2)
    constexpr double unlike = 0.5;
    if (const double left = options.shape > 0.0 ? pose.rms_shape
                            : options.cameras   ? pose.rms_cameras
                                                : pose.rms_pose;
        left > unlike) {
      const std::string likely = mistake(left);
      doubt(fmt::format(
          "the references of the cameras differ by {:.2f} of their contrast on the mesh (normalised; {:.2f}: nothing "
          "in common): {}",
          left, std::sqrt(2.0),
          likely.empty()
              ? "are the cameras exchanged in the calibration, is it of another set-up, or of images of another size?"
              : likely));
    }
  }
}

}  // namespace

std::vector<imaging::Image> references_of(const io::Case& test, const io::CameraCase& camera) {
  std::vector<imaging::Image> images;
  for (int number : camera.reference) {
    const auto& file = camera.images[static_cast<std::size_t>(test.index_of(number))];
    images.push_back(imaging::read_image(file));
    if (imaging::of_one_level(images.back()))
      throw InputError(file.string(), "one grey level throughout",
                       fmt::format("a picture of the specimen, as a reference of cameras.{}", camera.name));
  }
  return images;
}

mesh::Mesh surface_of(const io::Case& test, bool back) {
  mesh::Mesh mesh = mesh::read(test.specimen.mesh);
  for (int i = 0; i < test.specimen.refine; ++i) mesh = mesh::refine(mesh);
  if (mesh.type == mesh::CellType::quad4) {
    if (back) mesh.nodes.col(2).array() -= test.specimen.thickness;
    return mesh;
  }
  if (back) return mesh::back_surface(mesh).mesh;
  if (mesh.node_groups.contains(test.specimen.front)) mesh::choose_front(mesh, test.specimen.front);
  return mesh::front_surface(mesh).mesh;
}

double joint_noise(const std::vector<double>& sigma) {
  double inverse = 0.0;
  for (const double one : sigma) inverse += 1.0 / (one * one * static_cast<double>(sigma.size()));
  return 1.0 / std::sqrt(inverse);
}

void measure_noise(Rig& rig, std::size_t view, const correlation::PixelQuadrature& seen) {
  auto& at = rig.views[view];
  if (rig.noise_is_measured[view] || rig.statics[view].size() < 2) return;
  // the dark background has another noise
  const auto mask = correlation::footprint(seen, at.reference.width, at.reference.height);
  at.noise = imaging::noise_of_static_frames(rig.statics[view], &mask);
  rig.noise_is_measured[view] = at.noise > 0.0;
}

void doubt_saturation(const io::Case& test, Rig& rig, std::size_t view, const correlation::PixelQuadrature& seen) {
  constexpr double many = 0.01;  // of a picture with noise a handful of pixels lies at either end
  const auto& image = rig.statics[view].front();
  struct End {
    const char* name;
    float sign, level;
    double pixels;
  };
  End ends[] = {{"largest", 1.0F, -INFINITY, 0.0}, {"smallest", -1.0F, INFINITY, 0.0}};
  double all = 0.0;
  for (const auto& row : seen.rows) {
    all += row.count;
    for (const float level :
         image.row(row.row).subspan(static_cast<std::size_t>(row.column), static_cast<std::size_t>(row.count)))
      for (End& end : ends) {
        if (end.sign * level > end.sign * end.level) end.level = level, end.pixels = 0.0;
        if (level == end.level) end.pixels += 1.0;
      }
  }
  for (const End& end : ends) {
    const double share = end.pixels / std::max(all, 1.0);
    if (share < many || share == 1.0) continue;
    rig.doubts.push_back(fmt::format(
        "cameras.{}: {:.2g} % of the specimen's pixels have the {} grey level of its first reference frame, {:g}: "
        "where a picture is saturated it shows no motion",
        test.cameras[static_cast<std::size_t>(rig.cameras[view])].name, 100.0 * share, end.name, end.level));
    spdlog::warn("{}", rig.doubts.back());
  }
}

void doubt_bare_places(const io::Case& test, Rig& rig, std::size_t view, const correlation::PixelQuadrature& seen,
                       double response) {
  constexpr std::size_t enough = 36;  // pixels that tell whether an element has speckle
  constexpr double no_more = 2.0;     // standard deviation of the grey levels over that of noise
  if (!rig.noise_is_measured[view]) return;
  const double noise = rig.views[view].noise * response / std::sqrt(static_cast<double>(rig.references(view)));
  const Eigen::VectorXd variance = correlation::variance_of_elements(seen);
  int bare = 0;
  Eigen::RowVector2d middle = Eigen::RowVector2d::Zero();
  for (int e = 0; e < seen.elements(); ++e) {
    if (seen.pixels_of(e) < enough || std::sqrt(variance[e]) > no_more * noise) continue;
    ++bare;
    for (int i = 0; i < 4; ++i) middle += 0.25 * rig.surface.nodes.row(rig.surface.cells(e, i)).head<2>();
  }
  if (bare == 0) return;
  middle = (middle.array() / bare).unaryExpr([](double x) { return std::abs(x) < 1e-9 ? 0.0 : x; }).eval();
  rig.doubts.push_back(
      fmt::format("cameras.{}: {} of {} elements show no speckle, but noise, about ({:.3g}, {:.3g}) {}: does the mesh "
                  "cover a hole, a shadow or the background? What moves there is not seen",
                  test.cameras[static_cast<std::size_t>(rig.cameras[view])].name, bare, seen.elements(), middle[0],
                  middle[1], test.units.length));
  spdlog::warn("{}", rig.doubts.back());
}

Rig make_rig(const io::Case& test, bool back, mesh::Mesh surface) {
  Rig rig;
  rig.back = back, rig.surface = std::move(surface), rig.cameras = cameras_of(test, back);
  std::vector<correlation::RigView> pinholes;
  std::vector<std::size_t> which;
  correlation::PoseOptions options;
  for (const int c : rig.cameras) {
    const auto& declared = test.cameras[static_cast<std::size_t>(c)];
    const auto& images = rig.statics.emplace_back(references_of(test, declared));
    correlation::View view{.camera = nullptr,
                           .reference = imaging::average(images),
                           .noise = declared.noise.value_or(0.0),
                           .place = test.cameras.size() == 1 && declared.model != "pinhole"
                                        ? "cameras.place"
                                        : "cameras." + declared.name};
    if (declared.model != "pinhole") {
      const PlacedCamera placed = place_camera(declared, rig.surface, view.reference);
      view.camera = std::make_shared<imaging::TelecentricCamera>(placed.camera);
      rig.doubts.insert(rig.doubts.end(), placed.doubts.begin(), placed.doubts.end());
    } else if (const auto camera = calibrated(declared, view.reference); declared.frame == "specimen") {
      view.camera = std::make_shared<imaging::PinholeCamera>(camera.camera());
    } else {
      if (auto doubt = doubt_principal_point(declared.name, camera, view.reference); !doubt.empty()) {
        spdlog::warn("{}", doubt);
        rig.doubts.push_back(std::move(doubt));
      }
      if (test.specimen.place->camera == declared.name) options.camera = static_cast<int>(pinholes.size());
      pinholes.push_back({camera.camera(), view.reference, declared.name});
      which.push_back(rig.views.size());
    }
    rig.noise_is_measured.push_back(view.noise > 0.0);
    rig.views.push_back(std::move(view));
  }
  if (!pinholes.empty()) place_specimen(rig, test, pinholes, which, options);
  for (std::size_t c = 0; c < rig.views.size() && rig.views.size() > 1; ++c) {
    if (rig.noise_is_measured[c] || rig.statics[c].size() < 2) continue;
    const auto& view = rig.views[c];
    measure_noise(rig, c,
                  correlation::Correlation(rig.surface, view.camera, imaging::BSpline(view.reference),
                                           {.quadrature = {.clip = true, .place = view.place}})
                      .quadrature());
  }
  return rig;
}

namespace {

bool known(const correlation::DicFrame& frame) { return frame.converged && !frame.lost; }

/// What off-epipolar modes in the frames `off` look like, in words: empty where they are few, or neither of two things
/// leaves less than a tenth of their square and a third of what the other leaves.
std::string looks_like(const std::vector<std::string>& names, const correlation::Cameras& cameras,
                       const std::vector<std::size_t>& off, const std::vector<correlation::DicFrame>& frames) {
  constexpr double little = 0.1, less = 1.0 / 3.0;
  if (off.size() < 3) return {};
  Eigen::VectorXd mean = Eigen::VectorXd::Zero(cameras.epipolar_modes());
  double squares = 0.0;
  for (const auto t : off)
    mean += frames[t].epipolar / static_cast<double>(off.size()), squares += frames[t].epipolar.squaredNorm();
  const double left_by_push = 1.0 - static_cast<double>(off.size()) * mean.squaredNorm() / squares;
  // Late by a part of the way from the frame before: its pixels are where that part of the motion has not been made.
  double left_by_delay = 1.0, delay = 0.0;
  std::string late;
  for (int c = 0; c < cameras.size(); ++c) {
    double both = 0.0, of_motion = 0.0;
    for (const auto t : off) {
      std::vector<correlation::InImage> behind(static_cast<std::size_t>(cameras.size()),
                                               correlation::InImage::Zero(cameras.nodes(), 2));
      std::size_t after = t;  // the frame before that is known
      while (after > 0 && !known(frames[after - 1])) --after;
      behind[static_cast<std::size_t>(c)] =
          cameras[c].pixel_displacement(after > 0 ? frames[after - 1].displacement
                                                  : Eigen::VectorXd::Zero(cameras.unknowns())) -
          cameras[c].pixel_displacement(frames[t].displacement);
      const Eigen::VectorXd modes = cameras.epipolar_of(behind);
      both += modes.dot(frames[t].epipolar), of_motion += modes.squaredNorm();
    }
    if (const double left = 1.0 - both * both / (of_motion * squares); both > 0.0 && left < left_by_delay)
      left_by_delay = left, delay = both / of_motion, late = names[static_cast<std::size_t>(c)];
  }
  if (left_by_push < std::min(little, less * left_by_delay))
    return "It is alike in all of them, as if one of them was pushed.";
  if (left_by_delay < std::min(little, less * left_by_push))
    return fmt::format("It is as if the images of {} were about {:.1g} frames behind those of the others.", late,
                       delay);
  return {};
}

}  // namespace

std::string doubt_off_epipolar(const io::Case& test, const Rig& rig, const correlation::Cameras& cameras,
                               const io::Frames& numbers, const std::vector<correlation::DicFrame>& frames) {
  // [px]; a calibrated rig has 0.006 after a strain of 6 % (inputs/gt4_stereo)
  constexpr double allowed = 0.05;
  std::vector<std::size_t> off;
  io::Frames listed;
  std::size_t worst = 0, camera = 0;
  double largest = 0.0;
  std::vector<std::string> names;
  for (const int c : rig.cameras) names.push_back(test.cameras[static_cast<std::size_t>(c)].name);
  for (std::size_t t = 0; t < frames.size(); ++t) {
    if (!known(frames[t])) continue;
    const std::vector<double> rms = cameras.rms_off_epipolar(frames[t].epipolar);
    const auto most = std::max_element(rms.begin(), rms.end());
    if (*most > largest) largest = *most, worst = t, camera = static_cast<std::size_t>(most - rms.begin());
    if (*most > allowed) off.push_back(t), listed.push_back(numbers[t]);
  }
  if (off.empty()) return {};
  const std::string like = looks_like(names, cameras, off, frames);
  return fmt::format(
      "in {} of {} frames the cameras {} see the specimen off their epipolar lines, in the image of {} by {:.2f} px "
      "(rms) in frame {}, where less than {:g} px is usual: {}. {} What they see across these lines is taken off; what "
      "they see along them, which cannot be told from motion, is not",
      off.size(), frames.size(), fmt::join(names, " and "), names[camera], largest, numbers[worst], allowed,
      io::to_text(listed),
      like.empty() ? "One of them was pushed, their images are not of the same moments, or the calibration is wrong."
                   : like);
}

ResidualMap residual_map(const correlation::GlobalDic& dic, int camera, const imaging::BSpline& image,
                         const Eigen::VectorXd& displacement, double sigma, const correlation::InImage& off_epipolar) {
  const auto& correlation = dic.correlation(camera);
  const auto& rows = correlation.quadrature().rows;
  int left = std::numeric_limits<int>::max(), top = left, right = 0, bottom = 0;
  for (const auto& row : rows) {
    left = std::min(left, row.column), right = std::max(right, row.column + row.count);
    top = std::min(top, row.row), bottom = std::max(bottom, row.row + 1);
  }
  ResidualMap map{.columns = right - left, .rows = bottom - top, .values = {}};
  map.values.assign(static_cast<std::size_t>(map.columns) * static_cast<std::size_t>(map.rows), std::nan(""));
  const std::vector<float> residual = correlation.residual(image, displacement, off_epipolar);
  std::size_t p = 0;
  for (const auto& row : rows)
    for (int i = 0; i < row.count; ++i, ++p)
      map.values[static_cast<std::size_t>(row.row - top) * static_cast<std::size_t>(map.columns) +
                 static_cast<std::size_t>(row.column - left + i)] = residual[p] / sigma;
  return map;
}

}  // namespace imic3d::app
