#pragma once
// Uniform tests: stress-strain curves as a laboratory recorded them.

#include <Eigen/Core>
#include <filesystem>
#include <string>
#include <vector>

namespace imic3d::io {

/// Names of the columns of a curve; the time may be absent.
struct CurveColumns {
  std::string strain = "strain", stress = "stress", time;
};

/// The columns of a curve as they were recorded [rows].
struct CurveTable {
  Eigen::VectorXd strain, stress, time;  ///< time: empty if no column of that name was asked for
};

/// Reads a table separated by comma, semicolon or tab. The header is the first line that names all the columns; what a
/// laboratory wrote before it is passed over. Throws InputError with every mistake and its line and column.
[[nodiscard]] CurveTable read_curve(const std::filesystem::path& file, const CurveColumns& columns);

}  // namespace imic3d::io
