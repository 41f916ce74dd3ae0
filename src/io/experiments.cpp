#include "imic3d/io/experiments.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <cmath>
#include <fstream>

#include "delimited.hpp"
#include "imic3d/core/error.hpp"

namespace imic3d::io {

CurveTable read_curve(const std::filesystem::path& file, const CurveColumns& columns) {
  constexpr std::size_t most_mistakes = 20;
  std::vector<std::string> wanted = {columns.strain, columns.stress};
  if (!columns.time.empty()) wanted.push_back(columns.time);
  std::error_code error;
  std::ifstream stream(file);
  if (!stream || std::filesystem::is_directory(file, error))
    throw InputError(file.string(), "cannot be read", "a table with a header row");

  std::vector<std::string> header, first;
  std::vector<std::size_t> place;
  std::vector<std::vector<double>> values(wanted.size());
  std::vector<Mistake> mistakes;
  char separator = ',';
  std::string line;
  for (int number = 1; std::getline(stream, line); ++number) {
    if (number == 1 && line.starts_with("\xEF\xBB\xBF")) line.erase(0, 3);
    if (trimmed(line).empty() || trimmed(line).starts_with('#')) continue;
    if (place.empty()) {
      separator = separator_of(line);
      header = fields_of(line, separator).value_or(std::vector<std::string>{});
      for (const auto& name : wanted) {
        const auto found = std::find(header.begin(), header.end(), name);
        if (found != header.end()) place.push_back(static_cast<std::size_t>(found - header.begin()));
      }
      if (place.size() < wanted.size()) place.clear();
      if (first.empty() || header.size() > first.size()) first = header;
      continue;
    }
    const auto fields = fields_of(line, separator);
    for (std::size_t i = 0; i < wanted.size(); ++i) {
      const auto text = fields && place[i] < fields->size() ? (*fields)[place[i]] : std::string();
      const auto value = parsed<double>(text);
      values[i].push_back(value.value_or(std::nan("")));
      if (std::isfinite(values[i].back())) continue;
      mistakes.push_back({fmt::format("{}:{} column \"{}\"", file.string(), number, wanted[i]),
                          text.empty() ? "nothing" : text, "a finite number"});
    }
  }
  if (place.empty())
    throw InputError(
        file.string(), fmt::format("no row with the columns \"{}\"", fmt::join(wanted, "\", \"")),
        first.empty() ? "a table with a header row" : fmt::format("columns of \"{}\"", fmt::join(first, "\", \"")));
  if (mistakes.empty() && values[0].size() < 3)
    throw InputError(file.string(), fmt::format("{} rows", values[0].size()), "three rows or more");
  if (mistakes.size() > most_mistakes) mistakes.resize(most_mistakes);
  if (!mistakes.empty()) throw InputError(mistakes);
  const auto vector = [](const std::vector<double>& list) {
    return Eigen::VectorXd(Eigen::Map<const Eigen::VectorXd>(list.data(), static_cast<Eigen::Index>(list.size())));
  };
  CurveTable table{vector(values[0]), vector(values[1]), {}};
  if (wanted.size() > 2) table.time = vector(values[2]);
  return table;
}

}  // namespace imic3d::io
