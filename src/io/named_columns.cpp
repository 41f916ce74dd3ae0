#include "named_columns.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <fstream>

#include "delimited.hpp"
#include "utf8.hpp"

namespace imic3d::io {

namespace {

/// The line that is the header, or else what is said of the one that comes nearest.
class Header {
 public:
  explicit Header(const std::vector<std::string>& wanted) : wanted_(wanted) {}

  /// Whether this line names all.
  bool read(int line, const std::vector<std::string>& fields) {
    const auto named = std::count_if(wanted_.begin(), wanted_.end(), [&](auto& name) {
      return std::find(fields.begin(), fields.end(), name) != fields.end();
    });
    if (fields_.empty() || named > named_ || (named == named_ && fields.size() > fields_.size()))
      line_ = line, fields_ = fields, named_ = named;
    return named == std::ssize(wanted_);
  }

  [[nodiscard]] const std::vector<std::string>& fields() const { return fields_; }

  [[nodiscard]] std::vector<Mistake> mistakes(const std::filesystem::path& file, const std::string& kind) const {
    if (fields_.empty()) return {{file.string(), "an empty file", kind}};
    if (named_ == 0)
      return {{file.string(), fmt::format("no row with the columns \"{}\"", fmt::join(wanted_, "\", \"")),
               fmt::format("columns of \"{}\"", fmt::join(fields_, "\", \""))}};
    std::vector<Mistake> found;
    for (const auto& name : wanted_) {
      const auto times = std::count(fields_.begin(), fields_.end(), name);
      const auto place = fmt::format("{}:{} column \"{}\"", file.string(), line_, name);
      if (times == 0) found.push_back({place, "not there", fmt::format("one of \"{}\"", fmt::join(fields_, "\", \""))});
      if (times > 1) found.push_back({place, fmt::format("there {} times", times), "once"});
    }
    return found;
  }

 private:
  const std::vector<std::string>& wanted_;
  int line_ = 0;
  std::vector<std::string> fields_;
  std::ptrdiff_t named_ = 0;
};

}  // namespace

void NamedColumns::mistake(const Row& row, std::size_t column, std::string allowed, std::string found) {
  if (found.empty()) found = row.text[column].empty() ? "nothing" : row.text[column];
  mistakes.push_back({fmt::format("{}:{} column \"{}\"", file.string(), row.line, columns[column]), std::move(found),
                      std::move(allowed)});
}

void NamedColumns::refuse() const {
  constexpr std::size_t most = 5;
  auto first = mistakes;
  if (mistakes.size() > most) {
    first.resize(most);
    first.push_back({file.string(), fmt::format("{} more mistakes of this kind", mistakes.size() - most), ""});
  }
  if (!first.empty()) throw InputError(std::move(first));
}

std::optional<double> NamedColumns::number(const Row& row, std::size_t column) const {
  return number_in(row.text[column], separator);
}

NamedColumns read_named_columns(const std::filesystem::path& file, const std::vector<std::string>& wanted,
                                const std::string& kind, const std::vector<std::string>& welcome) {
  std::error_code error;
  std::ifstream stream(file);
  if (!stream || std::filesystem::is_directory(file, error)) throw InputError(file.string(), "cannot be read", kind);

  NamedColumns table{file, wanted, {}, {}, ','};
  table.columns.insert(table.columns.end(), welcome.begin(), welcome.end());
  Header header(wanted);
  std::vector<std::size_t> place;  // of the columns in a row
  std::string line;
  for (int number = 1; std::getline(stream, line); ++number) {
    if (number == 1 && line.starts_with("\xEF\xBB\xBF")) line.erase(0, 3);
    if (number == 1 && (line.starts_with("\xFF\xFE") || line.starts_with("\xFE\xFF")))
      throw InputError(file.string(), "text in UTF-16", "UTF-8");
    line = in_utf8(std::move(line));
    if (trimmed(line).empty() || trimmed(line).starts_with('#')) continue;
    const auto& named = header.fields();
    if (place.empty()) {
      table.separator = separator_of(line);
      if (header.read(number, fields_of(line, table.separator).value_or(std::vector<std::string>{})))
        for (const auto& name : table.columns)
          place.push_back(static_cast<std::size_t>(std::find(named.begin(), named.end(), name) - named.begin()));
      continue;
    }
    const auto fields = fields_of(line, table.separator);
    const auto columns = std::ssize(named);
    if (!fields) {
      table.mistakes.push_back({fmt::format("{}:{}", file.string(), number), "a quote that is not closed", ""});
    } else if (std::ssize(*fields) > columns && std::any_of(fields->begin() + columns, fields->end(),
                                                            [](const std::string& field) { return !field.empty(); })) {
      table.mistakes.push_back(
          {fmt::format("{}:{}", file.string(), number), fmt::format("{} fields", fields->size()),
           fmt::format("{} as in the header{}", columns,
                       table.separator == ',' ? " (where a comma parts fields, the decimal sign is the point)" : "")});
    } else if (!table.rows.empty() || !table.mistakes.empty() || !are_units(*fields, table.separator)) {
      auto& row = table.rows.emplace_back(NamedColumns::Row{number, {}});
      for (const auto at : place) row.text.push_back(at < named.size() && at < fields->size() ? (*fields)[at] : "");
    }
  }
  if (auto mistakes = header.mistakes(file, kind); !mistakes.empty()) throw InputError(std::move(mistakes));
  return table;
}

}  // namespace imic3d::io
