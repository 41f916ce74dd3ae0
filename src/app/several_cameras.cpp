#include "several_cameras.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>
#include <numbers>

#include "imic3d/app/output.hpp"
#include "imic3d/app/setup.hpp"
#include "imic3d/core/log.hpp"
#include "imic3d/correlation/global_dic.hpp"
#include "imic3d/io/pictures.hpp"
#include "imic3d/io/report.hpp"
#include "imic3d/io/run_results.hpp"
#include "rig.hpp"

namespace imic3d::app {
namespace {

using correlation::DicFrame;
using correlation::GlobalDic;

/// What the specimen did as a whole.
struct Motion {
  Eigen::Vector3d translation;  // of the middle of the nodes [length]
  Eigen::Vector3d rotation;     // vector [degree]
  Eigen::Vector3d strain;       // mean Green-Lagrange strain in the surface: xx, yy, xy
  double out_of_plane;          // mean of u_z [length]
  double bending;               // rms of what is left of u_z when the rigid motion is taken out [length]
};

Motion motion_of(const mesh::Mesh& surface, const Eigen::VectorXd& U, int dofs) {
  const Eigen::Index n = surface.nodes.rows();
  Eigen::Matrix3Xd X = surface.nodes.transpose(), u = Eigen::Matrix3Xd::Zero(3, n);
  for (Eigen::Index i = 0; i < n; ++i)
    for (int a = 0; a < dofs; ++a) u(a, i) = U[i * dofs + a];
  const Eigen::Vector3d middle = X.rowwise().mean(), shift = u.rowwise().mean();
  X.colwise() -= middle;
  const Eigen::Matrix3Xd x = X + (u.colwise() - shift);
  // Kabsch (1976): the rotation of the best rigid motion.
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(x * X.transpose(), Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Matrix3d R = svd.matrixU() * svd.matrixV().transpose();
  if (R.determinant() < 0.0)
    R = svd.matrixU() * Eigen::Vector3d(1.0, 1.0, -1.0).asDiagonal() * svd.matrixV().transpose();
  const Eigen::AngleAxisd turned(R);
  Motion motion{.translation = shift,
                .rotation = turned.angle() * turned.axis() * 180.0 / std::numbers::pi,
                .strain = Eigen::Vector3d::Zero(),
                .out_of_plane = u.row(2).mean(),
                .bending = 0.0};
  motion.bending = std::sqrt((x - R * X).row(2).squaredNorm() / static_cast<double>(n));
  double area = 0.0;
  for (Eigen::Index e = 0; e < surface.cells.rows(); ++e) {
    Eigen::Matrix<double, 3, 4> corner, moved;
    for (int i = 0; i < 4; ++i) corner.col(i) = X.col(surface.cells(e, i)), moved.col(i) = u.col(surface.cells(e, i));
    Eigen::Matrix<double, 4, 2> slopes;
    slopes << -1, -1, 1, -1, 1, 1, -1, 1;
    const Eigen::Matrix2d J = corner.topRows<2>() * slopes / 4.0;
    Eigen::Matrix<double, 3, 2> F = moved * slopes / 4.0 * J.inverse();  // du/dX
    const Eigen::Matrix<double, 3, 2> G = corner * slopes / 4.0 * J.inverse();
    const Eigen::Matrix2d E = 0.5 * ((G + F).transpose() * (G + F) - G.transpose() * G);
    const double part = std::abs(J.determinant());
    motion.strain += part * Eigen::Vector3d(E(0, 0), E(1, 1), E(0, 1)), area += part;
  }
  motion.strain /= area;
  return motion;
}

/// The displacement through the surface of one frame.
void draw_out_of_plane(const std::filesystem::path& picture, const mesh::Mesh& surface, const Eigen::VectorXd& U,
                       const std::string& legend) {
  std::vector<double> positions, values;
  for (Eigen::Index i = 0; i < surface.nodes.rows(); ++i) {
    positions.insert(positions.end(), {surface.nodes(i, 0), -surface.nodes(i, 1)});
    values.push_back(U[3 * i + 2]);
  }
  io::draw_field(picture, surface, positions, values, {.legend = legend, .diverging = false});
}

std::vector<double> all_components(const Eigen::VectorXd& U, int dofs) {
  std::vector<double> all;
  for (Eigen::Index i = 0; i < U.size() / dofs; ++i)
    for (int a = 0; a < 3; ++a) all.push_back(a < dofs ? U[i * dofs + a] : 0.0);
  return all;
}

nlohmann::json numbers(const auto& values) { return std::vector<double>(values.data(), values.data() + values.size()); }

}  // namespace

bool several_cameras(const io::Case& test) {
  return test.cameras.size() > 1 || std::any_of(test.cameras.begin(), test.cameras.end(),
                                                [](const auto& camera) { return camera.model == "pinhole"; });
}

namespace {

void dic_of_face(const Communicator& world, const io::Case& test, const identification::SeenFace& face,
                 const std::filesystem::path& folder) {
  const auto start = std::chrono::steady_clock::now();
  Rig rig = make_rig(test, face.back, surface_of(test, face.back));
  const auto count = rig.views.size();
  const int dofs = face.components;
  std::vector<const io::CameraCase*> cameras;
  for (const int c : rig.cameras) cameras.push_back(&test.cameras[static_cast<std::size_t>(c)]);
  const GlobalDic dic(rig.surface, rig.views, dofs,
                      {.pyramid_levels = test.dic.pyramid_levels,
                       .max_iterations = test.dic.max_iterations,
                       .tolerance = test.dic.tolerance,
                       .regularisation = test.dic.regularisation.value_or(0.0),
                       .low_pass = test.dic.low_pass,
                       .border = test.dic.border,
                       .brightness = test.dic.brightness,
                       .local_brightness = test.dic.local_brightness,
                       .groups = test.dic.groups});
  std::vector<int> places;
  int last = -1;
  for (const auto& camera : test.cameras)
    for (int number : camera.reference) last = std::max(last, test.index_of(number));
  for (int place = last + 1; place < static_cast<int>(test.frames.size()); ++place) places.push_back(place);
  if (places.empty())
    throw InputError("cameras.reference", "no frame comes after the reference", "frames before the last one");

  for (std::size_t c = 0; c < count; ++c) {
    measure_noise(rig, c, dic.correlation(static_cast<int>(c)).quadrature());
    doubt_saturation(test, rig, c, dic.correlation(static_cast<int>(c)).quadrature());
    doubt_bare_places(test, rig, c, dic.correlation(static_cast<int>(c)).quadrature(), dic.noise_response().level);
  }
  std::optional<io::ResultsFile> file;
  collectively(world, [&] {
    if (!world.is_root()) return;
    io::RunPlan plan;
    plan.versions = versions();
    plan.surface = &rig.surface;
    file = io::create_results(folder, test, plan);
    for (std::size_t c = 0; c < count; ++c) {
      std::vector<double> pixels;
      for (Eigen::Index i = 0; i < rig.surface.nodes.rows(); ++i) {
        const Eigen::Vector2d pixel = rig.views[c].camera->project(rig.surface.nodes.row(i).transpose());
        pixels.insert(pixels.end(), {pixel[0], pixel[1]});
      }
      const auto& declared = *cameras[c];
      io::draw_mesh_on_image(folder / fmt::format("mesh_on_{}.png", declared.name),
                             declared.images[static_cast<std::size_t>(test.index_of(declared.reference.front()))],
                             rig.surface, pixels);
    }
  });
  spdlog::info("{}: {} frames of {} cameras, {} elements, {} unknowns", test.title, places.size(), count,
               rig.surface.cells.rows(), dic.cameras().unknowns());

  std::vector<std::vector<std::filesystem::path>> images(count);
  for (std::size_t c = 0; c < count; ++c)
    for (int place : places) images[c].push_back(cameras[c]->images[static_cast<std::size_t>(place)]);
  const std::vector<DicFrame> frames = dic.run(world, images, [&](int t, const DicFrame& frame) {
    std::vector<double> rms;
    for (const auto& own : frame.cameras) rms.push_back(own.rms);
    spdlog::info("  frame {}: residual {:.3f} grey levels, {} iterations{}",
                 test.frames[static_cast<std::size_t>(places[static_cast<std::size_t>(t)])], fmt::join(rms, ", "),
                 frame.iterations,
                 frame.lost        ? ", lost"
                 : frame.converged ? ""
                                   : ", not converged");
    if (frame.hardly_seen > 0)
      spdlog::info(
          "    {} nodes are hardly seen by a second camera in this frame: their depth continues the neighbours'",
          frame.hardly_seen);
  });

  // Noise of an image of each camera [grey level]: measured, given, or what the DIC leaves in its best frame.
  std::vector<correlation::ImageNoise> noise;
  for (std::size_t c = 0; c < count; ++c) {
    double smallest = INFINITY;
    for (const DicFrame& frame : frames)
      if (frame.converged && !frame.lost) smallest = std::min(smallest, frame.cameras[c].rms);
    const double left = smallest / (dic.noise_response().level * std::sqrt(1.0 + 1.0 / rig.references(c)));
    noise.push_back({rig.noise_is_measured[c] ? rig.views[c].noise : left, rig.references(c)});
  }
  if (std::none_of(noise.begin(), noise.end(), [](const auto& one) { return std::isfinite(one.sigma); }))
    throw ConvergenceError("no frame could be correlated with the reference");
  const Eigen::VectorXd deviation = dic.standard_deviation(noise);
  double in_plane = 0.0, out_of_plane = 0.0;  // mean squares
  for (Eigen::Index i = 0; i < deviation.size(); ++i)
    (i % dofs == 2 ? out_of_plane : in_plane) +=
        deviation[i] * deviation[i] / static_cast<double>(deviation.size() / dofs);
  in_plane = std::sqrt(0.5 * in_plane), out_of_plane = std::sqrt(out_of_plane);
  if (!world.is_root()) return;

  nlohmann::json json, table = nlohmann::json::array();
  std::string csv = "frame,converged,iterations";
  for (const auto* camera : cameras) csv += ",rms_" + camera->name;
  const bool epipolar = dic.cameras().epipolar_modes() > 0;
  for (const auto* camera : cameras) csv += epipolar ? ",off_epipolar_" + camera->name : "";
  csv += ",tx,ty,tz,rx_degree,ry_degree,rz_degree,E_xx,E_yy,E_xy,mean_u_z,bending_u_z\n";
  fmt::print(
      "\n{}\n  residual [grey level], motion of the middle [{}], rotation [degree], mean Green-Lagrange strain [1e-6], "
      "u_z beyond the rigid motion\n",
      test.title, test.units.length);
  for (std::size_t t = 0; t < frames.size(); ++t) {
    const DicFrame& frame = frames[t];
    const auto place = static_cast<std::size_t>(places[t]);
    const int number = test.frames[place];
    const bool known = frame.converged && !frame.lost;
    const Eigen::VectorXd nothing =
        Eigen::VectorXd::Constant(frame.displacement.size(), std::numeric_limits<double>::quiet_NaN());
    io::write_dic_frame(*file, place, all_components(known ? frame.displacement : nothing, dofs), frame.rms,
                        {frame.element_rms.data(), static_cast<std::size_t>(frame.element_rms.size())});
    const Eigen::Vector3d unknown = nothing.head<3>();
    const Motion motion = known ? motion_of(rig.surface, frame.displacement, dofs)
                                : Motion{unknown, unknown, unknown, unknown[0], unknown[0]};
    std::vector<double> rms, off(frame.cameras.size(), nothing[0]);
    for (const auto& own : frame.cameras) rms.push_back(own.rms);
    if (known) off = dic.cameras().rms_off_epipolar(frame.epipolar);
    csv += fmt::format(
        "{},{},{},{:.5g}{},{:.8g},{:.6g},{:.6g},{:.8g},{:.6g}\n", number, static_cast<int>(known), frame.iterations,
        fmt::join(rms, ","), epipolar ? fmt::format(",{:.5g}", fmt::join(off, ",")) : "",
        fmt::join(std::span(motion.translation.data(), 3), ","), fmt::join(std::span(motion.rotation.data(), 3), ","),
        fmt::join(std::span(motion.strain.data(), 3), ","), motion.out_of_plane, motion.bending);
    table.push_back({{"frame", number},
                     {"converged", known},
                     {"iterations", frame.iterations},
                     {"residual", rms},
                     {"translation", numbers(motion.translation)},
                     {"rotation_degree", numbers(motion.rotation)},
                     {"mean_strain", numbers(motion.strain)},
                     {"mean_out_of_plane", motion.out_of_plane},
                     {"bending_out_of_plane", motion.bending}});
    if (epipolar) table.back()["off_epipolar"] = off;
    const Eigen::Vector3d micro = 1e6 * motion.strain;
    fmt::print("  {:5}  {:.2f}   {:9.4f}   {:8.4f}   {:8.0f}   {:.4f}{}\n", number, fmt::join(rms, " "),
               fmt::join(std::span(motion.translation.data(), 3), " "),
               fmt::join(std::span(motion.rotation.data(), 3), " "), fmt::join(std::span(micro.data(), 3), " "),
               motion.bending,
               frame.lost ? "   lost"
               : known    ? ""
                          : "   not converged");
    if (const bool drawn = frames.size() <= 12 || t + 1 == frames.size(); drawn && known && dofs == 3)
      draw_out_of_plane(folder / fmt::format("out_of_plane_frame_{:04d}.png", number), rig.surface, frame.displacement,
                        fmt::format("displacement through the surface, frame {} [{}]", number, test.units.length));
    if (frames.size() <= 12 || t + 1 == frames.size())
      for (std::size_t c = 0; c < count; ++c) {
        const auto map =
            residual_map(dic, static_cast<int>(c), dic.spline(imaging::read_image(images[c][t])), frame.displacement,
                         noise[c].sigma * dic.noise_response().level * std::sqrt(1.0 + 1.0 / noise[c].references),
                         dic.cameras().off_epipolar(static_cast<int>(c), frame.epipolar));
        io::draw_map(folder / fmt::format("residual_{}_frame_{:04d}.png", cameras[c]->name, number), map.values,
                     map.columns, map.rows,
                     {.legend = fmt::format("{}: f - g(x + u), frame {} [its noise]", cameras[c]->name, number),
                      .lower = -5.0,
                      .upper = 5.0});
      }
  }
  fmt::print("  standard deviation of a node by the noise: {:.3g} {} in the plane{}\n", in_plane, test.units.length,
             dofs == 3 ? fmt::format(", {:.3g} {} through it", out_of_plane, test.units.length) : std::string());

  json = io::summary(*file);
  json["frame_table"] = table;
  json["standard_deviation"] = {
      {"in_plane", io::quantity(in_plane, test.units.length)},
      {"out_of_plane", io::quantity(dofs == 3 ? out_of_plane : std::nan(""), test.units.length)}};
  for (std::size_t c = 0; c < count; ++c)
    json["noise"][cameras[c]->name] = {{"image", io::quantity(noise[c].sigma, "grey level")},
                                       {"image_is_measured", static_cast<bool>(rig.noise_is_measured[c])}};
  if (rig.placed) {
    const auto& pose = rig.pose;
    json["placement"] = {{"points_rms", io::quantity(pose.points_rms, "px")},
                         {"patches", pose.patches},
                         {"patches_on_plane", pose.matched},
                         {"patches_rms", io::quantity(pose.plane_rms, test.units.length)},
                         {"difference_of_references_start", pose.rms_start},
                         {"difference_of_references", pose.rms_pose},
                         {"rotation", numbers(Eigen::Matrix3d(pose.pose.rotation.transpose()))},
                         {"translation", numbers(pose.pose.translation)}};
    if (test.specimen.place->refine_cameras) {
      json["placement"]["difference_with_cameras_refined"] = pose.rms_cameras;
      for (const auto& change : pose.camera_change) json["placement"]["camera_changes"].push_back(numbers(change));
    }
    if (test.specimen.place->shape > 0.0) {
      json["placement"]["difference_with_shape"] = pose.rms_shape;
      json["placement"]["shape"] = {{"lowest", io::quantity(pose.shape.minCoeff(), test.units.length)},
                                    {"highest", io::quantity(pose.shape.maxCoeff(), test.units.length)}};
    }
  }
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  json["time"] = io::quantity(seconds, "s");
  io::write_json(folder / "result.json", json);
  io::write_text_file(folder / "motion.csv", csv);
  io::draw_pictures(*file, folder);
  auto doubts = test.doubts;
  doubts.insert(doubts.end(), rig.doubts.begin(), rig.doubts.end());
  io::Frames all;
  for (const int place : places) all.push_back(test.frames[static_cast<std::size_t>(place)]);
  if (auto doubt = doubt_off_epipolar(test, rig, dic.cameras(), all, frames); !doubt.empty()) {
    spdlog::warn("{}", doubt);
    doubts.push_back(std::move(doubt));
  }
  io::write_report(folder / "report.html", *file, io::pictures_in(folder), doubts);
  fmt::print("  {:.0f} s; report: {}\n", seconds, (folder / "report.html").string());
}

}  // namespace

void dic_with_several(const Communicator& world, const CommandOptions& options, const io::Case& test) {
  const std::filesystem::path folder = output_folder(test, options, world);
  const auto faces = seen_faces(test);
  for (const auto& face : faces) {
    const auto own = faces.size() == 1 ? folder : folder / (face.back ? "back" : "front");
    collectively(world, [&] {
      if (world.is_root()) std::filesystem::create_directories(own);
    });
    dic_of_face(world, test, face, own);
  }
}

}  // namespace imic3d::app
