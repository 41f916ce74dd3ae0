#include "imic3d/io/fields.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <cmath>
#include <fstream>
#include <vector>

#include "delimited.hpp"
#include "imic3d/core/error.hpp"

namespace imic3d::io {

PointTable read_points(const std::filesystem::path& file, const PointColumns& columns) {
  constexpr std::size_t most_mistakes = 20;
  std::vector<std::string> wanted = {columns.x, columns.y, columns.u, columns.v};
  if (!columns.valid.empty()) wanted.push_back(columns.valid);
  std::error_code error;
  std::ifstream stream(file);
  if (!stream || std::filesystem::is_directory(file, error)) throw InputError(file.string(), "cannot be read", "a table of points with a header row");

  std::vector<std::string> first;
  std::vector<std::size_t> place;
  std::vector<std::array<double, 4>> points;
  std::vector<Mistake> mistakes;
  char separator = ',';
  std::string line;
  for (int number = 1; std::getline(stream, line); ++number) {
    if (number == 1 && line.starts_with("\xEF\xBB\xBF")) line.erase(0, 3);
    if (trimmed(line).empty() || trimmed(line).starts_with('#')) continue;
    if (place.empty()) {
      separator = separator_of(line);
      const auto header = fields_of(line, separator).value_or(std::vector<std::string>{});
      for (const auto& name : wanted)
        if (const auto found = std::find(header.begin(), header.end(), name); found != header.end()) place.push_back(static_cast<std::size_t>(found - header.begin()));
      if (place.size() < wanted.size()) place.clear();
      if (header.size() > first.size()) first = header;
      continue;
    }
    const auto fields = fields_of(line, separator);
    const auto text = [&](std::size_t i) { return fields && place[i] < fields->size() ? (*fields)[place[i]] : std::string(); };
    if (wanted.size() > 4 && (text(4) == "false" || text(4) == "False" || parsed<double>(text(4)).value_or(1.0) == 0.0)) continue;
    std::array<double, 4> point{};
    bool known = true;
    for (std::size_t i = 0; i < 4; ++i) {
      const auto value = parsed<double>(text(i));
      point[i] = value.value_or(std::nan(""));
      if (std::isfinite(point[i])) continue;
      known = false;
      if (i >= 2 && value) continue;  // nan, inf: lost
      mistakes.push_back({fmt::format("{}:{} column \"{}\"", file.string(), number, wanted[i]), text(i).empty() ? "nothing" : text(i), i < 2 ? "a finite number" : "a number, or nan where it is not known"});
    }
    if (known) points.push_back(point);
  }
  if (place.empty())
    throw InputError(file.string(), fmt::format("no row with the columns \"{}\"", fmt::join(wanted, "\", \"")),
                     first.empty() ? "a table of points with a header row" : fmt::format("columns of \"{}\"", fmt::join(first, "\", \"")));
  if (mistakes.size() > most_mistakes) mistakes.resize(most_mistakes);
  if (!mistakes.empty()) throw InputError(mistakes);
  if (points.empty()) throw InputError(file.string(), "no point with a displacement", "one or more");
  PointTable table;
  table.at.resize(static_cast<Eigen::Index>(points.size()), 2), table.displacement.resize(static_cast<Eigen::Index>(points.size()), 2);
  for (std::size_t k = 0; k < points.size(); ++k) {
    const auto row = static_cast<Eigen::Index>(k);
    table.at.row(row) << points[k][0], points[k][1];
    table.displacement.row(row) << points[k][2], points[k][3];
  }
  return table;
}

}  // namespace imic3d::io
