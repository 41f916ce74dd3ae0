#pragma once
// Images: both readers of headers, then the pixels, where the header promises few.

#include <opencv2/core/utils/logger.hpp>

#include "../../src/io/image_files.hpp"
#include "imic3d/imaging/image.hpp"
#include "input_file.hpp"

namespace imic3d::fuzz {

inline void image(const std::uint8_t* data, std::size_t size) {
  cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);
  const auto file = write("image", data, size);
  expect_result_or_input_error([&] { (void)io::read_image_header(file); });
  expect_result_or_input_error([&] {
    const auto header = imaging::read_header(file);
    const double pixels = static_cast<double>(header.width) * header.height;
    if (pixels <= 1e6 || pixels > 1e8)
      (void)imaging::read_image(file);  // more than 1e8 must be refused: no input is so long
  });
}

}  // namespace imic3d::fuzz
