#include "named_columns.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <fstream>

#include "delimited.hpp"

namespace imic3d::io {

Mistake NamedColumns::mistake(const Row& row, std::size_t column, std::string allowed) const {
  return {fmt::format("{}:{} column \"{}\"", file.string(), row.line, wanted[column]), row.text[column].empty() ? "nothing" : row.text[column], std::move(allowed)};
}

std::optional<double> NamedColumns::number(const Row& row, std::size_t column) const { return number_in(row.text[column], separator); }

NamedColumns read_named_columns(const std::filesystem::path& file, const std::vector<std::string>& wanted, const std::string& kind) {
  std::error_code error;
  std::ifstream stream(file);
  if (!stream || std::filesystem::is_directory(file, error)) throw InputError(file.string(), "cannot be read", kind);

  NamedColumns table{file, wanted, {}, ','};
  std::vector<std::string> longest;
  std::vector<std::size_t> place;
  std::size_t columns = 0;
  std::string line;
  for (int number = 1; std::getline(stream, line); ++number) {
    if (number == 1 && line.starts_with("\xEF\xBB\xBF")) line.erase(0, 3);
    if (trimmed(line).empty() || trimmed(line).starts_with('#')) continue;
    if (place.empty()) {
      table.separator = separator_of(line);
      const auto header = fields_of(line, table.separator).value_or(std::vector<std::string>{});
      for (const auto& name : wanted)
        if (const auto found = std::find(header.begin(), header.end(), name); found != header.end()) place.push_back(static_cast<std::size_t>(found - header.begin()));
      if (place.size() < wanted.size()) place.clear();
      columns = header.size();
      if (header.size() > longest.size()) longest = header;
      continue;
    }
    const auto fields = fields_of(line, table.separator);
    if (table.rows.empty() && fields && are_units(*fields)) continue;
    if (fields && std::any_of(fields->begin() + static_cast<std::ptrdiff_t>(std::min(columns, fields->size())), fields->end(), [](const std::string& field) { return !field.empty(); }))
      throw InputError(fmt::format("{}:{}", file.string(), number), fmt::format("{} fields", fields->size()), fmt::format("{} as in the header{}", columns, table.separator == ',' ? " (where a comma parts fields, the decimal sign is the point)" : ""));
    auto& row = table.rows.emplace_back(NamedColumns::Row{number, std::vector<std::string>(wanted.size())});
    for (std::size_t i = 0; i < wanted.size(); ++i)
      if (fields && place[i] < fields->size()) row.text[i] = (*fields)[place[i]];
  }
  if (place.empty())
    throw InputError(file.string(), fmt::format("no row with the columns \"{}\"", fmt::join(wanted, "\", \"")), longest.empty() ? kind : fmt::format("columns of \"{}\"", fmt::join(longest, "\", \"")));
  return table;
}

void refuse(std::vector<Mistake> mistakes) {
  constexpr std::size_t most = 20;
  if (mistakes.size() > most) mistakes.resize(most);
  if (!mistakes.empty()) throw InputError(std::move(mistakes));
}

}  // namespace imic3d::io
