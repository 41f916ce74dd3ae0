// imic3d calibrate: cameras from the images of a flat target. Rank 0 does the work.

#include "imic3d/imaging/calibrate.hpp"

#include <fmt/format.h>

#include "imic3d/app/program.hpp"
#include "imic3d/core/log.hpp"
#include "imic3d/imaging/image.hpp"
#include "imic3d/io/calibration_report.hpp"

namespace imic3d::app {

namespace {

imaging::CameraSightings sightings_of(const io::CalibrationCase::Camera& camera, const imaging::Target& target) {
  imaging::CameraSightings seen{.name = camera.name, .width = camera.width, .height = camera.height, .pixels = {}};
  for (const auto& file : camera.images) {
    seen.pixels.push_back(imaging::find_target(target, imaging::read_image(file)));
    if (seen.pixels.back().empty()) spdlog::warn("  {}: the target is not found, the image is left out", file.string());
  }
  return seen;
}

void run_calibration(const CommandOptions& options) {
  const io::CalibrationCase request = io::read_calibration_case(options.case_file);
  const auto folder = options.output.empty() ? request.output : options.output;
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) throw InputError(folder.string(), "cannot be made: " + error.message(), "a folder that can be written to");
  begin_log_file(folder / "log.txt");
  spdlog::info("{}: {} camera{}, {} images each", request.title, request.cameras.size(),
               request.cameras.size() > 1 ? "s" : "", request.cameras[0].images.size());
  std::vector<imaging::CameraSightings> sightings;
  for (const auto& camera : request.cameras) sightings.push_back(sightings_of(camera, request.target));
  const imaging::RigCalibration result = imaging::calibrate_rig(request.target, sightings, request.terms);
  for (std::size_t c = 0; c < sightings.size(); ++c) {
    std::size_t found = 0;
    for (const auto& pixels : sightings[c].pixels) found += !pixels.empty();
    spdlog::info("  {}: target found in {} of {} images, reprojection error {:.4f} px rms", sightings[c].name, found,
                 sightings[c].pixels.size(), result.rms_of(c));
  }
  spdlog::info("reprojection error {:.4f} px rms of all, {} iterations", result.rms, result.iterations);
  imaging::write_calibration(folder / "calibration.yaml", result.cameras, request.unit);
  const io::CalibrationRun run{.request = request,
                               .sightings = sightings,
                               .result = result,
                               .program = version_text().substr(0, version_text().find('\n'))};
  io::write_calibration_result(folder / "result.json", run);
  io::write_calibration_page(folder / "calibration.html", run);
  fmt::print("{}\n", (folder / "calibration.yaml").string());
}

}  // namespace

void calibrate(const Communicator& world, const CommandOptions& options) {
  collectively(world, [&] {
    if (world.is_root()) run_calibration(options);
  });
}

}  // namespace imic3d::app
