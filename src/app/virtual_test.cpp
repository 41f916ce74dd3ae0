// imic3d virtual: Sec. 4, a virtual test. Simulation -> images by the inverse mapping (Eq. 17) -> loads.csv, truth.json.

#include <fmt/format.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <random>

#include "imic3d/app/output.hpp"
#include "imic3d/app/program.hpp"
#include "imic3d/app/simulation.hpp"
#include "imic3d/core/log.hpp"
#include "imic3d/imaging/placement.hpp"
#include "imic3d/imaging/synthesis.hpp"
#include "several_cameras.hpp"

namespace imic3d::app {

namespace {

/// Gaussian deviates that are the same on every machine (Box-Muller on mt19937_64).
class Gaussian {
 public:
  explicit Gaussian(std::uint64_t seed) : random_(seed) {}
  double operator()() {
    const double u = (static_cast<double>(random_() >> 11U) + 0.5) * 0x1.0p-53, v = static_cast<double>(random_() >> 11U) * 0x1.0p-53;
    return std::sqrt(-2.0 * std::log(u)) * std::cos(2.0 * M_PI * v);
  }

 private:
  std::mt19937_64 random_;
};

imaging::PixelPoints in_pixels(const imaging::TelecentricCamera& camera, const mesh::Mesh& surface, const Eigen::VectorXd& displacement) {
  imaging::PixelPoints pixels(surface.nodes.rows(), 2);
  for (Eigen::Index i = 0; i < surface.nodes.rows(); ++i) {
    Eigen::Vector3d point = surface.nodes.row(i).transpose();
    point.head<2>() += displacement.segment<2>(2 * i);
    pixels.row(i) = camera.project(point).transpose();
  }
  return pixels;
}

}  // namespace

void virtual_test(const Communicator& world, const CommandOptions& options) {
  const io::Case test = read_case(options, {"specimen", "material", "simulate", "virtual", "cameras"}, false);
  require_one_telecentric(test, "virtual");
  const io::VirtualCase& declared = *test.virtual_test;
  const Material material = make_material(test);
  const identification::Specimen specimen = make_specimen(test);
  const auto& view = test.cameras.front();
  if (!view.place.origin || view.pixel_size <= 0.0)
    throw InputError("cameras.place", "not an origin with a pixel_size", "place: {origin: [column, row]} and pixel_size");
  const auto camera = imaging::camera_from_pose(view.pixel_size, Eigen::Vector2d((*view.place.origin)[0], (*view.place.origin)[1]),
                                                view.place.rotation, view.place.flip);
  const auto folder = options.output.empty() ? declared.directory : options.output;
  collectively(world, [&] {
    if (world.is_root()) std::filesystem::create_directories(folder / "images");
  });
  SimulationOutput output(world, folder, test, specimen);

  imaging::SynthesisOptions options_of_images;
  options_of_images.width = declared.size[0];
  options_of_images.height = declared.size[1];
  options_of_images.depth = declared.depth;
  options_of_images.noise = declared.noise;
  options_of_images.seed = declared.seed;
  const double dynamic = declared.depth == 16 ? 65535.0 : 255.0;
  const auto& surface = specimen.surface.mesh;
  const Eigen::VectorXd still = Eigen::VectorXd::Zero(2 * surface.nodes.rows());
  const imaging::PixelPoints reference = in_pixels(camera, surface, still);
  std::unique_ptr<imaging::Texture> texture;
  if (declared.texture)
    texture = std::make_unique<imaging::ImageTexture>(imaging::read_image(*declared.texture));
  else
    texture = std::make_unique<imaging::Speckle>(
        reference.colwise().minCoeff().transpose(), reference.colwise().maxCoeff().transpose(),
        imaging::SpeckleOptions{.diameter = declared.speckle_size, .paint = 0.75 * dynamic, .disk = 0.2 * dynamic, .seed = declared.seed});
  const imaging::Speckle background = imaging::dark_background(options_of_images);

  // Rank 0 writes; the images of the frames are shared out over the ranks as they come.
  Gaussian load_noise(declared.seed + 77);
  std::string loads = fmt::format("frame,time_{},force_{}\n", test.units.time, test.units.force);
  int images = 0;
  const auto image = [&](const Eigen::VectorXd& displacement, double time, double force) {
    loads += fmt::format("{},{:.6g},{:.4f}\n", images, time, force + declared.load_noise * load_noise());
    if (images % world.size() == world.rank()) {
      const imaging::InverseMapping mapping(reference, in_pixels(camera, surface, displacement), surface.cells);
      imaging::write_image(imaging::record(imaging::render(mapping, *texture, background, options_of_images), images, options_of_images),
                           folder / "images" / fmt::format("frame_{:03}.png", images));
    }
    ++images;
  };
  const double start = test.simulate->time.empty() ? 0.0 : test.simulate->time.front();
  for (int i = 0; i < declared.static_frames; ++i) image(still, start, 0.0);
  run_simulation(world, test, specimen, material, [&](int frame, const mechanics::FrameState& state, double force) {
    output.frame(frame, state, force);
    const double time = test.simulate->time.empty() ? frame : test.simulate->time[static_cast<std::size_t>(frame)];
    image(specimen.project(state.displacement), time, force);
  });
  output.finish();
  world.barrier();
  if (!world.is_root()) return;
  io::write_text_file(folder / "loads.csv", loads);
  nlohmann::json truth;
  for (std::size_t j = 0; j < material.values.size(); ++j) truth[material.information[j].name] = material.values[j];
  truth["noise"] = {{"value", declared.noise * dynamic}, {"unit", "grey level"}};
  truth["force_noise"] = {{"value", declared.load_noise}, {"unit", test.units.force}};
  truth["static_frames"] = declared.static_frames;
  io::write_json(folder / "truth.json", truth);
  fmt::print("{}\n  {} images, loads.csv and truth.json in {}\n", test.title, images, folder.string());
}

}  // namespace imic3d::app
