#pragma once
// The file that says which images of a target calibrate which cameras.

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "imic3d/imaging/target.hpp"

namespace imic3d::io {

struct CalibrationCase {
  std::filesystem::path file;
  std::string text;  ///< of the file
  std::string title;
  imaging::Target target;
  std::string unit = "mm";
  struct Camera {
    std::string name;
    std::vector<std::filesystem::path> images;  ///< [frames]
    int width = 0, height = 0;                  ///< [px]
  };
  std::vector<Camera> cameras;
  std::vector<int> terms;  ///< free distortion terms: positions in Intrinsics::distortion
  std::filesystem::path output;
};

/// Reads and checks the file and the images' headers. Throws InputError with everything that is wrong.
[[nodiscard]] CalibrationCase read_calibration_case(const std::filesystem::path& file);

/// inputs/calibration.schema.json as the program was built with it.
[[nodiscard]] std::string_view calibration_schema();

}  // namespace imic3d::io
