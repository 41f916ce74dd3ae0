#pragma once
// result.json and the page of a calibration.

#include <filesystem>
#include <map>
#include <string>

#include "imic3d/imaging/calibrate.hpp"
#include "imic3d/io/calibration_case.hpp"

namespace imic3d::io {

struct CalibrationRun {
  const CalibrationCase& request;
  const std::vector<imaging::CameraSightings>& sightings;
  const imaging::RigCalibration& result;
  std::string program;  ///< version and revision
};

/// Headline numbers, every camera's numbers with their standard deviations, the error of every image, the images
/// without a target. Throws InputError if the file cannot be written.
void write_calibration_result(const std::filesystem::path& file, const CalibrationRun& run);

/// One self-contained page: the numbers, the error of every image as bars, the residuals over the sensor and every
/// image with its points and its residuals as magnified arrows. Throws InputError if the page cannot be written or an
/// image not read.
void write_calibration_page(const std::filesystem::path& page, const CalibrationRun& run);

}  // namespace imic3d::io
