// imic3d virtual: Sec. 4, a virtual test. Simulation -> images of every camera by the inverse mapping (Eq. 17) ->
// loads.csv, truth.json and the calibrations.

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <cmath>
#include <nlohmann/json.hpp>
#include <random>

#include "calibration_error.hpp"
#include "imic3d/app/output.hpp"
#include "imic3d/app/program.hpp"
#include "imic3d/app/simulation.hpp"
#include "imic3d/core/linear.hpp"
#include "imic3d/core/log.hpp"
#include "imic3d/imaging/calibration.hpp"
#include "imic3d/imaging/placement.hpp"
#include "imic3d/imaging/synthesis.hpp"
#include "test_effects.hpp"
#include "virtual_light.hpp"

namespace imic3d::app {

namespace {

/// Gaussian deviates that are the same on every machine (Box-Muller on mt19937_64).
class Gaussian {
 public:
  explicit Gaussian(std::uint64_t seed) : random_(seed) {}
  double operator()() {
    const double u = (static_cast<double>(random_() >> 11U) + 0.5) * 0x1.0p-53,
                 v = static_cast<double>(random_() >> 11U) * 0x1.0p-53;
    return std::sqrt(-2.0 * std::log(u)) * std::cos(2.0 * M_PI * v);
  }

 private:
  std::mt19937_64 random_;
};

using Points = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;

/// A camera of the test: it records one image a frame.
struct VirtualCamera {
  std::shared_ptr<const imaging::Camera> camera;
  const identification::Face* face;
  imaging::SynthesisOptions image;
  std::filesystem::path folder;
  std::shared_ptr<const imaging::Texture> texture;  // of the face, that of its other cameras too
  imaging::PixelPoints texture_points;              // of the face's nodes
  std::shared_ptr<const imaging::Speckle> background;
  // of the face as this camera shows it [3n x 1 + frames, length]
  Eigen::MatrixXd displacement;
};

/// Where a declared pinhole camera is: it looks from `from` at `at`, y upwards but for its roll.
imaging::PinholeCamera looking(const io::CameraCase& declared, const imaging::SynthesisOptions& image) {
  const io::ViewCase& view = *declared.view;
  const Eigen::Vector3d from(view.from.data()), at(view.at.data()), up = Eigen::Vector3d::UnitY();
  const Eigen::Vector3d z = (at - from).normalized(), x = z.cross(up).normalized();
  if (!z.allFinite() || !x.allFinite())
    throw InputError("cameras." + declared.name + ".view", "no direction, or along y",
                     "from and at that differ in x or z");
  imaging::Pose pose;
  pose.rotation.row(0) = x, pose.rotation.row(1) = z.cross(x), pose.rotation.row(2) = z;
  pose.rotation =
      Eigen::AngleAxisd(view.roll * M_PI / 180.0, Eigen::Vector3d::UnitZ()).toRotationMatrix() * pose.rotation;
  pose.translation = -pose.rotation * from;
  imaging::Intrinsics lens{
      .fx = view.focal, .fy = view.focal, .cx = 0.5 * (image.width - 1), .cy = 0.5 * (image.height - 1)};
  std::copy(view.distortion.begin(), view.distortion.end(), lens.distortion.begin());
  return {lens, pose};
}

std::shared_ptr<const imaging::Camera> make_camera(const io::CameraCase& declared,
                                                   const imaging::SynthesisOptions& image) {
  if (declared.model == "pinhole") {
    if (!declared.view)
      throw InputError("cameras." + declared.name + ".view", "not given", "{focal: …, from: [x, y, z], at: [x, y, z]}");
    return std::make_shared<imaging::PinholeCamera>(looking(declared, image));
  }
  if (!declared.place.origin || declared.pixel_size <= 0.0)
    throw InputError("cameras.place", "not an origin with a pixel_size",
                     "place: {origin: [column, row]} and pixel_size");
  const auto& place = declared.place;
  return std::make_shared<imaging::TelecentricCamera>(
      imaging::camera_from_pose(declared.pixel_size, Eigen::Vector2d((*place.origin)[0], (*place.origin)[1]),
                                place.rotation, place.flip != (declared.face == "back")));
}

/// The speckle of a face is painted in the pixels of its first camera, a perspective one's being those of the face's
/// middle.
imaging::PixelPoints painted(const imaging::Camera& camera, const mesh::Mesh& surface) {
  const Eigen::Vector3d middle = surface.nodes.colwise().mean();
  const Eigen::Matrix<double, 2, 3> J = camera.jacobian(middle);
  imaging::PixelPoints points(surface.nodes.rows(), 2);
  for (Eigen::Index i = 0; i < surface.nodes.rows(); ++i) {
    const Eigen::Vector3d X = surface.nodes.row(i).transpose();
    points.row(i) = (camera.affine() ? camera.project(X) : Eigen::Vector2d(J * (X - middle))).transpose();
  }
  return points;
}

std::vector<VirtualCamera> make_cameras(const io::Case& test, const identification::Specimen& specimen,
                                        const std::filesystem::path& folder) {
  const io::VirtualCase& declared = *test.virtual_test;
  const double dynamic = declared.depth == 16 ? 65535.0 : 255.0;
  std::vector<VirtualCamera> cameras(test.cameras.size());
  for (const auto& face : specimen.faces) {
    const VirtualCamera* first = nullptr;
    for (const int c : cameras_of(test, face.back)) {
      const auto& view = test.cameras[static_cast<std::size_t>(c)];
      VirtualCamera& camera = cameras[static_cast<std::size_t>(c)];
      const auto size = view.size.value_or(declared.size);
      camera.image = {.width = size[0],
                      .height = size[1],
                      .depth = declared.depth,
                      .noise = declared.noise,
                      .seed = declared.seed + 1000 * static_cast<unsigned>(c)};
      camera.folder = folder / (test.cameras.size() == 1 ? "images" : "images_" + view.name);
      camera.face = &face;
      camera.camera = make_camera(view, camera.image);
      camera.background = std::make_shared<imaging::Speckle>(imaging::dark_background(camera.image));
      if (first == nullptr) {
        first = &camera;
        camera.texture_points = painted(*camera.camera, face.surface.mesh);
        if (declared.texture)
          camera.texture = std::make_shared<imaging::ImageTexture>(imaging::read_image(*declared.texture));
        else
          camera.texture = std::make_shared<imaging::Speckle>(camera.texture_points.colwise().minCoeff().transpose(),
                                                              camera.texture_points.colwise().maxCoeff().transpose(),
                                                              imaging::SpeckleOptions{.diameter = declared.speckle_size,
                                                                                      .paint = 0.75 * dynamic,
                                                                                      .disk = 0.2 * dynamic,
                                                                                      .seed = camera.image.seed});
      } else {
        camera.texture = first->texture, camera.texture_points = first->texture_points;
      }
    }
  }
  return cameras;
}

/// The pinhole cameras of each face: a file that `calibration` takes, in the frame of the first of them, and points
/// that specimen.place takes; returns these by the camera's name.
nlohmann::json write_calibrations(const io::Case& test, const std::vector<VirtualCamera>& cameras,
                                  const identification::Specimen& specimen, const std::filesystem::path& folder) {
  nlohmann::json places;
  for (const auto& face : specimen.faces) {
    std::vector<imaging::CalibratedCamera> rig;
    Eigen::VectorXd variances;  // of all numbers of the rig
    imaging::Pose to_specimen;
    for (const int c : cameras_of(test, face.back)) {
      const auto& view = test.cameras[static_cast<std::size_t>(c)];
      const auto* camera =
          dynamic_cast<const imaging::PinholeCamera*>(cameras[static_cast<std::size_t>(c)].camera.get());
      if (camera == nullptr) continue;
      if (rig.empty()) {
        const Eigen::Matrix3d back = camera->pose().rotation.transpose();
        to_specimen = {back, -back * camera->pose().translation};
        const mesh::Mesh& surface = face.surface.mesh;
        const Eigen::RowVector3d low = surface.nodes.colwise().minCoeff(), high = surface.nodes.colwise().maxCoeff();
        const auto& image = cameras[static_cast<std::size_t>(c)].image;
        bool inside = false;
        for (double part = 0.8; !inside && part > 0.1; part *= 0.8) {  // the largest corners that the camera sees
          inside = true;
          auto& points = places[view.name] = nlohmann::json::array();
          for (const auto& [right, top] : {std::pair{0.0, 0.0}, {1.0, 0.0}, {1.0, 1.0}, {0.0, 1.0}}) {
            const double x = part * (low[0] + right * (high[0] - low[0])),
                         y = part * (low[1] + top * (high[1] - low[1]));
            const Eigen::Vector2d pixel = camera->project({x, y, low[2]});
            inside = inside && pixel.minCoeff() > 0.0 && pixel[0] < image.width - 1.0 && pixel[1] < image.height - 1.0;
            points.push_back({x, y, 0.01 * std::round(100.0 * pixel[0]), 0.01 * std::round(100.0 * pixel[1])});
          }
        }
      }
      const auto& image = cameras[static_cast<std::size_t>(c)].image;
      rig.push_back({.name = view.name,
                     .width = image.width,
                     .height = image.height,
                     .intrinsics = camera->intrinsics(),
                     .pose = camera->pose() * to_specimen,
                     .covariance = {}});
      const Eigen::VectorXd deviations = calibration_deviations(view);
      variances.conservativeResize(variances.size() + deviations.size());
      variances.tail(deviations.size()) = deviations.cwiseAbs2();
    }
    for (std::size_t k = 0; k < rig.size() && variances.sum() > 0.0; ++k) {
      const Eigen::MatrixXd all = variances.asDiagonal();
      rig[k].covariance =
          all.middleRows(imaging::camera_numbers * static_cast<Eigen::Index>(k), imaging::camera_numbers);
    }
    if (!rig.empty())
      imaging::write_calibration(folder / fmt::format("calibration_{}.yaml", face.back ? "back" : "front"), rig,
                                 test.units.length);
  }
  return places;
}

/// What one of several cameras errs by moves the nodes across its line of sight [3n x 1 + frames], for its image alone.
void err_alone(const PlantedEffects& planted, const std::string& name, VirtualCamera& camera) {
  const mesh::Mesh& surface = camera.face->surface.mesh;
  const loop::Sight sight(name, *camera.camera, surface,
                          {0.5 * (camera.image.width - 1), 0.5 * (camera.image.height - 1)});
  for (Eigen::Index t = 1; t < camera.displacement.cols(); ++t) {
    const auto now = [&](Eigen::Index i, Eigen::Index frame) -> Eigen::Vector3d {
      return surface.nodes.row(i).transpose() + camera.displacement.col(frame).segment<3>(3 * i);
    };
    loop::Pixels motion(surface.nodes.rows(), 2);
    for (Eigen::Index i = 0; i < motion.rows(); ++i)
      motion.row(i) = (camera.camera->project(now(i, t)) - camera.camera->project(now(i, 0))).transpose();
    const loop::Pixels beyond = planted.pixels_beyond(sight, surface, static_cast<int>(t) - 1, motion);
    for (Eigen::Index i = 0; i < motion.rows(); ++i)
      camera.displacement.col(t).segment<3>(3 * i) +=
          least_squares(camera.camera->jacobian(now(i, t)), beyond.row(i).transpose());
  }
}

/// What each camera shows of the simulated displacement [unknowns x 1 + frames]; puts what the record adds into the
/// force [1 + frames].
void see_effects(const io::Case& test, PlantedEffects& planted, std::vector<VirtualCamera>& cameras,
                 const Eigen::MatrixXd& displacement, Eigen::VectorXd& force) {
  const auto frames = force.size() - 1;
  const bool both = std::any_of(cameras.begin(), cameras.end(),
                                [&](const auto& camera) { return camera.face != cameras.front().face; });
  planted.simulated(force.tail(frames));
  for (auto& camera : cameras) {
    const auto& face = *camera.face;
    camera.displacement = displacement.middleRows(face.first_unknown, 3 * face.nodes());
    if (const auto& name = test.cameras[static_cast<std::size_t>(&camera - cameras.data())].name; planted.has_own(name))
      err_alone(planted, name, camera);
    const std::string side = !both ? "" : face.back ? "back" : "front";
    const auto key = planted.seen(side);
    if (key.empty()) continue;
    const auto* telecentric = dynamic_cast<const imaging::TelecentricCamera*>(camera.camera.get());
    if (telecentric == nullptr) throw InputError("effects." + key, "with a pinhole camera", "telecentric cameras");
    Eigen::MatrixXd seen(2 * face.nodes(), frames);
    for (Eigen::Index t = 0; t < frames; ++t)
      for (Eigen::Index i = 0; i < face.nodes(); ++i)
        seen.col(t).segment<2>(2 * i) =
            camera.displacement.col(t + 1).segment<2>(3 * i) - camera.displacement.col(0).segment<2>(3 * i);
    const Eigen::Matrix2d pixels = telecentric->linear.leftCols<2>();
    const Eigen::Vector2d middle(0.5 * (camera.image.width - 1), 0.5 * (camera.image.height - 1));
    const Eigen::MatrixXd beyond =
        planted.seen_beyond(side, face.surface.mesh, seen, pixels, pixels.inverse() * (middle - telecentric->offset));
    for (Eigen::Index t = 0; t < frames; ++t)
      for (Eigen::Index i = 0; i < face.nodes(); ++i)
        camera.displacement.col(t + 1).segment<2>(3 * i) += beyond.col(t).segment<2>(2 * i);
  }
  force[0] = planted.recorded_still(force[0]);
  force.tail(frames) = planted.recorded(force.tail(frames));
}

}  // namespace

void virtual_test(const Communicator& world, const CommandOptions& options) {
  const io::Case test = read_case(options, {"specimen", "material", "simulate", "virtual", "cameras"}, false);
  const io::VirtualCase& declared = *test.virtual_test;
  const Material material = make_material(test);
  PlantedEffects planted(test);
  const identification::Specimen specimen = make_specimen(test, true, planted.change());
  CommandOptions own = options;
  if (own.output.empty()) own.output = declared.directory;
  const auto folder = output_folder(test, own, world);
  std::vector<VirtualCamera> cameras = make_cameras(test, specimen, folder);
  collectively(world, [&] {
    for (const auto& camera : cameras)
      if (world.is_root()) std::filesystem::create_directories(camera.folder);
  });
  SimulationOutput output(world, folder, test, specimen);

  // The specimen is simulated first: what the record and the camera make of a frame may depend on the others.
  const auto frames = static_cast<Eigen::Index>(test.simulate->value.size()) - 1;
  // of all faces; first at rest
  Eigen::MatrixXd displacement = Eigen::MatrixXd::Zero(specimen.projection.rows(), frames + 1);
  Eigen::VectorXd force = Eigen::VectorXd::Zero(frames + 1);
  run_simulation(
      world, test, specimen, material,
      [&](int frame, const mechanics::FrameState& state, double resultant) {
        output.frame(frame, state, resultant);
        displacement.col(frame) = specimen.project(state.displacement);
        force[frame] = resultant;
      },
      planted.beyond());
  output.finish();
  see_effects(test, planted, cameras, displacement, force);

  std::vector<VirtualLight> lights;
  for (const auto& camera : cameras) {
    if (!planted.lit()) break;
    const mesh::Mesh& surface = camera.face->surface.mesh;
    const imaging::InverseMapping mapping(*camera.camera, camera.texture_points, Points(surface.nodes), surface.cells);
    const double dynamic = declared.depth == 16 ? 65535.0 : 255.0;
    const auto other = std::make_shared<imaging::Speckle>(Eigen::Vector2d(0.0, 0.0),
                                                          Eigen::Vector2d(camera.image.width, camera.image.height),
                                                          imaging::SpeckleOptions{.diameter = declared.speckle_size,
                                                                                  .paint = 0.75 * dynamic,
                                                                                  .disk = 0.2 * dynamic,
                                                                                  .seed = camera.image.seed + 77});
    lights.emplace_back(planted, test.cameras[static_cast<std::size_t>(&camera - cameras.data())].name, camera.camera,
                        surface, imaging::render(mapping, *camera.texture, *camera.background, camera.image), other);
  }

  // Rank 0 writes; the images of the frames are shared out over the ranks.
  Gaussian load_noise(declared.seed + 77);
  std::string loads = fmt::format("frame,time_{},force_{}\n", test.units.time, test.units.force);
  int images = 0, turn = 0;
  const auto image = [&](Eigen::Index frame) {
    const double time = test.simulate->time[static_cast<std::size_t>(frame)];
    loads += fmt::format("{},{:.6g},{:.4f}\n", images, time, force[frame] + declared.load_noise * load_noise());
    for (const auto& camera : cameras) {
      if (turn++ % world.size() != world.rank()) continue;
      const mesh::Mesh& surface = camera.face->surface.mesh;
      const Points moved =
          surface.nodes + Eigen::Map<const Points>(camera.displacement.col(frame).data(), surface.nodes.rows(), 3);
      const imaging::InverseMapping mapping(*camera.camera, camera.texture_points, moved, surface.cells);
      imaging::Image clean = imaging::render(mapping, *camera.texture, *camera.background, camera.image);
      imaging::SynthesisOptions with_noise = camera.image;
      if (!lights.empty())
        with_noise.noise *=
            lights[static_cast<std::size_t>(&camera - cameras.data())](static_cast<int>(frame) - 1, moved, clean);
      imaging::write_image(imaging::record(clean, images, with_noise),
                           camera.folder / fmt::format("frame_{:03}.png", images));
    }
    ++images;
  };
  collectively(world, [&] {
    for (int i = 0; i < declared.static_frames; ++i) image(0);
    for (Eigen::Index frame = 1; frame <= frames; ++frame) image(frame);
  });
  world.barrier();
  if (!world.is_root()) return;
  io::write_text_file(folder / "loads.csv", loads);
  nlohmann::json truth;
  for (std::size_t j = 0; j < material.values.size(); ++j) truth[material.information[j].name] = material.values[j];
  truth["noise"] = {{"value", declared.noise * (declared.depth == 16 ? 65535.0 : 255.0)}, {"unit", "grey level"}};
  truth["force_noise"] = {{"value", declared.load_noise}, {"unit", test.units.force}};
  truth["static_frames"] = declared.static_frames;
  if (const auto effects = planted.truth(); !effects.is_null()) truth["effects"] = effects;
  if (const auto places = write_calibrations(test, cameras, specimen, folder); !places.is_null())
    truth["place_points"] = places;
  io::write_json(folder / "truth.json", truth);
  fmt::print("{}\n  {} images of {} camera{}, loads.csv and truth.json in {}\n", test.title, images, cameras.size(),
             cameras.size() == 1 ? "" : "s", folder.string());
}

}  // namespace imic3d::app
