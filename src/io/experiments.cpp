#include "imic3d/io/experiments.hpp"

#include <fmt/format.h>

#include <cmath>

#include "delimited.hpp"
#include "named_columns.hpp"

namespace imic3d::io {

CurveTable read_curve(const std::filesystem::path& file, const CurveColumns& columns) {
  std::vector<std::string> wanted = {columns.strain, columns.stress};
  if (!columns.time.empty()) wanted.push_back(columns.time);
  NamedColumns table = read_named_columns(file, wanted, "a table with a header row");
  const auto rows = static_cast<Eigen::Index>(table.rows.size());
  Eigen::MatrixXd values(rows, static_cast<Eigen::Index>(wanted.size()));
  for (Eigen::Index r = 0; r < rows; ++r) {
    const auto& row = table.rows[static_cast<std::size_t>(r)];
    for (std::size_t i = 0; i < wanted.size(); ++i) {
      const double value = table.number(row, i).value_or(std::nan(""));
      values(r, static_cast<Eigen::Index>(i)) = value;
      if (!std::isfinite(value)) table.mistake(row, i, "a finite number");
    }
  }
  table.refuse();
  if (rows < 3) throw InputError(file.string(), fmt::format("{} rows", rows), "three rows or more");
  CurveTable result{values.col(0), values.col(1), {}};
  if (wanted.size() > 2) result.time = values.col(2);
  return result;
}

}  // namespace imic3d::io
