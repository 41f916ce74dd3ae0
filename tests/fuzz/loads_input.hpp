#pragma once
// Load records, and the tables of curves and of displacement fields, which share their reader's parts; lists of frames.

#include "imic3d/io/experiments.hpp"
#include "imic3d/io/fields.hpp"
#include "imic3d/io/frames.hpp"
#include "imic3d/io/loads.hpp"
#include "input_file.hpp"

namespace imic3d::fuzz {

inline void loads(const std::uint8_t* data, std::size_t size) {
  const auto file = write("loads.csv", data, size);
  expect_result_or_input_error([&] {
    auto records = io::read_loads(file);
    io::remove_lag(records, 0.5);
  });
  expect_result_or_input_error(
      [&] { (void)io::read_curve(file, {.strain = "strain", .stress = "stress", .time = ""}); });
  expect_result_or_input_error([&] { (void)io::read_points(file, {}); });
  expect_result_or_input_error([&] {
    (void)io::expand(io::parse_frames({reinterpret_cast<const char*>(data), size}));
  });
}

}  // namespace imic3d::fuzz
