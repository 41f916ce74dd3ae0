#pragma once
// Displacement fields that another program correlated: a table of points for each frame.

#include <Eigen/Core>
#include <filesystem>
#include <string>

namespace imic3d::io {

/// Names of the columns of a table of points.
struct PointColumns {
  std::string x = "x", y = "y", u = "u", v = "v";
  std::string valid;  ///< 0 or `false` where the point was lost; none if empty
};

/// The points of one frame at which the displacement is known, in the table's own unit and axes.
struct PointTable {
  /// place in the reference [points x 2], displacement [points x 2]
  Eigen::Matrix<double, Eigen::Dynamic, 2> at, displacement;
};

/// Reads a table separated by comma, semicolon or tab. The header is the first line that names all the columns; what
/// another program wrote before it is passed over. Points without a finite displacement are left out, as it writes them
/// where it is lost. Throws InputError with every mistake and its line and column: a column that is not there, a place
/// or a displacement that is no number.
[[nodiscard]] PointTable read_points(const std::filesystem::path& file, const PointColumns& columns);

}  // namespace imic3d::io
