#pragma once
// The load record of a test: time and force of each frame.

#include <filesystem>
#include <string>
#include <vector>

namespace imic3d::io {

/// Names of the columns of a load record.
struct LoadColumns {
  std::string image = "frame";            ///< frame number (an integer, ascending)
  std::string time = "time_s";            ///< time, never decreasing (static frames may share one)
  std::string force = "force_N";          ///< force
  std::string image_file = "image_file";  ///< file of the image, empty where there is none; the column may be absent
};

/// One row of the record.
struct LoadRecord {
  int frame = 0;
  double time = 0.0;            ///< [time]
  double force = 0.0;           ///< [force], already scaled
  std::filesystem::path image;  ///< resolved against the record's folder; empty if none is named
  int line = 0;                 ///< of the file, from 1
};

/// Reads a table with a header row, separated by comma, semicolon or tab (then the decimal sign may be a comma), with quoted fields, `#` comment lines
/// and, below the header, perhaps a row of units in brackets, which is passed over.
/// Throws InputError with every mistake and its line and column: a column that is not there, something that is not a
/// finite number, a time that decreases, a frame that comes twice or out of order.
[[nodiscard]] std::vector<LoadRecord> read_loads(const std::filesystem::path& file, const LoadColumns& columns = {},
                                                 double force_scale = 1.0);

/// Undoes a recorder that follows the force F by dr/dt = (F - r) / lag: F = r + lag dr/dt, the slope of the parabola
/// through three rows (of the line through two at the ends). Every row serves, with an image or not. Rows whose times
/// coincide with their neighbours' keep their force.
void remove_lag(std::vector<LoadRecord>& records, double lag);

}  // namespace imic3d::io
