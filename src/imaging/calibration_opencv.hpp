#pragma once
// Calibrations in OpenCV's file storage (YAML or XML).

#include <filesystem>
#include <string>
#include <vector>

#include "imic3d/imaging/calibration.hpp"

namespace imic3d::imaging {

/// Throws InputError naming file and key.
[[nodiscard]] std::vector<CalibratedCamera> read_opencv_calibration(const std::filesystem::path& file,
                                                                    const std::string& text);

/// Throws InputError if a number is not finite, a focal length not positive or the rotation not one.
void check_camera(const std::string& place, const CalibratedCamera& camera);

}  // namespace imic3d::imaging
