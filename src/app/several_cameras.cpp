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
#include "imic3d/imaging/calibration.hpp"
#include "imic3d/imaging/noise.hpp"
#include "imic3d/io/pictures.hpp"
#include "imic3d/io/report.hpp"
#include "imic3d/io/run_results.hpp"
#include "placement.hpp"

namespace imic3d::app {
namespace {

using correlation::DicFrame;
using correlation::GlobalDic;

mesh::Mesh surface_of(const io::Case& test) {
  mesh::Mesh mesh = mesh::read(test.specimen.mesh);
  for (int i = 0; i < test.specimen.refine; ++i) mesh = mesh::refine(mesh);
  if (mesh.type == mesh::CellType::quad4) return mesh;
  if (mesh.node_groups.contains(test.specimen.front)) mesh::choose_front(mesh, test.specimen.front);
  return mesh::front_surface(mesh).mesh;
}

imaging::PinholeCamera pinhole(const io::CameraCase& declared, const imaging::Image& reference) {
  const auto cameras = imaging::read_calibration(declared.calibration);
  if (declared.index >= static_cast<int>(cameras.size()))
    throw InputError("cameras." + declared.name + ".index", fmt::format("{}", declared.index),
                     fmt::format("0 to {}: {} has {} cameras", cameras.size() - 1, declared.calibration.string(), cameras.size()));
  const auto& camera = cameras[static_cast<std::size_t>(declared.index)];
  if (camera.width > 0 && (camera.width != reference.width || camera.height != reference.height))
    throw InputError("cameras." + declared.name, fmt::format("images of {} x {} pixels", reference.width, reference.height),
                     fmt::format("{} x {} as calibrated", camera.width, camera.height));
  return camera.camera();
}

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
  if (R.determinant() < 0.0) R = svd.matrixU() * Eigen::Vector3d(1.0, 1.0, -1.0).asDiagonal() * svd.matrixV().transpose();
  const Eigen::AngleAxisd turned(R);
  Motion motion{.translation = shift, .rotation = turned.angle() * turned.axis() * 180.0 / std::numbers::pi, .strain = Eigen::Vector3d::Zero(),
                .out_of_plane = u.row(2).mean(), .bending = 0.0};
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

/// The residual of one camera at one frame, in sigma of its noise.
void draw_residual(const std::filesystem::path& picture, const GlobalDic& dic, int camera, const imaging::Image& image, const DicFrame& frame,
                   double sigma, const std::string& legend) {
  const auto& correlation = dic.correlation(camera);
  const auto& rows = correlation.quadrature().rows;
  int left = std::numeric_limits<int>::max(), top = left, right = 0, bottom = 0;
  for (const auto& row : rows) {
    left = std::min(left, row.column), right = std::max(right, row.column + row.count);
    top = std::min(top, row.row), bottom = std::max(bottom, row.row + 1);
  }
  const int columns = right - left, height = bottom - top;
  std::vector<double> map(static_cast<std::size_t>(columns) * static_cast<std::size_t>(height), std::nan(""));
  const std::vector<float> residual = correlation.residual(dic.spline(image), frame.displacement);
  std::size_t p = 0;
  for (const auto& row : rows)
    for (int i = 0; i < row.count; ++i, ++p)
      map[static_cast<std::size_t>(row.row - top) * static_cast<std::size_t>(columns) + static_cast<std::size_t>(row.column - left + i)] = residual[p] / sigma;
  io::draw_map(picture, map, columns, height, {.legend = legend, .lower = -5.0, .upper = 5.0});
}

/// The displacement through the surface of one frame.
void draw_out_of_plane(const std::filesystem::path& picture, const mesh::Mesh& surface, const Eigen::VectorXd& U, const std::string& legend) {
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

/// Finds the specimen in front of the pinhole cameras; `which` views they are.
void place_specimen(Rig& rig, const io::Case& test, const std::vector<correlation::RigView>& pinholes, const std::vector<std::size_t>& which,
                    correlation::PoseOptions options) {
  const auto& place = *test.specimen.place;
  std::vector<correlation::PlacedPoint> points;
  for (const auto& [x, y, column, row] : place.points) points.push_back({x, y, column, row});
  options.point_deviation = place.deviation, options.cameras = place.refine_cameras, options.shape = place.shape;
  auto& pose = rig.pose = correlation::find_pose(rig.surface, pinholes, points, options);
  for (std::size_t k = 0; k < which.size(); ++k) rig.views[which[k]].camera = std::make_shared<imaging::PinholeCamera>(pose.cameras[k]);
  rig.surface.nodes.col(2) += pose.shape;
  spdlog::info("points of the mesh: rms {:.2f} px", pose.points_rms);
  if (pinholes.size() > 1) {
    const std::string unit = test.units.length;
    spdlog::info("{} of {} patches of {} found in the other cameras lie on a plane, rms {:.3g} {}", pose.matched, pose.patches,
                 pinholes[static_cast<std::size_t>(options.camera)].name, pose.plane_rms, unit);
    spdlog::info("difference of the references on the mesh (normalised): {:.3f}, {:.3f} with the pose refined", pose.rms_start, pose.rms_pose);
    for (std::size_t k = 1; k < pinholes.size() && options.cameras; ++k)
      spdlog::info("{:.3f} with the cameras refined: {} turned by {:.4f} degrees, moved by {:.4f} {}", pose.rms_cameras, pinholes[k].name,
                   pose.camera_change[k].head<3>().norm(), pose.camera_change[k].tail<3>().norm(), unit);
    if (options.shape > 0.0)
      spdlog::info("{:.3f} with the shape: from {:.4g} to {:.4g} {} off the plane", pose.rms_shape, pose.shape.minCoeff(), pose.shape.maxCoeff(), unit);
  }
}

nlohmann::json numbers(const auto& values) { return std::vector<double>(values.data(), values.data() + values.size()); }

}  // namespace

bool several_cameras(const io::Case& test) {
  return test.cameras.size() > 1 || std::any_of(test.cameras.begin(), test.cameras.end(), [](const auto& camera) { return camera.model == "pinhole"; });
}

void require_one_telecentric(const io::Case& test, const std::string& command) {
  if (several_cameras(test))
    throw InputError("cameras", fmt::format("{} cameras, the first is {}", test.cameras.size(), test.cameras.front().model),
                     "one telecentric camera for imic3d " + command + " (imic3d dic takes any number, and pinhole cameras)");
}

int unknowns_per_node(const io::Case& test) {
  const bool perspective = std::any_of(test.cameras.begin(), test.cameras.end(), [](const auto& camera) { return camera.model == "pinhole"; });
  return test.cameras.size() > 1 && perspective ? 3 : 2;
}

Rig make_rig(const io::Case& test) {
  Rig rig;
  rig.surface = surface_of(test);
  std::vector<correlation::RigView> pinholes;
  std::vector<std::size_t> which;
  std::vector<std::vector<imaging::Image>> references;
  correlation::PoseOptions options;
  for (const auto& declared : test.cameras) {
    std::vector<imaging::Image> images;
    for (int number : declared.reference) images.push_back(imaging::read_image(declared.images[static_cast<std::size_t>(test.index_of(number))]));
    correlation::View view{.camera = nullptr, .reference = imaging::average(images), .noise = declared.noise.value_or(0.0), .place = "cameras." + declared.name};
    rig.references.push_back(static_cast<int>(images.size()));
    if (declared.model == "pinhole") {
      if (test.specimen.place->camera == declared.name) options.camera = static_cast<int>(pinholes.size());
      pinholes.push_back({pinhole(declared, view.reference), view.reference, declared.name});
      which.push_back(rig.views.size());
    } else {
      view.camera = std::make_shared<imaging::TelecentricCamera>(place_camera(declared, rig.surface, view.reference));
    }
    rig.views.push_back(std::move(view));
    references.push_back(std::move(images));
  }
  if (!pinholes.empty()) place_specimen(rig, test, pinholes, which, options);
  for (std::size_t c = 0; c < rig.views.size(); ++c) {  // on the specimen: the dark background has another noise
    correlation::View& view = rig.views[c];
    if (view.noise == 0.0 && references[c].size() > 1) {
      const correlation::Correlation seen(rig.surface, view.camera, imaging::BSpline(view.reference), {.quadrature = {.clip = true, .place = view.place}});
      const auto mask = correlation::footprint(seen.quadrature(), view.reference.width, view.reference.height);
      view.noise = imaging::noise_of_static_frames(references[c], &mask);
    }
    rig.noise_is_measured.push_back(view.noise > 0.0);
  }
  return rig;
}

void dic_with_several(const Communicator& world, const CommandOptions& options, const io::Case& test) {
  const auto start = std::chrono::steady_clock::now();
  const Rig rig = make_rig(test);
  const auto count = rig.views.size();
  const int dofs = unknowns_per_node(test);
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
  if (places.empty()) throw InputError("cameras.reference", "no frame comes after the reference", "frames before the last one");

  const std::filesystem::path folder = output_folder(test, options, world);
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
      const auto& declared = test.cameras[c];
      io::draw_mesh_on_image(folder / fmt::format("mesh_on_{}.png", declared.name), declared.images[static_cast<std::size_t>(test.index_of(declared.reference.front()))],
                             rig.surface, pixels);
    }
  });
  spdlog::info("{}: {} frames of {} cameras, {} elements, {} unknowns", test.title, places.size(), count, rig.surface.cells.rows(), dic.cameras().unknowns());

  std::vector<std::vector<std::filesystem::path>> images(count);
  for (std::size_t c = 0; c < count; ++c)
    for (int place : places) images[c].push_back(test.cameras[c].images[static_cast<std::size_t>(place)]);
  const std::vector<DicFrame> frames = dic.run(world, images, [&](int t, const DicFrame& frame) {
    std::vector<double> rms;
    for (const auto& own : frame.cameras) rms.push_back(own.rms);
    spdlog::info("  frame {}: residual {:.3f} grey levels, {} iterations{}", test.frames[static_cast<std::size_t>(places[static_cast<std::size_t>(t)])],
                 fmt::join(rms, ", "), frame.iterations, frame.lost ? ", lost" : frame.converged ? "" : ", not converged");
    if (frame.hardly_seen > 0) spdlog::info("    {} nodes are hardly seen by a second camera in this frame: their depth continues the neighbours'", frame.hardly_seen);
  });

  // Noise of an image of each camera [grey level]: measured, given, or what the DIC leaves in its best frame.
  std::vector<correlation::ImageNoise> noise;
  for (std::size_t c = 0; c < count; ++c) {
    double smallest = INFINITY;
    for (const DicFrame& frame : frames)
      if (frame.converged && !frame.lost) smallest = std::min(smallest, frame.cameras[c].rms);
    const double left = smallest / (dic.noise_response().level * std::sqrt(1.0 + 1.0 / rig.references[c]));
    noise.push_back({rig.noise_is_measured[c] ? rig.views[c].noise : left, rig.references[c]});
  }
  if (std::none_of(noise.begin(), noise.end(), [](const auto& one) { return std::isfinite(one.sigma); }))
    throw ConvergenceError("no frame could be correlated with the reference");
  const Eigen::VectorXd deviation = dic.standard_deviation(noise);
  double in_plane = 0.0, out_of_plane = 0.0;  // mean squares
  for (Eigen::Index i = 0; i < deviation.size(); ++i)
    (i % dofs == 2 ? out_of_plane : in_plane) += deviation[i] * deviation[i] / static_cast<double>(deviation.size() / dofs);
  in_plane = std::sqrt(0.5 * in_plane), out_of_plane = std::sqrt(out_of_plane);
  if (!world.is_root()) return;

  nlohmann::json json, table = nlohmann::json::array();
  std::string csv = "frame,converged,iterations";
  for (const auto& camera : test.cameras) csv += ",rms_" + camera.name;
  csv += ",tx,ty,tz,rx_degree,ry_degree,rz_degree,E_xx,E_yy,E_xy,mean_u_z,bending_u_z\n";
  fmt::print("\n{}\n  residual [grey level], motion of the middle [{}], rotation [degree], mean Green-Lagrange strain [1e-6], u_z beyond the rigid motion\n",
             test.title, test.units.length);
  for (std::size_t t = 0; t < frames.size(); ++t) {
    const DicFrame& frame = frames[t];
    const auto place = static_cast<std::size_t>(places[t]);
    const int number = test.frames[place];
    const bool known = frame.converged && !frame.lost;
    const Eigen::VectorXd nothing = Eigen::VectorXd::Constant(frame.displacement.size(), std::numeric_limits<double>::quiet_NaN());
    io::write_dic_frame(*file, place, all_components(known ? frame.displacement : nothing, dofs), frame.rms,
                        {frame.element_rms.data(), static_cast<std::size_t>(frame.element_rms.size())});
    const Eigen::Vector3d unknown = nothing.head<3>();
    const Motion motion = known ? motion_of(rig.surface, frame.displacement, dofs) : Motion{unknown, unknown, unknown, unknown[0], unknown[0]};
    std::vector<double> rms;
    for (const auto& own : frame.cameras) rms.push_back(own.rms);
    csv += fmt::format("{},{},{},{:.5g},{:.8g},{:.6g},{:.6g},{:.8g},{:.6g}\n", number, static_cast<int>(known), frame.iterations, fmt::join(rms, ","),
                       fmt::join(std::span(motion.translation.data(), 3), ","), fmt::join(std::span(motion.rotation.data(), 3), ","),
                       fmt::join(std::span(motion.strain.data(), 3), ","), motion.out_of_plane, motion.bending);
    table.push_back({{"frame", number}, {"converged", known}, {"iterations", frame.iterations}, {"residual", rms}, {"translation", numbers(motion.translation)},
                     {"rotation_degree", numbers(motion.rotation)}, {"mean_strain", numbers(motion.strain)},
                     {"mean_out_of_plane", motion.out_of_plane}, {"bending_out_of_plane", motion.bending}});
    const Eigen::Vector3d micro = 1e6 * motion.strain;
    fmt::print("  {:5}  {:.2f}   {:9.4f}   {:8.4f}   {:8.0f}   {:.4f}{}\n", number, fmt::join(rms, " "), fmt::join(std::span(motion.translation.data(), 3), " "),
               fmt::join(std::span(motion.rotation.data(), 3), " "), fmt::join(std::span(micro.data(), 3), " "), motion.bending, frame.lost ? "   lost" : known ? "" : "   not converged");
    if (const bool drawn = frames.size() <= 12 || t + 1 == frames.size(); drawn && known && dofs == 3)
      draw_out_of_plane(folder / fmt::format("out_of_plane_frame_{:04d}.png", number), rig.surface, frame.displacement,
                        fmt::format("displacement through the surface, frame {} [{}]", number, test.units.length));
    if (frames.size() <= 12 || t + 1 == frames.size())
      for (std::size_t c = 0; c < count; ++c)
        draw_residual(folder / fmt::format("residual_{}_frame_{:04d}.png", test.cameras[c].name, number), dic, static_cast<int>(c), imaging::read_image(images[c][t]),
                      frame, noise[c].sigma * dic.noise_response().level * std::sqrt(1.0 + 1.0 / noise[c].references),
                      fmt::format("{}: f - g(x + u), frame {} [its noise]", test.cameras[c].name, number));
  }
  fmt::print("  standard deviation of a node by the noise: {:.3g} {} in the plane{}\n", in_plane, test.units.length,
             dofs == 3 ? fmt::format(", {:.3g} {} through it", out_of_plane, test.units.length) : std::string());

  json = io::summary(*file);
  json["frame_table"] = table;
  json["standard_deviation"] = {{"in_plane", io::quantity(in_plane, test.units.length)}, {"out_of_plane", io::quantity(dofs == 3 ? out_of_plane : std::nan(""), test.units.length)}};
  for (std::size_t c = 0; c < count; ++c)
    json["noise"][test.cameras[c].name] = {{"image", io::quantity(noise[c].sigma, "grey level")}, {"image_is_measured", static_cast<bool>(rig.noise_is_measured[c])}};
  if (test.specimen.place) {
    const auto& pose = rig.pose;
    json["placement"] = {{"points_rms", io::quantity(pose.points_rms, "px")}, {"patches", pose.patches}, {"patches_on_plane", pose.matched},
                         {"patches_rms", io::quantity(pose.plane_rms, test.units.length)}, {"difference_of_references_start", pose.rms_start},
                         {"difference_of_references", pose.rms_pose}, {"rotation", numbers(Eigen::Matrix3d(pose.pose.rotation.transpose()))},
                         {"translation", numbers(pose.pose.translation)}};
    if (test.specimen.place->refine_cameras) {
      json["placement"]["difference_with_cameras_refined"] = pose.rms_cameras;
      for (const auto& change : pose.camera_change) json["placement"]["camera_changes"].push_back(numbers(change));
    }
    if (test.specimen.place->shape > 0.0) {
      json["placement"]["difference_with_shape"] = pose.rms_shape;
      json["placement"]["shape"] = {{"lowest", io::quantity(pose.shape.minCoeff(), test.units.length)}, {"highest", io::quantity(pose.shape.maxCoeff(), test.units.length)}};
    }
  }
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  json["time"] = io::quantity(seconds, "s");
  io::write_json(folder / "result.json", json);
  io::write_text_file(folder / "motion.csv", csv);
  io::draw_pictures(*file, folder);
  io::write_report(folder / "report.html", *file, io::pictures_in(folder));
  fmt::print("  {:.0f} s; report: {}\n", seconds, (folder / "report.html").string());
}

}  // namespace imic3d::app
