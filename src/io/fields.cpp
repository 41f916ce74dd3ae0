#include "imic3d/io/fields.hpp"

#include <array>
#include <cmath>
#include <vector>

#include "delimited.hpp"
#include "named_columns.hpp"

namespace imic3d::io {

PointTable read_points(const std::filesystem::path& file, const PointColumns& columns) {
  std::vector<std::string> wanted = {columns.x, columns.y, columns.u, columns.v};
  if (!columns.valid.empty()) wanted.push_back(columns.valid);
  NamedColumns table = read_named_columns(file, wanted, "a table of points with a header row");
  std::vector<std::array<double, 4>> points;
  for (const auto& row : table.rows) {
    // Programs write 0, false, -1 or nan for a point that was lost.
    if (wanted.size() > 4 &&
        (row.text[4] == "false" || row.text[4] == "False" || !(table.number(row, 4).value_or(1.0) > 0.0)))
      continue;
    std::array<double, 4> point{};
    bool known = true;
    for (std::size_t i = 0; i < 4; ++i) {
      const auto value = table.number(row, i);
      point[i] = value.value_or(std::nan(""));
      if (std::isfinite(point[i])) continue;
      known = false;
      if (i >= 2 && value) continue;  // nan, inf: lost
      table.mistake(row, i, i < 2 ? "a finite number" : "a number, or nan where it is not known");
    }
    if (known) points.push_back(point);
  }
  table.refuse();
  if (points.empty()) throw InputError(file.string(), "no point with a displacement", "one or more");
  PointTable result;
  result.at.resize(static_cast<Eigen::Index>(points.size()), 2),
      result.displacement.resize(static_cast<Eigen::Index>(points.size()), 2);
  for (std::size_t k = 0; k < points.size(); ++k) {
    const auto row = static_cast<Eigen::Index>(k);
    result.at.row(row) << points[k][0], points[k][1];
    result.displacement.row(row) << points[k][2], points[k][3];
  }
  return result;
}

}  // namespace imic3d::io
