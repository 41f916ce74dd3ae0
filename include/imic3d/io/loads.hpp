#pragma once
// The load record of a test: time and force of each frame.

#include <filesystem>
#include <string>
#include <vector>

namespace imic3d::io {

/// Names of the columns of a load record, "" for one that is not to be read.
struct LoadColumns {
  std::string image = "frame";            ///< frame number (an integer, ascending); else the rows are numbered from 0
  std::string time = "time_s";            ///< time, never decreasing (static frames may share one)
  std::string force = "force_N";          ///< force; else 0
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

/// Reads a table with a header row, separated by comma, or by semicolon, tab or blanks (then the decimal sign may be a
/// comma), with quoted fields, `#` comment lines, what a laboratory wrote before the header and, below it, perhaps a
/// row of units in brackets. Throws InputError with every mistake and its line and column: a column that is not there,
/// something that is not a finite number, a time that decreases, a frame that comes twice or out of order.
[[nodiscard]] std::vector<LoadRecord> read_loads(const std::filesystem::path& file, const LoadColumns& columns = {},
                                                 double force_scale = 1.0);

/// Undoes a recorder that follows the force F by dr/dt = (F - r) / lag: F = r + lag dr/dt, the slope of the parabola
/// through three rows (of the line through two at the ends). Every row serves, with an image or not. Rows whose times
/// coincide with their neighbours' keep their force.
void remove_lag(std::vector<LoadRecord>& records, double lag);

/// A row for each of `frames` (number, time, image) that lies within the record, whose force is linear between the
/// record's rows; the last one counts where several share a time.
[[nodiscard]] std::vector<LoadRecord> at_frames(const std::vector<LoadRecord>& record, std::vector<LoadRecord> frames);

}  // namespace imic3d::io
